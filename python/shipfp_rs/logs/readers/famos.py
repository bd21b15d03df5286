"""imc FAMOS files (.raw, .dat), read by imctermite3."""

from __future__ import annotations

import math
import mmap
import re
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, Channel, Samples, blocks_of, first_of
from shipfp_rs.logs.faults.clock import same_rows
from shipfp_rs.logs.formats import warn
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.child_process import in_child
from shipfp_rs.logs.readers.columns import Found, log_of_found, tell_left_out
from shipfp_rs.logs.time_axis import TimeAxis, time_axis

EPOCH = datetime(1980, 1, 1, tzinfo=UTC)
"""Origin of trigger times. The logger's clock is assumed to be UTC."""
BLOCK_START = re.compile(rb"\|([A-Za-z]{2})\s*,\s*\d+\s*,\s*(\d{1,15})\s*,")
"""Pattern of the start of a block: key, version and length."""


@register_reader(".raw", ".dat")
@in_child("imctermite", extra="famos")
def open_famos(path: Path, rate_hz: float | None) -> Log:
    """Open a FAMOS file; scaled integers become float64, other types stay as recorded."""
    import imctermite

    if not hasattr(imctermite, "ImcTermite"):
        # The older package imctermite has the same module name and another interface.
        raise InputError(
            f"{path}: the installed module imctermite is not imctermite3; pip uninstall imctermite, then "
            "pip install --force-reinstall 'shipfp_rs[famos]'"
        )
    file = imctermite.ImcTermite(str(path))
    found = [channel for channel in file.get_channels_metadata() if channel.kind == "numeric"]
    first = min((channel.absolute_trigger_time for channel in found), default=0.0)
    left = _sample_bytes(path)
    channels: list[Found] = []
    keys: dict[str, tuple[str, Literal["raw", "scaled"]]] = {}
    pairs: dict[str, Samples] = {}
    skipped: list[str] = []
    for channel in found:
        later_s = channel.absolute_trigger_time - first
        if channel.dimension != 1:
            axis, samples = _pair(path, file, channel, later_s)
            if isinstance(axis, str):
                skipped.append(f"{channel.name} ({axis})")
            else:
                pairs[channel.name] = samples
                channels.append(Found.on(axis, channel.name, _unit(channel)))
            continue
        scaled = channel.y_factor != 1.0 or channel.y_offset != 0.0
        keys[channel.name] = (channel.uuid, "scaled" if scaled else "raw")
        even = _even(path, channel, later_s, rate_hz)
        part = next(file.iter_channel_numpy(channel.uuid, include_x=False, chunk_rows=1, mode="raw"), None)
        width = 0 if part is None else int(part["y"].itemsize)
        held, left = left // max(width, 1), left - even.samples * width
        if left < 0:
            even = replace(even, samples=_cut(path, channel.name, even.samples, held, alone=len(found) == 1))
        channels.append(Found(even))
    tell_left_out(path, "pairs of x and y, to be resampled in FAMOS", skipped, all_of_them=not channels)
    counts = {each.channel.name: each.channel.samples for each in channels}
    paired = blocks_of(pairs)

    def rows(name: str, first: int, size: int) -> Iterator[Samples]:
        if name in pairs:
            yield from paired(name, first, size)
            return
        uuid, mode = keys[name]
        chunks = file.iter_channel_numpy(uuid, include_x=False, chunk_rows=size, mode=mode, start_index=first)
        yield from first_of((chunk["y"] for chunk in chunks), counts[name] - first)

    start_utc = EPOCH + timedelta(seconds=first) if first else None
    return log_of_found(path, [replace(each, start_utc=start_utc) for each in channels], rows)


def _unit(channel: Any) -> str:
    return str(channel.y_unit.strip().strip('"'))


def _even(path: Path, channel: Any, later_s: float, rate_hz: float | None) -> Channel:
    """Channel with a constant time step that starts `later_s` after the first channel."""
    step = channel.x_step_width
    if rate_hz is None and not (math.isfinite(step) and step > 0):
        raise InputError(f"{path}: channel {channel.name!r} has a step of {step:g} s; give rate_hz (--rate)")
    start_s = later_s + channel.x_offset
    if not math.isfinite(start_s):
        raise InputError(f"{path}: channel {channel.name!r} starts at {start_s} s; is the file damaged?")
    return Channel(channel.name, _unit(channel), rate_hz or 1.0 / step, int(channel.sample_count), start_s)


def _pair(path: Path, file: Any, channel: Any, later_s: float) -> tuple[TimeAxis | str, Samples]:
    """Grid and samples of a channel of (x, y) pairs if x is an increasing time, else the reason for omitting it."""
    factor = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "": 1.0}.get(channel.x_unit.strip().strip('"').lower())
    if factor is None:
        return f"x is in {channel.x_unit!r}, no time", np.empty(0)
    parts = list(file.iter_channel_numpy(channel.uuid, include_x=True, chunk_rows=BLOCK, mode="scaled"))
    x, y = (
        np.concatenate([np.empty(0), *(np.asarray(part[side], dtype=np.float64) for part in parts)])
        for side in "xy"
    )
    try:
        return time_axis(
            path,
            channel.name,
            lambda: [x * factor + later_s],
            same=same_rows([lambda *ends: y[slice(*ends)]]),
        ), y
    except InputError as error:
        return str(error).removeprefix(f"{path}: "), y


def _sample_bytes(path: Path) -> int:
    """Number of sample bytes in a file; it reveals a truncated file, past whose end the package would read."""
    held = place = 0
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        while found := BLOCK_START.search(content, place):
            place = found.end() + int(found[2])
            start = content.find(b",", found.end(), place)  # after the block's number
            if found[1] == b"CS" and start >= 0:
                held += min(place, len(content)) - start - 1
    return held


def _cut(path: Path, name: str, samples: int, held: int, *, alone: bool) -> int:
    """Number of samples in a truncated channel; `InputError` unless it is `alone`, since channels may be interleaved."""
    what = f"cut short or damaged: channel {name!r} has {samples} samples"
    if not alone:
        raise InputError(
            f"{path}: {what}, more than the file holds in addition to its other channels; fetch it again"
        )
    warn(path, f"{what}, the file holds {held}; what came after them is lost")
    return held
