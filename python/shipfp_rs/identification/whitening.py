"""What leaves residuals white: each output's autoregression, and the spectral matrix of what these leave of all outputs.

Moving water drives speed and torque alike, slowly, and the governor ties the one to the other. No filter of single outputs
shows that. The likelihood in the frequency domain (P. Whittle, 1953) weighs residuals by the inverse of their spectral
matrix, which the residuals themselves tell, smoothed over frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import lfilter
from scipy.signal.windows import tukey

from shipfp_rs.optimise.normal_equations import Products
from shipfp_rs.support.arrays import Array, ComplexArray

CHUNK = 2048
"""Samples that are worked on at a time, so that they fit into a cache."""
BESIDE = 0.15
"""Part of a frequency to either side over which spectra are smoothed, ..."""
FEWEST, MOST = 8, 60
"""... with so many lines of the record's spectrum at least and at most."""
TAPER = 0.05
"""Part of a record at its ends that is faded in and out before its spectrum is taken."""
LEAST = 0.1
"""Power that is added to each output at all frequencies, as a part of its median. It bounds the weight of a combination of
outputs in which the noise cancels: few lines tell how well it does so, and no model is right to that many digits."""
ROOM = 0.05
"""Zeros behind a record, as a part of it, so that filters do not reach around from its end to its start."""


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
    """What leaves the residuals of one record white."""

    models: Sequence[Array]
    """Each output's autoregression [1, a1, ..., ap]."""
    colour: ComplexArray | None = None
    """Inverse root (O, O, F), a lower triangle, of the spectral matrix of what the models leave; None: not looked at."""

    @property
    def order(self) -> int:
        """How many samples back the longest of the models reaches."""
        return max(int(np.flatnonzero(model)[-1]) for model in self.models)

    def __call__(self, evaluation: Evaluation) -> Evaluation:
        """Filter the residuals and sensitivities of a record.

        A sample whose filter reaches over a masked one is masked too.
        """
        rows, valid = self._left(evaluation)
        if self.colour is not None:
            rows = irfft(self._coloured(rows), _length(len(valid)))[..., : len(valid)]
        rows = rows.swapaxes(0, 1)
        return Evaluation(rows[-1], rows[:-1], valid)

    def products(self, evaluation: Evaluation) -> Products:
        """Sum up the products of what a call returns; of a colour in the frequency domain, by Parseval's theorem."""
        rows, valid = self._left(evaluation)
        if self.colour is not None:
            length = _length(len(valid))
            transforms = self._coloured(rows)
            transforms *= np.sqrt(_lines(length) / length)
            rows = transforms.view(float)
        tall = rows.reshape(-1, rows.shape[-1])
        with np.errstate(over="ignore", invalid="ignore"):
            return Products((tall @ tall.T).reshape(rows.shape[:2] * 2), int(valid.sum()))

    def _left(self, evaluation: Evaluation) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Return what the models leave of sensitivities and residual (O, Q + 1, N), and where it is valid."""
        order = self.order
        reach = lfilter(np.ones(order + 1), [1.0], np.where(evaluation.valid, 0.0, 1.0))
        valid = np.asarray(reach < 0.5)
        valid[:order] = False
        outputs, samples = evaluation.residual.shape
        rows = np.empty((outputs, len(evaluation.jacobian) + 1, samples))
        for index, model in enumerate(self.models):
            rows[index, :-1], rows[index, -1] = evaluation.jacobian[:, index], evaluation.residual[index]
            rows[index] = lfilter(model[: order + 1], [1.0], rows[index], axis=-1)
        rows *= valid
        return rows, valid

    def _coloured(self, rows: Array) -> ComplexArray:
        """Return the transforms (O, Q + 1, F) of rows, with the colour taken out."""
        assert self.colour is not None
        transforms: ComplexArray = np.asarray(rfft(rows, _length(rows.shape[-1])))
        coloured = np.empty_like(transforms)
        for into in range(len(rows)):
            np.multiply(transforms[into], self.colour[into, into], out=coloured[into])
            for source in range(into):
                coloured[into] += transforms[source] * self.colour[into, source]
        return coloured

    def coloured(self, evaluation: Evaluation) -> tuple[Whitening, float]:
        """Return the whitening with the colour of a record's residuals, and Whittle's deviance of these.

        The deviance is the sum over all frequencies of ln det of the spectral matrix; of white residuals N ln det of their
        covariance.
        """
        left, valid = self._left(replace(evaluation, jacobian=evaluation.jacobian[:0]))
        length, count = _length(len(valid)), int(valid.sum())
        fade = tukey(len(valid), TAPER) * valid
        transform = rfft(left[:, 0] * fade, length) / max(float(np.linalg.norm(fade)), 1e-300)
        matrices = _smooth(np.einsum("of,pf->fop", transform, transform.conj()))
        outputs = np.arange(len(transform))
        least = LEAST * np.median(matrices[:, outputs, outputs].real, axis=0)
        matrices[:, outputs, outputs] += least + 1e-300
        roots = np.linalg.cholesky(matrices)
        sizes = np.log(roots[:, outputs, outputs].real).sum(axis=1)
        deviance = 2.0 * count / length * float(_lines(length) @ sizes)
        colour = np.ascontiguousarray(np.linalg.inv(roots).transpose(1, 2, 0))
        return replace(self, colour=colour), deviance


def _length(samples: int) -> int:
    """Length of the transform of a record."""
    return int(next_fast_len(samples + int(ROOM * samples) + 1, real=True))


def is_coloured(whitening: Whitening | None) -> bool:
    """Whether residuals are weighed by frequency."""
    return whitening is not None and whitening.colour is not None


def _lines(length: int) -> Array:
    """How often each frequency of a real transform stands for one of the whole, shape (F,)."""
    lines = np.full(length // 2 + 1, 2.0)
    lines[0] = 1.0
    if length % 2 == 0:
        lines[-1] = 1.0
    return lines


def _smooth(matrices: ComplexArray) -> ComplexArray:
    """Mean of each frequency's neighbours, shape (F, O, O)."""
    frequency = np.arange(len(matrices))
    half = np.clip((BESIDE * frequency).astype(int), FEWEST, MOST)
    low, high = np.maximum(frequency - half, 0), np.minimum(frequency + half + 1, len(matrices))
    sums = np.concatenate([np.zeros_like(matrices[:1]), np.cumsum(matrices, axis=0)])
    return np.asarray((sums[high] - sums[low]) / (high - low)[:, None, None])


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
