"""Detection of a chirp with constant frequency (fault D3)."""

from __future__ import annotations

import numpy as np

from shipfp_rs.support.arrays import Array

LEAST_HALVES = 3
"""Least number of half periods that can show a change of frequency."""
CHANGES = 1.3
"""Least ratio between the frequencies in the first and the last third of a record, or its inverse, for a chirp."""
HYSTERESIS = 0.2
"""Half the width of the hysteresis band about the middle level, relative to half the peak-to-peak range."""


def constant_frequency(samples: Array, rate_hz: float) -> float | None:
    """Frequency of a supposed chirp if it is constant [Hz], else None."""
    low, high = np.percentile(samples, [2.0, 98.0])
    middle, swing = 0.5 * (low + high), HYSTERESIS * 0.5 * (high - low)
    if not swing > 0.0:
        return 0.0
    side = np.where(samples > middle + swing, 1, np.where(samples < middle - swing, -1, 0))
    clear = np.flatnonzero(side)
    turns = np.flatnonzero(np.diff(side[clear]))
    # Half periods are timed between crossings of the middle level, with hysteresis against noise.
    # A crossing is halfway between the last sample outside the hysteresis band and the first sample across it.
    crossings = 0.5 * (clear[turns] + clear[turns + 1]) / rate_hz
    halves = np.diff(crossings)
    if len(halves) < LEAST_HALVES:  # the number of crossings gives the frequency, 0 without a crossing
        return float(0.5 * len(turns) * rate_hz / len(samples))
    third = max(len(halves) // 3, 1)
    ratio = float(np.median(halves[:third]) / np.median(halves[-third:]))
    if max(ratio, 1.0 / ratio) >= CHANGES:
        return None
    return float(0.5 / np.median(halves))
