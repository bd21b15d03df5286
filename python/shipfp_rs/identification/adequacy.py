"""Scores of a model's adequacy: the error of the model while the ship is excited, as far as noise can't explain it.

Noise does not depend on the excitation, but the error of a wrong model does. The residual's power is therefore compared
between stretches in which the response in a band is strong, and stretches in which it is weak.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import stft
from scipy.stats import chi2

from shipfp_rs.identification.fingerprint_content import ALARM
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.residual_tests import INPUT_LAGS
from shipfp_rs.identification.sampling import BEFORE_S
from shipfp_rs.support.arrays import Array

SMALL_MISS_PCT = 1.6
"""Misfit, as a share of an output's spread, that is acceptable: the error of a calibrated torque gauge (static torque check
of the thesis, eq. 6.3)."""
LARGE_MISS_PCT = 10.0
"""Misfit, as a share of an output's spread, above which a fingerprint is not usable."""
LEAST_EXPLAINED_PCT = 2.0
"""Least explained share of an output's spread, below which the output is not the ship's response."""
STRETCH_S = 20.0
"""Length of a stretch, over which a spectrum is computed [s]."""
STRONG, WEAK = 0.75, 0.5
"""Quantiles of the response's power in a band: above the first a stretch counts as excited, below the second as quiet."""
LOBE = 2.0
"""Half width of the main lobe of the spectra's window (Hann), in bins."""
CHANCE = 3.0
"""Standard deviations of the noise power that are subtracted from an excess, so that chance does not count as a misfit."""
SELDOM = 0.99
"""Level of the systematic errors' chi-squared law up to which they are attributed to gauge and calibration."""


def strain(likelihood: Likelihood, vector: Array) -> float:
    """Return the squared size of the fit's systematic errors, over the largest that gauge and calibration explain.

    Above 1 the model is wrong: it fits only with errors larger than those of gauge and calibration.
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
            # Above the band the residual is zero, and the window's main lobe spreads this edge into the band.
            at = np.arange(len(power))
            kept = (at > 0) & (at <= record.band_hz * length / rate - LOBE)
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


def misses_of(fit: Mapping[str, Mapping[str, float | None]], samples: int) -> dict[str, float]:
    """Return the misfit of each output, in per cent of its spread.

    The misfit is the root of the share of the whitened residual's power that the set point still explains, less the share
    by chance, times the residual.
    """
    misses = {}
    for name, row in fit.items():
        if name == "overall":
            continue
        misses[name] = missed_pct(row, chance=(INPUT_LAGS + 1) / samples)
    return misses


def missed_pct(row: Mapping[str, float | None], chance: float = 0.0) -> float:
    """Return the misfit of an output, in per cent of its spread.

    The misfit is the root of the share of the whitened residual that the set point still explains, less the share by chance.
    """
    share = (row.get("input_explained_pct") or 0.0) / 100.0
    rest = max(1.0 - (row.get("nrmse_pct") or 0.0) / 100.0, 0.0)
    return float(100.0 * max(share - chance, 0.0) ** 0.5 * rest)


def structure_test(tests: Mapping[str, Mapping[str, float | None]]) -> dict[str, float]:
    """Return the joint test of the structure by the residuals of all outputs; empty without residual tests.

    "structure_p" is the outputs' least p-value times their number (Bonferroni). "structure_misses_pct"
    is the largest share of an output's residual that the set point explains [%]: on long records a structure may be
    rejected although its error is small.
    """
    found = [p for row in tests.values() if (p := row.get("input_correlation_p")) is not None]
    if not found:
        return {}
    missed = max(row.get("input_explained_pct") or 0.0 for row in tests.values())
    return {"structure_p": min(1.0, len(found) * min(found)), "structure_misses_pct": missed}


def stands(misses: Mapping[str, float], structure_p: float | None = None) -> bool:
    """Whether a model's misfits [%] are small, or its residuals' joint test does not contradict its structure."""
    small = max(misses.values(), default=0.0) <= SMALL_MISS_PCT
    return small or (structure_p is not None and structure_p >= ALARM)
