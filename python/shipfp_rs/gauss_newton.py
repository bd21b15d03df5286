"""Gauss-Newton steps between bounds: from nearly a minimum to full precision, and whether it is a minimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

STEP_TOLERANCE = 1e-6
"""A step that would change a parameter by more than this part of it tells that the search stopped short."""
EXACT_STEP = 1e-10
"""A step below this part is rounding, whatever the gradient says: a perfect fit leaves a residual of mere noise."""
NULL_TOLERANCE = 1e-7
"""Directions with a singular value below this part of the largest are tried out instead of trusted."""
PROBE = 1e-2
"""Relative change of the parameters when a direction without slope is tried."""
FAR = (0.1, 0.01, 10.0)
"""Factors by which a parameter without any effect is tried elsewhere: its start may have been on a plateau."""
PLATEAU = 1e-10
"""A parameter whose effect, relative to the residual, fell below this part of what it was does nothing any more."""
NOTICEABLE = 1e-9
"""Part of the cost by which another point must be lower to count as a way down."""
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
    norm = np.linalg.norm(point.jacobian, axis=0)
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


def polish(evaluate: Callable[[Array], Point], point: Point, bounds: Bounds) -> Point:
    """Take Gauss-Newton steps while they help, down to where rounding decides."""
    last = np.inf
    for _ in range(POLISH_STEPS):
        step = gauss_newton_step(point, bounds)
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


def doubt(point: Point, start: Point, bounds: Bounds, tolerance: float) -> str:
    """Say why a point may not be a minimum: an empty text where nothing speaks against it.

    Three things do: a parameter that lost the effect which it had at the start, a Gauss-Newton step that is large
    beside the parameters, and a fall of the cost still promised by that step, above `tolerance` of the cost (the
    relative offset of Bates and Watts, Technometrics 23 (1981) 179-183, squared).
    """
    step = gauss_newton_step(point, bounds)
    reach = np.maximum(np.abs(point.vector), np.abs(start.vector))
    slope, slope_before = (np.linalg.norm(p.jacobian, axis=0) for p in (point, start))
    # In products, since either residual may be zero.
    lost = slope * np.sqrt(start.cost) < PLATEAU * slope_before * np.sqrt(point.cost)
    lost |= (slope == 0.0) & (slope_before > 0.0)
    lost &= ~step.held & (reach > 0.0)
    if lost.any():
        index = int(np.argmax(lost))
        return (
            f"entry {index} of the vector ran to {point.vector[index]:.3g}, where it has no effect any more"
        )
    typical = np.sqrt(start.cost) / np.where(slope_before > 0.0, slope_before, 1.0)
    size = np.maximum(np.abs(point.vector), typical)
    part = np.abs(step.step) / np.where(size > 0.0, size, 1.0)
    worst = int(np.argmax(part))
    if part[worst] > STEP_TOLERANCE:
        return f"entry {worst} of the vector still wants to move by {part[worst]:.1e} of its size"
    if step.promise > tolerance * point.cost and part[worst] > EXACT_STEP:
        return f"the sum of squares can still fall by {step.promise / point.cost:.1e} of itself"
    return ""


def way_down(evaluate: Callable[[Array], Point], point: Point, start: Point, bounds: Bounds) -> Point | None:
    """Return a lower point along a direction without slope, which tells a saddle or a plateau from a minimum."""
    size = np.maximum(np.abs(point.vector), np.abs(start.vector))
    size = np.where(size > 0.0, size, 1.0)
    trials = []
    for direction in gauss_newton_step(point, bounds).null:
        probe = direction * (PROBE / np.max(np.abs(direction) / size))
        trials += [point.vector + probe, point.vector - probe]
    for index in np.flatnonzero(~point.jacobian.any(axis=0)):
        for factor in FAR:
            trials.append(point.vector.copy())
            trials[-1][index] *= factor
    for vector in trials:
        trial = evaluate(bounds.clip(vector))
        if trial.cost < point.cost * (1.0 - NOTICEABLE):
            return trial
    return None
