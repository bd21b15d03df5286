"""Profile likelihood: how far a parameter can be moved, the others refitted, before the cost has risen too much."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.descent import damped_step, next_damping
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.variable_projection import Elimination
from shipfp_rs.identification.weighted_problem import Minimum
from shipfp_rs.optimise.gauss_newton import Bounds, Point, Step
from shipfp_rs.support.threads import require_going

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

CLOSE = 0.02
"""The end is interpolated from a point whose level differs by less than this from the one wanted, in deviations."""
SETTLED = 1e-2
"""A step must promise to lower the cost by at least this part of the threshold."""
STEPS = 12
"""Steps (Levenberg and Marquardt's where plain Gauss-Newton ones fail) of the other parameters at one value of this one."""
FAILURES = 3
"""Steps in a row that lower nothing, after which no more are tried: at a corner that a torque limit makes none does."""
TRIALS = 40
"""Most values tried on the way to one end. With steps that grow fourfold that reaches any size."""
GROWTH = 4.0


JUMP = 10.0
"""A point whose level is off by more deviations is not used: more likely the other parameters are not at their best."""
INSIDE = 0.5
"""If a point less than so many deviations high lies within `CLOSE` of one past the level, the others were not at their
best at the latter."""
DOUBTS = 8
"""How often such a point is dropped and tried again, starting from a nearer one, or the step of a trace is halved."""
EDGE = 0.05
"""The next value keeps this part of a bracket away from its ends; also the least growth of a step."""


@dataclass(frozen=True)
class End:
    """One end of a profile's interval: where it is, and whether the data set it, a bound cuts it, or nothing ends it."""

    value: float
    kind: Literal["data", "bound", "open"]


class Profile:
    """Profiles of a search's cost about its minimum, the weights and noise models held.

    Venzon and Moolgavkar (10.2307/2347496) by search along each parameter: at each value the others are led on by
    damped Gauss-Newton steps between their bounds, from where the last value left them.
    """

    def __init__(self, search: Search, best: Minimum) -> None:
        # Only differences of the cost count, so an error far below the noise does no harm.
        self._search, self._noise = search, replace(best.noise, sharp=best.noise.whitening is None)
        self._problem = Elimination(search, best.vector, best)
        kept = ~search.linear
        lower, upper = search.bounds()
        self._bounds = Bounds(lower[kept], upper[kept])
        # The next value will need about the same damping as the last one.
        self._damping = 0.0
        self._best = best
        self._origin = self._point(self._bounds.clip(best.vector[kept]))

    def alone(self) -> Profile:
        """Return the same with nothing remembered of values that were tried; several may be at work side by side."""
        other = copy(self)
        other._problem, other._damping = Elimination(self._search, self._best.vector, self._best), 0.0
        return other

    def end(self, index: int, step: float, threshold: float) -> End:
        """Return the end on the step's side: where the best cost has risen by the threshold.

        Parameters
        ----------
        index
            Of the parameter among the free ones.
        step
            Where to look first, as a change of its value; its sign tells the side.
        threshold
            Rise of the weighted sum of squares.
        """
        start = float(self._origin.vector[index])
        bound = float((self._bounds.upper if step > 0.0 else self._bounds.lower)[index])
        room = bound - start
        if room == 0.0:
            return End(bound, "bound")
        near, inner, outer = self._origin, (0.0, 0.0), (np.inf, np.inf)
        beyond = near
        self._damping = 0.0
        deviation, doubts = step, DOUBTS
        for _ in range(TRIALS):
            cut = abs(deviation) >= abs(room)
            deviation = room if cut else deviation
            # From whichever is nearer, unless the others lost their way out there.
            nearer = outer[1] < JUMP and abs(outer[0] - deviation) < abs(inner[0] - deviation)
            point = self._best_at(beyond if nearer else near, index, start + deviation, threshold)
            if nearer and point.cost - self._origin.cost > threshold:
                # The others may have been lost out there.
                again = self._best_at(near, index, start + deviation, threshold)
                point = min(point, again, key=lambda one: one.cost)
            level = float(np.sqrt(max(point.cost - self._origin.cost, 0.0) / threshold))
            tried = (deviation, level)
            if abs(level - 1.0) < CLOSE and not (cut and level < 1.0):
                return End(start + _between(inner, tried), "data")
            if level >= 1.0:
                outer, beyond = tried, point
                # Where the cost jumps, or others are lost, no value has exactly the level wanted.
                if abs(deviation - inner[0]) < CLOSE * abs(deviation):
                    return End(start + inner[0], "data")
            elif cut:
                return End(bound, "bound")
            else:
                before, inner, near = inner, tried, point
                touching = abs(outer[0] - deviation) < CLOSE * abs(deviation) and level < INSIDE
                if doubts and (outer[1] > JUMP or touching):
                    doubts, outer = doubts - 1, (np.inf, np.inf)
            deviation = _between(inner, outer) if np.isfinite(outer[0]) else _beyond(before, inner)
        if np.isinf(outer[0]):
            return End(float(np.copysign(np.inf, step)), "open")
        # The bracket has closed in on a jump of the cost: the end is there.
        closed = abs(outer[0] - inner[0]) < CLOSE * abs(outer[0])
        return End(start + inner[0], "data" if closed else "open")

    @property
    def minimum(self) -> Array:
        """The unknowns that the search does not eliminate, at the minimum, shape (P,)."""
        return self._origin.vector

    def trace(self, index: int, values: Array, threshold: float) -> tuple[Array, Array]:
        """Return the rise of the cost (K,) and the other parameters' best values (K, P) along values of this one.

        The values lead away from the minimum. At each the other parameters are fitted, from where they were at the value
        before, until the cost can fall by no more than a small part of the threshold. The rise is infinite where the
        model cannot be simulated at any of their values.
        """
        near, rise, vectors = (
            self._origin,
            np.empty(len(values)),
            np.empty((len(values), len(self._origin.vector))),
        )
        for place, value in enumerate(values):
            point = self._led_to(near, index, float(value), threshold)
            rise[place], vectors[place] = max(point.cost - self._origin.cost, 0.0), point.vector
            near = point if np.isfinite(point.cost) else near
        return rise, vectors

    def gain_without(self, on_bound: Mask) -> Array:
        """Fall of the cost that the linear model promises when one bound, and only it, is lifted, shape (P,)."""
        point, free = self._origin, np.ones(len(self._origin.vector), dtype=bool)
        free[: len(on_bound)] = ~on_bound
        gain = np.zeros(len(on_bound))
        here = _explained(point, free)
        for index in np.flatnonzero(on_bound):
            free[index] = True
            gain[index] = _explained(point, free) - here
            free[index] = False
        return gain

    def _led_to(self, near: Point, index: int, value: float, threshold: float) -> Point:
        """Lead the other parameters to one value of this one, in shorter steps where the cost rises as if they were lost."""
        best, doubts = self._best_at(near, index, value, threshold), DOUBTS
        point, aim, step = best, value, value - float(near.vector[index])
        while doubts:
            lost = not point.cost < near.cost + threshold
            if not lost and aim == value:
                break
            near, doubts = (near, doubts - 1) if lost else (point, doubts)
            step *= 0.5 if lost else 2.0
            here = float(near.vector[index])
            aim = value if abs(step) >= abs(value - here) else here + step
            point = self._best_at(near, index, aim, threshold)
            if aim == value:
                best = min(best, point, key=lambda one: one.cost)
        return best

    def _best_at(self, near: Point, index: int, value: float, threshold: float) -> Point:
        """Lead the other parameters to their best at one value of this one."""
        others = np.arange(len(near.vector)) != index
        bounds = Bounds(self._bounds.lower[others], self._bounds.upper[others])

        def moved(point: Point, by: Array) -> Point:
            step = np.empty(len(point.vector))
            step[index], step[others] = value - point.vector[index], by
            vector = self._bounds.clip(self._search.curved(point.vector, step, index))
            vector[index] = value
            return self._point(vector)

        def step_from(point: Point, residual: Array, damping: float) -> Step:
            rest = Point(point.vector[others], residual, point.jacobian[:, others], point.cost)
            return damped_step(rest, bounds, damping)

        ahead = near.residual + near.jacobian[:, index] * (value - near.vector[index])
        lead = step_from(near, ahead, 0.0)
        point = moved(near, lead.step)
        enough = float(ahead @ ahead) - lead.promise + threshold
        if enough <= point.cost < np.inf:
            again = moved(point, step_from(point, point.residual, 0.0).step)
            point = min(point, again, key=lambda one: one.cost)
        if not point.cost < enough:
            # Along a curved valley the linear step goes too far. Then the other parameters start from where they are.
            point = min(point, moved(near, np.zeros_like(lead.step)), key=lambda one: one.cost)
        damping, failed = self._damping, 0
        for _ in range(STEPS if np.isfinite(point.cost) else 0):
            step = step_from(point, point.residual, damping)
            if step.promise < SETTLED * threshold or failed == FAILURES:
                break
            trial = moved(point, step.step)
            damping = next_damping(damping, (point.cost - trial.cost) / step.promise)
            failed = 0 if trial.cost < point.cost else failed + 1
            point = min(point, trial, key=lambda one: one.cost)
        self._damping = damping
        return point

    def _point(self, vector: Array) -> Point:
        require_going()
        try:
            self._search.require_stable(vector)
            residual, jacobian = self._problem(vector, self._noise)
        except (SimulationError, ArithmeticError, np.linalg.LinAlgError):
            return Point(vector, np.zeros(0), np.zeros((0, len(vector))), np.inf)
        return Point(vector, residual, jacobian, float(residual @ residual))


def _between(inner: tuple[float, float], outer: tuple[float, float]) -> float:
    """Deviation between two (deviation, level) where the line through them meets level 1, away from both."""
    share = (1.0 - inner[1]) / (outer[1] - inner[1]) if outer[1] < JUMP else 0.5
    return inner[0] + (outer[0] - inner[0]) * min(
        max(share, EDGE), 1.0 - EDGE if outer[1] > 1.0 + CLOSE else np.inf
    )


def _beyond(before: tuple[float, float], last: tuple[float, float]) -> float:
    """Deviation beyond the last where the line through both would meet level 1, at most `GROWTH` times as far."""
    rise = last[1] - before[1]
    share = (1.0 - last[1]) / rise if rise > 0.0 else np.inf
    farther = (last[0] - before[0]) * max(share, EDGE)
    return last[0] + float(np.copysign(min(abs(farther), (GROWTH - 1.0) * abs(last[0])), last[0]))


def _explained(point: Point, free: Mask) -> float:
    """Part of the sum of squares that a linear step of the free parameters, wherever they go, takes away."""
    if not free.any():
        return 0.0
    columns = point.jacobian[:, free]
    norm = np.linalg.norm(columns, axis=0)
    norm[norm == 0.0] = 1.0
    step, *_ = np.linalg.lstsq(columns / norm, -point.residual, rcond=1e-7)
    rest = point.residual + (columns / norm) @ step
    return point.cost - float(rest @ rest)
