"""Shaft angle as a spline through the passages of all pulses, with the variance of its slope."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded

from shipfp_rs.support.arrays import Array

_DEGREE = 4
"""Degree of the angle spline; the speed is its slope, a cubic spline."""
_STIFFNESS = 1e-6
"""Weight of the coefficients' second differences relative to that of the pulses. It determines the spline where there
are no pulses.
"""


@dataclass(frozen=True)
class AngleSpline:
    """Spline of the angle [rev]; its slope is the speed."""

    spline: BSpline
    factor: Array
    """Banded Cholesky factor of the normal matrix, lower form."""
    shift: Array
    """Derivative of the coefficients with respect to the offset of each stretch but the first, shape (M, R)."""
    offsets: Array
    """Angle at the start of each stretch [rev], shape (S,)."""
    offset_covariance: Array

    def speed(self, time: Array) -> Array:
        """Speed [rev/s]."""
        return np.asarray(self.spline(time, 1))

    def speed_variance(self, time: Array) -> Array:
        """Variance of the speed [(rev/s)^2]."""
        slope = _slopes(self.spline, time)
        own = np.asarray((slope @ _inverse_band(self.factor)).multiply(slope).sum(axis=1)).ravel()
        through = slope @ self.shift
        return np.asarray(own + np.einsum("ij,jk,ik->i", through, self.offset_covariance, through))


@dataclass(frozen=True)
class AnglePieces:
    """Angle splines in order of time with gaps between them, and the angle at the start of each stretch [rev]."""

    splines: tuple[AngleSpline, ...]
    spans_s: Array
    offsets: Array

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return sum(len(piece.spline.c) for piece in self.splines)

    def piece_at(self, time: Array) -> npt.NDArray[np.intp]:
        """Index of the spline that covers each time, -1 where there is none."""
        piece = np.searchsorted(self.spans_s[:, 0], time, side="right") - 1
        return np.where((piece >= 0) & (time <= self.spans_s[piece, 1]), piece, -1)

    def angle(self, time: Array) -> Array:
        """Angle [rev], NaN between the pieces."""
        return self._each(time, lambda piece, at: piece.spline(at))

    def speed(self, time: Array) -> Array:
        """Speed [rev/s], NaN between the pieces."""
        return self._each(time, lambda piece, at: piece.speed(at))

    def speed_variance(self, time: Array) -> Array:
        """Variance of the speed [(rev/s)^2], NaN between the pieces."""
        return self._each(time, lambda piece, at: piece.speed_variance(at))

    def _each(self, time: Array, value: Callable[[AngleSpline, Array], Array]) -> Array:
        result, at = np.full(len(time), np.nan), self.piece_at(time)
        for k, piece in enumerate(self.splines):
            if (inside := at == k).any():
                result[inside] = value(piece, time[inside])
        return result


def fit_angle_pieces(
    time: Array, angle: Array, weight: Array, stretch: npt.NDArray[np.intp], spacing_s: float
) -> AnglePieces:
    """Fit a spline to each run of stretches that overlap in time; arguments as in `fit_angle_spline`."""
    count = int(stretch.max()) + 1
    first, last = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(first, stretch, time)
    np.maximum.at(last, stretch, time)
    order = np.argsort(first)
    reached = np.maximum.accumulate(last[order])
    fresh = np.append(True, first[order][1:] > reached[:-1])
    piece_of = np.empty(count, dtype=np.intp)
    piece_of[order] = np.cumsum(fresh) - 1
    splines, offsets = [], np.empty(count)
    for k in range(int(piece_of.max()) + 1):
        own = np.flatnonzero(piece_of == k)
        chosen = np.isin(stretch, own) if len(own) < count else np.ones(len(time), dtype=np.bool_)
        splines.append(
            fit_angle_spline(
                time[chosen], angle[chosen], weight[chosen], np.searchsorted(own, stretch[chosen]), spacing_s
            )
        )
        offsets[own] = splines[-1].offsets
    spans = np.column_stack(
        [first[order][fresh], reached[np.append(np.flatnonzero(fresh)[1:] - 1, count - 1)]]
    )
    return AnglePieces(tuple(splines), spans, offsets)


def fit_angle_spline(
    time: Array, angle: Array, weight: Array, stretch: npt.NDArray[np.intp], spacing_s: float
) -> AngleSpline:
    """Fit a spline and an offset per stretch to the passages by weighted least squares.

    Parameters
    ----------
    time, angle
        Passages [s] and their angles, counted within the stretch [rev], shape (N,).
    weight
        Inverse variance of each angle [1/rev^2], shape (N,).
    stretch
        Index of the stretch of each passage, shape (N,), from 0; the offset of stretch 0 is zero.
    spacing_s
        Distance between knots [s].
    """
    first, last = float(time.min()), float(time.max())
    pieces = max(int(np.ceil((last - first) / spacing_s)), 1)
    inner = np.linspace(first, last, pieces + 1)
    knots = np.concatenate([[first] * _DEGREE, inner, [last] * _DEGREE])
    basis = BSpline.design_matrix(time, knots, _DEGREE)
    normal = (basis.T @ basis.multiply(weight[:, None])).todia()
    size = basis.shape[1]
    differences = sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(size - 2, size))
    normal = normal + _STIFFNESS * np.median(normal.diagonal()) * (differences.T @ differences)
    band = np.zeros((_DEGREE + 1, size))
    for k in range(_DEGREE + 1):
        band[k, : size - k] = normal.diagonal(k)
    factor = cholesky_banded(band, lower=True)

    stretches = int(stretch.max()) + 1
    member = sparse.csr_array(
        (np.ones(len(time)), (np.arange(len(time)), stretch)), shape=(len(time), stretches)
    )[:, 1:]
    coupling = (basis.T @ member.multiply(weight[:, None])).toarray()
    right = basis.T @ (weight * angle)
    alone = cho_solve_banded((factor, True), right)
    shift = cho_solve_banded((factor, True), coupling) if stretches > 1 else np.zeros((size, 0))
    # Eliminating the spline leaves a small system for the offsets, in which long and short stretches count equally.
    total = member.T @ weight
    scale = 1.0 / np.sqrt(np.outer(total, total))
    covariance = scale * np.linalg.pinv(
        scale * (np.diag(total) - coupling.T @ shift), rcond=1e-9, hermitian=True
    )
    # The spline is angle + offset, so the offsets below are added to the counts of their stretches.
    offsets = covariance @ (coupling.T @ alone - member.T @ (weight * angle))
    coefficients = alone + shift @ offsets
    return AngleSpline(
        BSpline(knots, coefficients, _DEGREE), factor, shift, np.append(0.0, offsets), covariance
    )


def _slopes(spline: BSpline, time: Array) -> sparse.csr_array:
    lower = BSpline.design_matrix(time, spline.t[1:-1], _DEGREE - 1)
    size = len(spline.c)
    rise = _DEGREE / (spline.t[_DEGREE + 1 : size + _DEGREE] - spline.t[1:size])
    change = sparse.diags_array([-rise, rise], offsets=[0, 1], shape=(size - 1, size))
    return lower @ change


def _inverse_band(factor: Array) -> sparse.dia_matrix:
    """Band of the inverse of a matrix from its banded Cholesky factor (lower form), by Takahashi's recursion.

    K. Takahashi, J. Fagan, M. Chin, Eighth PICA Conference (1973) 63. Rows are computed from the last to the first; within
    the band each needs only rows below it.
    """
    width, size = factor.shape
    reach = width - 1
    inverse = np.zeros((size + reach, width))  # inverse[i, d] is entry (i, i + d)
    window = np.zeros((reach, reach))  # rows i + 1 to i + reach, both triangles
    for i in range(size - 1, -1, -1):
        pivot = factor[0, i]
        column = factor[1:, i] / pivot
        beside = -window @ column
        corner = 1.0 / pivot**2 - column @ beside
        inverse[i, 0], inverse[i, 1:] = corner, beside
        window[1:, 1:] = window[:-1, :-1].copy()
        window[0, 0] = corner
        window[0, 1:] = window[1:, 0] = beside[:-1]
    diagonals = [inverse[: size - d, d] for d in range(width)]
    return sparse.diags_array(
        diagonals[:0:-1] + diagonals, offsets=list(range(-reach, width)), shape=(size, size)
    )
