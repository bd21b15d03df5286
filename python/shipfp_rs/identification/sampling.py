"""Excited bandwidth of a record, and the course of inputs between samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.fft import prev_fast_len, rfft

from shipfp_rs.support.arrays import Array

Between = Literal["band-limited", "straight", "held"]
"""Course of the inputs between samples: smooth, piecewise linear, or held."""
BAND_HZ = 4.0
"""Highest frequency that is compared [Hz]; above it ships' tachometers and loops carry little information."""
EXCITED = 0.99
"""Share of the inputs' power times frequency that is inside the band; beyond it the data are noise."""
LEAST_HZ, LEAST_PERIODS = 0.5, 40
"""Least bandwidth [Hz], and least number of a record's frequencies in it, so that the noise can be estimated."""
EDGE_S = 2.0
"""Time over which a record fades in and out [s], so that its edges do not leak into the band."""
SHORTEST_S = 10.0 * EDGE_S
"""Least length of a record for a spectrum [s]."""
BEFORE_S = 2.0
"""Initial time that is not compared [s]: dead times carry into it what happened before the record, which is unknown if the
record starts during an excitation."""


def down_of(rate_hz: float, seen_hz: float) -> int:
    """Decimation factor that keeps three or more samples per period of the highest frequency."""
    return max(1, int(rate_hz / (3.0 * seen_hz) + 1e-9))


def excited_hz(inputs: Sequence[Array], rate_hz: float, most_hz: float) -> float:
    """Return the frequency [Hz] below which the inputs have `EXCITED` of their power times frequency, at most `most_hz`."""
    found = LEAST_HZ
    for one in inputs:
        if not len(one):
            continue
        count = prev_fast_len(len(one), real=True)
        fade = np.minimum(np.arange(count), np.arange(count)[::-1]) / (EDGE_S * rate_hz)
        power = np.abs(rfft((one[:count] - one[:count].mean()) * np.clip(fade, 0.0, 1.0))) ** 2
        frequency = np.fft.rfftfreq(count, 1.0 / rate_hz)
        grown = np.cumsum(np.where(frequency <= most_hz, power * frequency, 0.0))
        found = max(
            found,
            float(frequency[np.searchsorted(grown, EXCITED * grown[-1])]),
            LEAST_PERIODS * rate_hz / count,
        )
    return min(found, most_hz)
