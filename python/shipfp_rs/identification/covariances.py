"""From whitened residuals and sensitivities to covariances of the estimates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shipfp_rs.identification.identifiability import Sensitivity
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.whitening import Evaluation

Array = npt.NDArray[np.float64]


def without_nuisance(jacobian: Array, count: int) -> Array:
    """Return the parameters' columns without the part that the blocks' own unknowns could explain, shape (R, P)."""
    columns, nuisance = jacobian[:, :count], jacobian[:, count:]
    if not nuisance.shape[1]:
        return columns
    size = np.linalg.norm(nuisance, axis=0)
    basis, _ = np.linalg.qr(nuisance[:, size > 0] / size[size > 0])
    return np.asarray(columns - basis @ (basis.T @ columns))


def row_variance(search: Search, evaluations: Sequence[Evaluation], residual: Array, freedom: int) -> Array:
    """Variance of every row, shape (R,): that of the output's weighted residuals, 1 for priors and for known deviations.

    It is infinite where there are too few samples.
    """
    outputs = len(search.structure.outputs)
    widths = [evaluation.residual.shape[1] for evaluation in evaluations]
    ends = np.cumsum([0, *(outputs * width for width in widths)])
    variance = np.ones(outputs)
    if search.weighting != "std":
        squares = sum(
            (residual[ends[i] : ends[i + 1]].reshape(outputs, width) ** 2).sum(axis=1)
            for i, width in enumerate(widths)
        )
        variance = squares * outputs / freedom if freedom > 0 else np.full(outputs, np.inf)
    rows = np.ones(len(residual))
    rows[: ends[-1]] = np.concatenate([np.repeat(variance, width) for width in widths])
    return rows


def covariance_of(inner: Sensitivity, jacobian: Array, variance: Array) -> Array:
    """Covariance (P, P) of the inner parameters: the sandwich H J'SJ H of the Gauss-Newton inverse H."""
    base = inner.covariance()
    if not np.isfinite(variance).all():
        return np.full_like(base, np.inf)
    return np.asarray(base @ (jacobian.T @ (jacobian * variance[:, None])) @ base)
