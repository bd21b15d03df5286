"""Gauss-Newton steps between bounds, which take a point near a minimum to full precision."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from shipfp_rs.support.arrays import Array, Mask

NULL_TOLERANCE = 1e-7
"""Along directions with a singular value below this part of the largest no step is computed; points there are tried."""
ROUNDING = 1e-13
"""Part of the cost below which its changes are noise."""
TURNS = 4
"""Most changes of the set of active bounds during one step, as a multiple of the number of entries."""
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
    """Minimise the linearised sum of squares between the bounds (Stark and Parker's BVLS, Comput. Stat. 10 (1995) 129).

    Directions with a singular value of the column-scaled Jacobian below `NULL_TOLERANCE` of the largest are left alone.
    """
    norm = np.sqrt(np.einsum("rq,rq->q", point.jacobian, point.jacobian))
    scale = np.where(norm > 0.0, norm, 1.0)
    size = len(scale)
    # The triangular factor of [J r] has the same products as the tall matrix.
    factor = np.asarray(np.linalg.qr(np.column_stack([point.jacobian / scale, point.residual]), mode="r"))
    triangle, target = factor[:, :size], factor[:, size]
    slope = triangle.T @ target
    lower, upper = ((bound - point.vector) * scale for bound in (bounds.lower, bounds.upper))
    held = ((lower >= 0.0) & (slope > 0.0)) | ((upper <= 0.0) & (slope < 0.0))
    step = np.zeros(size)
    for _ in range(TURNS * size + 1):
        free = ~held
        left, singular, right = np.linalg.svd(triangle[:, free])
        rank = int(np.sum(singular > NULL_TOLERANCE * singular.max(initial=0.0)))
        rest = -(target + triangle[:, held] @ step[held])
        best = step.copy()
        best[free] = right[:rank].T @ ((left.T @ rest)[:rank] / singular[:rank])
        way = best - step
        room = np.where(way < 0.0, lower, upper) - step
        part = np.divide(room, way, out=np.full(size, np.inf), where=free & (way != 0.0))
        if part.min(initial=np.inf) < 1.0:
            first = int(np.argmin(part))
            # Go to the first bound only: the others may lie ahead only because this one would be crossed.
            step = np.clip(step + part[first] * way, lower, upper)
            step[first] = lower[first] if way[first] < 0.0 else upper[first]
            held[first] = True
            continue
        step = best
        slope = triangle.T @ (target + triangle @ step)
        inward = held * np.where(step <= lower, -slope, slope)
        if not inward.max(initial=0.0) > ROUNDING * np.linalg.norm(target):
            break
        held[int(np.argmax(inward))] = False
    null = np.zeros((len(right) - rank, size))
    null[:, free] = right[rank:]
    explained = triangle @ step
    promise = -float((2.0 * target + explained) @ explained)
    return Step(np.asarray(step / scale), max(promise, 0.0), held, null / scale)


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
        # Once the cost changes by rounding only, a shrinking step still shows progress.
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


def sparse_basis(null: Array) -> Array:
    """Gauss-Jordan form with full pivoting: each direction has a leading 1 and zeros at the others' leads."""
    basis = null.copy()
    for row in range(len(basis)):
        free_rows = np.abs(basis[row:])
        pivot_row, pivot = divmod(int(np.argmax(free_rows)), basis.shape[1])
        basis[[row, row + pivot_row]] = basis[[row + pivot_row, row]]
        basis[row] /= basis[row, pivot]
        for other in range(len(basis)):
            if other != row:
                basis[other] -= basis[other, pivot] * basis[row]
    return basis
