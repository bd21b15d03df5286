"""Whether the model is the ship's: what it misses where the ship is driven hard, beyond what is left where it is not.

Noise does not know the excitation; what a model lacks, whether linear or not, comes and goes with it. The residual's power
in stretches and bands in which the response is strong, less its power in stretches in which the same band is quiet, is a
miss that no noise explains.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import stft
from scipy.stats import chi2

from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.sampling import BEFORE_S
from shipfp_rs.support.arrays import Array

STRETCH_S = 20.0
"""Length of the stretches whose spectra are looked at [s]."""
STRONG, WEAK = 0.75, 0.5
"""Quantiles of the response's power within a band above which a stretch is driven, and below which it is quiet."""
CHANCE = 3.0
"""Deviations of what chance leaves in excess that are taken off a miss."""

SELDOM = 0.99
"""Level of the law of the smooth errors up to which they are taken for those of gauge and calibration."""


def strain(likelihood: Likelihood, vector: Array) -> float:
    """Return how large the smooth errors are that a fit needs, over what gauge and calibration leave open.

    Above one the model is bent by more than that: it is not the ship's.
    """
    sizes, unsure = likelihood.smooth_errors(likelihood.residuals(vector))
    told = len(unsure) - float(np.trace(unsure))
    return float(np.sum(sizes**2) / chi2.ppf(SELDOM, max(told, 1.0)))


def misses_pct(likelihood: Likelihood, vector: Array) -> list[float]:
    """Return what the model misses of each output's response, per cent of its size, all records together."""
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
            # Powers scatter as much as they are.
            scatter[output] += np.sum(
                quiet**2 * (strong.sum(axis=1) + strong.sum(axis=1) ** 2 / weak.sum(axis=1))
            )
            size[output] += np.sum(power * strong)
    surely = np.maximum(missed - CHANCE * np.sqrt(scatter), 0.0)
    return [float(one) for one in 100.0 * np.sqrt(surely / size)]


def explained_pct(likelihood: Likelihood, vector: Array) -> list[list[float]]:
    """Return the fit 100 (1 - |y - model| / |y - mean|) of each record's outputs in the band."""
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
