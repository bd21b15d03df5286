"""Whether the end of a search is a minimum: what speaks against it, and where else to look before it is called one."""

from __future__ import annotations

import numpy as np

from shipfp_rs.optimise.gauss_newton import (
    NULL_TOLERANCE,
    ROUNDING,
    Bounds,
    Point,
    gauss_newton_step,
    sparse_basis,
)
from shipfp_rs.support.arrays import Array, Mask

STEP_TOLERANCE = 1e-6
"""If a Gauss-Newton step would change a parameter by more than this part of it, the search stopped too early."""
EXACT_STEP = 1e-10
"""A step below this part is rounding: with a perfect fit the residual, and so the gradient, is rounding, too."""
PLATEAU = 1e-10
"""A parameter has lost its effect if that, relative to the residual, fell below this part of what it was at the start."""
FAR_AWAY = 1e4
"""A parameter has run away if it is this many times its start and lost its effect on the way; with no effect at the start,
the square of this counts."""
SMALLEST = 1e-300
"""Size that stands in for that of a value of zero."""
NEAR = 1e-2
"""Relative change of the parameters when a direction without slope is tried."""
NO_EFFECT = 1e-15
"""A parameter has no effect if changing it by its own size changes the residual by less than this part."""
ACROSS = 1.1
"""Relative change along a direction that lost its effect, before a new search; it makes the smaller of two merged terms
change its sign."""
FAR = (0.1, 0.01, 10.0)
"""Factors by which a parameter without any effect is tried elsewhere: it may have started on a plateau."""


def doubt(point: Point, start: Point, bounds: Bounds, tolerance: float, hidden: float = 0.0) -> str:
    """Say why a point may not be a minimum; an empty text where nothing speaks against it.

    Parameters
    ----------
    point, start
        Where the search ended and where it began.
    bounds
        Those of the search.
    tolerance
        Part of the cost that a Gauss-Newton step may still promise: the square of the relative offset of Bates and
        Watts (Technometrics 23 (1981) 179-183), but for the degrees of freedom.
    hidden
        Part of the cost that the noise hides: a step that promises less, however long, is no reason to doubt.
    """
    step = gauss_newton_step(point, bounds)
    slope, slope_before = (np.linalg.norm(p.jacobian, axis=0) for p in (point, start))
    free = ~step.held
    # Products, not quotients, since either residual may be zero.
    reach = np.maximum(np.abs(point.vector), np.abs(start.vector))
    lost = slope * np.sqrt(start.cost) < PLATEAU * slope_before * np.sqrt(point.cost)
    lost = free & (reach > 0.0) & (lost | ((slope == 0.0) & (slope_before > 0.0)))
    if lost.any():
        index = int(np.argmax(lost))
        return (
            f"entry {index} of the vector ran to {point.vector[index]:.3g}, where it has no effect any more"
        )
    if point.cost > 0.0 and (slope * reach <= NO_EFFECT * np.sqrt(point.cost)).all():
        return "no entry of the vector has an effect here"
    # The size of a parameter that starts at zero is the change of it that would matter beside the residual.
    typical = np.sqrt(start.cost) / np.where(slope_before > 0.0, slope_before, np.inf)
    size = np.where(start.vector != 0.0, np.abs(start.vector), typical)
    part = np.abs(step.step) / np.maximum(np.maximum(np.abs(point.vector), size), SMALLEST)
    worst = int(np.argmax(part))
    # A long step that gains less than rounding leads along the floor of a valley, on which no point is better.
    if part[worst] > STEP_TOLERANCE and step.promise > max(ROUNDING, hidden) * point.cost:
        return f"entry {worst} of the vector still wants to move by {part[worst]:.1e} of its size"
    if step.promise > max(tolerance, hidden) * point.cost and part[worst] > EXACT_STEP:
        return f"the sum of squares can still fall by {step.promise / point.cost:.1e} of itself"
    far = FAR_AWAY if _lost_rank(point, start, step.held) else FAR_AWAY**2
    away = free & (size > 0.0) & (np.abs(point.vector) > far * size)
    if len(step.null) and away.any():
        index = int(np.argmax(away))
        return f"entry {index} of the vector ran to {point.vector[index]:.3g}, where it has no effect of its own any more"
    return ""


def nearby(point: Point, start: Point, bounds: Bounds) -> list[Array]:
    """Vectors a little along every direction without slope: a lower one tells a saddle from a minimum."""
    directions = _directions(point, start, bounds)
    return [bounds.clip(point.vector + sign * NEAR * row) for row in directions for sign in (1.0, -1.0)]


def elsewhere(point: Point, start: Point, bounds: Bounds) -> list[Array]:
    """Vectors from which to search again, where the search lost what told the parameters apart.

    There may be none: what the residual never depended on is no reason to doubt.
    """
    held = gauss_newton_step(point, bounds).held
    reach = np.linalg.norm(point.jacobian, axis=0) * np.maximum(np.abs(point.vector), np.abs(start.vector))
    vectors = []
    for index in np.flatnonzero(~held & (reach <= NO_EFFECT * np.sqrt(point.cost))):
        for factor in FAR:
            vectors.append(point.vector.copy())
            vectors[-1][index] = factor * (point.vector[index] or 1.0)
    if _lost_rank(point, start, held):
        directions = _directions(point, start, bounds)
        vectors += [point.vector + shift * row for row in directions for shift in (ACROSS, -ACROSS)]
    return [bounds.clip(vector) for vector in vectors]


def _directions(point: Point, start: Point, bounds: Bounds) -> Array:
    """Null directions (K, Q), each over few entries, the largest change as large as its parameter."""
    size = np.maximum(np.abs(point.vector), np.abs(start.vector))
    size = np.where(size > 0.0, size, 1.0)
    relative = sparse_basis(gauss_newton_step(point, bounds).null / size)
    return np.asarray(relative / np.abs(relative).max(axis=1, initial=SMALLEST, keepdims=True) * size)


def _lost_rank(point: Point, start: Point, held: Mask) -> bool:
    return _rank(point.jacobian[:, ~held]) < _rank(start.jacobian[:, ~held])


def _rank(jacobian: Array) -> int:
    scale = np.linalg.norm(jacobian, axis=0)
    triangle = np.linalg.qr(jacobian / np.where(scale > 0.0, scale, 1.0), mode="r")
    singular = np.linalg.svd(triangle, compute_uv=False)
    return int(np.sum(singular > NULL_TOLERANCE * singular.max(initial=0.0)))
