"""ASAM MDF files, versions 3 and 4 (.mf4, .mdf), read by asammdf."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import fields
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, Samples, in_blocks
from shipfp_rs.logs.faults.clock import same_rows
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.can_signals import Frames, log_of_frames
from shipfp_rs.logs.readers.child_process import in_child
from shipfp_rs.logs.readers.columns import Found, log_of_found, tell_left_out
from shipfp_rs.logs.time_axis import TimeAxis, time_axis
from shipfp_rs.support.arrays import Mask

Key = tuple[int, int, bool]
"""Group number, channel index in the group, and whether the samples are read without conversion."""


@register_reader(".mf4", ".mdf", takes=("names",))
@in_child("asammdf", extra="mdf")
def open_mdf(path: Path, rate_hz: float | None, names: str | None = None) -> Log:
    """Open an MDF file; values are scaled, texts are replaced by their codes, and invalidated samples are gaps."""
    import asammdf

    file: Any = asammdf.MDF(path)
    if rate_hz is None and not any(group.channel_group.cycles_nr for group in file.groups):
        raise InputError(f"{path}: no samples in it; was the recording finished?")
    start_utc = file.header.start_time.astimezone(UTC)
    frames = _frames(file)
    if frames is not None:
        return log_of_frames(path, frames, names, start_utc)
    if names is not None:
        raise InputError(f"{path}: has no frames of a CAN bus, so {names} can't be used; leave --names out")
    found, keys, skipped, reasons = _found(path, file, start_utc, rate_hz)
    if not found and reasons:
        raise InputError(reasons[0])
    why = f" ({reasons[0].removeprefix(f'{path}: ')})" if reasons else ""
    tell_left_out(path, f"no numbers or no uniform time base{why}", skipped, all_of_them=not found)

    def length(name: str) -> int:
        return int(file.groups[keys[name][0]].channel_group.cycles_nr)

    def rows(name: str, first: int, stop: int) -> Samples:
        return _values(file, *keys[name], first, stop - first)

    return log_of_found(path, found, in_blocks(length, rows, path))


def _found(
    path: Path, file: Any, start_utc: datetime, rate_hz: float | None
) -> tuple[list[Found], dict[str, Key], list[str], list[str]]:
    """Channels with numbers, their keys, names of omitted channels, and reasons for omitted groups."""
    counts = Counter(channel.name for group in file.groups for channel in group.channels)
    found: list[Found] = []
    keys: dict[str, Key] = {}
    skipped: list[str] = []
    reasons: list[str] = []
    for number, group in enumerate(file.groups):
        master = file.masters_db.get(number)
        try:
            axis = _group_axis(path, file, number, group, rate_hz)
        except InputError as error:
            skipped += [channel.name for index, channel in enumerate(group.channels) if index != master]
            reasons.append(str(error))
            continue
        for index, channel in enumerate(group.channels):
            if index == master:
                continue
            name = channel.name if counts[channel.name] == 1 else f"{channel.name} {number}"
            raw = _must_be_raw(file, number, index)
            if raw is None or name in keys:
                skipped.append(name)
                continue
            keys[name] = (number, index, raw)
            found.append(Found.on(axis, name, _unit(channel), start_utc=start_utc))
    return found, keys, skipped, reasons


def _frames(file: Any) -> Frames | None:
    """Frames of the CAN buses in a file; None if there are none."""
    parts: list[Frames] = []
    for number, group in enumerate(file.groups):
        by_name = {channel.name: index for index, channel in enumerate(group.channels)}
        if "CAN_DataFrame.ID" not in by_name or not group.channel_group.cycles_nr:
            continue

        def read(name: str, number: int = number, by_name: dict[str, int] = by_name) -> Any:
            index = by_name.get(f"CAN_DataFrame.{name}")
            if index is None:
                return None
            return file.get(
                group=number, index=index, raw=True, samples_only=True, ignore_invalidation_bits=True
            )[0]

        identifier, data, kind = read("ID"), read("DataBytes"), read("IDE")
        identifier = np.asarray(identifier, dtype=np.uint64)
        extended = (identifier >= 1 << 31) | (identifier > 0x7FF) if kind is None else np.asarray(kind) != 0
        data = np.asarray(data, dtype=np.uint8).reshape(len(identifier), -1)
        length = read("DataLength")
        length = np.full(len(data), data.shape[1]) if length is None else np.asarray(length)
        bus = read("BusChannel")
        bus = np.full(len(data), group.channel_group.acq_name or "") if bus is None else np.asarray(bus)
        wide = np.zeros((len(data), 64), dtype=np.uint8)
        wide[:, : data.shape[1]] = data
        parts.append(Frames.of(file.get_master(number), identifier & 0x1FFFFFFF, extended, wide, length, bus))
    if not parts:
        return None
    return Frames(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(Frames)))


def _group_axis(path: Path, file: Any, number: int, group: Any, rate_hz: float | None) -> TimeAxis:
    count = group.channel_group.cycles_nr
    if file.masters_db.get(number) is None and rate_hz is None:
        raise InputError(f"{path}: group {number} has no time channel; give rate_hz (--rate)")

    def times() -> Iterator[Any]:
        return (
            file.get_master(number, record_offset=start, record_count=min(BLOCK, count - start))
            for start in range(0, count, BLOCK)
        )

    def read(index: int, raw: bool, first: int, stop: int) -> Samples:
        return _values(file, number, index, raw, first, stop - first)

    def same(*rows: int) -> Mask:
        others = (k for k in range(len(group.channels)) if k != file.masters_db.get(number))
        raws = ((k, _must_be_raw(file, number, k)) for k in others)
        return same_rows(partial(read, k, raw) for k, raw in raws if raw is not None)(*rows)

    return time_axis(path, f"time of group {number}", times, rate_hz=rate_hz, same=same)


def _must_be_raw(file: Any, number: int, index: int) -> bool | None:
    """Whether a channel is numeric only before conversion, for instance to text; None if it is never numeric."""
    for raw in (False, True):
        if _values(file, number, index, raw, 0, 1).dtype.kind in "biuf":
            return raw
    return None


def _values(file: Any, number: int, index: int, raw: bool, start: int, count: int) -> Samples:
    samples, invalid = file.get(
        group=number,
        index=index,
        raw=raw,
        samples_only=True,
        ignore_invalidation_bits=True,  # otherwise invalid samples are dropped and later samples shifted
        record_offset=start,
        record_count=count,
    )
    if samples.ndim != 1:
        return np.empty(0, object)
    return samples if invalid is None or not invalid.any() else np.ma.MaskedArray(samples, invalid)


def _unit(channel: Any) -> str:
    conversion = getattr(channel, "conversion", None)
    return str(channel.unit or getattr(conversion, "unit", "") or "").strip()
