"""What leaves residuals white: each output's autoregression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from shipfp_rs.support.arrays import Array

CHUNK = 2048
"""Samples that are worked on at a time, so that they fit into a cache."""


@dataclass
class Evaluation:
    """Residuals e = measured - model (O, R) and d(model)/d(vector) (Q, O, R), zero where a sample is masked."""

    residual: Array
    jacobian: Array
    valid: npt.NDArray[np.bool_]

    def turned(self) -> Evaluation:
        """Return the columns after an orthogonal transformation over the samples that leaves few rows; `valid` stays.

        What is left has the same products of all columns in all pairs of outputs.
        """
        rows = np.concatenate([self.jacobian, self.residual[None]])
        tall = rows.reshape(-1, rows.shape[-1]).T
        if tall.shape[0] <= tall.shape[1]:
            return self
        factor = np.zeros((0, tall.shape[1]))
        for start in range(0, len(tall), CHUNK):
            more = np.concatenate([factor, tall[start : start + CHUNK]])
            factor = np.asarray(np.linalg.qr(more, mode="r"))
        short = factor.T.reshape(*rows.shape[:2], -1)
        return Evaluation(short[-1], short[:-1], self.valid)


@dataclass(frozen=True, eq=False)
class Whitening:
    """What leaves residuals white."""

    models: Sequence[Array]
    """Each output's autoregression [1, a1, ..., ap]."""

    @property
    def order(self) -> int:
        """How many samples back the longest of the models reaches."""
        return max(int(np.flatnonzero(model)[-1]) for model in self.models)

    def __call__(self, evaluation: Evaluation) -> Evaluation:
        """Filter the residuals and sensitivities of a record.

        A sample whose filter reaches over a masked one is masked too.
        """
        order = self.order
        reach = lfilter(np.ones(order + 1), [1.0], np.where(evaluation.valid, 0.0, 1.0))
        valid = np.asarray(reach < 0.5)
        valid[:order] = False
        rows = np.concatenate([evaluation.jacobian, evaluation.residual[None]])
        for index, model in enumerate(self.models):
            rows[:, index] = lfilter(model[: order + 1], [1.0], rows[:, index], axis=-1)
        rows *= valid
        return Evaluation(rows[-1], rows[:-1], valid)


def autoregressive_model(residuals: Sequence[tuple[Array, npt.NDArray[np.bool_]]], order: int) -> Array:
    """Fit [1, a1, ..., ap] to the residuals of one output, gaps left out, by least squares over all blocks."""
    whole = np.zeros((order + 1, order + 1))
    for values, valid in residuals:
        if len(values) <= 2 * order:
            continue
        gaps = not valid.all()
        for start in range(order, len(values), CHUNK):
            stop = min(start + CHUNK, len(values))
            lagged = np.stack([values[start - lag : stop - lag] for lag in range(order + 1)])
            if gaps:
                lagged *= np.all([valid[start - lag : stop - lag] for lag in range(order + 1)], axis=0)
            whole += lagged @ lagged.T
    gram, right = whole[1:, 1:], whole[1:, 0]
    ridge = 1e-12 * np.trace(gram) / order
    if not ridge > 0.0:
        return np.concatenate([[1.0], np.zeros(order)])
    coefficients = np.linalg.solve(gram + ridge * np.eye(order), right)
    return np.concatenate([[1.0], -coefficients])
