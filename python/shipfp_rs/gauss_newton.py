"""Gauss-Newton steps between bounds, which take a point near a minimum to full precision."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

NULL_TOLERANCE = 1e-7
"""Directions with a singular value below this part of the largest are tried out instead of trusted."""
ROUNDING = 1e-13
"""Part of the cost below which its changes are noise."""
POLISH_STEPS = 30


@dataclass(frozen=True)
class Point:
    """A vector (Q,) with its residual (R,), Jacobian (R, Q) and sum of squares; infinite where it has none."""

    vector: Array
    residual: Array
    jacobian: Array
    cost: float


@dataclass(frozen=True)
class Bounds:
    """Lower and upper bounds, each of shape (Q,)."""

    lower: Array
    upper: Array

    @property
    def finite(self) -> bool:
        """Whether any bound is finite."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    def clip(self, vector: Array) -> Array:
        """Return the nearest vector between the bounds."""
        return np.clip(vector, self.lower, self.upper)


@dataclass(frozen=True)
class Step:
    """A Gauss-Newton step (Q,), the fall of the cost it promises, the entries that bounds hold, null directions (K, Q)."""

    step: Array
    promise: float
    held: Mask
    null: Array


def gauss_newton_step(point: Point, bounds: Bounds) -> Step:
    """Minimise the linearised sum of squares between the bounds.

    Directions with a singular value of the column-scaled Jacobian below `NULL_TOLERANCE` of the largest are left alone.
    """
    norm = np.sqrt(np.einsum("rq,rq->q", point.jacobian, point.jacobian))
    scale = np.where(norm > 0.0, norm, 1.0)
    size = len(scale)
    # The triangular factor of [J r] tells all that the tall matrix does.
    factor = np.asarray(np.linalg.qr(np.column_stack([point.jacobian / scale, point.residual]), mode="r"))
    triangle, target = factor[:, :size], factor[:, size]
    slope = triangle.T @ target
    held = ((point.vector <= bounds.lower) & (slope > 0.0)) | ((point.vector >= bounds.upper) & (slope < 0.0))
    step = np.zeros(size)
    while True:
        free = ~held
        left, singular, right = np.linalg.svd(triangle[:, free])
        rank = int(np.sum(singular > NULL_TOLERANCE * singular.max(initial=0.0)))
        rest = -(target + triangle[:, held] @ step[held])
        step[free] = right[:rank].T @ ((left.T @ rest)[:rank] / singular[:rank])
        moved = point.vector + step / scale
        inside = bounds.clip(moved)
        over = free & (moved != inside)
        if not over.any():
            break
        step[over] = ((inside - point.vector) * scale)[over]
        held |= over
    null = np.zeros((len(right) - rank, size))
    null[:, free] = right[rank:]
    return Step(step / scale, float(np.sum((triangle @ step) ** 2)), held, null / scale)


def polish(
    evaluate: Callable[[Array], Point],
    point: Point,
    bounds: Bounds,
    *,
    worthwhile: float = 0.0,
    promising: float = 0.0,
) -> Point:
    """Take Gauss-Newton steps while they help, down to where rounding decides.

    Nor is one taken that moves no entry by a worthwhile part of it, or promises no more than a part of the cost.
    """
    last = np.inf
    for _ in range(POLISH_STEPS):
        step = gauss_newton_step(point, bounds)
        still = (np.abs(step.step) < worthwhile * np.abs(point.vector)).all()
        if still or step.promise < promising * point.cost:
            return point
        length = float(np.linalg.norm(step.step * np.linalg.norm(point.jacobian, axis=0)))
        # At the floor of rounding the cost says nothing more, but a shrinking step still does.
        floor = step.promise <= ROUNDING * point.cost
        enough = point.cost * (1.0 + ROUNDING) if floor and length < last else point.cost
        for part in (1.0,) if floor else (1.0, 0.5, 0.25):
            trial = evaluate(bounds.clip(point.vector + part * step.step))
            if trial.cost < enough:
                break
        else:
            return point
        point, last = trial, length
    return point
