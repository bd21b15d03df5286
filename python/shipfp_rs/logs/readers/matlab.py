"""MATLAB files (.mat): version 7.3 is HDF5, older ones are read by SciPy."""

from __future__ import annotations

import posixpath
import warnings
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.formats import warn
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.child_process import in_child
from shipfp_rs.logs.readers.columns import (
    VALUES,
    Found,
    Row,
    axis_of,
    blocks_of_rows,
    column_names,
    is_table,
    log_of_found,
    tell_left_out,
    tell_no_time,
    time_of,
    times_among,
)
from shipfp_rs.logs.readers.hdf5 import open_hdf5
from shipfp_rs.logs.readers.time_cells import is_time, split_unit
from shipfp_rs.logs.readers.time_column import even_step


@register_reader(".mat")
def open_matlab(path: Path, rate_hz: float | None) -> Log:
    """Open a MATLAB file of any version."""
    with path.open("rb") as file:
        begin = file.read(520)
    is_hdf5 = begin.startswith((b"MATLAB 7.3", b"\x89HDF")) or begin[512:].startswith(b"\x89HDF")
    return (open_hdf5 if is_hdf5 else open_matlab_5)(path, rate_hz)


@in_child("scipy.io", extra="")
def open_matlab_5(path: Path, rate_hz: float | None) -> Log:
    """Open a MATLAB file up to version 7; vectors and matrix columns, also within structs, are channels."""
    # SciPy reads whole variables, of at most 2 GB in these versions; larger logs are saved with -v7.3.
    tree = _tree(path)
    rows = tree.rows()
    clock = cache(lambda key: axis_of(path, key, rows[key], rows))
    found: list[Found] = []
    timeless: list[Row] = []
    times = times_among(rows)
    for name, row in rows.items():
        if name in times and row.length > 1 and len(rows) > 1:
            continue
        key, beside = time_of(row, rows, tree.scalars)
        rate = rate_hz or beside
        if rate is not None:
            found.append(Found(Channel(name, row.unit, rate, row.length)))
        elif key:
            axis, plan = clock(key)
            found.append(Found.on(axis, name, row.unit, plan))
        else:
            timeless.append(row)
    hint = (
        "; save tables and timeseries as structs (table2struct(T, 'ToScalar', true))" if tree.opaque else ""
    )
    tell_no_time(path, timeless, all_of_them=not found)
    skipped = [*tree.skipped, *("an object" if name == "None" else name for name in tree.opaque)]
    tell_left_out(path, f"no vectors of numbers{hint}", skipped, all_of_them=not found)
    return log_of_found(path, found, blocks_of_rows(path, rows))


def _tree(path: Path) -> _Tree:
    """Read all complete variables of a file, with a warning if it is truncated."""
    from scipy.io import loadmat, whosmat

    try:
        kinds = {name: kind for name, _, kind in whosmat(path)}
    except TypeError:  # MATLAB objects have no shape; SciPy names each object "None"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            kinds = {name: "opaque" if name == "None" else "" for name in loadmat(path)}
    whole = _whole_variables(path)
    if whole is not None and len(kinds) > whole:
        lost = list(kinds)[whole]
        warn(path, f"cut short within variable {lost!r}; it and all that came after it are lost")
        kinds = {name: kinds[name] for name in list(kinds)[:whole]}
    if not kinds:
        raise InputError(f"{path}: no variables in it")
    tree = _Tree()
    for name, kind in kinds.items():
        if kind in ("opaque", "object", "function"):
            tree.opaque.append(name)
        elif name and not name.startswith("__"):
            try:
                with warnings.catch_warnings():
                    # SciPy keeps only the real part.
                    warnings.simplefilter("error", np.exceptions.ComplexWarning)
                    held = loadmat(path, variable_names=[name], mat_dtype=True, struct_as_record=False)
            except np.exceptions.ComplexWarning:
                tree.skipped.append(f"{name} (complex)")
                continue
            tree.add(name, held[name], logical=kind == "logical")
    return tree


class _Tree:
    """Variables of a file; structs are unpacked."""

    def __init__(self) -> None:
        self.held: dict[str, npt.NDArray[Any]] = {}
        self.units: dict[str, str] = {}
        self.words: dict[str, list[str]] = {}
        self.scalars: list[tuple[str, Any]] = []
        self.skipped: list[str] = []
        self.opaque: list[str] = []  # types that SciPy can't open

    def add(self, name: str, content: Any, *, logical: bool = False) -> None:
        """Add a variable; the fields of a struct are added under their paths."""
        array = np.asarray(content)
        fields = getattr(content, "_fieldnames", None)
        if fields is not None:
            for field in fields:
                self.add(f"{name}/{field}", getattr(content, field))
            return
        if array.dtype == object and array.size and hasattr(array.flat[0], "_fieldnames"):
            seen: Counter[str] = Counter()
            for k, item in enumerate(array.flat):
                own = [key for key in ("label", "name", "Name") if key in item._fieldnames]
                label = _word(getattr(item, own[0])) if own else ""
                seen[label] += 1
                label += f" {seen[label]}" if label and seen[label] > 1 else ""
                inner = name if array.size == 1 else f"{name}/{label or k + 1}"
                self.add(inner, item)
            return
        if array.ndim > 2 and array.dtype.kind in "biuf":  # axes of length one, as written by Simulink
            array = np.atleast_2d(np.squeeze(array))
        text = _word(content)
        if text:
            base = posixpath.dirname(name)
            if posixpath.basename(name).lower() in ("unit", "units") and base:
                self.units[base] = text
            else:
                self.skipped.append(name)
        elif array.dtype == object and array.size and all(_word(cell) for cell in array.flat):
            self.words[name] = [_word(cell) for cell in array.flat]
        elif array.dtype.kind in "biuf" and array.size == 1:
            self.scalars.append((name, array.reshape(-1)[0]))
        elif array.dtype.kind in "biuf" and array.ndim == 2 and array.size:
            self.held[name] = array.astype(bool) if logical else array
        else:
            self.skipped.append(name)

    def rows(self) -> dict[str, Row]:
        """Vectors and matrix columns, by name."""
        found: dict[str, Row] = {}
        for name, array in self.held.items():
            if min(array.shape) == 1:
                vector = array.ravel()
                key, unit = self._channel(name), self.units.get(posixpath.dirname(name), "")
                found[key] = _row(key, self.units.get(name) or unit, vector)
                continue
            table = array if array.shape[0] >= array.shape[1] else array.T
            if not is_table(table.shape):
                self.skipped.append(name)
                continue
            above = posixpath.dirname(name)
            beside = {key: words for key, words in self.words.items() if posixpath.dirname(key) == above}
            names = column_names(table.shape[1], beside, posixpath.basename(name))
            for k, heading in enumerate(names):
                own, unit = split_unit(heading)
                key = posixpath.join(above, own) if own not in found else f"{name}/{own}"
                found[key] = _row(key, unit, table[:, k])
        # The first column of a matrix without names may be its time.
        for name, array in self.held.items():
            key = posixpath.join(posixpath.dirname(name), f"{posixpath.basename(name)} 1")
            timed = any(is_time(posixpath.basename(k)) for k in found)
            if key in found and min(array.shape) > 1 and not timed:
                row = found[key]
                if even_step(row.read(0, row.length).astype(np.float64)):
                    del found[key]
                    time = posixpath.join(posixpath.dirname(key), "time")
                    found[time] = Row(time, "", row.length, row.read)
        return found

    def _channel(self, name: str) -> str:
        """Name of a channel: that of the struct if the samples' field has a general name such as `data`."""
        above, last = posixpath.split(name)
        only = [
            key
            for key in self.held
            if posixpath.dirname(key) == above
            and not is_time(posixpath.basename(key))
            and self.held[key].size == self.held[name].size
        ]
        return above if above and last.lower() in VALUES and len(only) == 1 else name


def _row(name: str, unit: str, values: npt.NDArray[Any]) -> Row:
    return Row(name, unit, len(values), lambda start, stop: values[start:stop])


def _word(value: Any) -> str:
    array = np.asarray(value)
    while array.dtype == object and array.size == 1 and isinstance(array.flat[0], np.ndarray):
        array = array.flat[0]
    return str(array.reshape(-1)[0]).strip() if array.dtype.kind in "US" and array.size == 1 else ""


def _whole_variables(path: Path) -> int | None:
    """Number of complete variables in a truncated version 5 file; None if the file is complete."""
    # SciPy mistakes the truncation for the end of the file. Each variable starts with its type and its length in bytes.
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
