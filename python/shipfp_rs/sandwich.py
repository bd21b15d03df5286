"""Covariance for residuals that are still correlated, in time and from output to output: a sandwich of their spectrum.

The estimates of a fit whose weights are not quite right scatter by H S H, where H is the inverse of J'J and S the
covariance of J'e. Here one autoregression of all outputs together describes the residuals e, and its spectral matrix
gives S (H. White, Econometrica 48 (1980) 817; W. J. den Haan, A. Levin, NBER Technical Paper 197, 1996).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len, rfft

Array = npt.NDArray[np.float64]
Record = tuple[Array, npt.NDArray[np.bool_]]

ORDER = 8
"""Samples that the autoregression reaches back."""


def score_covariance(rows: Sequence[Array], records: Sequence[Record]) -> Array:
    """Return the covariance of J'e, shape (P, P).

    Parameters
    ----------
    rows
        Columns J of each record, shape (P, O, R), zero where masked.
    records
        Residuals e of each record (O, R), and where they are valid (R,).
    """
    polynomial, scatter = vector_autoregression(records)
    whole = np.zeros((len(rows[0]),) * 2)
    for columns in rows:
        size = next_fast_len(2 * columns.shape[-1], real=True)
        transform = rfft(columns, size)
        # e = A^-1 w, so the columns that w meets are A^-H J at each frequency.
        inverse = np.linalg.inv(rfft(polynomial, size, axis=0))
        met = np.einsum("foq,pof->pqf", inverse.conj(), transform, optimize=True)
        weight = np.full(transform.shape[-1], 2.0)
        weight[0] = 1.0
        if size % 2 == 0:
            weight[-1] = 1.0
        whole += np.einsum("paf,ab,qbf,f->pq", met.conj(), scatter, met, weight / size, optimize=True).real
    return whole


def vector_autoregression(records: Sequence[Record], order: int = ORDER) -> tuple[Array, Array]:
    """Fit e[k] + A1 e[k-1] + ... = w[k] by least squares, gaps left out.

    Parameters
    ----------
    records
        Outputs (O, R) and where they are valid (R,), all of one process.
    order
        Number of matrices.

    Returns
    -------
    polynomial, scatter
        [I, A1, A2, ...] (order + 1, O, O), and the covariance of w (O, O).

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(size=(2, 20000))
    >>> noise[0, 1:] += 0.8 * noise[1, :-1]
    >>> polynomial, _ = vector_autoregression([(noise, np.ones(20000, dtype=bool))], order=1)
    >>> bool(abs(polynomial[1] + [[0.0, 0.8], [0.0, 0.0]]).max() < 0.02)
    True
    """
    outputs = len(records[0][0])
    gram = np.zeros(((order + 1) * outputs,) * 2)
    count = 0
    for values, valid in records:
        if values.shape[1] <= order:
            continue
        reached = np.lib.stride_tricks.sliding_window_view(valid, order + 1).all(axis=1)
        lagged = np.concatenate([values[:, order - lag : values.shape[1] - lag] for lag in range(order + 1)])
        lagged = lagged[:, reached]
        gram += lagged @ lagged.T
        count += lagged.shape[1]
    now, before = gram[:outputs], gram[outputs:, outputs:]
    ridge = 1e-12 * np.trace(before) / len(before) * np.eye(len(before))
    coefficients = np.linalg.solve(before + ridge, gram[outputs:, :outputs]).T
    scatter = (now[:, :outputs] - coefficients @ gram[outputs:, :outputs]) / max(count - order * outputs, 1)
    matrices = -coefficients.reshape(outputs, order, outputs).transpose(1, 0, 2)
    return np.concatenate([np.eye(outputs)[None], matrices]), np.asarray(scatter)
