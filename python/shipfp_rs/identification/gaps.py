"""Interpolation of masked samples from their neighbours, by auto- and cross-covariances (simple cokriging)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import solve

from shipfp_rs.support.arrays import Array

NUGGET = 1e-4
"""Share of the variance that no neighbouring sample predicts."""


def kriged(values: Array, gaps: npt.NDArray[np.bool_], reach: int) -> Array:
    """Return signals (O, N) with the samples in gaps (O, N) replaced by their best linear estimate.

    The estimate uses `reach` samples of all signals on either side. Far inside a gap in all signals it is the mean.

    Notes
    -----
    Cressie 1993, "Statistics for Spatial Data", section 3.4.5.
    """
    mean = np.array(
        [row[~own].mean() if not own.all() else 0.0 for row, own in zip(values, gaps, strict=True)]
    )
    centred = np.where(gaps, 0.0, values - mean[:, None])
    stretches = [_stretches(row) for row in gaps]
    longest = max((int(end - first) for rows in stretches for first, end in rows), default=0)
    covariance = _covariance(centred, gaps, 2 * reach + longest + 1)
    nugget = np.maximum(NUGGET * covariance[:, :, 0].diagonal(), 1e-30)
    found = centred.copy()
    for output, rows in enumerate(stretches):
        for first, end in rows:
            around = np.arange(max(first - reach, 0), min(end + reach, values.shape[1]))
            whose, when = np.nonzero(~gaps[:, around])
            when = around[when]
            square = _between(covariance, whose, when, whose, when)
            square.flat[:: len(when) + 1] += nugget[whose]
            inside = np.arange(first, end)
            across = _between(covariance, np.full(len(inside), output), inside, whose, when)
            found[output, inside] = across @ solve(square, centred[whose, when], assume_a="pos")
    return np.where(gaps, found + mean[:, None], values)


def _stretches(gaps: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """First sample of each gap, and the first after it, shape (G, 2)."""
    return np.flatnonzero(np.diff(np.concatenate([[False], gaps, [False]]))).reshape(-1, 2)


def _covariance(centred: Array, gaps: npt.NDArray[np.bool_], lags: int) -> Array:
    """Covariance of signals at lags between -`lags` and `lags`, outside gaps, shape (O, O, 2 `lags` - 1).

    Negative lags have negative indices.
    """
    size = next_fast_len(centred.shape[1] + lags, real=True)
    spectra = rfft(centred, size)
    counts = np.sqrt((~gaps).sum(axis=1))
    # A common divisor for all lags keeps the covariance matrix positive definite.
    products = irfft(spectra[:, None] * spectra[None].conj(), size) / np.outer(counts, counts)[..., None]
    return np.asarray(products[:, :, np.r_[0:lags, size - lags + 1 : size]])


def _between(
    covariance: Array,
    a: npt.NDArray[np.intp],
    at: npt.NDArray[np.intp],
    b: npt.NDArray[np.intp],
    then: npt.NDArray[np.intp],
) -> Array:
    """Covariances of samples `at` of signals `a` with samples `then` of signals `b`."""
    return np.asarray(covariance[a[:, None], b, at[:, None] - then])
