"""Damped Gauss-Newton steps to a minimum, each point's weights those of its own residuals."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass

import numpy as np

from shipfp_rs.errors import IdentificationError, SimulationError
from shipfp_rs.identification.variable_projection import Elimination
from shipfp_rs.identification.weighted_problem import Noise, WeightedProblem, mean_scatter
from shipfp_rs.optimise.gauss_newton import Bounds, Point, Step, gauss_newton_step
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.threads import require_going

FAR_DAMPING, NEAR_DAMPING = 0.1, 1e-3
"""Damping of the first step far from a minimum and near one, as a part of each column's square."""
LEAST_DAMPING = 1e-5
"""Damping below which a step is a plain Gauss-Newton one."""
MOST_DAMPING = 1e6
"""Damping at which no step is worth another try."""
EASIER, HARDER = 0.1, 5.0
"""Factors of the damping after a step that kept its promise, and one that did not."""
GOOD, POOR = 0.75, 0.25
"""Parts of the promised fall from which on a step kept its promise, and below which it did not."""

CREPT, CREEPING = 1e-2, 20
"""Fall of the deviance in that many passes below which a descent creeps, ..."""
WITHIN_REACH = 0.01
"""... which ends it where a plain step promises no more: the minimum is within a tenth of a standard deviation."""
REFUSED_REACH = 0.1
"""The same where a plain step was tried in these passes, and the deviance did not fall: what it promises is not there."""
CORNER = "M_max"
"""Parameter whose holding or letting go of samples makes corners: where no step, however short, lowers the deviance there
is a minimum, whatever the slopes on one side of it promise."""
CORNER_REACH = 0.25
"""What a plain step may promise at most where no step lowers the deviance, although nothing makes a corner there."""


@dataclass(frozen=True)
class Reached:
    """Where a descent ended: the unknowns that are searched, the weights there, the passes it took."""

    kept: Array
    noise: Noise
    passes: int
    limit: str
    """Which limit stopped it; empty where none did."""
    settled: bool = False
    """Whether no step promises more than was asked for, or none that promises more keeps it."""
    crept: bool = False
    """Whether the descent ended since steps keep little of what they promise, and none promises much."""


@dataclass(frozen=True)
class _Place:
    """A point with the weights of its own residuals, and what is minimised."""

    point: Point
    noise: Noise
    objective: float


def descend(
    problem: WeightedProblem,
    elimination: Elimination,
    kept: Array,
    noise: Noise,
    *,
    near: bool,
    enough: float,
    max_evaluations: int = 500,
    time_limit_s: float | None = None,
) -> Reached:
    """Descend to where a step promises less than `enough` of the deviance.

    A valley whose floor is flat, such as that of a ship whose torque was not measured, has a minimum that steps creep
    towards for hundreds of passes: there the descent ends as soon as the fall of the deviance means nothing any more.
    The deviance is N ln det of the residuals' scatter, whose Gauss-Newton step is that of the sum of squares weighted
    by the scatter's inverse (Bard, Nonlinear Parameter Estimation, 1974, section 5-10): every step has the weights of
    the point where it starts, and none is taken that the deviance does not fall by. From a start that is not `near` a
    minimum the first steps are short. Steps follow the problem's own valley (`Equations.curved`).

    Raises
    ------
    IdentificationError
        Where the start can't be simulated.
    """
    walk = _Walk(problem, elimination)
    until = np.inf if time_limit_s is None else time.monotonic() + time_limit_s
    try:
        place = walk.at(kept, noise)
    except (SimulationError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise IdentificationError(f"the start vector can't be evaluated: {error}; choose another") from None
    damping = NEAR_DAMPING if near else FAR_DAMPING
    fallen, refused = deque([np.inf], maxlen=CREEPING), deque([False], maxlen=CREEPING)
    while True:
        promise = gauss_newton_step(place.point, walk.bounds).promise
        creeps = (
            promise < (REFUSED_REACH if any(refused) else WITHIN_REACH)
            and fallen[0] - place.objective < CREPT
        )
        stuck = damping > MOST_DAMPING
        if promise < enough or creeps or stuck:
            crept = creeps or (stuck and (promise < CORNER_REACH or CORNER in problem.names))
            return Reached(place.point.vector, place.noise, walk.passes, "", promise < enough or crept, crept)
        if walk.passes >= max_evaluations:
            return Reached(place.point.vector, place.noise, walk.passes, f"{walk.passes} evaluations")
        if time.monotonic() > until:
            return Reached(place.point.vector, place.noise, walk.passes, f"{time_limit_s:.3g} s")
        fallen.append(place.objective)
        trial, kept_promise = walk.tried(place, damped_step(place.point, walk.bounds, damping))
        refused.append(damping == 0.0 and trial is None)
        damping = next_damping(damping, kept_promise)
        place = trial or place


def next_damping(damping: float, kept_promise: float) -> float:
    """Return the damping of the step after one that kept such a part of its promise, none or less where it failed."""
    if kept_promise > GOOD:
        return damping * EASIER if damping > LEAST_DAMPING else 0.0
    if kept_promise < POOR:
        # A plain step that went wrong says little of how much damping is needed; a damped one says that a little more is.
        first = LEAST_DAMPING if kept_promise > 0.0 else NEAR_DAMPING
        return max(damping * HARDER, LEAST_DAMPING) if damping > 0.0 else first
    return damping


def damped_step(point: Point, bounds: Bounds, damping: float) -> Step:
    """Return the Gauss-Newton step with so much of each column's square added to the diagonal of J'J."""
    if damping == 0.0:
        return gauss_newton_step(point, bounds)
    norm = np.linalg.norm(point.jacobian, axis=0)
    rows = np.diag(np.sqrt(damping) * np.where(norm > 0.0, norm, 1.0))
    residual = np.concatenate([point.residual, np.zeros(len(norm))])
    return gauss_newton_step(
        Point(point.vector, residual, np.vstack([point.jacobian, rows]), point.cost), bounds
    )


class _Walk:
    """Points of a problem, evaluated with the weights of their own residuals."""

    def __init__(self, problem: WeightedProblem, elimination: Elimination) -> None:
        self._problem, self._elimination = problem, elimination
        lower, upper = problem.bounds()
        self.bounds = Bounds(lower[~problem.linear], upper[~problem.linear])
        self.passes = 0

    def at(self, kept: Array, noise: Noise) -> _Place:
        """Evaluate a vector; raises `SimulationError` where it can't be simulated."""
        require_going()
        self.passes += 1
        problem = self._problem
        problem.require_stable(kept)
        vector, sums = self._elimination.complete(kept, noise)
        own = problem.priors(vector)[:, -1]
        noise, deviance = problem.noise_at(noise, *mean_scatter(sums))
        residual, jacobian = self._elimination(kept, noise)
        point = Point(kept, residual, jacobian, float(residual @ residual))
        return _Place(point, noise, deviance + float(own @ own))

    def tried(self, place: _Place, step: Step) -> tuple[_Place | None, float]:
        """Return the place behind a step, None where the deviance is no lower there, and the part of the promise kept."""
        vector = self.bounds.clip(self._problem.curved(place.point.vector, step.step))
        try:
            trial = self.at(vector, place.noise)
            residual, _ = self._elimination(vector, place.noise)
        except (SimulationError, ArithmeticError, np.linalg.LinAlgError):
            return None, -1.0
        fall = place.point.cost - float(residual @ residual)
        return (trial if trial.objective < place.objective else None), fall / max(step.promise, 1e-300)
