"""Bounded nonlinear least squares: SciPy's searches, polished to full precision, with an honest certificate."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from shipfp_rs.errors import IdentificationError, InputError, SimulationError
from shipfp_rs.optimise.convergence import doubt, elsewhere, nearby
from shipfp_rs.optimise.gauss_newton import Bounds, Point, gauss_newton_step, polish
from shipfp_rs.support.arrays import Array, Mask

Function = Callable[[Array], tuple[Array, Array]]

NOTICEABLE = 1e-9
"""Another point counts as lower if its cost is less by more than this part."""
ROUNDS = 8
"""How often a search whose end is in doubt is continued from there, as long as that lowers the cost."""
WORTHWHILE = 1e-12
"""Near a minimum a step that changes no entry by more than this part is not taken."""
DEVIATIONS = 1e-7
"""Near a minimum a step smaller than so many standard deviations of the estimates is not taken."""
HIDDEN = 1e-3
"""Remaining step, in standard deviations of the estimates, that does not prevent convergence: in a curved valley the search
cannot take it."""
TOLERANCE = 1e-12
"""Relative change of the sum of squares below which a search ends and its end is taken for a minimum."""
ROUGH = 1e-6
"""Relative change of the sum of squares that ends an approach."""
STOPPED = "stopped at the limit of"
"""Beginning of the message of a search that used up its evaluations or its time."""


@dataclass(frozen=True)
class Solution:
    """Where a search ended, and whether that is a minimum.

    Parameters
    ----------
    vector
        The best vector found, shape (Q,).
    residual, jacobian
        Residual (R,) and its Jacobian (R, Q) there.
    cost
        Sum of squares of the residual.
    converged
        True where the vector is a minimum between the bounds to working precision, see `minimise`.
    message
        Why it is, or why it is not; one line.
    evaluations
        Calls of the function.
    active
        True for an entry that its bound holds, shape (Q,).
    """

    vector: Array
    residual: Array
    jacobian: Array
    cost: float
    converged: bool
    message: str
    evaluations: int
    active: Mask


def minimise(
    function: Function,
    start: npt.ArrayLike,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    *,
    near: int = 0,
    deviations: float | None = None,
    max_evaluations: int = 500,
    time_limit_s: float | None = None,
) -> Solution:
    """Minimise the sum of squares of a residual between bounds, from one start.

    Parameters
    ----------
    function
        Vector (Q,) to residual (R,) and Jacobian (R, Q). Where it raises `SimulationError` or returns what is not
        finite, the search turns back.
    start
        Where to begin, shape (Q,); moved between the bounds if it is outside.
    lower, upper
        Bounds, shape (Q,) or one for all; infinite where there is none.
    near
        Where the start is close to the minimum, the number of samples whose noise the residual sums up: then Gauss-Newton
        steps go first, and end where the noise would hide them.
    deviations
        Standard deviations of the estimates below which such a step is hidden; None: `DEVIATIONS`.
    max_evaluations, time_limit_s
        Limits of calls and of seconds.

    Returns
    -------
    Solution
        Converged only if the Gauss-Newton step from there is small beside the vector and promises no noticeable
        gain, no parameter ran to where it lost its effect, and no direction without slope leads down; where the search
        lost what told parameters apart (two terms became one), it also looks elsewhere first. A Jacobian that never
        had full rank is no obstacle: what the residual does not depend on stays near its start.

    Raises
    ------
    InputError
        For a start or bounds that can't be used.
    IdentificationError
        Where the start can't be evaluated.

    Examples
    --------
    >>> import numpy as np
    >>> valley = lambda x: (np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10], [-1, 0]]))
    >>> found = minimise(valley, [-1.2, 1.0], -np.inf, np.inf)
    >>> found.converged, found.vector.round(12).tolist()
    (True, [1.0, 1.0])
    """
    vector, bounds = _checked(start, lower, upper)
    recorder = _Recorder(function, max_evaluations, time_limit_s)
    return _minimise(recorder, vector, bounds, near=near, deviations=deviations)


@np.errstate(all="ignore")  # as in `_minimise`
def approach(
    function: Function,
    start: npt.ArrayLike,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    *,
    max_evaluations: int = 500,
    time_limit_s: float | None = None,
) -> Solution:
    """Go towards a minimum until the sum of squares falls by less than `ROUGH` of itself; parameters as for `minimise`.

    The solution is never converged; its message is empty unless a limit was reached.
    """
    vector, bounds = _checked(start, lower, upper)
    recorder = _Recorder(function, max_evaluations, time_limit_s)
    point, message = recorder.begin(vector), ""
    try:
        _run_scipy(recorder, point, bounds=bounds, tolerance=ROUGH)
    except _LimitReachedError as limit:
        message = f"{STOPPED} {limit}, before a minimum was reached"
    return _solution(recorder, recorder.best, bounds, converged=False, message=message)


class _LimitReachedError(Exception):
    """The evaluations or the time are used up."""


class _Recorder:
    """Calls the function; turns failures into an infinite cost, keeps the best point, and watches the limits."""

    def __init__(self, function: Function, max_evaluations: int, time_limit_s: float | None) -> None:
        self.function = function
        self.max_evaluations, self.time_limit_s = max_evaluations, time_limit_s
        self.until = np.inf if time_limit_s is None else time.monotonic() + time_limit_s
        self.evaluations = 0
        self.failure = ""

    def begin(self, vector: Array) -> Point:
        """Evaluate the start, which must succeed."""
        point = self._evaluate(vector)
        if not np.isfinite(point.cost):
            raise IdentificationError(f"the start vector can't be evaluated: {self.failure}; choose another")
        self.first = self.best = self.last = point
        return point

    def __call__(self, vector: Array) -> Point:
        if np.array_equal(vector, self.last.vector):
            return self.last
        if self.evaluations >= self.max_evaluations:
            raise _LimitReachedError(f"{self.evaluations} evaluations")
        if time.monotonic() > self.until:
            raise _LimitReachedError(f"{self.time_limit_s:.3g} s")
        self.last = self._evaluate(vector.copy())
        if self.last.cost <= self.best.cost:
            self.best = self.last
        return self.last

    def _evaluate(self, vector: Array) -> Point:
        self.evaluations += 1
        try:
            residual, jacobian = self.function(vector)
            cost = float(residual @ residual)
        except (SimulationError, ArithmeticError, np.linalg.LinAlgError) as error:
            self.failure = str(error)
        else:
            if jacobian.shape != (len(residual), len(vector)):
                raise InputError(
                    f"function: Jacobian of shape {jacobian.shape}, expected {(len(residual), len(vector))}"
                )
            if np.isfinite(cost) and np.isfinite(jacobian).all():
                return Point(vector, residual, jacobian, cost)
            self.failure = "its residual or Jacobian is not finite"
        if self.evaluations == 1:
            return Point(vector, np.zeros(0), np.zeros((0, len(vector))), np.inf)
        # SciPy's searches shorten a step that leads to residuals which are not finite.
        nothing = np.full_like(self.first.residual, np.nan)
        return Point(vector, nothing, self.first.jacobian, np.inf)


def _checked(start: npt.ArrayLike, lower: npt.ArrayLike, upper: npt.ArrayLike) -> tuple[Array, Bounds]:
    vector = np.array(start, dtype=np.float64)
    if vector.ndim != 1 or not vector.size or not np.isfinite(vector).all():
        raise InputError(f"start: found {vector}, expected a vector of finite numbers")
    low, high = (
        np.broadcast_to(np.asarray(bound, dtype=np.float64), vector.shape) for bound in (lower, upper)
    )
    if not (low < high).all():
        index = int(np.argmin(low < high))
        raise InputError(
            f"bounds of entry {index}: {low[index]:g} to {high[index]:g} hold no value between them"
        )
    bounds = Bounds(low, high)
    return bounds.clip(vector), bounds


@np.errstate(
    all="ignore"
)  # a step that is too long may overflow, in the model or in SciPy's norms; it is shortened
def _minimise(
    recorder: _Recorder,
    start: Array,
    bounds: Bounds,
    *,
    near: int = 0,
    deviations: float | None = None,
) -> Solution:
    first = point = recorder.begin(start)
    run = partial(_run_scipy, recorder, bounds=bounds, tolerance=TOLERANCE)
    converged, message = False, ""
    try:
        for turn in range(ROUNDS):
            before = point.cost
            if turn or not near:
                run(point)
            enough = (
                {
                    "worthwhile": WORTHWHILE,
                    "promising": (DEVIATIONS if deviations is None else deviations) ** 2 / near,
                }
                if near
                else {}
            )
            point = polish(recorder, recorder.best, bounds, **enough)
            message = doubt(point, first, bounds, TOLERANCE, HIDDEN**2 / near if near else 0.0)
            lower = None if message else _way_down(recorder, run, point, first, bounds)
            if lower is not None:
                point, message = lower, "a direction without slope leads further down"
            elif not message:
                converged, message = True, "the gradient vanishes and no direction tried leads down"
                break
            if not _is_lower(point, before) and (turn or not near):
                break
    except _LimitReachedError as limit:
        point, message = recorder.best, f"{STOPPED} {limit}, before a minimum was reached"
    return _solution(recorder, point, bounds, converged=converged, message=message)


def _solution(
    recorder: _Recorder, point: Point, bounds: Bounds, *, converged: bool, message: str
) -> Solution:
    return Solution(
        point.vector,
        point.residual,
        point.jacobian,
        point.cost,
        converged,
        message,
        recorder.evaluations,
        gauss_newton_step(point, bounds).held,
    )


def _is_lower(point: Point, cost: float) -> bool:
    return point.cost < cost * (1.0 - NOTICEABLE)


def _way_down(
    recorder: _Recorder, run: Callable[[Point], Point], point: Point, first: Point, bounds: Bounds
) -> Point | None:
    """Return a lower point reached over a direction without slope, if there is one."""
    found = map(recorder, nearby(point, first, bounds))
    lower = next((trial for trial in found if _is_lower(trial, point.cost)), None)
    if lower is not None:
        return lower
    for vector in elsewhere(point, first, bounds):
        trial = recorder(vector)
        if not np.isfinite(trial.cost):
            continue
        end = run(trial)
        # Where two terms merged, the cost may only fall after part of one is moved to the other.
        for other in (end, *map(recorder, nearby(end, first, bounds))):
            if _is_lower(other, point.cost):
                return other
    return None


def _run_scipy(recorder: _Recorder, point: Point, *, bounds: Bounds, tolerance: float) -> Point:
    try:
        ended = least_squares(
            lambda vector: recorder(vector).residual,
            point.vector,
            jac=lambda vector: recorder(vector).jacobian,
            bounds=(bounds.lower, bounds.upper),
            method="trf",
            x_scale="jac",
            ftol=tolerance,
            xtol=tolerance,
            gtol=tolerance,
            # The recorder counts; SciPy must not stop before it.
            max_nfev=recorder.max_evaluations + 1,
        )
    except np.linalg.LinAlgError:
        # A decomposition that does not converge ends this run; its best point is kept and judged as any other.
        return recorder.best
    return recorder(ended.x)
