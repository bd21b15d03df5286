"""Which crossings of a pulse train are pulses, and where pulses can't be told from noise."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from shipfp_rs.support.spans import Spans, runs

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

AT_REST = 1 / 3
"""Pulses lower than this part of the usual height are doubted: they may be the noise or the hum of a shaft at rest."""
NEAR_LIMIT = 1.2
"""Pulses that are not as much higher than the limit may have lost others beside them."""
_IN_A_ROW = 20
"""So many even periods in a row have pulses and noise has not: of its periods less than half are even."""
_EVEN = 0.25
_NEIGHBOURS = 7
_GRID = 1.2
"""Samples by which the periods of an even train differ at most, since they begin and end between two of them."""
_MOST_TEETH = 3
"""A wheel's gap lasts two or three periods."""
_SAME_HEIGHT, _SAME_PERIOD = 2.0, 1.6
"""Ratios up to which low pulses go on from the others; hum at rest has neither their height nor their period."""
_SILENCE = 5.5
"""Periods without a pulse after which there are none; fewer are missed pulses."""


def clear_pulses(times: Array, heights: Array, limits: Array, usual: float) -> Flags:
    """Tell which crossings are pulses: those that are high enough, and those that follow one another evenly.

    Parameters
    ----------
    times
        Of the crossings [samples], shape (N,).
    heights
        Of the train at each, NaN where not known, shape (N,).
    limits
        Heights from which on they can't be noise, shape (N,).
    usual
        The train's usual height.
    """
    clear = ~((heights < limits) | (heights < AT_REST * usual))
    if clear.all():
        return clear
    kept = clear.copy()
    for first, stop in runs(~clear).tolist():
        # With as many on either side as may belong to a row.
        begin, end = max(first - _IN_A_ROW, 0), min(stop + _IN_A_ROW, len(times))
        for start, last in runs(_even(np.diff(times[begin:end]))).tolist():
            if last - start >= _IN_A_ROW:
                row = slice(max(begin + start, first), min(begin + last + 1, stop))
                kept[row] = True
    if clear.any():
        for first, stop in runs(kept & (heights < AT_REST * usual)).tolist():
            kept[first:stop] = any(
                _goes_on(times, heights, *pair, kept)
                for pair in ((first, first - 1), (stop - 1, stop))
                if 0 <= pair[1] < len(times)
            )
    return kept


def unclear(times: Array, kept: Flags, low: Flags, missing: Spans, samples: int) -> Array:
    """Return the stretches without pulses that are no missing samples, from pulse to pulse [samples], shape (K, 2).

    Parameters
    ----------
    times
        Of all crossings [samples], shape (N,).
    kept, low
        Which of them are pulses, and which are hardly higher than noise, shape (N,).
    missing
        Stretches without samples, first and first after, shape (K, 2).
    samples
        How many the record has.
    """
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
            doubted[1:-1] |= (low[1:] | low[:-1]) & (inner > _SAME_PERIOD * np.minimum(before, after))
        doubted[0] = ends[0] > _SILENCE * inner[:3].max()
        doubted[-1] = ends[1] > _SILENCE * inner[-3:].max()
    if len(pulses) < len(times):
        doubted |= np.bincount(np.searchsorted(pulses, times[~kept]), minlength=len(doubted)) > 0
    at = np.flatnonzero(doubted)
    edges = np.concatenate([[0.0], pulses, [float(samples)]]) if at.size else np.zeros(1)
    found = np.column_stack([edges[at], edges[at + 1]]) if at.size else np.empty((0, 2))
    # What lies beside missing samples is silent because of them.
    lost = np.zeros(len(found))
    for first, stop in missing.tolist():
        lost += np.clip(np.minimum(found[:, 1], stop) - np.maximum(found[:, 0], first), 0.0, None)
    return np.asarray(found[lost < 0.5 * (found[:, 1] - found[:, 0])])


def _even(periods: Array) -> Flags:
    """Whether each period is the usual one of its neighbours, or, alone among such, two or three of it."""
    if not len(periods):
        return np.zeros(0, dtype=np.bool_)
    usual = median_filter(periods, size=_NEIGHBOURS, mode="nearest")
    allowed = np.maximum(_EVEN * usual, _GRID)
    single = np.abs(periods - usual) <= allowed
    beside = np.append(True, single[:-1]) & np.append(single[1:], True)
    teeth = np.clip(np.rint(periods / usual), 2.0, _MOST_TEETH)
    even = single | (beside & (np.abs(periods - teeth * usual) <= allowed))
    # Where noise goes over into pulses, each has its own usual period.
    jumps = np.abs(np.diff(usual)) > allowed[1:] + allowed[:-1]
    return np.asarray(even & ~(np.append(False, jumps) | np.append(jumps, False)))


def _goes_on(times: Array, heights: Array, end: int, beyond: int, kept: Flags) -> bool:
    """Whether a row of low pulses goes on from its end to the pulses beyond."""
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
