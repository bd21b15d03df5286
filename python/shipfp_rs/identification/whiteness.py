"""Whiteness test of residuals by their correlations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from shipfp_rs.support.arrays import Array, Mask
from shipfp_rs.support.quantiles import DEVIATIONS_95

WHITENESS_LAGS = 25
"""Lags of the autocorrelation, as in MATLAB's `resid`."""


@dataclass(frozen=True)
class ResidualTest:
    """Correlations by lag, with a test of all together.

    Parameters
    ----------
    lags
        In samples, shape (L,).
    correlation, band
        Correlation coefficients [-], and half width of their 95 % band by chance, shape (L,).
    statistic, freedom
        Test statistic and its degrees of freedom; chi-squared if there is no correlation.
    p
        Probability of so large a statistic by chance; None without a degree of freedom.
    """

    lags: npt.NDArray[np.int64]
    correlation: Array
    band: Array
    statistic: float
    freedom: int

    @property
    def p(self) -> float | None:
        """Probability of such correlations by chance."""
        return float(chi2.sf(self.statistic, self.freedom)) if self.freedom > 0 else None

    def by_lag(self) -> dict[str, list[float]]:
        """Return lags, correlations and bands as lists, without lags that have no pair of samples."""
        known = np.isfinite(self.band)
        return {
            "lags": self.lags[known].tolist(),
            "correlation": self.correlation[known].tolist(),
            "band": self.band[known].tolist(),
        }


def whiteness(
    records: Sequence[tuple[Array, Mask]], fitted: int = 0, lags: int = WHITENESS_LAGS
) -> ResidualTest:
    """Test residuals for autocorrelation by Ljung and Box (10.1093/biomet/65.2.297), without gaps.

    Parameters
    ----------
    records
        Residuals of one output in each experiment, shape (N,), and their mask of valid samples.
    fitted
        Number of noise-model coefficients that whitened them.
    lags
        Number of lags, starting at one sample.

    Examples
    --------
    >>> import numpy as np
    >>> noise = np.random.default_rng(1).normal(size=5000)
    >>> whiteness([(noise, np.isfinite(noise))]).p > 0.01
    True
    >>> whiteness([(np.cumsum(noise), np.isfinite(noise))]).p < 1e-6
    True
    """
    steps = np.arange(1, lags + 1)
    products, pairs, samples = np.zeros(lags), np.zeros(lags), 0
    for values, valid in records:
        count = int(valid.sum())
        if count < 2:
            continue
        centred = np.where(valid, values - values[valid].mean(), 0.0)
        spread = float(np.sqrt(centred @ centred / count)) or 1.0
        samples += count
        for index, lag in enumerate(steps[steps < len(values)]):
            products[index] += centred[lag:] @ centred[:-lag] / spread**2
            pairs[index] += np.count_nonzero(valid[lag:] & valid[:-lag])
    known = pairs > 0
    correlation = np.divide(products, pairs, out=np.zeros(lags), where=known)
    band = np.divide(DEVIATIONS_95, np.sqrt(pairs), out=np.full(lags, np.inf), where=known)
    statistic = float(np.sum(pairs * correlation**2)) * (samples + 2) / max(samples, 1)
    return ResidualTest(steps, correlation, band, statistic, int(known.sum()) - fitted)
