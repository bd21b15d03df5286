"""Decides which crossings of a pulse train are pulses, and finds stretches where pulses are lost in noise."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.ndimage import correlate1d, median_filter

from shipfp_rs.support.arrays import Array, Spans, runs

Flags = npt.NDArray[np.bool_]

AT_REST = 1 / 3
"""Pulses below this fraction of the usual height are doubtful: they may be noise, or mains hum while the
shaft is at rest.
"""
NEAR_LIMIT = 1.2
"""If pulses are lower than this multiple of the limit, other pulses nearby may be lost in noise."""
FAR_FROM_LIMIT = 2.0
"""A pulse higher than this multiple of the limit can't be noise."""
_LIMIT = 14.0
"""Least height of a pulse, in standard deviations of the noise."""
_DENSE = 10.0
"""With fewer samples per pulse, the noise can't be measured, and the limit does not show whether pulses were lost."""
IN_A_ROW = 20
"""This many successive periods of nearly equal length are pulses; noise has less than half as many in a row."""
_EVEN = 0.25
"""Largest relative difference between a period of an evenly spaced row and the mean of its two neighbours."""
_MARGIN = 2
_UNTOLD = 16
_NEIGHBOURS = 7
_GRID = 1.2
"""Largest difference between periods of an even pulse train [samples], since both ends of a period lie between
samples.
"""
_MOST_TEETH = 3
"""Longest gap of a wheel with missing teeth, in periods."""
_SAME_HEIGHT, _SAME_PERIOD = 2.0, 1.6
"""Low pulses continue a train if heights and periods differ by less than these ratios; mains hum at rest
differs by more.
"""
_SILENCE = 5.5
"""After this many periods without a pulse, the train has stopped; in a shorter break, pulses were missed."""


def without_noise(times: Array, heights: Array, limits: Array) -> Array:
    """Pulse heights (N,) minus the height that noise adds to the extremes of half a pulse; a height of 0 stays 0."""
    if len(times) < 2:
        return heights
    periods = np.diff(times)
    samples = 0.5 * np.maximum(np.append(periods[0], periods), np.append(periods, periods[-1]))
    # The largest of m normally distributed numbers is about sqrt(2 ln m) - 0.6 standard deviations above their mean.
    pushed = np.maximum(np.sqrt(2.0 * np.log(np.maximum(samples, 1.0))) - 0.6, 0.0)
    return np.asarray(
        np.where(heights > 0.0, np.maximum(heights - 2.0 * pushed * limits / _LIMIT, 1e-300), heights)
    )


def clear_pulses(times: Array, heights: Array, limits: Array, usual: float) -> Flags:
    """Mark the crossings that are pulses: higher than their limits, or evenly spaced. Unneeded heights are NaN."""
    clear = ~((heights < limits) | (heights < AT_REST * usual))
    if clear.all():
        return clear
    kept = clear | _in_rows(times, ~clear, (heights < limits) & (heights > 0.0))
    # The height is 0 without turning points nearby, for example beside a spike. Such a crossing counts only between pulses.
    for first, stop in runs(heights == 0.0).tolist():
        beside = first > 0 and stop < len(times) and kept[first - 1] and kept[stop]
        kept[first:stop] &= beside and stop - first <= _UNTOLD
    low = kept & (heights < AT_REST * usual)
    return _joined(times, heights, kept & ~low, runs(low)) if clear.any() else kept


def _in_rows(times: Array, doubted: Flags, faint: Flags) -> Flags:
    """Mark the crossings in evenly spaced rows around doubtful ones; of a row below the limit, only the inner ones."""
    found = np.zeros(len(times), dtype=np.bool_)
    for first, stop in runs(doubted).tolist():
        # Include crossings on either side that may belong to the same evenly spaced row.
        begin, end = max(first - IN_A_ROW, 0), min(stop + IN_A_ROW, len(times))
        for start, last in (runs(_even(np.diff(times[begin:end]))) + begin).tolist():
            if last - start >= IN_A_ROW:
                # The first and last crossings of a faint row may be noise.
                inner = slice(start + _MARGIN if start else 0, last + 1 - _MARGIN * (last + 1 < len(times)))
                found[start : last + 1] |= ~faint[start : last + 1]
                found[inner] = True
    return found


def _joined(times: Array, heights: Array, sure: Flags, low: Spans) -> Flags:
    """Mark the sure pulses, and the low pulses that continue a row of sure ones."""
    kept, left = sure.copy(), low.tolist()

    def joins(end: int, beyond: int) -> bool:
        return 0 <= beyond < len(times) and _goes_on(times, heights, end, beyond, kept)

    while joining := [one for one in left if joins(one[0], one[0] - 1) or joins(one[1] - 1, one[1])]:
        for first, stop in joining:
            kept[first:stop] = True
        left = [span for span in left if span not in joining]
    return kept


def unclear(times: Array, kept: Flags, low: Flags, missing: Spans, samples: int) -> Array:
    """Stretches with samples but without clear pulses, from pulse to pulse [samples], shape (K, 2)."""
    pulses = times if kept.all() else times[kept]
    if not len(pulses):
        return np.array([[0.0, float(samples)]])
    ends = pulses[0], samples - pulses[-1]
    inner = np.diff(pulses)
    doubted = np.zeros(len(inner) + 2, dtype=np.bool_)
    if len(inner) > 2:
        low = low[kept]
        if inner.max() > _SILENCE * inner.min() or low.any():
            before, after = np.append(inner[1], inner[:-1]), np.append(inner[1:], inner[-2])
            doubted[1:-1] = inner > _SILENCE * np.maximum(before, after)
            usual = np.minimum(before, after)
            low = (low[1:] | low[:-1]) & (usual >= _DENSE)
            doubted[1:-1] |= low & (inner > _SAME_PERIOD * usual)
        doubted[0] = ends[0] > _SILENCE * inner[:3].max()
        doubted[-1] = ends[1] > _SILENCE * inner[-3:].max()
    if len(pulses) < len(times):
        doubted |= np.bincount(np.searchsorted(pulses, times[~kept]), minlength=len(doubted)) > 0
    edges = np.concatenate([[0.0], pulses, [float(samples)]])
    found = np.column_stack([edges[:-1][doubted], edges[1:][doubted]])
    # A stretch that consists mostly of missing samples is not listed.
    lost = np.zeros(len(found))
    for first, stop in missing.tolist():
        lost += np.clip(np.minimum(found[:, 1], stop) - np.maximum(found[:, 0], first), 0.0, None)
    return np.asarray(found[lost < 0.5 * (found[:, 1] - found[:, 0])])


def _even(periods: Array) -> Flags:
    """Whether each period, divided by its number of teeth, is near the mean of its two neighbours."""
    if not len(periods):
        return np.zeros(0, dtype=np.bool_)
    usual = median_filter(periods, size=_NEIGHBOURS, mode="nearest")
    allowed = np.maximum(_EVEN * usual, _GRID)
    teeth = np.clip(np.rint(periods / usual), 1.0, _MOST_TEETH)
    teeth[np.abs(periods - teeth * usual) > np.maximum(allowed, teeth * _GRID)] = 1.0
    pitches = periods / teeth
    return np.asarray(np.abs(pitches - correlate1d(pitches, [0.5, 0.0, 0.5], mode="nearest")) <= allowed)


def _goes_on(times: Array, heights: Array, end: int, beyond: int, kept: Flags) -> bool:
    """Whether the first kept pulse from index `beyond` on continues the row of low pulses that ends at index `end`."""
    step = 1 if beyond > end else -1
    others = np.flatnonzero(kept[beyond::step])
    if not len(others):
        return False
    other = beyond + step * int(others[0])
    high, low = max(heights[end], heights[other]), min(heights[end], heights[other])
    if high <= _SAME_HEIGHT * low:
        return True
    if not (0 <= end - 2 * step < len(times) and 0 <= other + 2 * step < len(times)):
        return False
    periods = abs(times[end] - times[end - 2 * step]), abs(times[other + 2 * step] - times[other])
    return bool(max(periods) <= _SAME_PERIOD * min(periods))
