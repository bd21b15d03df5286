"""What each stretch of the records says by itself: intervals that allow for a wrong model, tests that one jump can't pass.

A deviance adds up over time. Where the model is right its slopes in stretches of the records scatter by as much as its
curvature says. Where it is not they scatter by more, and so do estimates (White 1982, doi:10.2307/1912526).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft

from shipfp_rs.identification.likelihood import Likelihood, turned
from shipfp_rs.identification.profiles import scaled_inverse
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.support.arrays import Array, ComplexArray

STRETCH_S = 3.0
"""Length of a stretch [s]: a whitened residual forgets sooner."""


class Score(NamedTuple):
    """Test of a column that might be missing from the model.

    `fall` is that of the deviance; `consistency` the square of the stretches' sum over the sum of their squares, one by
    chance; `size` the column's factor; `share` the root mean square of what it explains over the response's, the most of
    any output.
    """

    fall: float
    consistency: float
    size: float
    share: float


@dataclass(frozen=True, eq=False)
class Stretches:
    """Slopes of a deviance at a vector by stretches of the records, smooth errors taken out.

    Parameters
    ----------
    likelihood, vector
        What was lowered, and where it ended.
    columns
        For each record spectra of the outputs that might be missing, (C, O, F).
    """

    likelihood: Likelihood
    vector: Array
    columns: Sequence[ComplexArray] = ()

    @cached_property
    def _smooth(self) -> list[ComplexArray]:
        """Shapes of the smooth errors of each record in units of noise, (E, O, F)."""
        found = []
        for index, shapes in enumerate(self.likelihood._shapes):
            found.append(turned(self.likelihood.root(index), shapes))
            found[-1][..., 0] = 0.0
        return found

    @cached_property
    def _white(self) -> list[ComplexArray]:
        """Residual, derivatives and columns of each record (1 + P + C, O, F) in units of noise, smooth errors taken out."""
        found, errors = [], self._smooth
        for index in range(len(self.likelihood.records)):
            residual, jacobian = self.likelihood.spectra(self.vector, index)
            more = self.columns[index] if self.columns else np.empty((0, *residual.shape), complex)
            rows = turned(self.likelihood.root(index), np.concatenate([residual[None], jacobian, more]))
            rows[..., 0] = 0.0
            found.append(rows)
        square = np.eye(len(errors[0])) + sum(_products(one, one) for one in errors)
        sizes = np.linalg.solve(
            square, sum(_products(one, rows) for one, rows in zip(errors, found, strict=True))
        )
        for rows, one in zip(found, errors, strict=True):
            _flat(rows)[:] -= sizes.T @ _flat(one)
        return found

    @cached_property
    def _gram(self) -> Array:
        """Products of derivatives and columns (P + C, P + C), priors included."""
        gram = np.array(sum(_products(rows[1:], rows[1:]) for rows in self._white))
        size = self._priors.shape[1]
        gram[:size, :size] += self._priors.T @ self._priors
        return gram

    @cached_property
    def _priors(self) -> Array:
        return self.likelihood.prior_rows(self.vector)[:, 1:]

    @cached_property
    def _slopes(self) -> Array:
        """Residual times derivatives and columns in each stretch, (P + C, S)."""
        pairs = zip(self.likelihood.records, self._white, strict=True)
        return np.concatenate([by_stretch(record, rows[1:], rows[0]) for record, rows in pairs], axis=1)

    @cached_property
    def _inverse(self) -> Array:
        """Of the curvature by the parameters alone, (P, P)."""
        size = self._priors.shape[1]
        square = self._gram[:size, :size]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(square), 1e-12))
        inverse = np.linalg.pinv(square * scale[:, None] * scale, rcond=1e-12, hermitian=True)
        return np.asarray(inverse * scale[:, None] * scale)

    @cached_property
    def _covariance(self) -> Array:
        """Of the parameters by the deviance's own curvature, (P, P)."""
        return scaled_inverse(self.likelihood.products(self.vector).matrix)

    def widening(self, gradient: Array) -> float:
        """Return a figure's deviation by the scatter of the stretches over that by the curvature, at least 1."""
        size = self._priors.shape[1]
        along = self._inverse @ gradient
        scatter = float(np.sum((along @ self._slopes[:size]) ** 2) + np.sum((self._priors @ along) ** 2))
        return float(np.sqrt(max(scatter / max(float(gradient @ along), 1e-300), 1.0)))

    def influence(self, gradient: Array) -> tuple[Array, Array, Array]:
        """Return how far a figure is moved by stretches (S,), and by smooth errors (E,) and priors (K,) of their size."""
        along = self._covariance @ gradient
        size = len(along)
        pairs = zip(self._white, self._smooth, strict=True)
        errors = [
            _products(shapes, np.tensordot(along, rows[1 : 1 + size], 1)[None])[:, 0]
            for rows, shapes in pairs
        ]
        return along @ self._slopes[:size], np.sum(errors, axis=0), self._priors @ along

    def scores(self) -> list[Score]:
        """Return the test of each column."""
        size, found = self._priors.shape[1], []
        response = _power([record.spectrum[None] for record in self.likelihood.records])[0]
        shares = self._gram[size:, :size] @ self._inverse
        bare = [np.array(one, order="C") for one in self.columns]
        for index, one in enumerate(bare):
            _flat(one)[:] -= shares @ _flat(self.likelihood.spectra(self.vector, index)[1])
        power = _power(bare)
        for place, share in enumerate(shares, size):
            local = self._slopes[place] - share @ self._slopes[:size]
            own = self._gram[place, place] - share @ self._gram[:size, place]
            if not own > 1e-9 * self._gram[place, place]:
                found.append(Score(0.0, 0.0, 0.0, 0.0))
                continue
            along = float(local.sum())
            explained = abs(along / own) * np.sqrt(np.max(power[place - size] / response))
            consistency = along**2 / max(float(np.sum(local**2)), 1e-300)
            found.append(Score(along**2 / own, consistency, along / own, float(explained)))
        return found


def by_stretch(record: Spectra, rows: ComplexArray, residual: ComplexArray) -> Array:
    """Products of rows of outputs (A, O, F) with a residual (O, F) in each stretch of a record, (A, S)."""
    count = record.decimated.shape[1]
    in_time, left = (irfft(one, count, axis=-1) for one in (rows, residual))
    local = 0.5 * count * np.sum(in_time * left, axis=1)
    length = min(max(int(STRETCH_S * record.data_hz / record.down), 1), count)
    kept = count // length * length
    return np.asarray(local[:, :kept].reshape(len(local), -1, length).sum(axis=2))


def _power(spectra: Sequence[ComplexArray]) -> Array:
    """Power of each row's outputs (A, O) of records' spectra (A, O, F), without the means."""
    return np.asarray(np.sum([np.sum(np.abs(one[..., 1:]) ** 2, axis=-1) for one in spectra], axis=0))


def _products(first: ComplexArray, second: ComplexArray) -> Array:
    """Real products of rows (A, O, F) and (B, O, F), shape (A, B)."""
    return _flat(first) @ _flat(second).T


def _flat(rows: ComplexArray) -> Array:
    """Rows of complex numbers (A, O, F) as rows of real ones, the same memory, (A, R)."""
    return rows.reshape(len(rows), -1).view(float)
