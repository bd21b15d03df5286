"""Even time grid of recorded rows; rows at uneven times are resampled."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, Blocks, Channel, Samples, first_of
from shipfp_rs.logs.faults.clock import (
    LONGEST_GAP,
    MOST_JUMPS,
    UNKNOWN_S,
    Clock,
    ClockScan,
    Jump,
    Same,
    parted_at,
    same_rows,
    spliced,
    without,
)
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.formats import warn
from shipfp_rs.logs.joining import CoarseClock, find_coarse
from shipfp_rs.support.arrays import Array, Mask, joined, unmasked
from shipfp_rs.support.sentences import Sentence

Times = Callable[[], Iterable[Array]]
"""Function that iterates over the times of all rows [s], from the start at each call."""

LEAST_CHANGES, LONGEST_SCANS, OFTEN = 8, 4.0, 0.1
"""A channel counts as recorded on change if it has at least `LEAST_CHANGES` steps, and more than the fraction `OFTEN`
of them are longer than `LONGEST_SCANS` scans.
"""
WHOLE = 0.1
"""Largest deviation of a step from a whole number of scans, relative to the step."""
GAP = 3.0
"""Steps longer than this multiple of the 90 % quantile of all steps remain gaps."""
MOST_GROWTH = 8.0
"""Largest number of grid samples per recorded sample; where rows are denser than the grid, they are averaged over its
cells.
"""
CHANGES_GROWTH = 32.0
"""Largest number of grid samples per recorded state change."""
MOST_EVEN, MISSED = 1.01, 1.5
"""Rows are evenly spaced if the 90 % quantile of their time steps is below `MOST_EVEN` times the 5 % quantile. In such
rows, a step above `MISSED` times the 90 % quantile is a gap.
"""
HELD_GROWTH = 1000.0
"""Largest number of grid samples per recorded change of a held channel."""
BOUNCE = 0.05
"""State changes closer than this fraction of a grid step belong to one edge, which bounces."""
CHANGE_STEPS = 4.0
"""Least number of grid steps between two state changes, except for the shortest twentieth of the intervals."""
FAR_OFF = 1.5
"""Ratio between a given rate and that of a time column, or its inverse, above which a warning is given."""
MOST_EQUAL = 0.1
"""Largest fraction of rows with the time of the previous row, except under a coarse clock."""


@dataclass(frozen=True)
class TimeAxis:
    """Even time grid of a file, with the clock's faults, a note on uneven times, and the conversion of rows to samples."""

    start_s: float
    rate_hz: float
    samples: int
    faults: tuple[Fault, ...]
    note: str
    on_grid: Callable[[Blocks], Blocks]
    doubled: Callable[[Blocks, str], tuple[Fault, ...]] = lambda blocks, channel: ()
    """Function (rows, channel) that returns the fault of a two-state channel's edges that bounce."""

    def faults_of(self, channel: str) -> tuple[Fault, ...]:
        """Faults of the clock, with spans that refer to the samples of `channel`."""
        return tuple(replace(fault, of=channel) for fault in self.faults)

    def tell(self, path: Path | str) -> None:
        """Warn of jumps and uneven times."""
        for text in (*map(str, self.faults), self.note):
            if text:
                warn(path, text)


def time_axis(
    path: Path | str,
    column: str,
    times: Times,
    *,
    rate_hz: float | None = None,
    same: Same | None = None,
    changes: bool = False,  # rows are state changes of two-state channels: the grid is finer, and long steps are no gaps
    held: bool = False,  # rows may record only the changes of a channel with an even scan: each value is held until the next
) -> TimeAxis:
    """Find the even grid of a time column; `path` and `column` are for messages. `InputError` if times do not increase."""
    # Times are even if they deviate from a straight line by less than half a step, apart from single jumps.
    # A given rate takes precedence over the times; only their start is then used.
    same = same or same_rows([])
    scan = ClockScan()
    for part in _ended(times()):
        scan.feed(part)
    try:
        clock = scan.finish(str(path), column, same, trusted=rate_hz is None)
    except InputError as error:
        return _uneven(path, column, np.concatenate([np.empty(0), *times()]), error, same, changes, held)
    # If each row is a state change, a long step is a long state, such as a missing tooth of a wheel; no row is missing.
    if rate_hz is None and (scan.bends() or (changes and clock.faults)):
        told = InputError(f"{path}: time column {column!r} is not uniform: its rate changes by and by")
        return _uneven(path, column, np.concatenate(list(times())), told, same, changes, held)
    return _even(clock, rate_hz)


def _ended(times: Iterable[Array]) -> Iterator[Array]:
    """Yield the times without the empty cells at the end of a column that is shorter than its table."""
    empty: list[Array] = []
    for part in times:
        count = int(np.max(np.flatnonzero(np.isfinite(part)), initial=-1)) + 1
        if count:
            yield from empty
            yield part[:count]
            empty = []
        empty.append(part[count:])


def _even(clock: Clock, rate_hz: float | None) -> TimeAxis:
    def on_grid(blocks: Blocks) -> Blocks:
        return spliced(blocks, clock.segments) if clock.faults else blocks

    rate = rate_hz or clock.rate_hz
    far = max(rate / clock.rate_hz, clock.rate_hz / rate) > FAR_OFF
    note = (
        f"a rate of {rate:g} Hz is given, but the column of time tells {clock.rate_hz:.6g} Hz" if far else ""
    )
    return TimeAxis(clock.start_s, rate, clock.samples, clock.faults, note, on_grid)


def _uneven(
    path: Path | str, column: str, times: Array, error: InputError, same: Same, changes: bool, held: bool
) -> TimeAxis:
    """Grid of uneven times; raises `error` if the numbers can't be times."""
    known = np.isfinite(times)
    count = len(times) if not known.any() else int(np.flatnonzero(known)[-1]) + 1
    times = times[:count]  # a column shorter than the table ends in empty cells
    if count < 3 or not known[:count].all():
        raise error
    steps = np.diff(times)
    again = steps == 0.0
    if again.any():
        again &= same(1, 0, count - 1)
        lengths = np.diff(np.flatnonzero(np.concatenate([[True], ~again, [True]])))
        times_each = int(np.gcd.reduce(lengths)) if len(lengths) >= LEAST_CHANGES else 1
        if times_each > 1:  # rows with the same time may differ, as under a coarse clock
            again = np.arange(1, count) % times_each > 0
        if times_each > 1 or (again >= (steps == 0.0)).all():
            return _once(path, column, times, np.append(True, ~again), changes, held)
    back = np.flatnonzero(steps < 0.0)
    if back.size > max(MOST_JUMPS * count, 1):
        row = int(back[0]) + 1
        raise InputError(
            f"{path}: time column {column!r} goes back at row {row + 1}: {times[row]:.12g} s after "
            f"{times[row - 1]:.12g} s, and in {back.size} of {count} rows; cut the file there, or give rate_hz (--rate)"
        ) from error
    if not steps.any():
        raise error
    coarse = find_coarse(times) if np.mean(steps == 0.0) >= MOST_EQUAL else None
    if coarse is not None:
        return _seen_through(path, column, coarse, same)
    if np.mean(steps == 0.0) > MOST_EQUAL:
        raise InputError(
            f"{path}: time column {column!r} repeats the previous row's time in {np.count_nonzero(steps == 0.0)} of {count} "
            "rows and has no even rate; give rate_hz (--rate), or a column with a finer time (--time)"
        ) from error
    return _resampled(path, column, times, steps, changes=changes, held=held)


def _once(path: Path | str, column: str, times: Array, kept: Mask, changes: bool, held: bool) -> TimeAxis:
    """Grid of the rows marked in `kept`; the others are second copies."""
    rows = np.flatnonzero(kept)
    axis = time_axis(path, column, lambda: [times[rows]], changes=changes, held=held)

    def once(blocks: Blocks) -> Blocks:
        def read(channel: str, first: int, size: int) -> Iterator[Samples]:
            row = int(rows[first])
            for block in blocks(channel, row, size):
                yield block[: len(kept) - row][kept[row : row + len(block)]]
                row += len(block)

        return read

    at = np.round((times[~kept] - axis.start_s) * axis.rate_hz).astype(np.int64)
    at = np.maximum(at, np.cumsum(kept)[~kept] - 1)  # a coarse clock gives only the tick of a row
    twice = joined([np.column_stack([at, at + 1])])
    fault = Fault("repeated", column, Sentence("copies left out"), twice, excluded=False)
    return replace(axis, faults=(fault, *axis.faults), on_grid=lambda blocks: axis.on_grid(once(blocks)))


def are_on_change(times: Array) -> bool:
    """Whether a channel is recorded on change: nearly all steps are whole numbers of scans, and many are long."""
    steps = np.diff(times)
    if len(steps) < LEAST_CHANGES or not (steps > 0.0).all():
        return False
    scans = steps / np.quantile(steps, 0.05, method="lower")
    whole = np.abs(scans - np.round(scans)) < WHOLE * scans
    return bool(whole.mean() > 0.95 and np.mean(scans > LONGEST_SCANS) > OFTEN)


def _seen_through(path: Path | str, column: str, coarse: CoarseClock, same: Same) -> TimeAxis:
    """Grid of evenly spaced rows under a coarse clock; its jumps are treated like the jumps of a fine clock."""
    rate, resolution = coarse.rate_hz, coarse.resolution_s
    note = (
        f"time column {column!r} has one time for several rows: taken as even at {rate:.6g} Hz, start known to "
        f"{resolution:g} s"
    )
    if not coarse.jumps:
        return TimeAxis(float(coarse.times[0]), rate, len(coarse.times), (), note, lambda blocks: blocks)
    scan = ClockScan()
    scan.feed(coarse.times)
    clock = scan.finish(str(path), column, same, trusted=True)
    known, hidden = without(clock.segments, coarse.masked)
    method = Sentence(
        "masked: the ticks of {tick} s that lack rows, it is not known which", tick=f"{resolution:g}"
    )
    faults = (*clock.faults, Fault("time_gap", column, method, hidden))
    faults = tuple(fault for fault in faults if len(fault.spans))
    return TimeAxis(clock.start_s, rate, clock.samples, faults, note, lambda blocks: spliced(blocks, known))


def _resampled(
    path: Path | str, column: str, times: Array, steps: Array, *, changes: bool, held: bool
) -> TimeAxis:
    positive, held = steps[steps > 0.0], held and are_on_change(times)
    median, short, long = (float(value) for value in np.quantile(positive, (0.5, 0.05, 0.9), method="lower"))
    far = LONGEST_GAP * float(np.minimum(positive, GAP * long).sum())
    parts = np.flatnonzero((steps < 0.0) | (steps > far))
    apart = max(UNKNOWN_S, 2.0 * GAP * long)
    own, by = times[parts], steps[parts]
    later = np.cumsum(apart - by)
    times = times + np.concatenate([[0.0], later])[np.searchsorted(parts, np.arange(len(times)))]
    steps = np.diff(times)
    even = not held and long < MOST_EVEN * short
    longest = (MISSED if even and len(steps) >= LEAST_CHANGES else GAP) * long
    gaps = parts if changes or held else np.flatnonzero(steps > longest)
    covered = float(times[-1] - times[0] - steps[gaps].sum())
    if not covered > 0.0:
        raise InputError(f"{path}: time column {column!r} has nothing but gaps; give rate_hz (--rate)")
    # The rate of the short steps (5 % quantile) avoids aliasing.
    step = median if short > 0.8 * median and not held else short
    growth = HELD_GROWTH if held else CHANGES_GROWTH if changes else MOST_GROWTH
    step = max(short / CHANGE_STEPS if changes else step, covered / (growth * len(times)))
    rate = float(f"{1.0 / step:.6g}")
    samples = int(np.floor((times[-1] - times[0]) * rate + 1e-6)) + 1
    if samples > 100 * growth * len(times):
        worst = int(gaps[np.argmax(steps[gaps])])
        raise InputError(
            f"{path}: time column {column!r} jumps by {steps[worst]:g} s at row {worst + 2}; cut the file there, or give "
            "rate_hz (--rate)"
        )
    at = (np.column_stack([times[gaps], times[gaps + 1]]) - times[0]) * rate
    spans = np.column_stack([np.floor(at[:, 0] + 1e-6) + 1, np.ceil(at[:, 1] - 1e-6)]).astype(np.int64)
    wide = spans[:, 1] > spans[:, 0]
    gaps, spans = gaps[wide], spans[wide]
    known = ~np.isin(gaps, parts)
    jumps = [Jump(*each) for each in zip(own, by, later, spans[~known].tolist(), strict=True)]
    method = Sentence("masked: steps of more than {step} s", step=f"{longest:.3g}")
    faults = (Fault("time_gap", column, method, spans[known]), parted_at(column, jumps))
    note = (
        f"time column {column!r} is not uniform, steps of {short:.3g} to {long:.3g} s: resampled at {rate:.6g} Hz by "
        "straight lines, means where samples are denser, two states held; give rate_hz (--rate) to take the rows as even"
    )
    grid = _Grid(times, float(times[0]), rate, samples, spans, changes, held)
    told = tuple(fault for fault in faults if len(fault.spans))
    note = (
        f"{column} is recorded on change: held at {rate:.6g} Hz" if held else "" if changes or even else note
    )
    return TimeAxis(grid.start_s, rate, samples, told, note, grid.on_grid, grid.doubled)


@dataclass(frozen=True)
class _Grid:
    """Rows at uneven times and the grid they are resampled to."""

    times: Array
    start_s: float
    rate_hz: float
    samples: int
    gaps: npt.NDArray[np.int64]
    changes: bool
    """Whether each row is a change of a state."""
    held: bool
    """Whether each value is held until the next row."""

    def on_grid(self, blocks: Blocks) -> Blocks:
        held: dict[str, bool] = {}

        def read(channel: str, first: int, size: int) -> Iterator[Samples]:
            if channel not in held:
                held[channel] = self.held or _has_two_states(blocks, channel)
            for start in range(first, self.samples, size):
                yield self._block(blocks, channel, start, min(start + size, self.samples), held[channel])

        return read

    def doubled(self, blocks: Blocks, channel: str) -> tuple[Fault, ...]:
        rows, count = _edges(self.times, _rows(blocks, channel, 0, len(self.times)), 1.0 / self.rate_hz)
        at = np.round((self.times[rows[count > 1]] - self.start_s) * self.rate_hz).astype(np.int64)
        spans = np.column_stack([at, at + 1])
        told = Fault("A", channel, Sentence("second crossings removed"), spans, excluded=False)
        return (told,) if len(spans) else ()

    def _block(self, blocks: Blocks, channel: str, first: int, stop: int, held: bool) -> Array:
        half = 0.5 / self.rate_hz
        at = self.start_s + np.arange(first, stop) / self.rate_hz
        reach, beside = (4.0 * half, 3) if self.changes else (half, 1)
        low = max(int(np.searchsorted(self.times, at[0] - reach, side="right")) - beside, 0)
        high = min(int(np.searchsorted(self.times, at[-1] + reach)) + beside, len(self.times))
        values = _rows(blocks, channel, low, high)
        if held and self.changes:
            sampled = _on_ramps(self.times[low:high], values, at, 2.0 * half)
        elif held:
            last = np.searchsorted(self.times[low:high], at + 1e-6 / self.rate_hz, side="right") - 1
            sampled = values[np.maximum(last, 0)]
        else:
            sampled = _on_lines(self.times[low:high], values, at, half)
        for start, end in self.gaps - first:
            sampled[max(start, 0) : max(end, 0)] = np.nan
        return sampled


def finer(channel: Channel, blocks: Blocks, rate_hz: float, *, held: bool) -> tuple[Channel, Blocks]:
    """Raise the rate of a channel: hold each value until the next one (`held`), or interpolate linearly."""
    times = channel.start_s + np.arange(channel.samples) / channel.rate_hz
    samples = int(channel.samples * rate_hz / channel.rate_hz)
    no_gaps = np.empty((0, 2), dtype=np.int64)
    grid = _Grid(times, channel.start_s, rate_hz, samples, no_gaps, changes=False, held=held)
    return replace(channel, rate_hz=rate_hz, samples=samples), grid.on_grid(blocks)


def _rows(blocks: Blocks, channel: str, first: int, stop: int) -> Array:
    count = stop - first
    parts = [unmasked(block) for block in first_of(blocks(channel, first, count), count)]
    return np.concatenate([np.empty(0), *parts, np.full(count - sum(map(len, parts)), np.nan)])


def _has_two_states(blocks: Blocks, channel: str) -> bool:
    """Whether a channel has at most two different values."""
    seen: set[float] = set()
    for block in blocks(channel, 0, BLOCK):
        for part in (block[:1000], block[1000:]):  # the first rows suffice for most channels
            seen.update(np.unique(np.ma.compressed(np.ma.masked_invalid(part)).astype(np.float64)).tolist())
            if len(seen) > 2:
                return False
    return True


def _on_lines(times: Array, values: Array, at: Array, half: float) -> Array:
    """Interpolate between rows, or average the rows where a grid cell has several."""
    time, index = np.unique(times, return_inverse=True)
    if len(time) < len(values):  # mean over rows with the same time
        values = np.bincount(index, values) / np.bincount(index)
    sampled = np.interp(at, time, values)
    dense = np.flatnonzero(np.searchsorted(time, at + half) - np.searchsorted(time, at - half) > 1)
    if dense.size:
        sampled[dense] = _means(time, values, at[dense] - half, at[dense] + half)
    return sampled


def _on_ramps(times: Array, values: Array, at: Array, step: float) -> Array:
    """Samples of a two-state channel with ramps over two grid steps, which preserve the times of its changes.

    An edge that bounces has several changes of state. If the state after them differs from the state before them, the
    first change counts; else none counts.

    Examples
    --------
    >>> _on_ramps(np.array([0.0, 2.3]), np.array([0.0, 1.0]), np.arange(5.0), 1.0)
    array([0.  , 0.  , 0.35, 0.85, 1.  ])
    """
    rows, count = _edges(times, values, step)
    rows = rows[count % 2 == 1]
    if not rows.size:
        return np.full(len(at), values[0])
    apart = np.diff(times[rows], prepend=-np.inf, append=np.inf)
    half = np.minimum(step, 0.5 * np.minimum(apart[1:], apart[:-1]))
    ends = np.column_stack([times[rows] - half, times[rows] + half]).ravel()
    return np.asarray(np.interp(at, ends, np.column_stack([values[rows - 1], values[rows]]).ravel()))


def _edges(times: Array, values: Array, step: float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """First row and number of changes of each edge; an edge that bounces has several changes within part of a grid step."""
    rows = np.flatnonzero(values[1:] != values[:-1]) + 1
    first = np.flatnonzero(np.diff(times[rows], prepend=-np.inf) >= BOUNCE * step)
    return rows[first], np.diff(first, append=len(rows))


def _means(time: Array, values: Array, begins: Array, ends: Array) -> Array:
    """Mean of the linear interpolation over each grid cell; cells are cut off at the first and the last sample."""
    begins, ends = np.maximum(begins, time[0]), np.minimum(ends, time[-1])
    lost = ~np.isfinite(values)
    if lost.any():
        if lost.all():
            return np.full(len(begins), np.nan)
        filled = np.interp(time, time[~lost], values[~lost])
        means = _means(time, filled, begins, ends)
        counted = np.concatenate([[0], np.cumsum(lost)])
        means[counted[np.searchsorted(time, ends)] > counted[np.searchsorted(time, begins)]] = np.nan
        return means
    areas = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])

    def area(x: Array) -> Array:
        k = np.clip(np.searchsorted(time, x, side="right") - 1, 0, len(time) - 2)
        part = x - time[k]
        slope = (values[k + 1] - values[k]) / (time[k + 1] - time[k])
        return np.asarray(areas[k] + part * (values[k] + 0.5 * slope * part))

    return np.asarray((area(ends) - area(begins)) / (ends - begins))
