"""Detection of evenly spaced rows, and of missing ones, under a clock coarser than the rows, such as whole seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.arrays import Array

Rows = npt.NDArray[np.int64]

UNEVEN_TICKS = 0.01
"""Ticks count as equal where all clock steps are multiples of the shortest step, to within this fraction of it."""
USUAL = 0.9
"""Where this fraction of the ticks has the same number of rows, ticks with fewer rows lack some."""
WITHIN = 1.05
"""Largest deviation [rows] of evenly spaced rows from a line through the first rows of their ticks."""

EARLY = 0.25
"""Fraction of a tick by which rows may be stamped early or late."""


@dataclass(frozen=True)
class CoarseClock:
    """Evenly spaced rows under a coarse clock.

    Parameters
    ----------
    rate_hz
        Rate of the rows: the roundest number consistent with the ticks.
    resolution_s
        One tick [s].
    times
        Time of every row [s], to within one row; it jumps where rows are missing or the clock was set.
    jumps
        Whether rows are missing or the clock was set.
    masked
        Rows [first, stop) with unknown times, since other rows of their tick are missing; shape (K, 2).
    """

    rate_hz: float
    resolution_s: float
    times: Array
    jumps: bool
    masked: Rows


def find_coarse(times: Array) -> CoarseClock | None:
    """Find evenly spaced rows under a clock with fewer steps than rows; None where the rows are not even."""
    steps = np.diff(times)
    rises = np.flatnonzero(steps != 0.0) + 1
    if len(rises) < 3 or not (steps > 0.0).any():
        return None
    tick = float(steps[steps > 0.0].min())
    passed = steps[rises - 1] / tick
    alike = np.abs(passed - np.rint(passed)).max() < UNEVEN_TICKS
    if not alike:  # missing rows can't be found among ticks of different lengths
        return _through(times, rises, tick, [])
    slips, early = _slips(np.rint(passed), np.diff(rises))
    # Where some rows are stamped early, a tick with fewer rows lacks none, provided that all rows lie on one line.
    return (_through(times, rises, tick, []) if early else None) or _through(times, rises, tick, slips)


def _through(times: Array, rises: Rows, tick: float, slips: Sequence[_Slip]) -> CoarseClock | None:
    """Evenly spaced rows that fit all changes of the clock except at slips; None where the rows are not even."""
    ends = [0, *(k for slip in slips for k in (slip.before, slip.behind)), len(rises) - 1]
    spans = rises[np.reshape(ends, (-1, 2))]
    count = int(np.diff(spans).sum())
    period = float(np.diff(times[spans]).sum()) / count if count else 0.0
    if not period > 0.0:
        return None
    known = 1.5 / count  # accurate to one row; the logger has the roundest rate within it
    rate = next(
        rounded
        for digits in range(1, 13)
        if abs((rounded := float(f"{1.0 / period:.{digits}g}")) * period - 1.0) <= known
    )
    # The first row of each tick is late by less than a row; one tick in ten may be early.
    behind = times[rises] - rises / rate
    levels = [
        float(np.quantile(behind[first : stop + 1], 0.9, method="higher"))
        for first, stop in np.reshape(ends, (-1, 2))
    ]
    breaks = [int(rises[slip.at]) for slip in slips]
    row = np.arange(len(times))
    found = np.asarray(levels)[np.searchsorted(breaks, row, side="right")] + row / rate
    masked = [_rows(slip, rises, len(times)) for slip in slips if slip.hides]
    off = times - found
    for slip in slips:
        off[slice(*_rows(slip, rises, len(times)))] = np.nan
    if np.isnan(off).all() or not np.nanmax(off) - np.nanmin(off) <= 1.02 * tick + 2.0 / rate:
        return None
    return CoarseClock(rate, tick, found, bool(slips), np.reshape(masked, (-1, 2)).astype(np.int64))


class _Slip(NamedTuple):
    """Missing rows or a clock that was set: indices of the last change of the clock before it and the first one after it."""

    before: int
    behind: int
    at: int
    """Index of the change at which the rows after the slip begin."""
    hides: bool
    """Whether the times of the rows in between are unknown."""


def _rows(slip: _Slip, rises: Rows, count: int) -> tuple[int, int]:
    """Rows [first, stop) of a slip; at an end of the file, which has no whole tick, all rows up to that end."""
    first = 0 if slip.before == 0 else int(rises[slip.before])
    return first, count if slip.behind == len(rises) - 1 else int(rises[slip.behind])


def _rows_a_tick(counts: Rows) -> float:
    """Rows in a whole tick: the usual number where other ticks can only lack rows, else the mean."""
    if not len(counts):
        return np.nan
    usual = float(np.median(counts))
    near = counts[np.abs(counts - usual) <= 2.0]
    mean = float(near.mean()) if len(near) else usual
    fewer = float((usual - near).sum())
    if fewer >= 2.0:  # at a fractional rate, ticks lack rows at even intervals
        walk, slopes = np.cumsum(near - mean)[:, None], np.linspace(-1.0, 1.0, 41) / len(near)
        if np.ptp(walk + np.arange(len(near))[:, None] * slopes, axis=0).min() <= WITHIN:
            return mean
    return mean if fewer < 0.0 or np.mean(counts == usual) < USUAL else usual


def _slips(passed: Array, counts: Rows) -> tuple[list[_Slip], bool]:
    """Find slips from the ticks at each change and the rows between changes; also whether some rows are stamped early."""
    steps = passed[1:]
    usual = _rows_a_tick(counts[steps == 1.0])
    lacking = usual * steps - counts
    # Ticks with a few rows more than usual show how early or late rows are stamped.
    more = -lacking[(steps == 1.0) & (lacking >= -EARLY * usual)].min(initial=0.0)
    least = 0.5 if usual == round(usual) else 2.0 * WITHIN
    early = bool(more > least)
    least += 2.0 * more if early else 0.0
    odd = np.abs(lacking) > least
    odd[0] |= passed[0] != 1.0  # no whole tick comes before the first change
    slips: list[_Slip] = []
    for first, stop in (
        np.flatnonzero(np.diff(np.concatenate([[False], odd, [False]]))).reshape(-1, 2).tolist()
    ):
        by, net = steps[first:stop], float(lacking[first:stop].sum())
        if -max(1.5, least) <= net <= least and (by > 0.0).all() and (first or passed[0] == 1.0):
            continue  # rows stamped early or late
        alone = stop - first == 1 and (by[0] != 1.0 or net < 0.0)
        amid = stop - first == 2 and by[0] != 1.0 and by[1] == 1.0
        at_end = first == 0 or stop == len(steps)
        at = first + 1 if amid and not at_end else stop
        slips.append(_Slip(first, stop, at, at_end or not (alone or amid)))
    return slips, early
