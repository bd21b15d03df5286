"""Covariance for residuals that are still correlated, in time and from output to output: a sandwich of their spectrum.

The estimates of a fit whose weights are not quite right scatter by H S H, where H is the inverse of J'J and S the
covariance of J'e. The spectral matrix of the residuals e gives S (H. White, Econometrica 48 (1980) 817). A low
autoregression of all outputs together takes most of their colour out; the spectrum of what it leaves is smooth and
told by a lag window (D. W. K. Andrews, J. C. Monahan, 10.2307/2951574).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal.windows import parzen

Array = npt.NDArray[np.float64]
Record = tuple[Array, npt.NDArray[np.bool_]]

ORDER = 4
"""Samples that the autoregression reaches back. A higher one alone would not do: signals that a low-pass brought to a
lower rate have an edge in their spectrum, about which the spectra of autoregressions wave by a third."""
REACH = 1.25
"""Reach of the lag window, in square roots of the number of samples."""


def score_covariance(rows: Sequence[Array], records: Sequence[Record]) -> Array:
    """Return the covariance of J'e, shape (P, P).

    Parameters
    ----------
    rows
        Columns J of each record, shape (P, O, R), zero where masked.
    records
        Residuals e of each record (O, R), and where they are valid (R,).
    """
    polynomial = vector_autoregression(records)
    left = _correlation(polynomial, records)
    whole = np.zeros((len(rows[0]),) * 2)
    for columns in rows:
        size = next_fast_len(2 * max(columns.shape[-1], left.shape[-1]), real=True)
        transform = rfft(columns, size)
        # With e = A^-1 w, J'e = (A^-H J)'w at each frequency.
        inverse = np.linalg.inv(rfft(polynomial, size, axis=0))
        met = np.einsum("foq,pof->pqf", inverse.conj(), transform, optimize=True)
        # Lags above zero, and those below it at the end, where a transform has them.
        around = np.zeros((*left.shape[:2], size))
        around[..., : left.shape[-1]] = left
        around[..., size - left.shape[-1] + 1 :] = left.swapaxes(0, 1)[..., :0:-1]
        weight = np.full(transform.shape[-1], 2.0)
        weight[0] = 1.0
        if size % 2 == 0:
            weight[-1] = 1.0
        turned = np.einsum("abf,qbf->qaf", rfft(around), met * (weight / size))
        whole += np.einsum("paf,qaf->pq", met.conj(), turned, optimize=True).real
    return whole


def _correlation(polynomial: Array, records: Sequence[Record]) -> Array:
    """Correlation (O, O, L) of what the autoregression leaves at lags from 0 on, under the window."""
    order = len(polynomial) - 1
    reach = max(round(REACH * np.sqrt(sum(int(valid.sum()) for _, valid in records))), 1)
    outputs = polynomial.shape[1]
    whole, count = np.zeros((outputs, outputs, reach + 1)), 0
    for values, valid in records:
        if values.shape[1] <= order:
            continue
        told = np.lib.stride_tricks.sliding_window_view(valid, order + 1).all(axis=1)
        kept = values.shape[1] - order
        left = sum(polynomial[lag] @ values[:, order - lag :][:, :kept] for lag in range(order + 1)) * told
        size = next_fast_len(kept + reach + 1, real=True)
        transform = rfft(left, size)
        products = irfft(transform[:, None] * transform.conj()[None], size)
        whole += products[..., : reach + 1]
        count += int(told.sum())
    # Every lag is divided by the number of all samples, so that the spectrum can't become negative.
    return np.asarray(whole * parzen(2 * reach + 1)[reach:] / max(count - order * outputs, 1))


def vector_autoregression(records: Sequence[Record], order: int = ORDER) -> Array:
    """Fit e[k] + A1 e[k-1] + ... = w[k] by least squares, gaps left out.

    Parameters
    ----------
    records
        Outputs (O, R) and where they are valid (R,), all of one process.
    order
        Number of matrices.

    Returns
    -------
    ndarray
        [I, A1, A2, ...], shape (order + 1, O, O).

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(size=(2, 20000))
    >>> noise[0, 1:] += 0.8 * noise[1, :-1]
    >>> polynomial = vector_autoregression([(noise, np.ones(20000, dtype=bool))], order=1)
    >>> bool(abs(polynomial[1] + [[0.0, 0.8], [0.0, 0.0]]).max() < 0.02)
    True
    """
    outputs = len(records[0][0])
    gram = np.zeros(((order + 1) * outputs,) * 2)
    for values, valid in records:
        if values.shape[1] <= order:
            continue
        reached = np.lib.stride_tricks.sliding_window_view(valid, order + 1).all(axis=1)
        lagged = np.concatenate([values[:, order - lag : values.shape[1] - lag] for lag in range(order + 1)])
        lagged = lagged[:, reached]
        gram += lagged @ lagged.T
    before = gram[outputs:, outputs:]
    ridge = 1e-12 * np.trace(before) / len(before) * np.eye(len(before))
    coefficients = np.linalg.solve(before + ridge, gram[outputs:, :outputs]).T
    matrices = -coefficients.reshape(outputs, order, outputs).transpose(1, 0, 2)
    return np.concatenate([np.eye(outputs)[None], matrices])
