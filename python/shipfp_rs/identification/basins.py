"""Search for the distinct minima of the deviance, by parallel descents from several starts."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from scipy.linalg.lapack import dposv

from shipfp_rs.errors import IdentificationError, SimulationError
from shipfp_rs.identification.likelihood import Likelihood, Products
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.threads import require_going

SETTLED = 0.01
"""Least decrease of the deviance for a descent to continue; this decrease moves the ends of an interval by a thousandth."""
MOST_STEPS = 60
LEAST = 1e-14
"""Damping that keeps a matrix regular where the data do not determine a direction."""
DAMPED, DAMPED_NEAR, REJECTED, LESS, MORE, FURTHER = 1e-4, 1e-6, 1e-6, 0.15, 8.0, 2.0
"""Levenberg-Marquardt damping: initial value, initial value near the minimum, least value after a rejected step, factor
after an accepted step, factor after a rejected step (Marquardt 1963), and growth of that factor with each further rejected
step (Nielsen 1999)."""
MOST_DAMPED = 1e4
"""Damping at which a descent stops, since its steps are then only a ten-thousandth of a gradient step."""
FIRST, ROUGH, MIDDLE, FINE = (3, 50.0), (8, 50.0), (30, 1.0), (MOST_STEPS, SETTLED)
"""Limits of each round of descents, from many starts to few minima: number of steps, and least decrease of the deviance."""
MOST_BASINS = 5
SAME = 4.0
"""Squared distance, in the metric of the deviance's curvature, below which two minima count as the same."""
ALIKE = 10.0
"""Deviance above the lowest minimum from which another minimum no longer affects a 95 % interval."""

Known = TypeVar("Known", bound=Likelihood)
Penalty = Callable[[Array], tuple[float, Array]]
"""Maps a point of the search to the value and gradient of a further residual, whose square is added to the deviance."""


@dataclass(frozen=True)
class Basin:
    """A minimum: its deviance, its search vector, and the likelihood's products there, without a penalty."""

    cost: float
    vector: Array
    settled: bool = True
    products: Products | None = field(default=None, repr=False, compare=False)
    values: Mapping[str, float] | None = field(default=None, repr=False, compare=False)
    """Parameters at the minimum; None where they were not stored."""


@dataclass(frozen=True)
class Minima:
    """A likelihood with estimated noise, and its distinct minima, the lowest first."""

    likelihood: Likelihood
    basins: tuple[Basin, ...]

    @property
    def best(self) -> Basin:
        """The lowest minimum."""
        return self.basins[0]

    @property
    def values(self) -> dict[str, float]:
        """Parameters at the best minimum."""
        return self.likelihood.coordinates.values(self.best.vector)

    @cached_property
    def total(self) -> float:
        """Deviance of the best minimum, log determinant included, with the noise estimated from its own residuals."""
        return self.likelihood.total(self.best.vector)


def descend(
    likelihood: Likelihood,
    start: Array,
    *,
    steps: int = MOST_STEPS,
    settled: float = SETTLED,
    penalty: Penalty | None = None,  # not part of the returned cost
    near: bool = False,  # the start is close to the minimum
    until: float | None = None,  # deadline by `time.monotonic`
) -> Basin:
    """Minimise the deviance within the bounds, by Levenberg-Marquardt with an active set."""
    low, high = likelihood.coordinates.bounds
    x = np.clip(start, low, high)
    likelihood = likelihood.near(x)
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
        except np.linalg.LinAlgError:  # numerically singular: the data do not determine some direction
            damping = max(damping * MORE, 1e-9)
            continue
        promised = 2.0 * step @ now.downhill - step @ now.matrix @ step
        if promised < 0.0:  # clipped to the bounds, the step would raise the deviance
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


def expected(likelihood: Likelihood, vector: Array) -> Basin:
    """Return a minimum at the true parameters, with the gradient that is expected over the noise: zero."""
    found = likelihood.products(vector)
    return Basin(found.cost, vector, products=found._replace(downhill=np.zeros_like(found.downhill)))


def _computed(likelihood: Likelihood, penalty: Penalty | None, vector: Array) -> tuple[Products, Products]:
    """Return deviance, gradient and curvature at a point of the search, without and with the penalty."""
    found = likelihood.products(vector)
    if penalty is None:
        return found, found
    value, slope = penalty(vector)
    # The convention of the likelihood: the residual is data minus model, -value, and the derivative is the model's, `slope`.
    return found, found._replace(
        cost=found.cost + value**2,
        downhill=found.downhill - value * slope,
        matrix=found.matrix + np.outer(slope, slope),
    )


def _step(now: Products, x: Array, low: Array, high: Array, damping: float) -> Array:
    """Return a damped Gauss-Newton step within the bounds; entries that would cross a bound stop at it."""
    # Units that differ by orders of magnitude need no scaling, since the accuracy of Cholesky does not depend on them.
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
    """Solve a positive definite system by LAPACK, without the checks of `numpy.linalg.solve`, or raise `LinAlgError`."""
    _, found, fault = dposv(matrix.T, right)
    if fault:
        raise np.linalg.LinAlgError("a matrix that is not positive definite")
    solution: Array = found
    return solution


def best_basins(
    likelihood: Known,
    starts: Sequence[Array],
    *,
    until: float | None = None,
    alone: Callable[..., Basin] | None = None,
) -> tuple[Known, list[Basin], float]:
    """Return the likelihood with estimated noise, its distinct minima (lowest first), and the lowest total deviance."""
    # Rough descents with white noise come first. The best ends continue by `alone`, each with the noise of its residuals.
    # The likeliest of these gives the noise for all.
    ends = each(likelihood, starts, until, *FIRST)
    ends = each(likelihood, [end.vector for end in ends], until, *ROUGH)
    ends = distinct(likelihood, ends)[:MOST_BASINS]
    jobs = [partial(alone or by_own_noise, likelihood, end.vector, until=until) for end in ends]
    ends = sorted(likelihood.each(jobs), key=lambda end: end.cost)
    if not ends or not np.isfinite(ends[0].cost):
        raise IdentificationError(
            f"identify: none of {len(starts)} starts leads to a model that can be simulated"
        )
    total, vectors = ends[0].cost, [end.vector for end in ends if np.isfinite(end.cost)]
    likelihood = likelihood.settled_at(vectors[0]) if alone else likelihood.with_noise(vectors[0])
    ends = distinct(likelihood, each(likelihood, vectors, until, *FINE))
    return likelihood, [end for end in ends if end.cost < ends[0].cost + ALIKE], total


def by_own_noise(likelihood: Likelihood, vector: Array, *, until: float | None = None) -> Basin:
    """Descend twice, each time with noise estimated from the residuals; the cost includes the noise's log determinant."""
    for steps, settled in (MIDDLE, FINE):
        try:
            likelihood = likelihood.with_noise(vector)
        except (SimulationError, np.linalg.LinAlgError):
            return Basin(np.inf, vector, False)
        vector = descend(likelihood, vector, steps=steps, settled=settled, until=until).vector
    return Basin(likelihood.total(vector), vector)


def settle(
    likelihood: Known,
    start: Basin,
    *,
    rounds: int,
    still: float,  # ends the search if the minimum moved by less (squared distance in standard deviations)
    least: float = 0.0,  # ends the search if every entry of the minimum moved by less
    settled: float = SETTLED,
    until: float | None = None,
) -> tuple[Known, Basin]:
    """Descend with noise and records' corrections re-estimated at each minimum; return the last likelihood and minimum."""
    best = start
    for _ in range(rounds):
        try:
            following = likelihood.resettled_at(best.vector)
        except (SimulationError, np.linalg.LinAlgError):
            break
        end = descend(following, best.vector, settled=settled, until=until)
        if not np.isfinite(end.cost):  # the model diverges with the new corrections
            break
        moved = end.vector - best.vector
        likelihood, best = following, end
        if end.products is None or moved @ end.products.matrix @ moved < still or np.abs(moved).max() < least:
            break
    return likelihood, best


def distinct(likelihood: Likelihood, ends: Sequence[Basin]) -> list[Basin]:
    """Return the minima without duplicates, which are nearly equal to another or can't be distinguished by the deviance."""
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
    """Descend from each start, in parallel; return the minima, the lowest first."""
    jobs = [
        partial(descend, likelihood, start, steps=steps, settled=settled, until=until) for start in starts
    ]
    return sorted(likelihood.each(jobs), key=lambda end: end.cost)
