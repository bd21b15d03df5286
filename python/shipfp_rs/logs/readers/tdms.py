"""National Instruments TDMS files through the package npTDMS."""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Iterator
from datetime import UTC
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import BLOCK, Channel, Samples, in_blocks
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.columns import Row, axis_of
from shipfp_rs.logs.readers.found_channels import Found, log_of_found, tell_left_out
from shipfp_rs.logs.readers.isolation import in_child
from shipfp_rs.logs.readers.time_cells import TimePlan
from shipfp_rs.logs.readers.time_words import is_time, split_bracketed
from shipfp_rs.logs.time_axis import TimeAxis


@register_reader(".tdms")
@in_child("nptdms", extra="tdms")
def open_tdms(path: Path, rate_hz: float | None) -> Log:
    """Open a TDMS file; a channel carries its group's name in front where another has the same name.

    npTDMS reads a channel in pieces no smaller than the logger wrote: a file defragmented into one piece needs
    the memory of a whole channel.
    """
    import nptdms

    file = nptdms.TdmsFile.open(path)
    every = [channel for group in file.groups() for channel in group.channels()]
    names = Counter(channel.name for channel in every)
    named = [
        (channel.name if names[channel.name] == 1 else f"{channel.group_name}/{channel.name}", channel)
        for channel in every
    ]
    by_name = dict(named)
    times = {(channel.group_name, len(channel)): channel for channel in reversed(every) if _is_time(channel)}
    axes: dict[str, tuple[TimeAxis, TimePlan]] = {}
    found: list[Found] = []
    skipped: list[str] = []
    for name, channel in named:
        if channel.dtype.kind not in "biuf" or channel.dtype.itemsize > 8:
            skipped.append(name)
            continue
        if channel in times.values() and len(times) < len(every):
            continue
        step = float(channel.properties.get("wf_increment", math.nan))
        if rate_hz is not None or 0.0 < step < math.inf:
            found.append(_stepped(path, name, channel, rate_hz or 1.0 / step))
            continue
        own = times.get((channel.group_name, len(channel)))
        if own is None:
            raise InputError(
                f"{path}: channel {name!r} has no wf_increment above 0, and no channel of times belongs to it; give "
                "rate_hz (--rate)"
            )
        if own.path not in axes:
            row = Row(own.name, _unit(own), len(own), partial(_cells, own))
            axes[own.path] = axis_of(path, own.name, row)
            axes[own.path][0].tell(path)
        axis, plan = axes[own.path]
        found.append(Found.on(axis, name, _unit(channel), plan.zero))
    _tell_cut(path, file.file_status)
    tell_left_out(path, "no numbers", skipped, all_of_them=not found)

    def rows(name: str, first: int, size: int) -> Iterator[Samples]:
        channel = by_name[name]
        step = max(size, BLOCK // size * size)  # each piece of the file is read anew for every part of it
        parts = in_blocks(
            lambda _: len(channel), lambda _, start, stop: channel.read_data(start, stop - start), path
        )
        for part in parts(name, first, step):
            for offset in range(0, len(part), size):
                yield part[offset : offset + size]

    return log_of_found(path, found, rows)


def _stepped(path: Path, name: str, channel: Any, rate_hz: float) -> Found:
    """Return a channel that tells its own step and start."""
    offset = float(channel.properties.get("wf_start_offset", 0.0))
    if not math.isfinite(offset):
        raise InputError(f"{path}: channel {name!r} starts at {offset} s; is the file damaged?")
    start = channel.properties.get("wf_start_time")
    start_utc = None if start is None else start.astype("M8[us]").item().replace(tzinfo=UTC)
    return Found(Channel(name, _unit(channel), rate_hz, len(channel), offset), start_utc=start_utc)


def _unit(channel: Any) -> str:
    return str(channel.properties.get("unit_string", ""))


def _tell_cut(path: Path, status: Any) -> None:
    """Warn of samples that a file announces and does not hold."""
    if not status.incomplete_final_segment:
        return
    lost = sum(each.expected_length - each.read_length for each in (status.channel_statuses or {}).values())
    warnings.warn(
        f"{path}: cut short: {lost} samples of its last segment are lost, the rest is read",
        LogWarning,
        stacklevel=3,
    )


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


def _cells(channel: Any, first: int, stop: int) -> Samples:
    return np.asarray(channel[first:stop])
