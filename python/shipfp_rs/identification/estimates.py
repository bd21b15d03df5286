"""From the end of a search to estimates: which parameters the data tell, how well, and why not the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from shipfp_rs.identification.covariances import covariance_of, row_variance, without_nuisance
from shipfp_rs.identification.estimate import Estimate, Identifiability
from shipfp_rs.identification.identifiability import (
    NULL_PART,
    Sensitivity,
    describe,
    gradient_of,
)
from shipfp_rs.identification.intervals import along_valley, deviation_of, profile_ends, within_bounds
from shipfp_rs.identification.profile import End, Profile
from shipfp_rs.identification.residual_tests import responds
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.weighted_problem import Minimum
from shipfp_rs.identification.whitening import Evaluation
from shipfp_rs.structures.combinations import COMBINATIONS
from shipfp_rs.structures.structure import Parameter, Structure
from shipfp_rs.support.threads import where_alone

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

AT_BOUND = 1e-5
"""A parameter is on a bound if it is nearer than this part of its size, or of the width between its bounds, if less."""
CUT = 10.0
"""Along a null direction parameters can move only until one of them meets a bound. A parameter that moves by less than so
many standard deviations has an interval all the same."""
SHORT = 1e-3
"""The same limit, as a part of the width between the parameter's own bounds."""
EDGE = 1e-6
"""The same limit, as a part of the parameter's size, where the standard deviation is zero."""
SHARPER = 1.0 / 3.0
"""A combination is listed where its relative deviation is below this part of that of its least known member."""
NOTHING: Mapping[str, Any] = {"names": [], "matrix": []}
"""The covariance where none is known."""


@dataclass(frozen=True)
class Estimates:
    """What a search's end tells: estimates by name, combinations, identifiability, and what it was computed from."""

    parameters: Mapping[str, Estimate]
    derived: Mapping[str, Estimate]
    covariance: Mapping[str, Any]
    identifiability: Identifiability
    values: Mapping[str, float]
    rank: int
    """Rank of the sensitivities to the parameters that no bound holds."""
    samples: int
    freedom: int
    threshold: Mapping[str, float]
    """Rise of the cost at the ends of each searched parameter's 95 % interval."""
    evaluations: Sequence[Evaluation]


@dataclass(frozen=True)
class _Optimum:
    """The best minimum, with the values on the bounds that they all but touch."""

    search: Search
    best: Minimum
    values: Mapping[str, float]
    scale: Array
    own: Array
    """Sensitivities of the whitened residuals (R, P), without the part that the blocks' own unknowns could explain."""
    everything: Sensitivity
    inward: npt.NDArray[np.int_]
    """For each parameter +1 on its lower bound, -1 on its upper one, 0 between them."""
    on_bound: Mask
    """Which parameters a bound really holds."""
    profile: Profile

    @classmethod
    def of(cls, search: Search, best: Minimum, own: Array) -> _Optimum:
        """Return it from the sensitivities (R, P)."""
        values = search.values(best.vector)
        for index, name in enumerate(search.names):
            bound = _bound(search, best, index)
            if bound is not None:
                values[name] = bound
        values = search.structure.complete(values)
        # A value near zero does not show the size of its parameter.
        scale = np.array([max(abs(values[p.name]), p.scale) for p in search.free])
        everything = Sensitivity.of(own, search.names, scale)
        inward = np.array([_inward(parameter, values) for parameter in search.free])
        on_bound = everything.held_by_bounds(inward)
        return cls(search, best, values, scale, own, everything, inward, on_bound, Profile(search, best))

    def reach(self) -> Array:
        """How far the null directions lead each parameter between the bounds, shape (P,)."""
        centre = np.array([self.values[name] for name in self.search.names])
        low, high = np.array([(parameter.lower, parameter.upper) for parameter in self.search.free]).T
        return self.everything.reach(centre, low, high)

    def inside(self, held: Mask, rows: int) -> tuple[Sensitivity, int]:
        """Return the sensitivity of the parameters that are not held, and the degrees of freedom that they leave."""
        names = [name for name, bounded in zip(self.search.names, held, strict=True) if not bounded]
        inner = Sensitivity.of(self.own[:, ~held], names, self.scale[~held])
        return inner, rows - inner.rank - (self.search.size - len(self.search.free))


@dataclass(frozen=True)
class _Spread:
    """How far the estimates scatter about the optimum."""

    held: Mask
    """Which parameters the data press against a bound."""
    inner: Sensitivity
    """Sensitivity to the parameters that are not held."""
    unscaled: Array
    """Their covariance (P, P) for residuals of unit variance."""
    covariance: Array
    """Their covariance (P, P); infinite where too few samples leave it unknown."""
    quantile: float
    freedom: int
    variance: float
    """Mean variance of the whitened residuals."""

    @classmethod
    def of(cls, optimum: _Optimum, evaluations: Sequence[Evaluation], residual: Array, rows: int) -> _Spread:
        """Return it from the whitened residuals (R,), of which `rows` count."""
        search, on_bound = optimum.search, optimum.on_bound
        gain = optimum.profile.gain_without(on_bound)
        _, freedom = optimum.inside(on_bound, rows)
        variance = row_variance(search, evaluations, residual, freedom)
        quantile = float(student.ppf(0.975, freedom)) if freedom > 0 else np.inf
        # A bound adds nothing where the data would move the parameter away from it by less than the interval's width.
        held = on_bound & (gain > quantile**2)
        inner, freedom = optimum.inside(held, rows)
        unscaled = inner.covariance()
        covariance = covariance_of(inner, optimum.own[:, ~held], variance)
        return cls(held, inner, unscaled, covariance, quantile, freedom, float(np.mean(variance)))

    def thresholds(self, names: Sequence[str]) -> dict[str, float]:
        """Rise of the cost at the ends of each parameter's 95 % interval."""
        # For a parameter that is not known by itself the rise follows from the residuals' variance alone.
        threshold = dict.fromkeys(names, self.quantile**2 * self.variance)
        for place, name in enumerate(self.inner.names):
            own, unscaled = float(self.covariance[place, place]), float(self.unscaled[place, place])
            if np.isfinite(own) and unscaled > 0.0:
                threshold[name] = self.quantile**2 * own / unscaled
        return threshold


def estimates(search: Search, best: Minimum) -> Estimates:
    """Turn the best minimum into estimates with 95 % intervals.

    A parameter on a bound that the data would leave by less than the quantile gets the interval that its bound cuts,
    and the other intervals count with it going inside; one that the data press harder against its bound stays there,
    without an interval, and those of the others hold only with it there.
    """
    evaluations, residual, jacobian = search.whitened(best)
    if not responds(search, best):
        jacobian[: sum(evaluation.residual.size for evaluation in evaluations)] = 0.0
    samples = sum(int(evaluation.valid.sum()) for evaluation in evaluations)
    structure = search.structure
    optimum = _Optimum.of(search, best, without_nuisance(jacobian, len(search.free)))
    spread = _Spread.of(optimum, evaluations, residual, samples * len(structure.outputs))
    reach = optimum.reach()
    jobs = [
        partial(_estimate, optimum, spread, index, float(reach[index])) for index in range(len(search.names))
    ]
    parameters = dict(zip(search.names, where_alone(jobs), strict=True))
    for parameter in structure.parameters:
        if parameter.fixed:
            fixed = Estimate(parameter.start, unit=parameter.unit, status="fixed", reason="given")
            parameters[parameter.name] = fixed
    parameters = with_tied(parameters, structure)
    covariance: Mapping[str, Any] = NOTHING
    derived: dict[str, Estimate] = {}
    if np.isfinite(spread.covariance).all():
        covariance = {"names": list(spread.inner.names), "matrix": spread.covariance.tolist()}
        derived = _derived(parameters, optimum, spread)
    return Estimates(
        parameters,
        derived,
        covariance,
        describe(optimum.everything),
        optimum.values,
        spread.inner.rank,
        samples,
        spread.freedom,
        spread.thresholds(search.names),
        evaluations,
    )


def _estimate(optimum: _Optimum, spread: _Spread, index: int, reach: float) -> Estimate:
    """Return the estimate of the free parameter `index`; null directions lead it as far as `reach` between the bounds."""
    parameter = optimum.search.free[index]  # within the bounds of what is tied to it
    value, unit = optimum.values[parameter.name], parameter.unit
    side = "lower" if value == parameter.lower else "upper"
    if spread.held[index]:
        where = f"pressed against its {side} bound {value:g}"
        return Estimate(value, unit=unit, status="at_bound", reason=where)
    reason = _unknown(optimum, spread, index, reach)
    if reason:
        return Estimate(None, unit=unit, status="unidentifiable", reason=reason)
    low, high = _interval(optimum, spread, index)
    std = deviation_of(value, low, high, spread.quantile)
    if std is None:
        reason = f"the data allow everything between its bounds {parameter.lower:g} and {parameter.upper:g}"
    elif std > (parameter.upper - parameter.lower) / np.sqrt(12.0) and not optimum.on_bound[index]:
        reason = f"its standard deviation {std:.3g} says less than its bounds {parameter.lower:g} to {parameter.upper:g}"
    if reason:
        return Estimate(None, unit=unit, status="unidentifiable", reason=reason)
    interval = low.value, high.value
    if optimum.inward[index]:
        allowed = f"up to {high.value:.4g}" if side == "lower" else f"down to {low.value:.4g}"
        where = f"on its {side} bound {value:g}; the data allow {allowed}"
        return Estimate(value, None, interval, unit, "at_bound", where)
    return Estimate(value, std, interval, unit, "free" if parameter.prior is None else "prior")


def _unknown(optimum: _Optimum, spread: _Spread, index: int, reach: float) -> str:
    """Say why a parameter has no interval of its own, empty where it has one."""
    parameter = optimum.search.free[index]
    place = spread.inner.names.index(parameter.name)
    variance = float(spread.covariance[place, place])
    # Where bounds cut a null direction, a parameter on a bound still has an interval.
    open_over = CUT * float(np.sqrt(variance)) + EDGE * optimum.scale[index]
    cut = reach < min(open_over, SHORT * (parameter.upper - parameter.lower))
    reason = "" if optimum.on_bound[index] or cut else why_unknown(optimum.everything, index)
    if not reason and not np.isfinite(variance):
        reason = "too few samples for an uncertainty"
    return reason


def _interval(optimum: _Optimum, spread: _Spread, index: int) -> tuple[End, End]:
    search, inner, quantile = optimum.search, spread.inner, spread.quantile
    parameter = search.free[index]
    place = inner.names.index(parameter.name)
    about = along_valley(search, optimum.best, inner.names, spread.covariance[place], place, quantile)
    if search.intervals != "profile":
        return within_bounds(parameter, *about)
    variances = float(spread.covariance[place, place]), float(spread.unscaled[place, place])
    value, scale = optimum.values[parameter.name], float(optimum.scale[index])
    return profile_ends(optimum.profile.alone(), value, index, quantile, *variances, scale, about)


def with_tied(parameters: Mapping[str, Estimate], structure: Structure) -> dict[str, Estimate]:
    """Add what is tied to the parameters that are not, in the structure's order."""
    found = dict(parameters)
    for name, tie in structure.ties.items():
        other = parameters[tie.to]
        low, high = sorted(map(tie, other.ci95 or (0.0, 0.0)))
        found[name] = Estimate(
            None if other.value is None else tie(other.value),
            None if other.std is None else abs(tie.factor) * other.std,
            None if other.ci95 is None else (low, high),
            structure[name].unit,
            other.status,
            f"tied as {tie}",
        )
    return {name: found[name] for name in structure.names}


def _bound(search: Search, best: Minimum, index: int) -> float | None:
    parameter, value = search.free[index], float(best.vector[index])
    for bound in (parameter.lower, parameter.upper):
        room = AT_BOUND * min(abs(bound) or np.inf, parameter.upper - parameter.lower)
        if np.isfinite(bound) and abs(value - bound) <= room:
            return bound
    return None


def _inward(parameter: Parameter, values: Mapping[str, float]) -> int:
    """+1 on the lower bound, -1 on the upper one, 0 between them."""
    value = values[parameter.name]
    return int(value == parameter.lower) - int(value == parameter.upper)


def why_unknown(everything: Sensitivity, index: int) -> str:
    """Say why the data do not tell a parameter, empty where they do."""
    null_part = float(np.linalg.norm(everything.null[:, index])) if len(everything.null) else 0.0
    if null_part <= NULL_PART:
        return ""
    partners = sorted(
        {
            other
            for row in everything.null
            if abs(row[index]) > NULL_PART
            for other, part in zip(everything.names, row, strict=True)
            if abs(part) > NULL_PART and other != everything.names[index]
        }
    )
    return "only known together with " + ", ".join(partners) if partners else "the data do not depend on it"


def _relative(estimate: Estimate) -> float:
    if estimate.std is None or not estimate.value:
        return 0.0
    return estimate.std / abs(estimate.value)


def _derived(parameters: Mapping[str, Estimate], optimum: _Optimum, spread: _Spread) -> dict[str, Estimate]:
    """Combinations that the data determine although one of their members is not known by itself.

    Where the model is curved the data tell something of every member; then also combinations that are known far better
    than one of their members.
    """
    values, everything, structure = optimum.values, optimum.everything, optimum.search.structure
    curved = structure.settings["kind"] == "ship"
    derived: dict[str, Estimate] = {}
    for name, (unit, function) in COMBINATIONS.items():
        try:
            value = function(values)
            gradient = gradient_of(function, values, everything.names, structure.ties)
        except (KeyError, ZeroDivisionError):
            continue
        members = [n for n, slope in zip(everything.names, gradient, strict=True) if slope != 0.0]
        each = all(parameters[member].status in ("free", "prior", "fixed") for member in members)
        if (each and not curved) or not everything.tells(gradient):
            continue
        part = np.array([gradient[everything.names.index(n)] for n in spread.inner.names])
        if not np.any(part) or not spread.inner.tells(part):
            continue
        std = float(np.sqrt(max(part @ spread.covariance @ part, 0.0)))
        if not np.isfinite(std) or std > abs(value):
            continue
        widest = max((_relative(parameters[member]) for member in members), default=0.0)
        if each and std / abs(value) > SHARPER * widest:
            continue
        half = spread.quantile * std
        derived[name] = Estimate(value, std, (value - half, value + half), unit)
    return derived
