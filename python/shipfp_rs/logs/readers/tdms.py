"""National Instruments TDMS files through the package npTDMS."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import BLOCK, Channel, Samples
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.isolation import in_child
from shipfp_rs.logs.readers.time_column import Column, find_time
from shipfp_rs.logs.readers.time_words import is_time, split_bracketed
from shipfp_rs.logs.time_axis import TimeAxis, time_axis


@register_reader(".tdms")
@in_child("nptdms", extra="tdms")
def open_tdms(path: Path, rate_hz: float | None) -> Log:
    """Open a TDMS file; a channel carries its group's name in front where another has the same name.

    npTDMS reads a channel in pieces no smaller than the logger wrote: a file defragmented into one piece needs
    the memory of a whole channel.
    """
    import nptdms

    channels: list[Channel] = []
    keys: dict[str, tuple[str, str]] = {}
    starts: dict[str, datetime] = {}
    skipped: list[str] = []
    file = nptdms.TdmsFile.open(path)
    found = [channel for group in file.groups() for channel in group.channels()]
    names = [channel.name for channel in found]
    times = {(channel.group_name, len(channel)): channel for channel in reversed(found) if _is_time(channel)}
    axes: dict[tuple[str, str], tuple[TimeAxis, datetime | None]] = {}
    axis_by: dict[str, TimeAxis] = {}
    for channel in found:
        once = names.count(channel.name) == 1
        name = channel.name if once else f"{channel.group_name}/{channel.name}"
        if channel.dtype.kind not in "biuf" or channel.dtype.itemsize > 8:
            skipped.append(name)
            continue
        step = float(channel.properties.get("wf_increment", math.nan))
        if channel in times.values() and len(times) < len(found):
            continue
        if rate_hz is None and not 0.0 < step < math.inf:
            own = times.get((channel.group_name, len(channel)))
            if own is None:
                raise InputError(
                    f"{path}: channel {name!r} tells no wf_increment above 0, and no channel of times is beside it; give "
                    "rate_hz (--rate)"
                )
            key = (own.group_name, own.name)
            if key not in axes:
                axes[key] = _axis(path, own)
                axes[key][0].tell(path)
            axis, zero = axes[key]
            if zero is not None:
                starts[name] = zero
            axis_by[name] = axis
            unit = str(channel.properties.get("unit_string", ""))
            keys[name] = (channel.group_name, channel.name)
            channels.append(Channel(name, unit, axis.rate_hz, axis.samples, axis.start_s))
            continue
        offset = float(channel.properties.get("wf_start_offset", 0.0))
        if not math.isfinite(offset):
            raise InputError(f"{path}: channel {name!r} starts at {offset} s; is the file damaged?")
        if "wf_start_time" in channel.properties:
            starts[name] = channel.properties["wf_start_time"].astype("M8[us]").item().replace(tzinfo=UTC)
        unit = str(channel.properties.get("unit_string", ""))
        keys[name] = (channel.group_name, channel.name)
        channels.append(Channel(name, unit, rate_hz or 1.0 / step, len(channel), offset))
    start_utc = min(starts.values(), default=None)
    if start_utc is not None:
        channels = [
            replace(c, start_s=c.start_s + (starts.get(c.name, start_utc) - start_utc).total_seconds())
            for c in channels
        ]
    status = file.file_status
    if status.incomplete_final_segment:
        lost = sum(
            each.expected_length - each.read_length for each in (status.channel_statuses or {}).values()
        )
        warnings.warn(
            f"{path}: cut short: {lost} samples of its last segment are lost, the rest is read",
            LogWarning,
            stacklevel=2,
        )
    if skipped and not channels:
        raise InputError(f"{path}: no numbers in {', '.join(skipped)}; expected at least one channel of them")
    if skipped:
        warnings.warn(f"{path}: no numbers in {', '.join(skipped)}; left out", LogWarning, stacklevel=2)

    def rows(name: str, first: int, size: int) -> Iterator[Samples]:
        group, key = keys[name]
        channel = file[group][key]
        step = max(size, BLOCK // size * size)  # each piece of the file is read anew for every part of it
        for start in range(first, len(channel), step):
            part = channel.read_data(start, min(step, len(channel) - start))
            for offset in range(0, len(part), size):
                yield part[offset : offset + size]

    readers = {name: axis.on_grid(rows) for name, axis in axis_by.items()}

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        return readers.get(name, rows)(name, first, size)

    return Log(str(path), channels, blocks, start_utc)


def _is_time(channel: Any) -> bool:
    """Whether a channel holds times: stamps, or numbers under a name of time that have no wf_increment themselves."""
    if channel.dtype.kind == "M":
        return len(channel) > 1
    named = is_time(split_bracketed(channel.name)[0])
    return (
        named
        and channel.dtype.kind in "iuf"
        and len(channel) > 1
        and "wf_increment" not in channel.properties
    )


def _axis(path: Path, channel: Any) -> tuple[TimeAxis, datetime | None]:
    """Return the grid of a channel of times, and when it began."""
    name, unit = split_bracketed(channel.name)
    values = np.asarray(channel[:])
    cells = pa.array(values.astype("M8[ns]") if values.dtype.kind == "M" else values)
    column = Column(name, str(channel.properties.get("unit_string", unit)), channel.name, cells)
    (plan,) = find_time(path, [column], {name: channel.name}, wish=name)
    return time_axis(path, channel.name, lambda: plan.seconds(path, lambda _: iter([cells]))), plan.zero
