"""The search: descents side by side from several starts to the distinct minima of the deviance."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.linalg.lapack import dposv

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.likelihood import Likelihood, Products
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.threads import require_going

SETTLED = 0.01
"""A step that lowers the deviance by less ends a descent: a hundredth of what makes an interval's end uncertain by a
thousandth."""
MOST_STEPS = 60
LEAST = 1e-14
"""Damping that keeps a matrix that nothing tells a part of from being singular by rounding."""
DAMPED, DAMPED_NEAR, REJECTED, LESS, MORE, FURTHER = 1e-4, 1e-6, 1e-6, 0.15, 8.0, 2.0
"""Damping of a descent to begin with, and of one that begins near its end; the least after a bad step, its factors after a
good step and a bad one (Marquardt 1963), and by how much the latter grows with each bad step in a row (Nielsen 1999)."""
MOST_DAMPED = 1e4
"""Damping with which a descent ends: steps a ten-thousandth as long as the gradient's own lead nowhere lower."""
FIRST, ROUGH, MIDDLE, FINE = (3, 50.0), (8, 50.0), (30, 1.0), (MOST_STEPS, SETTLED)
"""Most steps and least decrease of the descents, from many starts to few minima."""
MOST_BASINS = 5
SAME = 4.0
"""Two ends are one minimum where the deviance's curvature puts them less than this apart, two deviations."""
ALIKE = 10.0
"""Minima whose deviance is above the least by more than this tell nothing of an interval of 95 per cent."""

LIKELY = 30.0
"""Ends of first descents above the least by more than this are not followed: their last steps bring less."""

Known = TypeVar("Known", bound=Likelihood)
Penalty = Callable[[Array], tuple[float, Array]]
"""Row that is added to the residuals: its value at a vector and its gradient."""


@dataclass(frozen=True)
class Basin:
    """The end of a descent: deviance and vector, and what was computed there without a penalty."""

    cost: float
    vector: Array
    settled: bool = True
    products: Products | None = field(default=None, repr=False, compare=False)


def descend(
    likelihood: Likelihood,
    start: Array,
    *,
    steps: int = MOST_STEPS,
    settled: float = SETTLED,
    penalty: Penalty | None = None,
    near: bool = False,
    until: float | None = None,
) -> Basin:
    """Go down from a vector within the bounds, Levenberg-Marquardt with an active set.

    Parameters
    ----------
    likelihood, start
        What is lowered, from where.
    steps, settled
        Steps at most, and the decrease below which it ends.
    penalty
        A stiff row beside, for a profile; the cost returned is without it.
    near
        Whether it begins near its end.
    until
        Clock (`time.monotonic`) at which it ends.
    """
    low, high = likelihood.coordinates.bounds
    x = np.clip(start, low, high)
    at = partial(_computed, likelihood, penalty)
    try:
        plain, now = at(x)
    except SimulationError:
        return Basin(np.inf, x, False)
    left, damping, more = steps - 1, DAMPED_NEAR if near else DAMPED, MORE
    while damping < MOST_DAMPED:
        require_going()
        if until is not None and time.monotonic() > until:
            break
        try:
            step = _step(now, x, low, high, damping)
        except np.linalg.LinAlgError:  # singular to rounding: the data do not determine some direction
            damping = max(damping * MORE, 1e-9)
            continue
        promised = 2.0 * step @ now.downhill - step @ now.matrix @ step
        if promised < 0.0:  # the bounds cut the step so that it would rise
            damping *= MORE
            continue
        if promised < 0.1 * settled:
            return Basin(plain.cost, x, True, plain)
        there = np.minimum(np.maximum(x + step, low), high)
        try:
            then = at(there)
            fell = now.cost - then[1].cost
        except SimulationError:
            fell = -np.inf
        if fell <= 0.0:
            damping, more = max(damping * more, REJECTED), more * FURTHER
            continue
        more = MORE
        good = fell / promised
        damping *= LESS if good > 0.7 else 1.0 if good > 0.25 else 4.0
        x, (plain, now) = there, then
        if fell < settled:
            return Basin(plain.cost, x, True, plain)
        left -= 1
        if left < 1:
            break
    return Basin(plain.cost, x, damping >= MOST_DAMPED, plain)


def _computed(likelihood: Likelihood, penalty: Penalty | None, vector: Array) -> tuple[Products, Products]:
    """Return deviance, gradient and curvature at a vector, without and with a penalty."""
    found = likelihood.products(vector)
    if penalty is None:
        return found, found
    value, slope = penalty(vector)
    # The row's residual is -value, its derivative as the model's: slope.
    return found, found._replace(
        cost=found.cost + value**2,
        downhill=found.downhill - value * slope,
        matrix=found.matrix + np.outer(slope, slope),
    )


def _step(now: Products, x: Array, low: Array, high: Array, damping: float) -> Array:
    """Damped Gauss-Newton step within the bounds: what it would push out is held, and the rest solved again."""
    # By Cholesky, which is as exact whatever units the entries have, be they orders of magnitude apart.
    damped, downhill, low, high = now.matrix.copy(), now.downhill, low - x, high - x
    damped.flat[:: len(x) + 1] += np.maximum(now.matrix.diagonal(), 1e-30) * (damping + LEAST)
    held = ((low >= 0.0) & (downhill < 0.0)) | ((high <= 0.0) & (downhill > 0.0))
    if not held.any():
        step = _solved(damped, downhill)
        if not ((step < low) | (step > high)).any():
            return step
    step, free = np.zeros(len(x)), ~held
    for _ in range(4):
        places = free.nonzero()[0]
        if not len(places):
            break
        rows, step[places] = damped[places], 0.0
        step[places] = _solved(rows[:, places], downhill[places] - rows @ step)
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step[out] = np.minimum(np.maximum(step, low), high)[out]
        free &= ~out
    return np.minimum(np.maximum(step, low), high)


def _solved(matrix: Array, right: Array) -> Array:
    """Solution of a symmetric system, by LAPACK at once: `numpy.linalg.solve` takes longer to check than to solve.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where the matrix is not positive definite.
    """
    _, found, fault = dposv(matrix.T, right)
    if fault:
        raise np.linalg.LinAlgError("a matrix that is not positive definite")
    solution: Array = found
    return solution


def best_basins(
    likelihood: Known, starts: Sequence[Array], *, until: float | None = None
) -> tuple[Known, list[Basin]]:
    """Return the likelihood with its noise, and the distinct minima that count, the lowest first.

    Rough descents with white noise come first. The best ends then go on under the noise of their own residuals, and the one
    that is likeliest gives the noise for all.

    Raises
    ------
    SimulationError
        Where no start leads to a ship that can be simulated.
    """
    ends = each(likelihood, starts, until, *FIRST)
    ends = each(likelihood, [end.vector for end in ends], until, *ROUGH)
    if not ends or not np.isfinite(ends[0].cost):
        raise SimulationError("no start leads to a ship that can be simulated")
    ends = distinct(likelihood, ends)[:MOST_BASINS]
    jobs = [partial(by_own_noise, likelihood, end.vector, until=until) for end in ends]
    vectors = [end.vector for end in sorted(likelihood.each(jobs), key=lambda end: end.cost)]
    likelihood = likelihood.with_noise(vectors[0])
    ends = distinct(likelihood, each(likelihood, vectors, until, *FINE))
    return likelihood, [end for end in ends if end.cost < ends[0].cost + ALIKE]


def by_own_noise(likelihood: Likelihood, vector: Array, *, until: float | None = None) -> Basin:
    """Go down under the noise of the residuals themselves; the cost is the total, determinant included."""
    for steps, settled in (MIDDLE, FINE):
        try:
            likelihood = likelihood.with_noise(vector)
        except (SimulationError, np.linalg.LinAlgError):
            return Basin(np.inf, vector, False)
        vector = descend(likelihood, vector, steps=steps, settled=settled, until=until).vector
    return Basin(likelihood.total(vector), vector)


def distinct(likelihood: Likelihood, ends: Sequence[Basin]) -> list[Basin]:
    """Leave out minima that are the same: apart by less than the deviance tells, or nearly equal in every coordinate."""
    ends = sorted((end for end in ends if np.isfinite(end.cost)), key=lambda one: one.cost)
    if len(ends) < 2:
        return ends
    first = ends[0].products or likelihood.products(ends[0].vector)
    kept: list[Basin] = []
    for end in ends:
        apart = [end.vector - other.vector for other in kept]
        if all(one @ first.matrix @ one > SAME and np.abs(one).max() > 1e-3 for one in apart):
            kept.append(end)
    return kept


def each(
    likelihood: Likelihood,
    starts: Sequence[Array],
    until: float | None,
    steps: int = MOST_STEPS,
    settled: float = SETTLED,
) -> list[Basin]:
    """Go down from each start, side by side; return the ends, the lowest first."""
    jobs = [
        partial(descend, likelihood, start, steps=steps, settled=settled, until=until) for start in starts
    ]
    return sorted(likelihood.each(jobs), key=lambda end: end.cost)
