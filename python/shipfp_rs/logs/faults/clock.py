"""Scan of a time column: start, rate, and jumps, repeated times and resets of the clock."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Blocks, Samples, first_of
from shipfp_rs.logs.faults.record import SHOWN, Fault
from shipfp_rs.support.arrays import Array, Mask, Spans, unmasked
from shipfp_rs.support.sentences import Sentence

Same = Callable[[int, int, int], Mask]
"""Function (row, earlier row, count) that compares `count` rows from either row on: whether each pair is equal in all
channels.
"""


def same_rows(reads: Iterable[Callable[[int, int], Samples]]) -> Same:
    """Make `Same` from one function per channel, which reads rows [first, stop)."""
    every = list(reads)

    def same(row: int, earlier: int, count: int) -> Mask:
        alike = np.full(count, bool(every))
        for read in every:
            here, before = (unmasked(read(first, first + count)) for first in (row, earlier))
            alike &= (here == before) | (np.isnan(here) & np.isnan(before))
        return alike

    return same


FIRST = 1024
"""Number of first rows whose median step is accurate enough to detect jumps."""
MOST_JUMPS = 0.01
"""Largest fraction of rows with a jump of the clock; a column with more jumps is not a clock."""
MARKED = 64
"""Interval, in rows, at which times are compared with a straight line."""
BENT = 2e-5
"""Largest deviation of times from a line, relative to the record's length; real clocks deviate so much in hours."""
COMPARED = 4096
"""Largest number of rows compared where times repeat. Equal rows were written twice; different rows mean that the
clock was set back.
"""
FILL = 1 << 16
"""Largest number of missing samples in a yielded block."""
LONGEST_GAP = 100.0
"""Largest number of missing samples in a gap, per recorded sample; a longer gap means that the clock was set."""
UNKNOWN_S = 2.0
"""Time put between two stretches that a jump of unknown length separates [s]; longer than any filter."""


@dataclass(frozen=True)
class Segment:
    """Mapping of a file's rows [row, row + count) to samples [sample, sample + count)."""

    row: int
    count: int
    sample: int


@dataclass(frozen=True)
class Clock:
    """Start and rate of a time column, its mapping from rows to samples (one segment if it has no jump), and faults."""

    start_s: float
    rate_hz: float
    segments: tuple[Segment, ...]
    faults: tuple[Fault, ...]

    @property
    def samples(self) -> int:
        """Number of samples, including missing samples."""
        return self.segments[-1].sample + self.segments[-1].count


class ClockScan:
    """Scan of a time column in chunks of any length."""

    def __init__(self) -> None:
        self._held: list[Array] = []
        self._count = 0
        self._last = self._start = self._interval = np.nan
        self._rows: list[npt.NDArray[np.int64]] = []
        self._jumps: list[Array] = []
        self._marks: list[tuple[npt.NDArray[np.int64], Array]] = []

    def feed(self, times: Array) -> None:
        """Add the next times [s]."""
        if np.isnan(self._interval):
            self._held.append(times)
            if sum(map(len, self._held)) < FIRST:
                return
            times = self._begin()
        self._take(times)

    @np.errstate(all="ignore")  # `finish` reports times that are not finite
    def _begin(self) -> Array:
        times, self._held = np.concatenate([np.empty(0), *self._held]), []
        if len(times):
            self._start = self._last = float(times[0])
            first = times[:FIRST]
            known = np.isfinite(first).sum() > 1
            self._interval = float(np.nanmedian(np.diff(first))) if known else np.nan
        return times

    @np.errstate(all="ignore")
    def _take(self, times: Array) -> None:
        if not len(times):
            return
        steps = np.diff(times, prepend=self._last if self._count else times[0] - self._interval)
        odd = np.flatnonzero(~(np.abs(steps - self._interval) < 0.5 * self._interval))
        self._rows.append(odd + self._count)
        self._jumps.append(steps[odd])
        marked = np.arange(-self._count % MARKED, len(times), MARKED)
        self._marks.append((marked + self._count, times[marked]))
        self._last = float(times[-1])
        self._count += len(times)

    def bends(self) -> bool:
        """Whether the times without their jumps deviate from a straight line by more than one step and more than `BENT`."""
        if not self._marks:
            return False
        rows, times = (np.concatenate(part) for part in zip(*self._marks, strict=True))
        rows, times = np.append(rows, self._count - 1), np.append(times, self._last)
        jumped = np.concatenate([[], *self._rows]).astype(np.int64)
        excess = np.concatenate([[0.0], np.cumsum(np.concatenate([[], *self._jumps]) - self._interval)])
        line = times - excess[np.searchsorted(jumped, rows, side="right")]
        ideal = np.interp(rows, [rows[0], rows[-1]], [line[0], line[-1]])
        return bool(np.ptp(line - ideal) > max(self._interval, BENT * float(np.ptp(line))))

    def finish(self, name: str, column: str, same: Same, *, trusted: bool) -> Clock:
        """Finish the scan; `same` compares rows, and `trusted` is False if the user gave a sample rate."""
        if self._held:
            self._take(self._begin())
        whole = (Segment(0, self._count, 0),)
        if not np.isfinite(self._start):
            raise InputError(
                f"{name}: time column {column!r} starts at {self._start:g} s; expected numbers that increase"
            )
        if not trusted:
            length = float(self._last - self._start)
            return Clock(self._start, (self._count - 1) / length if length > 0.0 else np.nan, whole, ())
        if self._count < 2:
            raise InputError(f"{name}: {self._count} row of samples, expected 2 or more")
        if not self._interval > 0.0:
            raise InputError(
                f"{name}: time column {column!r} does not increase from row to row; give rate_hz (--rate)"
            )
        rows, jumps = np.concatenate([[], *self._rows]).astype(np.int64), np.concatenate([[], *self._jumps])
        unknown = np.flatnonzero(~np.isfinite(jumps))
        even = self._count - 1 - len(rows)
        if len(unknown):
            raise InputError(
                f"{name}: time column {column!r} has no time in row {rows[unknown[0]] + 1}, such as headings written again; "
                "leave the row out, cut the file there or give rate_hz (--rate)"
            )
        if len(rows) > MOST_JUMPS * self._count or not even:
            raise InputError(
                f"{name}: time column {column!r} is not uniform at row {rows[0] + 1}: a step of "
                f"{jumps[0]:g} s, expected {self._interval:g} s; {len(rows)} of {self._count} rows have such "
                "steps; cut the file there or give rate_hz (--rate)"
            )
        rate_hz = even / float(self._last - self._start - jumps.sum())
        rate_hz = float(f"{rate_hz:.12g}")  # 20, not 19.999999999999996: last bits of times are inaccurate
        if not len(rows):
            return Clock(self._start, rate_hz, whole, ())
        return self._spliced(column, rate_hz, rows, jumps, same)

    def _spliced(
        self, column: str, rate_hz: float, rows: npt.NDArray[np.int64], jumps: Array, same: Same
    ) -> Clock:
        """Map the rows between jumps to samples by their times."""
        ends = np.append(rows[1:], self._count).tolist()
        segments = [Segment(0, int(rows[0]), 0)]
        gaps: list[tuple[int, int]] = []
        twice: list[tuple[int, int]] = []
        back: list[list[int]] = []
        parted: list[Jump] = []
        behind = 0  # how late the clock is at this row, in samples
        skipped_to = 0
        missing = [round(jump * rate_hz) - 1 for jump in jumps.tolist()]
        for row, stop, jump, moved, after in zip(
            rows.tolist(), ends, jumps.tolist(), missing, [*missing[1:], 0], strict=True
        ):
            at = segments[-1].sample + segments[-1].count
            first, far = row, moved > LONGEST_GAP * self._count
            if moved * behind > 0 and abs(moved - behind) <= 1:
                back[-1][1], behind = at, 0
            elif (
                moved < 0
                and jump <= 0.0  # a copy has the time of the row that it repeats
                and row >= -moved
                and same(row, row + moved, min(-moved, stop - row, COMPARED)).all()
            ):
                twice.append((at + moved, at))
                first = row - moved
            elif (jump < 0.0 or far) and not (moved * after < 0 and abs(moved + after) <= 1):
                stands = at + max(round(UNKNOWN_S * rate_hz), 1)
                before = parted[-1].later_s if parted else 0.0
                later_s = (stands - at + 1) / rate_hz - jump + before
                parted.append(Jump(self._start + (at - 1) / rate_hz - before, jump, later_s, (at, stands)))
                at, behind = stands, 0
            elif moved > 0 and not far:
                gaps.append((at, at + moved))
                at += moved
            elif moved:
                behind -= moved
                back.append([at, -1])
            skipped_to = max(skipped_to, first)
            if stop > skipped_to:
                segments.append(Segment(skipped_to, stop - skipped_to, at))
        end = segments[-1].sample + segments[-1].count
        faults = [
            Fault("time_gap", column, Sentence("masked: missing rows inserted"), np.array(gaps)),
            Fault("repeated", column, Sentence("copies left out"), np.array(twice), excluded=False),
            Fault(
                "time_back",
                column,
                Sentence("times continued at the sampling rate, since the file's own times are late here"),
                np.array([(start, end if stop < 0 else stop) for start, stop in back]),
                excluded=False,
            ),
            parted_at(column, parted),
        ]
        return Clock(
            self._start,
            rate_hz,
            tuple(s for s in segments if s.count),
            tuple(f for f in faults if len(f.spans)),
        )


class Jump(NamedTuple):
    """Jump of a clock by an unknown amount: backwards, or longer than the recording."""

    own_s: float
    """Time of the row before the jump, as recorded [s]."""
    by_s: float
    later_s: float
    """Correction of all later times [s]."""
    span: tuple[int, int]
    """Samples between the two stretches."""


def parted_at(column: str, jumps: Sequence[Jump]) -> Fault:
    """Make the fault "time_jump" of the jumps that divide a log into stretches."""

    def told(values: Sequence[float]) -> str:
        more = " ..." if len(values) > SHOWN else ""
        return ", ".join(f"{round(value, 3):.13g}" for value in values[:SHOWN]) + more

    method = Sentence(
        "masked: it jumps by {by} s after {own} s, and nobody knows how long the gap is; the stretches stand {apart} s "
        "apart, no window spans both, and to the file's times from there on {later} s are added",
        by=told([jump.by_s for jump in jumps]),
        own=told([jump.own_s for jump in jumps]),
        later=told([jump.later_s for jump in jumps]),
        apart=f"{UNKNOWN_S:g}",
    )
    return Fault("time_jump", column, method, np.array([jump.span for jump in jumps]))


def spliced(blocks: Blocks, segments: tuple[Segment, ...]) -> Blocks:
    """Make a reader of samples from a reader of rows; missing samples are NaN, and rows outside all segments are skipped."""
    return laid_out(lambda _: ((segment, blocks) for segment in segments))


def laid_out(segments_of: Callable[[str], Iterable[tuple[Segment, Blocks]]]) -> Blocks:
    """Make `Blocks` from the segments of a channel, each with its reader of rows; missing samples are NaN."""

    def read(channel: str, first: int, size: int) -> Iterator[Samples]:
        at = first
        for segment, rows in segments_of(channel):
            while at < segment.sample:
                yield np.full(min(segment.sample - at, size, FILL), np.nan)
                at += min(segment.sample - at, size, FILL)
            later, left = at - segment.sample, segment.sample + segment.count - at
            for block in first_of(rows(channel, segment.row + later, size), left):
                yield block
                at += len(block)

    return read


def without(segments: Sequence[Segment], rows: Spans) -> tuple[tuple[Segment, ...], Spans]:
    """Remove rows from segments; return the new segments and the spans of the removed rows' samples, which become NaN."""
    kept: list[Segment] = []
    hidden: list[tuple[int, int]] = []
    for segment in segments:
        row, end = segment.row, segment.row + segment.count
        later = segment.sample - segment.row
        for first, stop in np.clip(rows, row, end).tolist():
            if stop > first:
                kept.append(Segment(row, first - row, row + later))
                hidden.append((first + later, stop + later))
                row = stop
        # The last segment is kept even if it is empty: its end is the number of samples.
        kept.append(Segment(row, end - row, row + later))
    return tuple(kept), np.array(hidden, dtype=np.int64).reshape(-1, 2)
