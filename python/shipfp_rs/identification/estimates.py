"""From the end of a search to estimates: which parameters the data tell, how well, and why not the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from shipfp_rs.identification.blocks import Evaluation
from shipfp_rs.identification.estimate import Estimate, Identifiability, Status
from shipfp_rs.identification.identifiability import (
    NULL_PART,
    Sensitivity,
    describe,
    gradient_of,
)
from shipfp_rs.identification.profile import End, Profile
from shipfp_rs.identification.residual_tests import responds
from shipfp_rs.identification.sandwich import score_covariance
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.weighted_problem import Minimum
from shipfp_rs.structures.combinations import COMBINATIONS
from shipfp_rs.structures.structure import Parameter, Structure
from shipfp_rs.structures.ties import Ties

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

AT_BOUND = 1e-5
"""A parameter this part of its size (or of the width between its bounds, if less) from a bound is on it."""
CUT = 10.0
"""Standard deviations: a parameter that the data leave open only so far, before one meets its bound, has an interval."""
SHORT = 1e-3
"""The same as a part of the width between its own bounds."""
EDGE = 1e-6
"""Part of a parameter's size that is as good as nothing to be left open over."""
EXACT = 1e-7
"""Part of a parameter's size below which an interval is too narrow for its cost to be told from rounding."""
SHARPER = 1.0 / 3.0
"""Part of its widest member's relative deviation below which a combination is worth a line of its own."""
NOTHING: Mapping[str, Any] = {"names": [], "matrix": []}
"""Covariance of no parameter."""


@dataclass(frozen=True)
class Estimates:
    """What a search's end tells: estimates by name, combinations, identifiability, and what it was computed from."""

    parameters: Mapping[str, Estimate]
    derived: Mapping[str, Estimate]
    covariance: Mapping[str, Any]
    identifiability: Identifiability
    values: Mapping[str, float]
    rank: int
    """Of the sensitivities to the parameters that no bound holds."""
    samples: int
    freedom: int
    threshold: Mapping[str, float]
    """Rise of the cost at the ends of each searched parameter's 95 % interval."""
    evaluations: Sequence[Evaluation]


def estimates(search: Search, best: Minimum) -> Estimates:
    """Turn the best minimum into estimates with 95 % intervals.

    A parameter on a bound that the data would leave by less than the quantile gets the interval that its bound cuts,
    and the other intervals count with it going inside; one that the data press harder against its bound stays there,
    without an interval, and those of the others hold only with it there.
    """
    count = len(search.free)
    evaluations, residual, jacobian = search.whitened(best)
    if not responds(search, best):
        jacobian[: sum(evaluation.residual.size for evaluation in evaluations)] = 0.0
    values = search.values(best.vector)
    for index in range(count):
        bound = _bound(search, best, index)
        if bound is not None:
            values[search.names[index]] = bound
    values = search.structure.complete(values)
    # A value that the search drove towards zero is no measure of its own size.
    scale = np.array([max(abs(values[p.name]), p.scale) for p in search.free])
    own = without_nuisance(jacobian, count)
    everything = Sensitivity.of(own, search.names, scale)
    centre = np.array([values[name] for name in search.names])
    low_high = np.array([(parameter.lower, parameter.upper) for parameter in search.free]).T
    reach = everything.reach(centre, *low_high)
    on_bound = everything.held_by_bounds(np.array([_inward(search, values, index) for index in range(count)]))

    samples = sum(int(evaluation.valid.sum()) for evaluation in evaluations)
    rows = samples * len(search.structure.outputs)
    profile = Profile(search, best)
    gain = profile.gain_without(on_bound)

    def inside(held: Mask) -> tuple[Sensitivity, int]:
        names = [name for name, bounded in zip(search.names, held, strict=True) if not bounded]
        inner = Sensitivity.of(own[:, ~held], names, scale[~held])
        return inner, rows - inner.rank - (search.size - count)

    _, freedom = inside(on_bound)
    variance = _row_variance(search, evaluations, residual, freedom)
    quantile = float(student.ppf(0.975, freedom)) if freedom > 0 else np.inf
    # A bound is no knowledge where the data would leave it by less than the interval's own width.
    held = on_bound & (gain > quantile**2)
    inner, freedom = inside(held)
    told = inner.covariance()
    covariance = _covariance(inner, own[:, ~held], variance)
    if search.covariance == "sandwich" and np.isfinite(covariance).all():
        covariance = told @ _scores(search, best)[np.ix_(~held, ~held)] @ told
    # Of a parameter that is not told by itself only the residuals' own variance says what a rise means.
    threshold = dict.fromkeys(search.names, quantile**2 * float(np.mean(variance)))
    for place, name in enumerate(inner.names):
        if np.isfinite(covariance[place, place]) and told[place, place] > 0.0:
            threshold[name] = quantile**2 * float(covariance[place, place] / told[place, place])

    parameters: dict[str, Estimate] = {}
    for parameter in search.structure.parameters:
        name = parameter.name
        if parameter.fixed:
            parameters[name] = Estimate(parameter.start, unit=parameter.unit, status="fixed", reason="given")
            continue
        if parameter.tied is not None:
            continue
        index = search.names.index(name)
        parameter = search.free[index]  # within the bounds of what is tied to it
        if held[index]:
            where = f"pressed against its {_side(parameter, values)} bound {values[name]:g}"
            parameters[name] = Estimate(values[name], unit=parameter.unit, status="at_bound", reason=where)
            continue
        place = inner.names.index(name)
        # Bounds that cut a null direction leave an interval to the parameter that stands on one.
        open_over = CUT * float(np.sqrt(covariance[place, place])) + EDGE * scale[index]
        cut = reach[index] < min(open_over, SHORT * (parameter.upper - parameter.lower))
        reason = "" if on_bound[index] or cut else why_unknown(everything, index)
        if not reason and not np.isfinite(covariance[place, place]):
            reason = "too few samples for an uncertainty"
        if not reason:
            variance_told = float(covariance[place, place]), float(told[place, place])
            about = _along_valley(search, best, inner.names, covariance[place], place, quantile)
            if search.intervals == "profile":
                low, high = _ends(profile, values[name], index, quantile, *variance_told, scale[index], about)
            else:
                low, high = _within(parameter, *about)
            std = _std(values[name], low, high, quantile)
            width = parameter.upper - parameter.lower
            if std is None:
                reason = f"the data allow everything between its bounds {parameter.lower:g} and {parameter.upper:g}"
            elif std > width / np.sqrt(12.0) and not on_bound[index]:
                reason = (
                    f"its standard deviation {std:.3g} says less than its bounds {parameter.lower:g} to "
                    f"{parameter.upper:g}"
                )
        if reason:
            parameters[name] = Estimate(None, unit=parameter.unit, status="unidentifiable", reason=reason)
        elif on_bound[index] or _inward(search, values, index):
            where = f"on its {_side(parameter, values)} bound {values[name]:g}; the data allow"
            where += (
                f" up to {high.value:.4g}" if values[name] == parameter.lower else f" down to {low.value:.4g}"
            )
            interval = low.value, high.value
            parameters[name] = Estimate(values[name], None, interval, parameter.unit, "at_bound", where)
        else:
            status: Status = "free" if parameter.prior is None else "prior"
            parameters[name] = Estimate(values[name], std, (low.value, high.value), parameter.unit, status)
    parameters = with_tied(parameters, search.structure)
    return Estimates(
        parameters,
        _derived(
            parameters,
            values,
            everything,
            inner,
            covariance,
            quantile,
            search.structure.ties,
            curved=search.structure.settings["kind"] == "ship",
        ),
        {"names": list(inner.names), "matrix": covariance.tolist()}
        if np.isfinite(covariance).all()
        else NOTHING,
        describe(everything),
        values,
        inner.rank,
        samples,
        freedom,
        threshold,
        evaluations,
    )


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


def _inward(search: Search, values: Mapping[str, float], index: int) -> int:
    """+1 on the lower bound, -1 on the upper one, 0 between them."""
    parameter = search.free[index]
    return int(values[parameter.name] == parameter.lower) - int(values[parameter.name] == parameter.upper)


def without_nuisance(jacobian: Array, count: int) -> Array:
    """Parts of the parameters' columns that the blocks' own unknowns can't imitate, shape (R, P)."""
    columns, nuisance = jacobian[:, :count], jacobian[:, count:]
    if not nuisance.shape[1]:
        return columns
    size = np.linalg.norm(nuisance, axis=0)
    basis, _ = np.linalg.qr(nuisance[:, size > 0] / size[size > 0])
    return np.asarray(columns - basis @ (basis.T @ columns))


def _row_variance(search: Search, evaluations: Sequence[Evaluation], residual: Array, freedom: int) -> Array:
    """Variance of every row (R,): of each output's weighted residuals, 1 for a known deviation and for a prior.

    0 for a ridge, which is a wish and no measurement; infinite where too few samples leave it unknown.
    """
    outputs = len(search.structure.outputs)
    widths = [evaluation.residual.shape[1] for evaluation in evaluations]
    ends = np.cumsum([0, *(outputs * width for width in widths)])
    variance = np.ones(outputs)
    if search.weighting != "std":
        squares = sum(
            (residual[ends[i] : ends[i + 1]].reshape(outputs, width) ** 2).sum(axis=1)
            for i, width in enumerate(widths)
        )
        variance = squares * outputs / freedom if freedom > 0 else np.full(outputs, np.inf)
    rows = np.ones(len(residual))
    rows[: ends[-1]] = np.concatenate([np.repeat(variance, width) for width in widths])
    rows[len(rows) - len(search.ridge) :] = 0.0
    return rows


def _covariance(inner: Sensitivity, jacobian: Array, variance: Array) -> Array:
    """Covariance (P, P) of the inner parameters: the sandwich H J'SJ H of the Gauss-Newton inverse H."""
    base = inner.covariance()
    if not np.isfinite(variance).all():
        return np.full_like(base, np.inf)
    return np.asarray(base @ (jacobian.T @ (jacobian * variance[:, None])) @ base)


def _scores(search: Search, best: Minimum) -> Array:
    """Covariance (P, P) of J'e from the residuals' own spectral matrix, each experiment's own unknowns taken out."""
    count, outputs = len(search.free), len(search.structure.outputs)
    evaluations = search.filtered(best.vector, best.noise)
    parts = list(search.parts(evaluations, best.noise))
    priors = search.priors(best.vector)[:, :-1]
    stacked = np.concatenate([*(part[:-1].reshape(len(part) - 1, -1).T for part in parts), priors])
    own = without_nuisance(stacked, count).T
    ends = np.cumsum([0, *(part[0].size for part in parts)])
    rows = [own[:, ends[i] : ends[i + 1]].reshape(count, outputs, -1) for i in range(len(parts))]
    records = [(part[-1], evaluation.valid) for part, evaluation in zip(parts, evaluations, strict=True)]
    known = own[:, ends[-1] : own.shape[1] - len(search.ridge)]
    return score_covariance(rows, records) + known @ known.T


def _along_valley(
    search: Search, best: Minimum, names: Sequence[str], row: Array, place: int, quantile: float
) -> tuple[float, float]:
    """Both ends of a parameter's interval by its row (P,) of the covariance, along the structure's valley.

    Without one they are as far from the value as its deviation says.
    """
    kept = best.vector[~search.linear]
    index = search.names.index(names[place])
    if not row[place] > 0.0:
        return float(kept[index]), float(kept[index])
    step = np.zeros(len(kept))
    step[[search.names.index(name) for name in names]] = row * (quantile / np.sqrt(row[place]))
    low, high = sorted(float(search.curved(kept, sign * step)[index]) for sign in (-1.0, 1.0))
    return low, high


def _ends(
    profile: Profile,
    value: float,
    index: int,
    quantile: float,
    variance: float,
    told: float,
    scale: float,
    about: tuple[float, float],
) -> tuple[End, End]:
    """Both ends of a parameter's interval, which are looked for first `about` where they should be.

    The rise of the cost at an end is the quantile's square, made larger by what the variance of the estimate is beyond
    that for residuals of unit variance.
    """
    half = quantile * float(np.sqrt(variance))
    if half < EXACT * scale:
        return End(value - half, "data"), End(value + half, "data")
    threshold = quantile**2 * variance / told
    down, up = (min(about[0] - value, -1e-3 * half), max(about[1] - value, 1e-3 * half))
    return profile.end(index, down, threshold), profile.end(index, up, threshold)


def _within(parameter: Parameter, low: float, high: float) -> tuple[End, End]:
    """Both ends, cut by the bounds."""
    return (
        End(low, "data") if low > parameter.lower else End(parameter.lower, "bound"),
        End(high, "data") if high < parameter.upper else End(parameter.upper, "bound"),
    )


def _std(value: float, low: End, high: End, quantile: float) -> float | None:
    """Half the interval in quantiles; the side that the data set where a bound cuts the other, None if they set none."""
    sides = [abs(end.value - value) for end in (low, high) if end.kind == "data"]
    return float(np.mean(sides)) / quantile if sides else None


def _side(parameter: Parameter, values: Mapping[str, float]) -> str:
    return "lower" if values[parameter.name] == parameter.lower else "upper"


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


def _derived(
    parameters: Mapping[str, Estimate],
    values: Mapping[str, float],
    everything: Sensitivity,
    inner: Sensitivity,
    covariance: Array,
    quantile: float,
    ties: Ties,
    *,
    curved: bool,
) -> dict[str, Estimate]:
    """Combinations that the data tell although a member is not known by itself.

    Of a `curved` model, whose curvature tells each member a little, also those that are told far better than a member.
    """
    derived: dict[str, Estimate] = {}
    if not np.isfinite(covariance).all():
        return derived
    for name, (unit, function) in COMBINATIONS.items():
        try:
            value = function(values)
            gradient = gradient_of(function, values, everything.names, ties)
        except (KeyError, ZeroDivisionError):
            continue
        members = [n for n, slope in zip(everything.names, gradient, strict=True) if slope != 0.0]
        each = all(parameters[member].status in ("free", "prior", "fixed") for member in members)
        if each and not curved:
            continue
        if not everything.tells(gradient):
            continue
        part = np.array([gradient[everything.names.index(n)] for n in inner.names])
        if not np.any(part) or not inner.tells(part):
            continue
        std = float(np.sqrt(part @ covariance @ part))
        if not np.isfinite(std) or std > abs(value):
            continue
        widest = max((_relative(parameters[member]) for member in members), default=0.0)
        if each and std / abs(value) > SHARPER * widest:
            continue
        derived[name] = Estimate(value, std, (value - quantile * std, value + quantile * std), unit)
    return derived
