"""Finite impulse response (FIR) low-pass of measured and simulated signals."""

from __future__ import annotations

import numpy as np
from scipy import signal

from shipfp_rs.support.arrays import Array

PASSBAND, STOPBAND = 0.3, 0.5
"""Edges of the low-pass as fractions of the output's rate; frequencies above half of it must not alias."""
ATTENUATION_DB = 80.0


def taps(rate: float, shift: float) -> Array:
    """Kaiser-windowed sinc for an output at `rate` times the inner rate, delayed by `shift` inner samples."""
    count, beta = signal.kaiserord(ATTENUATION_DB, (STOPBAND - PASSBAND) * rate / 0.5)
    half = count // 2
    time = np.arange(-half, half + 1) + shift
    inside = np.sqrt(np.maximum(1.0 - (time / (half + abs(shift))) ** 2, 0.0))
    cutoff = (PASSBAND + STOPBAND) * rate
    taps = cutoff * np.sinc(cutoff * time) * np.i0(beta * inside)
    return np.asarray(taps / taps.sum())
