"""A chirp whose frequency never changes (fault D3)."""

from __future__ import annotations

import numpy as np

from shipfp_rs.support.arrays import Array

LEAST_HALVES = 3
"""Fewest half periods that can show a change of frequency."""
CHANGES = 1.3
"""Least ratio of a chirp's frequencies in the first and the last third of a record."""
HYSTERESIS = 0.2
"""Share of the swing that the signal must pass on either side of its middle to count as a half period."""


def constant_frequency(samples: Array, rate_hz: float) -> float | None:
    """Return the frequency of what should be a chirp but stays at one [Hz], or None where the frequency changes.

    Half periods are timed between crossings of the middle, with hysteresis against noise. A record with fewer than
    three of them is no chirp either: the frequency returned is what the crossings tell, 0 without any.

    Parameters
    ----------
    samples
        The set point, shape (N,), finite, any unit.
    rate_hz
        Sample rate [Hz].
    """
    low, high = np.percentile(samples, [2.0, 98.0])
    middle, swing = 0.5 * (low + high), HYSTERESIS * 0.5 * (high - low)
    if not swing > 0.0:
        return 0.0
    side = np.where(samples > middle + swing, 1, np.where(samples < middle - swing, -1, 0))
    clear = np.flatnonzero(side)
    turns = np.flatnonzero(np.diff(side[clear]))
    # The crossing is taken halfway from the last sample clearly on one side to the first on the other.
    crossings = 0.5 * (clear[turns] + clear[turns + 1]) / rate_hz
    halves = np.diff(crossings)
    if len(halves) < LEAST_HALVES:
        return float(0.5 * len(turns) * rate_hz / len(samples))
    third = max(len(halves) // 3, 1)
    ratio = float(np.median(halves[:third]) / np.median(halves[-third:]))
    if max(ratio, 1.0 / ratio) >= CHANGES:
        return None
    return float(0.5 / np.median(halves))
