"""Noise at a spectral line, estimated from residuals at neighbouring frequencies."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.arrays import Array

_REACH = 10
"""Number of bins on either side of a line for its noise estimate."""


def line_noise(residual: npt.ArrayLike, rate_hz: float, frequencies_hz: npt.ArrayLike) -> Array:
    """Return for each line the variance of white noise with the same power as the residuals have near the line.

    A power law is fitted to the periodogram at neighbouring bins by maximum likelihood (Whittle). The periodogram has no
    window, since a steep spectrum leaks into the fitted line in the same way.

    Parameters
    ----------
    residual
        Samples minus the fitted lines, shape (N,), NaN where missing.
    rate_hz
        Sample rate [Hz].
    frequencies_hz
        Frequencies of all fitted lines [Hz], shape (L,).

    Returns
    -------
    ndarray
        Noise variance, shape (L,), unit of the residual squared. Since it is estimated from few bins, it is increased to
        the variance of Student's distribution with the same degrees of freedom. For a line with neighbours on one
        side only it is the mean of these bins, without neighbours the residuals' variance.

    Notes
    -----
    GUM Supplement 1 (JCGM 101:2008), section 6.4.9: v / (v - 2) for v degrees of freedom.
    """
    values = np.asarray(residual, dtype=np.float64)
    lines = np.asarray(frequencies_hz, dtype=np.float64) * len(values) / rate_hz
    present = np.isfinite(values)
    spectrum = np.abs(np.fft.rfft(np.where(present, values, 0.0))) ** 2 / present.sum()
    found = np.empty(len(lines))
    for k, line in enumerate(lines):
        # At most an octave: over a wider band the noise is no power law.
        first, last = (
            max(round(line) - _REACH, int(line / 2), 1),
            min(round(line) + _REACH, int(2 * line) + 2),
        )
        bins = np.arange(first, min(last + 1, len(spectrum) - 1))
        # A bin or more away from every line the fit removes nothing, and the residuals are noise.
        beside = bins[np.abs(bins[:, None] - lines).min(axis=1, initial=np.inf) > 1.0 - 1e-6]
        below = int(np.sum(beside < line))
        if min(below, len(beside) - below) >= 2:
            found[k] = _power_law(beside / line, spectrum[beside])
        elif beside.size:
            found[k] = _student(spectrum[beside].mean(), 2.0 * len(beside))
        else:
            found[k] = np.sum(values[present] ** 2) / max(present.sum() - 2 * len(lines) - 1, 1)
    return found


def _power_law(ratio: Array, power: Array) -> float:
    """Fit a power law to exponentially distributed periodogram values, and return its value at ratio 1."""
    floor = np.finfo(np.float64).tiny + 1e-12 * power.max()
    design = np.column_stack([np.ones(len(ratio)), np.log(ratio)])
    # The mean logarithm of an exponential variable is Euler's constant below the logarithm of its mean.
    best = np.linalg.lstsq(design, np.log(power + floor) + np.euler_gamma)[0]
    for _ in range(8):
        model = np.exp(np.clip(design @ best, -700.0, 700.0))
        best = best + np.linalg.lstsq(design, np.clip(power / model - 1.0, -1.0, 2.0))[0]
    # The logarithm of chi-squared of v degrees of freedom has the variance 2 / v.
    return _student(float(np.exp(best[0])), 2.0 / float(np.linalg.inv(design.T @ design)[0, 0]))


def _student(variance: float, freedom: float) -> float:
    return float(variance * freedom / max(freedom - 2.0, 1.0))
