"""National Instruments TDMS files, read by npTDMS."""

from __future__ import annotations

import contextlib
import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import timedelta
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, Channel, Samples, in_blocks
from shipfp_rs.logs.faults.clock import LONGEST_GAP, Segment, spliced
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.formats import warn
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.child_process import in_child
from shipfp_rs.logs.readers.columns import Found, Row, axis_of, log_of_found, tell_left_out
from shipfp_rs.logs.readers.time_cells import EPOCH, TimePlan, is_time, split_bracketed
from shipfp_rs.logs.time_axis import TimeAxis
from shipfp_rs.support.sentences import Sentence


@register_reader(".tdms")
@in_child("nptdms", extra="tdms")
def open_tdms(path: Path, rate_hz: float | None) -> Log:
    """Open a TDMS file; a channel name that occurs in several groups gets the group's name as a prefix."""
    import nptdms

    # npTDMS reads a channel in pieces as large as the logger wrote them.
    # A file defragmented into one piece needs the memory of a whole channel.

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
    begins, pieces = _begins(path)
    grids: dict[tuple[Segment, ...], TimeAxis] = {}
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
            begun = begins.get(channel.path, [])
            each = _stepped(path, name, channel, rate_hz or 1.0 / step, begun)
            segments = _segments(path, each.channel, begun)
            if len(segments) > 1 and rate_hz is None:
                axis = grids.setdefault(segments, _grid(each.channel, segments))
                each = replace(each, channel=replace(each.channel, samples=axis.samples), axis=axis)
            found.append(each)
            continue
        own = times.get((channel.group_name, len(channel)))
        if own is None:
            raise InputError(
                f"{path}: channel {name!r} has no wf_increment above 0, and no channel of times belongs to it; give "
                "rate_hz (--rate)"
            )
        if own.path not in axes:
            beside = _rows_of_group(own, every)
            axes[own.path] = axis_of(path, own.name, beside[own.name], beside)
        axis, plan = axes[own.path]
        found.append(Found.on(axis, name, _unit(channel), plan))
    _tell_cut(path, file.file_status)
    tell_left_out(path, "no numbers", skipped, all_of_them=not found)

    def rows(name: str, first: int, size: int) -> Iterator[Samples]:
        channel = by_name[name]
        step = max(size, BLOCK // size * size)  # each read decodes a whole piece of the file again
        parts = in_blocks(
            lambda _: len(channel), lambda _, start, stop: channel.read_data(start, stop - start), path
        )
        for part in parts(name, first, step):
            for offset in range(0, len(part), size):
                yield part[offset : offset + size]

    return log_of_found(path, found, rows, _joined(found, pieces) if rate_hz is None else ())


def _joined(found: Sequence[Found], pieces: int) -> list[str]:
    """Note on channels whose segments have no times of their own."""
    names = ", ".join(one.channel.name for one in found if pieces > 1 and not (one.axis or one.start_utc))
    told = (
        f"{pieces} segments of {names} are joined: without wf_start_time a pause between them can't be known"
    )
    return [told] if names else []


def _stepped(path: Path, name: str, channel: Any, rate_hz: float, begins: list[tuple[int, int]]) -> Found:
    """Channel with a constant time step, with its start from its properties."""
    offset = float(channel.properties.get("wf_start_offset", 0.0))
    if not math.isfinite(offset):
        raise InputError(f"{path}: channel {name!r} starts at {offset} s; is the file damaged?")
    start_utc = EPOCH + timedelta(microseconds=begins[0][1]) if begins and begins[0][1] else None
    return Found(Channel(name, _unit(channel), rate_hz, len(channel), offset), start_utc=start_utc)


def _begins(path: Path) -> tuple[dict[str, list[tuple[int, int]]], int]:
    """First row and start time [us] of each segment with a start time, by channel path; number of segments with data."""
    from nptdms.reader import TdmsReader

    begins: dict[str, list[tuple[int, int]]] = defaultdict(list)
    pieces = 0
    with contextlib.closing(TdmsReader(str(path))) as reader:
        # npTDMS keeps only the last value of a property, so these methods are replaced to record the value of each segment.
        count, note = reader._update_object_metadata, reader._update_object_properties
        segments, before = list[Any](), set[str]()

        about = reader.object_metadata

        def take(properties: dict[str, Any] | None) -> None:
            nonlocal pieces
            rows = {key: one.num_values for key, one in about.items()}
            note(properties)
            for key, facts in (properties or {}).items():
                start = dict(facts).get("wf_start_time")
                if start is not None:
                    begins[key].append((rows.get(key, 0), int(start.as_datetime64("us").astype(np.int64))))
            count(segments[-1])
            written = {each.path for each in segments.pop().ordered_objects if each.has_data}
            pieces += bool(written)
            # A channel that was absent from a segment resumes at the time of the other channels of its rate.
            steps = {key: about[key].properties.get("wf_increment") for key in written}
            for key in (written - before) & rows.keys():
                beside = [about[each].num_values for each in written & before if steps[each] == steps[key]]
                late = max(beside, default=0) - about[key].num_values
                if steps[key] and late > 0:
                    at_s = steps[key] * (rows[key] + late)
                    begins[key] = begins[key] or [(0, 0)]
                    begins[key].append((rows[key], begins[key][0][1] + round(1e6 * at_s)))
            before.clear()
            before.update(written)

        reader._update_object_metadata, reader._update_object_properties = segments.append, take
        reader.read_metadata()
    return begins, pieces


def _segments(path: Path, channel: Channel, begins: list[tuple[int, int]]) -> tuple[Segment, ...]:
    """Map rows to samples: a segment that starts late leaves a gap, and one that starts early is appended."""
    segments = [Segment(0, channel.samples, 0)]
    for row, start in begins[1:]:
        last = segments[-1]
        end = last.sample + row - last.row
        at = round((start - begins[0][1]) * 1e-6 * channel.rate_hz)
        if at - end > LONGEST_GAP * channel.samples:
            raise InputError(
                f"{path}: channel {channel.name!r} pauses for {(at - end) / channel.rate_hz:g} s at row {row + 1}; cut the "
                "file there, or give rate_hz (--rate) to join the rows"
            )
        if at > end + 1 and row < channel.samples:
            segments[-1] = Segment(last.row, row - last.row, last.sample)
            segments.append(Segment(row, channel.samples - row, at))
    return tuple(segment for segment in segments if segment.count)


def _grid(channel: Channel, segments: tuple[Segment, ...]) -> TimeAxis:
    """Grid of a channel whose segments have their own times; NaN between them."""
    gaps = np.array([(one.sample + one.count, two.sample) for one, two in pairwise(segments)])
    fault = Fault("time_gap", channel.name, Sentence("masked: between segments of the file"), gaps)
    samples = segments[-1].sample + segments[-1].count
    return TimeAxis(
        channel.start_s, channel.rate_hz, samples, (fault,), "", partial(spliced, segments=segments)
    )


def _unit(channel: Any) -> str:
    return str(channel.properties.get("unit_string", ""))


def _tell_cut(path: Path, status: Any) -> None:
    """Warn of samples that the metadata of a file states but the file lacks."""
    if not status.incomplete_final_segment:
        return
    lost = sum(each.expected_length - each.read_length for each in (status.channel_statuses or {}).values())
    warn(path, f"cut short: {lost} samples of its last segment are lost, the rest is read")


def _is_time(channel: Any) -> bool:
    """Whether a channel holds times: time stamps, or numbers with a name that means time and without wf_increment."""
    if channel.dtype.kind == "M":
        return len(channel) > 1
    named = is_time(split_bracketed(channel.name)[0])
    numbers = channel.dtype.kind in "iuf" and len(channel) > 1
    return named and numbers and "wf_increment" not in channel.properties


def _rows_of_group(own: Any, every: Sequence[Any]) -> dict[str, Row]:
    """A channel of times and the channels of numbers in its group."""
    return {
        each.name: Row(each.name, _unit(each), len(each), partial(_cells, each))
        for each in every
        if each is own or (each.group_name == own.group_name and each.dtype.kind in "biuf")
    }


def _cells(channel: Any, first: int, stop: int) -> Samples:
    return np.asarray(channel[first:stop])
