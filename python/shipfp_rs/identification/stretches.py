"""Gradients of the deviance in short stretches of time, for intervals and tests that allow for an incomplete model.

A deviance is a sum over time. If the model is right, the deviance's gradients in stretches of the records scatter as much as
its curvature predicts. If the model is wrong they scatter more, and so do estimates (White 1982, doi:10.2307/1912526). An
effect that a model lacks is significant only if several stretches show it, not one jump of the set point alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft

from shipfp_rs.identification.basins import Basin
from shipfp_rs.identification.likelihood import Likelihood, Products
from shipfp_rs.identification.noise import turned
from shipfp_rs.identification.profiles import Profiles, scaled_inverse
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.support.arrays import Array, ComplexArray

STRETCH_S = 3.0
"""Length of a stretch [s], longer than the correlation of a whitened residual."""


class Score(NamedTuple):
    """Test of an effect that the model may lack, given as a column of spectra."""

    fall: float  # decrease of the deviance
    consistency: float  # squared sum over stretches, divided by the sum of squares; 1 by chance
    size: float  # coefficient of the column
    share: float  # root mean square of the effect over the response's, largest of any output


@dataclass(frozen=True, eq=False)
class Stretches:
    """Contributions of stretches of the records to the gradient of a deviance at a minimum, without systematic errors."""

    likelihood: Likelihood
    vector: Array
    columns: Sequence[ComplexArray] = ()  # per record: spectra (C, O, F) of effects that the model may lack

    @cached_property
    def _rows(self) -> list[ComplexArray]:
        """Residual, derivatives and additional columns of each record, stacked (1 + P + C, O, F), in units of noise."""
        found = []
        for index in range(len(self.likelihood.records)):
            residual, jacobian = self.likelihood.spectra(self.vector, index)
            more = self.columns[index] if self.columns else np.empty((0, *residual.shape), complex)
            found.append(
                turned(self.likelihood.root(index), np.concatenate([residual[None], jacobian, more]))
            )
            found[-1][..., 0] = 0.0
        return found

    @cached_property
    def _white(self) -> list[ComplexArray]:
        """Rows of `_rows` with systematic errors eliminated, given the priors of these errors."""
        if not self.likelihood.bends:
            return self._rows
        along = sum(self.likelihood.along_errors(index, rows) for index, rows in enumerate(self._rows))
        sizes = along @ self.likelihood.errors_inverse
        return [
            rows - np.tensordot(sizes, one, 1)
            for rows, one in zip(self._rows, self.likelihood.white_shapes, strict=True)
        ]

    @cached_property
    def _gram(self) -> Array:
        """Gram matrix of residual, derivatives and columns in the deviance, (1 + P + C, 1 + P + C)."""
        return self.likelihood.gram(self.vector, self.columns, fused=False)

    @cached_property
    def _priors(self) -> Array:
        return self.likelihood.prior_rows(self.vector)[:, 1:]

    @cached_property
    def _slopes(self) -> Array:
        """Residual times derivatives and columns in each stretch, (P + C, S)."""
        pairs = zip(self.likelihood.records, self._white, strict=True)
        return np.concatenate([by_stretch(record, rows[1:], rows[0]) for record, rows in pairs], axis=1)

    @cached_property
    def _covariance(self) -> Array:
        """Covariance of the parameters from the deviance's curvature (P, P), zero for a parameter on its bound."""
        end = 1 + self._priors.shape[1]
        now = Products(float(self._gram[0, 0]), self._gram[0, 1:end], self._gram[1:end, 1:end])
        return Profiles(self.likelihood, []).covariance(Basin(now.cost, self.vector, products=now))

    def widening(self, gradient: Array) -> float:
        """Return a figure's standard deviation by the scatter of stretches, over that by the curvature; at least 1."""
        # Parameters on a bound are free here, since their true values may be inside it.
        end = 1 + self._priors.shape[1]
        along = scaled_inverse(self._gram[1:end, 1:end]) @ gradient
        scatter = sum(float(moves @ moves) for moves in self._moved(along))
        return float(np.sqrt(max(scatter / max(float(gradient @ along), 1e-300), 1.0)))

    def _moved(self, along: Array) -> tuple[Array, Array, Array]:
        """Change of the parameters along a direction (P,) due to stretches, systematic errors and priors."""
        size = len(along)
        pairs = zip(self._white, self.likelihood.white_shapes, strict=True)
        errors = [
            _products(shapes, np.tensordot(along, rows[1 : 1 + size], 1)[None])[:, 0]
            for rows, shapes in pairs
        ]
        return along @ self._slopes[:size], np.sum(errors, axis=0), self._priors @ along

    def scores(self) -> list[Score]:
        """Return the test of each column."""
        size, found = self._priors.shape[1], []
        gram, slopes = self._gram[1:, 1:], self._gram[0, 1:]
        response = _power([record.spectrum[None] for record in self.likelihood.records])[0]
        shares = gram[size:, :size] @ self._covariance
        bare = [np.array(one, order="C") for one in self.columns]
        for index, one in enumerate(bare):
            _flat(one)[:] -= shares @ _flat(self.likelihood.spectra(self.vector, index)[1])
        power = _power(bare)
        for place, share in enumerate(shares, size):
            local = self._slopes[place] - share @ self._slopes[:size]
            own = gram[place, place] - share @ gram[:size, place]
            if not own > 1e-9 * gram[place, place]:
                found.append(Score(0.0, 0.0, 0.0, 0.0))
                continue
            along = float(slopes[place] - share @ slopes[:size])
            explained = abs(along / own) * np.sqrt(np.max(power[place - size] / response))
            consistency = float(local.sum()) ** 2 / max(float(np.sum(local**2)), 1e-300)
            found.append(Score(along**2 / own, consistency, along / own, float(explained)))
        return found


def by_stretch(record: Spectra, rows: ComplexArray, residual: ComplexArray) -> Array:
    """Products of rows (A, O, F) with a residual (O, F) in each stretch of a record, (A, S)."""
    count = record.decimated.shape[1]
    in_time, left = (irfft(one, count, axis=-1) for one in (rows, residual))
    local = 0.5 * count * np.sum(in_time * left, axis=1)
    length = min(max(int(STRETCH_S * record.data_hz / record.down), 1), count)
    kept = count // length * length
    return np.asarray(local[:, :kept].reshape(len(local), -1, length).sum(axis=2))


def _power(spectra: Sequence[ComplexArray]) -> Array:
    """Power of each row's outputs (A, O) in spectra of records (A, O, F), without means."""
    return np.asarray(np.sum([np.sum(np.abs(one[..., 1:]) ** 2, axis=-1) for one in spectra], axis=0))


def _products(first: ComplexArray, second: ComplexArray) -> Array:
    """Real products of rows (A, O, F) and (B, O, F), shape (A, B)."""
    return _flat(first) @ _flat(second).T


def _flat(rows: ComplexArray) -> Array:
    """View of complex rows (A, O, F) as real rows (A, R)."""
    return rows.reshape(len(rows), -1).view(float)
