"""imc FAMOS files (.raw, .dat) through the package imctermite3."""

from __future__ import annotations

import math
import mmap
import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import numpy as np

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import BLOCK, Blocks, Channel, Samples
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.found_channels import Found
from shipfp_rs.logs.readers.isolation import in_child
from shipfp_rs.logs.time_axis import TimeAxis, time_axis

EPOCH = datetime(1980, 1, 1, tzinfo=UTC)
"""Trigger times count from here, on the logger's own clock, which is taken as UTC."""

BLOCK_START = re.compile(rb"\|([A-Za-z]{2})\s*,\s*\d+\s*,\s*(\d{1,15})\s*,")
"""Key, version and length of each block of a file."""


@register_reader(".raw", ".dat")
@in_child("imctermite", extra="famos")
def open_famos(path: Path, rate_hz: float | None) -> Log:
    """Open a FAMOS file; integers with a scale become float64, all else keeps the recorded type."""
    import imctermite

    if not hasattr(imctermite, "ImcTermite"):
        # The older package imctermite owns the same module name and has another interface.
        raise InputError(
            f"{path}: the installed module imctermite is not imctermite3; pip uninstall imctermite, then "
            "pip install --force-reinstall 'shipfp_rs[famos]'"
        )
    file = imctermite.ImcTermite(str(path))
    found = [channel for channel in file.get_channels_metadata() if channel.kind == "numeric"]
    first = min((channel.absolute_trigger_time for channel in found), default=0.0)
    left = _sample_bytes(path)
    channels: list[Channel] = []
    keys: dict[str, tuple[str, Literal["raw", "scaled"]]] = {}
    paired: dict[str, Blocks] = {}
    skipped: list[str] = []
    for channel in found:
        if channel.dimension != 1:
            pair = _pair(path, file, channel, channel.absolute_trigger_time - first)
            if isinstance(pair, str):
                skipped.append(f"{channel.name} ({pair})")
            else:
                axis, read = pair
                axis.tell(path)
                paired[channel.name] = axis.on_grid(read)
                channels.append(Found.on(axis, channel.name, _unit(channel)).channel)
            continue
        if channel.name in keys:
            raise InputError(f"{path}: channel {channel.name!r} appears twice; give each its own name")
        scaled = channel.y_factor != 1.0 or channel.y_offset != 0.0
        keys[channel.name] = (channel.uuid, "scaled" if scaled else "raw")
        even = _even(path, channel, channel.absolute_trigger_time - first, rate_hz)
        width = _sample_width(file, channel)
        held, left = left // max(width, 1), left - even.samples * width
        if left < 0:
            even = replace(even, samples=_cut(path, channel.name, even.samples, held, alone=len(found) == 1))
        channels.append(even)
    if skipped and not channels:
        raise InputError(
            f"{path}: nothing but pairs of x and y: {', '.join(skipped)}; resample them in FAMOS"
        )
    if skipped:
        warnings.warn(f"{path}: pairs of x and y left out: {', '.join(skipped)}", LogWarning, stacklevel=2)
    counts = {channel.name: channel.samples for channel in channels}

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        if name in paired:
            yield from paired[name](name, first, size)
            return
        uuid, mode = keys[name]
        left = counts[name] - first
        for chunk in file.iter_channel_numpy(
            uuid, include_x=False, chunk_rows=size, mode=mode, start_index=first
        ):
            if left <= 0:
                return
            yield chunk["y"][:left]
            left -= len(chunk["y"])

    return Log(str(path), channels, blocks, EPOCH + timedelta(seconds=first) if first else None)


def _unit(channel: Any) -> str:
    return str(channel.y_unit.strip().strip('"'))


def _sample_width(file: Any, channel: Any) -> int:
    """Bytes of one recorded sample; 0 for a channel without samples."""
    part = next(file.iter_channel_numpy(channel.uuid, include_x=False, chunk_rows=1, mode="raw"), None)
    return 0 if part is None else int(part["y"].itemsize)


def _even(path: Path, channel: Any, later_s: float, rate_hz: float | None) -> Channel:
    """Return a channel with a step of its own, which began `later_s` after the first."""
    step = channel.x_step_width
    if rate_hz is None and not (math.isfinite(step) and step > 0):
        raise InputError(f"{path}: channel {channel.name!r} has a step of {step:g} s; give rate_hz (--rate)")
    start_s = later_s + channel.x_offset
    if not math.isfinite(start_s):
        raise InputError(f"{path}: channel {channel.name!r} starts at {start_s} s; is the file damaged?")
    return Channel(channel.name, _unit(channel), rate_hz or 1.0 / step, int(channel.sample_count), start_s)


def _pair(path: Path, file: Any, channel: Any, later_s: float) -> tuple[TimeAxis, Blocks] | str:
    """Return the grid and the samples of (x, y) pairs whose x is an increasing time; else why they are left out."""
    if channel.x_unit.strip().strip('"').lower() not in ("s", "ms", "sec", ""):
        return f"x is in {channel.x_unit!r}, no time"
    parts = list(file.iter_channel_numpy(channel.uuid, include_x=True, chunk_rows=BLOCK, mode="scaled"))
    factor = 1e-3 if channel.x_unit.strip().strip('"') == "ms" else 1.0
    x = (
        np.concatenate([np.empty(0), *(np.asarray(part["x"], dtype=np.float64) for part in parts)]) * factor
        + later_s
    )
    y = np.concatenate([np.empty(0), *(np.asarray(part["y"], dtype=np.float64) for part in parts)])
    try:
        axis = time_axis(path, channel.name, lambda: [x])
    except InputError as error:
        return str(error).removeprefix(f"{path}: ")

    def read(name: str, first: int, size: int) -> Iterator[Samples]:
        for start in range(first, len(y), size):
            yield y[start : start + size]

    return axis, read


def _sample_bytes(path: Path) -> int:
    """Count the bytes of samples in a file: where it was cut, the package would read beyond its end."""
    held = place = 0
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        while found := BLOCK_START.search(content, place):
            place = found.end() + int(found[2])
            start = content.find(b",", found.end(), place)  # behind the block's number
            if found[1] == b"CS" and start >= 0:
                held += min(place, len(content)) - start - 1
    return held


def _cut(path: Path, name: str, samples: int, held: int, *, alone: bool) -> int:
    """Return the samples left of a channel; with several channels none may be whole, since they may be interleaved."""
    what = f"{path}: cut short or damaged: channel {name!r} has {samples} samples"
    if not alone:
        raise InputError(f"{what}, more than the file holds beside the other channels; fetch it again")
    warnings.warn(f"{what}, the file holds {held}; what came after them is lost", LogWarning, stacklevel=3)
    return held
