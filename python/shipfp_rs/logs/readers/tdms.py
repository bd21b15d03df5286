"""National Instruments TDMS files through the package npTDMS."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import BLOCK, Channel, Samples
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.isolation import in_child


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
    for channel in found:
        once = names.count(channel.name) == 1
        name = channel.name if once else f"{channel.group_name}/{channel.name}"
        if channel.dtype.kind not in "biuf" or channel.dtype.itemsize > 8:
            skipped.append(name)
            continue
        step = float(channel.properties.get("wf_increment", math.nan))
        if rate_hz is None and not 0.0 < step < math.inf:
            raise InputError(f"{path}: channel {name!r} tells no wf_increment above 0; give rate_hz (--rate)")
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

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        group, key = keys[name]
        channel = file[group][key]
        step = max(size, BLOCK // size * size)  # each piece of the file is read anew for every part of it
        for start in range(first, len(channel), step):
            part = channel.read_data(start, min(step, len(channel) - start))
            for offset in range(0, len(part), size):
                yield part[offset : offset + size]

    return Log(str(path), channels, blocks, start_utc)
