"""Model adequacy: the residual power that appears only where the ship is excited, which noise can't explain.

Noise does not depend on the excitation, but the error of a wrong model does. The residual's power is therefore compared
between stretches in which the response in a band is strong, and stretches in which it is weak.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import stft
from scipy.stats import chi2

from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.sampling import BEFORE_S
from shipfp_rs.support.arrays import Array

STRETCH_S = 20.0
"""Length of a stretch, over which a spectrum is computed [s]."""
STRONG, WEAK = 0.75, 0.5
"""Quantiles of the response's power in a band: above the first a stretch counts as excited, below the second as quiet."""
CHANCE = 3.0
"""Standard deviations of the noise power that are subtracted from an excess, so that chance does not count as a misfit."""

SELDOM = 0.99
"""Level of the smooth errors' chi-squared law up to which they are attributed to gauge and calibration."""


def strain(likelihood: Likelihood, vector: Array) -> float:
    """Return the squared size of the fit's smooth errors, over the largest that gauge and calibration explain.

    Above 1 the model is wrong: it needs errors larger than that.
    """
    sizes, unsure = likelihood.smooth_errors(likelihood.residuals(vector))
    told = len(unsure) - float(np.trace(unsure))
    return float(np.sum(sizes**2) / chi2.ppf(SELDOM, max(told, 1.0)))


def misses_pct(likelihood: Likelihood, vector: Array) -> list[float]:
    """Return the misfit of each output, in per cent of its response, over all records."""
    missed = np.zeros(len(likelihood.accuracy))
    scatter = np.zeros(len(likelihood.accuracy))
    size = np.full(len(likelihood.accuracy), 1e-30)
    for index, record in enumerate(likelihood.records):
        rate = record.data_hz / record.down
        begin = int(BEFORE_S * rate)
        model = likelihood.modelled(vector, index)[:, begin:]
        length = min(int(STRETCH_S * rate), model.shape[1] // 4)
        for output, (response, data) in enumerate(zip(model, record.decimated[:, begin:], strict=True)):
            power, left = (
                np.abs(stft(row - row.mean(), rate, nperseg=length, boundary=None, padded=False)[2]) ** 2
                for row in (response, data[: len(response)] - response)
            )
            kept = (np.arange(len(power)) * rate / length <= record.band_hz) & (np.arange(len(power)) > 0)
            power, left = power[kept], left[kept]
            strong = power >= np.quantile(power, STRONG, axis=1, keepdims=True)
            weak = power <= np.quantile(power, WEAK, axis=1, keepdims=True)
            quiet = np.sum(left * weak, axis=1) / weak.sum(axis=1)
            missed[output] += np.sum((left - quiet[:, None]) * strong)
            # The standard deviation of a spectral power equals its mean.
            scatter[output] += np.sum(
                quiet**2 * (strong.sum(axis=1) + strong.sum(axis=1) ** 2 / weak.sum(axis=1))
            )
            size[output] += np.sum(power * strong)
    surely = np.maximum(missed - CHANCE * np.sqrt(scatter), 0.0)
    return [float(one) for one in 100.0 * np.sqrt(surely / size)]


def explained_pct(likelihood: Likelihood, vector: Array) -> list[list[float]]:
    """Return the fit 100 (1 - |y - model| / |y - mean(y)|) of each record's outputs in the band."""
    rows = []
    for index, record in enumerate(likelihood.records):
        model = likelihood.modelled(vector, index)
        data = record.decimated
        spread = np.linalg.norm(data - data.mean(axis=1, keepdims=True), axis=1)
        rows.append(
            [
                float(100.0 * (1.0 - a / max(b, 1e-30)))
                for a, b in zip(np.linalg.norm(data - model, axis=1), spread, strict=True)
            ]
        )
    return rows
