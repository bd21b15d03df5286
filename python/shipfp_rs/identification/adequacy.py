"""Scores of a model's adequacy: the error of the model while the ship is excited, beyond what noise explains.

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
"""Largest acceptable misfit, in per cent of an output's spread: the error of a calibrated torque gauge (static torque check
of the thesis, eq. 6.3)."""
LARGE_MISS_PCT = 10.0
"""Misfit, in per cent of an output's spread, above which a fingerprint is not usable."""
LEAST_EXPLAINED_PCT = 2.0
"""Explained share of an output's spread below which the output is not the ship's response."""
STRETCH_S = 20.0
"""Length of a stretch, over which a spectrum is computed [s]."""
STRONG, WEAK = 0.75, 0.5
"""Quantiles of the response's power in a band. A stretch above the first is excited, one below the second is quiet."""
LOBE = 2.0
"""Half width of the main lobe of the spectra's window (Hann), in bins."""
CHANCE = 3.0
"""Number of standard deviations that are subtracted from an excess of power, so that chance does not count as a misfit."""
SELDOM = 0.99
"""Quantile of the chi-squared distribution up to which systematic errors are attributed to gauge and calibration."""


def strain(likelihood: Likelihood, vector: Array) -> float:
    """Return the systematic errors' chi-squared over the most that gauge and calibration explain; above 1: a wrong model."""
    sizes, unsure = likelihood.smooth_errors(likelihood.residuals(vector))
    told = len(unsure) - float(np.trace(unsure))
    return float(np.sum(sizes**2) / chi2.ppf(SELDOM, max(told, 1.0)))


def misses_pct(likelihood: Likelihood, vector: Array) -> list[float]:
    """Return the misfit of each output, in per cent of its response while the ship is excited, over all records."""
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
    """Return the misfit of each output, in per cent of its spread; see `missed_pct`."""
    misses = {}
    for name, row in fit.items():
        if name == "overall":
            continue
        misses[name] = missed_pct(row, chance=(INPUT_LAGS + 1) / samples)
    return misses


def missed_pct(row: Mapping[str, float | None], chance: float = 0.0) -> float:
    """Return the misfit of an output, in per cent of its spread: the part of the residual that the set point explains."""
    # The root of the explained share of the whitened residual's power, less the share by chance, times the residual.
    share = (row.get("input_explained_pct") or 0.0) / 100.0
    rest = max(1.0 - (row.get("nrmse_pct") or 0.0) / 100.0, 0.0)
    return float(100.0 * max(share - chance, 0.0) ** 0.5 * rest)


def structure_test(tests: Mapping[str, Mapping[str, float | None]]) -> dict[str, float]:
    """Return the joint test of the structure by the residuals of all outputs; empty without residual tests."""
    # "structure_p" is the outputs' least p-value times their number (Bonferroni). "structure_misses_pct" is the largest
    # share of a residual that the set point explains [%]: a long record may reject a structure whose error is small.
    found = [p for row in tests.values() if (p := row.get("input_correlation_p")) is not None]
    if not found:
        return {}
    missed = max(row.get("input_explained_pct") or 0.0 for row in tests.values())
    return {"structure_p": min(1.0, len(found) * min(found)), "structure_misses_pct": missed}


def stands(misses: Mapping[str, float], structure_p: float | None = None) -> bool:
    """Whether a model's misfits [%] are small, or the joint test of its residuals does not reject its structure."""
    small = max(misses.values(), default=0.0) <= SMALL_MISS_PCT
    return small or (structure_p is not None and structure_p >= ALARM)
