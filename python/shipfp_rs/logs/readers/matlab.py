"""MATLAB files (.mat): version 7.3 is HDF5, older ones are read through SciPy."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import Channel, Samples
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.hdf5 import open_hdf5
from shipfp_rs.logs.readers.isolation import in_child
from shipfp_rs.logs.readers.time_base import TIME_NAMES, stated_rate, time_base

CLASSES = (
    "double",
    "single",
    "int8",
    "uint8",
    "int16",
    "uint16",
    "int32",
    "uint32",
    "int64",
    "uint64",
    "logical",
)


@register_reader(".mat")
def open_matlab(path: Path, rate_hz: float | None) -> Log:
    """Open a MATLAB file of any version."""
    with path.open("rb") as file:
        begin = file.read(520)
    is_hdf5 = begin.startswith((b"MATLAB 7.3", b"\x89HDF")) or begin[512:].startswith(b"\x89HDF")
    return (open_hdf5 if is_hdf5 else open_matlab_5)(path, rate_hz)


@in_child("scipy.io", extra="")
def open_matlab_5(path: Path, rate_hz: float | None) -> Log:
    """Open a MATLAB file up to version 7: each vector of numbers is a channel.

    A vector `time` or `t` [s] is the time base of those of its length; a scalar `fs`, `rate_hz` or `dt` is that of all.
    SciPy reads a variable whole, at most 2 GB in these versions; larger logs are saved with -v7.3.
    """
    from scipy.io import loadmat, whosmat

    found = {name: (shape, kind) for name, shape, kind in whosmat(path)}
    whole = _whole_variables(path)
    if whole is not None and len(found) > whole:
        lost = list(found)[whole:]
        warnings.warn(
            f"{path}: cut short within variable {lost[0]!r}; it and all that came after it are lost",
            LogWarning,
            stacklevel=2,
        )
        found = {name: found[name] for name in list(found)[:whole]}
    if not found:
        raise InputError(f"{path}: no variables in it")

    def load(name: str) -> Samples:
        values: Samples = loadmat(path, variable_names=[name], mat_dtype=True)[name].ravel()
        return values.astype(bool) if found[name][1] == "logical" else values

    lengths = {
        name: max(shape)
        for name, (shape, kind) in found.items()
        if kind in CLASSES and len(shape) == 2 and min(shape) == 1
    }
    scalars = [(name, load(name)) for name, length in lengths.items() if length == 1]
    rate = rate_hz or stated_rate(scalars)
    times = {length: name for name, length in lengths.items() if name.lower() in TIME_NAMES and length > 1}
    clocks = {
        length: (0.0, rate) if rate else time_base(path, name, [load(name)], check=True)
        for length, name in times.items()
    }
    channels: list[Channel] = []
    skipped = [name for name in found if name not in lengths]
    for name, length in lengths.items():
        if length == 1 or name in times.values():
            continue
        if length not in clocks and rate is None:
            raise InputError(
                f"{path}: no time base for {name!r}: neither a scalar rate_hz nor a vector time of its {length} "
                "samples; add one or give rate_hz (--rate)"
            )
        start_s, own_rate = clocks.get(length, (0.0, rate))
        channels.append(Channel(name, "", float(own_rate or 0.0), length, start_s))
    if skipped and not channels:
        raise InputError(f"{path}: no vectors of numbers among {', '.join(skipped)}")
    if skipped:
        warnings.warn(
            f"{path}: no vectors of numbers: {', '.join(skipped)}; left out", LogWarning, stacklevel=2
        )

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        samples = load(name)
        for start in range(first, len(samples), size):
            yield samples[start : start + size]

    return Log(str(path), channels, blocks)


def _whole_variables(path: Path) -> int | None:
    """Variables of a version 5 file that were not cut, None for one that was not cut at all.

    SciPy takes a cut for the end of the file. Each variable begins with its type and its length in bytes.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        order = file.read(128)[126:]
        if order not in (b"IM", b"MI"):  # version 4
            return None
        place, count = 128, 0
        while place < size:
            file.seek(place + 4)
            place += 8 + int.from_bytes(file.read(4), "little" if order == b"IM" else "big")
            if place > size:
                return count
            count += 1
    return None
