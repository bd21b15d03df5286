"""Missed and extra pulses: crossing times to tracks of counted intervals."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
import numpy.typing as npt

from shipfp_rs._core import pulses_are_even, running_median
from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import Array

_MEDIAN_WINDOW = 21
"""Periods in the running median against which missed and extra pulses show."""
_EXTRA_BELOW = 0.6
"""A period shorter than this part of the median ends at an extra pulse. Both halves of a period cut in the middle are
that short; a shaft does not speed up so much within a few pulses."""
_CLEARLY_BETTER = 0.05
"""Of two crossings close together the first is the edge and the second that of a saw-tooth on it (Fig. 6.15), unless
the second fits better by this part of a period. Uneven reflectors and changing speed make smaller differences."""
_MISSED_FROM = 1.6
_MOST_MISSED = 4
"""More missed pulses in a row are a stopped shaft or a dead pick-up, and are left out rather than filled in."""


class PulseFlag(IntFlag):
    """What was repaired in an interval."""

    GOOD = 0
    EXTRA = 1
    """Extra crossings within it were removed."""
    MISSED = 2
    """Its crossings were missed; it is an equal share of a longer one."""


@dataclass(frozen=True)
class Track:
    """Pulses between two breaks: interval k runs from edge k to k + 1 over `count[k]` true intervals."""

    edges_s: Array
    count: npt.NDArray[np.int64]
    flags: npt.NDArray[np.uint8]
    usable: npt.NDArray[np.bool_]


def require_positive(name: str, value: float) -> None:
    """Refuse what is not a positive number."""
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name}: found {value}, expected a positive number")


def checked_times(
    times_s: npt.ArrayLike, pulses_per_rev: int, gaps: npt.ArrayLike | None
) -> tuple[Array, Array]:
    """Return times and gaps as arrays, or say what is wrong with them."""
    times = np.asarray(times_s, dtype=np.float64)
    if times.ndim != 1:
        raise InputError(f"times_s: found shape {times.shape}, expected one axis")
    if pulses_per_rev < 1:
        raise InputError(f"pulses_per_rev: found {pulses_per_rev}, expected 1 or more")
    ascending = times[1:] > times[:-1]
    if not ascending.all():
        k = int(np.argmin(ascending))
        raise InputError(
            f"times_s: {times[k + 1]} follows {times[k]} at index {k + 1}, expected ascending times"
        )
    gap_times = np.empty((0, 2)) if gaps is None else np.asarray(gaps, dtype=np.float64)
    if gap_times.ndim != 2 or gap_times.shape[1] != 2:
        raise InputError(f"gaps: found shape {gap_times.shape}, expected (G, 2)")
    return times, gap_times


def _running_median(periods: Array) -> Array:
    return running_median(periods, _MEDIAN_WINDOW)


def _without_extra(times: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Remove extra crossings; also tell which intervals between the remaining ones contain a removed one."""
    median = _running_median(np.diff(times))
    if not (np.diff(times) < _EXTRA_BELOW * median).any():
        return times, np.zeros(len(times) - 1, dtype=np.bool_)
    kept = [times[0]]
    merged = [False]
    pending = False
    for time, usual in zip(times[1:], median, strict=True):
        if time - kept[-1] >= _EXTRA_BELOW * usual:
            kept.append(time)
            merged.append(pending)
            pending = False
        elif (
            len(kept) > 1
            and abs(time - kept[-2] - usual) < abs(kept[-1] - kept[-2] - usual) - _CLEARLY_BETTER * usual
        ):
            # The one before it was the extra pulse.
            kept[-1], merged[-1] = time, True
        else:
            pending = True
    return np.array(kept), np.array(merged[1:])


def cut_tracks(times: Array, gaps: Array) -> list[Track]:
    """Cut the pulses at breaks, count what each interval holds, and flag the repairs."""
    if len(times) < 2:
        return []
    if not len(gaps) and pulses_are_even(times, _EXTRA_BELOW, _MISSED_FROM):
        # As what follows would find, for no median is beyond its periods.
        size = len(times) - 1
        one, good = np.ones(size, dtype=np.int64), np.zeros(size, dtype=np.uint8)
        return [Track(times, one, good, np.ones(size, dtype=np.bool_))]
    times, merged = _without_extra(times)
    if len(times) < 2:
        return []
    periods = np.diff(times)
    ratio = periods / _running_median(periods)
    count = np.where(ratio < _MISSED_FROM, 1, np.rint(ratio)).astype(np.int64)
    over_gap = np.searchsorted(gaps[:, 0], times[1:]) > np.searchsorted(gaps[:, 1], times[:-1], side="right")
    # Over a gap the count goes on only where the number of pulses in it is certain.
    broken = (count > 1 + _MOST_MISSED) | (over_gap & (np.abs(ratio - count) > 0.3))
    flags = np.where(count > 1, PulseFlag.MISSED, 0) | np.where(merged, PulseFlag.EXTRA, 0)
    cuts = np.flatnonzero(broken)
    tracks = []
    for first, last in zip(np.append(0, cuts + 1), np.append(cuts, len(periods)), strict=True):
        if last > first:
            span = slice(first, last)
            tracks.append(
                Track(times[first : last + 1], count[span], flags[span].astype(np.uint8), ~over_gap[span])
            )
    return tracks
