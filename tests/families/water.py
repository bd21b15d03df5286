"""Water that moves at the propeller, air at the fan: a slow random change of the load's law, smooth in time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

KNOT_S = 0.05


@njit(cache=True)
def changed(coefficients, t):
    """Value of the spline with knots every `KNOT_S` from zero on."""
    i = min(max(int(t / KNOT_S), 0), coefficients.shape[1] - 1)
    x = t - i * KNOT_S
    c = coefficients
    return ((c[0, i] * x + c[1, i]) * x + c[2, i]) * x + c[3, i]


@njit(cache=True)
def _changed_at(coefficients, times):
    out = np.empty(len(times))
    for i in range(len(times)):
        out[i] = changed(coefficients, times[i])
    return out


@dataclass(frozen=True)
class Water:
    """Noise with two equal poles: `share` its standard deviation over the load, `memory_s` the poles' time constant."""

    share: float
    memory_s: float
    seconds: float
    seed: int

    @cached_property
    def coefficients(self) -> np.ndarray:
        count, settle = int(self.seconds / KNOT_S) + 3, int(20.0 * self.memory_s / KNOT_S)
        pole = np.exp(-KNOT_S / self.memory_s)
        raw = np.random.default_rng(self.seed).standard_normal(count + settle)
        smooth = lfilter([1.0], np.convolve([1.0, -pole], [1.0, -pole]), raw)[settle:]
        # Variance of the filter's output by its poles, not of this one record.
        variance = (1.0 + pole**2) / ((1.0 - pole**2) ** 3)
        return np.ascontiguousarray(
            CubicSpline(np.arange(count) * KNOT_S, self.share * smooth / np.sqrt(variance)).c
        )

    def __call__(self, times):
        return _changed_at(self.coefficients, np.asarray(times, dtype=float))
