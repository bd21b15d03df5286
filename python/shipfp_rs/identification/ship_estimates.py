"""From the fit of a ship to a fingerprint without a verdict: parameters, intervals, covariance, adequacy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from shipfp_rs.identification.adequacy import explained_pct, misses_pct, stands, strain
from shipfp_rs.identification.basins import descend
from shipfp_rs.identification.coordinates import Figure
from shipfp_rs.identification.engine_tests import engine_curves
from shipfp_rs.identification.estimate import (
    ALONG,
    ASSUMED,
    KNOWN,
    SMALL,
    Estimate,
    Identifiability,
    Status,
    unidentifiable,
    with_interval,
)
from shipfp_rs.identification.fingerprint import Fingerprint, record_row, search_settings
from shipfp_rs.identification.input_checks import doubts
from shipfp_rs.identification.limited_ship import LimitedShip, limit_figures
from shipfp_rs.identification.profiles import NEAR, RISE, Interval, Profiles, figures_of, profiled
from shipfp_rs.identification.question import (
    BOUNDS,
    OF_LOADED,
    Question,
)
from shipfp_rs.identification.ship_fit import refined
from shipfp_rs.identification.ship_found import DISCREPANCY, ShipFit
from shipfp_rs.identification.sides import covariance_of, load_alone, undescribed
from shipfp_rs.identification.stretches import Stretches
from shipfp_rs.identification.verdict import Told, element_rows
from shipfp_rs.structures.elements import ELEMENTS, QUANTITIES
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import COMBINATIONS
from shipfp_rs.support.sentences import Sentence

TOGETHER = ("K_p/K_i", "(p-g)/tau_n", "vK_p/tau_n", "vK_i/tau_n", "(p-g)/(vK_i)", "(p-g)/(vK_i)+T_set-T_f")
"""Combinations of parameters that a fingerprint also gives."""
FULL_SHIP = "the full ship"
"""Name, in a fingerprint's settings, of the structure that is fitted where none is given."""
NUISANCES = {one.name for one in QUANTITIES.values() if one.nuisance}
"""Parameters that are estimated together with the ship's, and reported without an interval."""


def ship_told(fit: ShipFit) -> Told:
    """Return the fingerprint of a ship's fit, and what its verdict needs."""
    question, intervals = fit.question, fit.question.options.intervals
    missed, rows = _missed(fit)
    kind = undescribed(fit, missed, [min(row) for row in rows])
    before, values, c = fit, fit.values, fit.likelihood.coordinates
    gains = ("K_p", "K_i") if "v" in c.free else ()
    names = [name for name in c.names if name not in NUISANCES]
    values = {name: values[name] for name in structure_of(fit).names if name in values}
    figures = figures_of([*names, *gains]) | {
        name: COMBINATIONS[name][1] for name in TOGETHER if _applies(name, values)
    }
    # If the data contradict the engine's model, the fit's intervals are not reported and need no profiles.
    fit, found, possible = intervals_of(fit, figures, "symmetric" if kind else intervals)
    profiles = Profiles(fit.likelihood, list(fit.basins))
    structure = structure_of(fit)
    told = {name: _estimate(fit, name, found[name]) for name in (*names, *gains)}
    if fit.ramp is not None:
        told["set_rate"] = with_interval(fit.ramp.value, fit.ramp.ends, _unit("set_rate"))
    parameters = {one.name: told.get(one.name) or _fixed(fit, one) for one in structure.parameters}
    if "dM" not in question.outputs and question.structure is None:
        parameters = _without_torque(parameters, question)
    parameters |= _of_a_stiff_shaft(parameters, question)
    together = (*(("vK_p", "vK_i") if gains else ()), *TOGETHER)
    derived = {
        name: with_interval(found[name].value, found[name].ends, COMBINATIONS[name][0])
        for name in together
        if name in found
    }
    if kind:
        parameters, derived = load_alone(parameters, fit.side, kind, question.bounds), {}
    if fit is not before:  # a profile reached a lower minimum
        missed, rows = _missed(fit)
    misses = dict(zip(question.outputs, missed, strict=True))
    covariance = (
        covariance_of(parameters, fit.side) if kind and fit.side else _covariance(profiles, fit, parameters)
    )
    fingerprint = Fingerprint(
        parameters=parameters,
        derived=derived,
        identifiability=_identifiability(parameters, covariance),
        fit=_fit(fit, rows, misses),
        structure=structure.to_dict(),
        data=tuple(_record(fit, index, row) for index, row in enumerate(rows)),
        settings=_settings(fit, intervals) | {"possible": [_named(fit, structure, one) for one in possible]},
        verdict=tuple(doubts(question.experiments)),
        covariance=covariance,
        elements=element_rows(fit, parameters),
        adequate=_adequate(fit, misses, kind),
        load_side={} if fit.side is None else fit.side.parameters,
    )
    size = strain(fit.likelihood, fit.best.vector)
    return Told(fingerprint, question.experiments, size, kind)


def _adequate(fit: ShipFit, misses: Mapping[str, float], kind: str | None) -> dict[str, Any]:
    """Return the adequacy of the model; `kind` is the contradiction to its drive and governor, if there is one."""
    limits: dict[str, dict[str, float]] = {}
    if fit.likelihood.limited:
        told: dict[str, float] = {name: fit.values[name] for name in ("M_max", "rate") if name in fit.values}
        limits = {"limit": {**told, **limit_figures(fit.likelihood, fit.best.vector)}}
    return {
        **limits,
        "stands": stands(misses),
        "misses_pct": misses,
        "sides": {"load": fit.side is not None or not kind, "engine": not kind},
        "engine": {name: score._asdict() for name, score in fit.scores.items()},
        "engine_curves": engine_curves(fit) if fit.scores else {},
    }


def _missed(fit: ShipFit) -> tuple[list[float], list[list[float]]]:
    """Return the misfit of each output [%], and the explained share of each record's outputs [%]."""
    at = fit.likelihood, fit.best.vector
    return misses_pct(*at), explained_pct(*at)


def intervals_of(
    fit: ShipFit, figures: Mapping[str, Figure], intervals: Literal["profile", "symmetric"]
) -> tuple[ShipFit, dict[str, Interval], list[dict[str, float]]]:
    """Return the fit, the interval of each figure, and ships within the intervals; a profile may lower the fit's minimum."""
    if intervals == "symmetric":
        profiles = Profiles(fit.likelihood, list(fit.basins))
        return fit, {name: profiles.symmetric(figure) for name, figure in figures.items()}, []
    model = fit.likelihood.models[0]
    if isinstance(model, LimitedShip) and model.simulates:
        # Derivatives of simulations hold only close to the minimum, too close for a profile.
        profiles = Profiles(fit.likelihood, [descend(fit.likelihood, one.vector) for one in fit.basins])
        found = {name: profiles.symmetric(one, surely=True) for name, one in figures.items()}
    else:
        fit, profiles, found = profiled(fit, figures, refined, fit.question.bounds)
    c = fit.likelihood.coordinates
    most = profiles.best.cost + RISE * (1.0 + NEAR)
    inside = [point.vector for point in profiles.visited if point.cost < most]
    stretches = Stretches(fit.likelihood, fit.best.vector)
    beyond = 1.0 if fit.is_smooth else DISCREPANCY
    for name, figure in figures.items():
        one = profiles.widened(figure, found[name])
        slope = fit.likelihood.coordinates.gradient(figure, fit.best.vector)
        wider, moved = beyond * stretches.widening(slope), figure(fit.values) - one.value
        # The interval also covers the intervals about the other possible minima.
        apart = [moved, *(figure(c.values(vector)) - one.value for vector in fit.alike)]
        low = one.value - wider * (one.value - one.low) + min(*apart, 0.0)
        high = one.value + wider * (one.high - one.value) + max(*apart, 0.0)
        least, most = fit.question.bounds.get(name, (-np.inf, np.inf))
        found[name] = Interval(one.value + moved, max(low, least), min(high, most), one.kinds)
    return fit, found, [c.values(vector) for vector in inside]


def structure_of(fit: ShipFit) -> Structure:
    """Return the structure whose parameters were searched or given."""
    if fit.question.structure is not None:
        return fit.question.structure
    question, names = fit.question, set(fit.likelihood.coordinates.names) | set(fit.question.fixed)
    acting = [
        name
        for name, element in ELEMENTS.items()
        if any(parameter.name in names for parameter in element.parameters)
    ]
    structure = Structure.ship(
        acting,
        torque="gauge" if question.gauge else "brake",
        outputs=question.outputs,
        products="v" not in names,
        propeller_speed=question.propeller,
        mean_sampling=True,
        name="ship",
    )
    given = {
        name: value for name, value in fit.likelihood.coordinates.given.items() if name in structure.names
    }
    given |= {name: value for name, value in fit.values.items() if name in NUISANCES & set(structure.names)}
    return structure.with_fixed(**given) if given else structure


def _named(fit: ShipFit, structure: Structure, values: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of the structure; searched ones within their bounds, nuisance parameters as fitted."""
    found, along = {}, NUISANCES & set(fit.likelihood.coordinates.names)
    for one in structure.parameters:
        if one.fixed and one.name not in along:
            found[one.name] = float(one.start)
        elif one.name in values:
            bounds = fit.question.bounds.get(one.name, BOUNDS.get(one.name, (-np.inf, np.inf)))
            found[one.name] = float(np.clip(values[one.name], *bounds))
    return found


def _applies(name: str, values: Mapping[str, float]) -> bool:
    if "(vK_i)" in name and values.get("droop"):  # with a droop, this is not the lag behind a ramp
        return False
    try:
        return bool(np.isfinite(COMBINATIONS[name][1](values)))
    except (KeyError, ZeroDivisionError):
        return False


def _unit(name: str) -> str:
    return QUANTITIES[name].unit


def _estimate(fit: ShipFit, name: str, interval: Interval) -> Estimate:
    low, high = bounds = fit.question.bounds.get(name, BOUNDS[name])
    unit, least, most = _unit(name), max(interval.low, low), min(interval.high, high)
    c, best = fit.likelihood.coordinates, fit.best.products
    flat = name in c.free and best is not None and best.matrix[c.place(name), c.place(name)] == 0.0
    if name in ("M_max", "rate") and (flat or most >= high):
        # For a limit far above everything in the record, no profile finds the level at which it would act.
        reason = (
            Sentence("no limit was reached in the data")
            if flat or least <= low
            else Sentence(
                "no limit was reached in the data: any value above {low} fits as well", low=f"{least:.4g}"
            )
        )
        return unidentifiable(reason, unit)
    if flat:
        return unidentifiable(Sentence("the data do not depend on it"), unit)
    loaded = fit.question.loaded and name in OF_LOADED
    prior = name in fit.likelihood.priors and (loaded or not QUANTITIES[name].loose)
    status: Status = "prior" if prior or name in fit.question.priors else "free"
    return with_interval(interval.value, interval.ends, unit, status, bounds=bounds)


def _fixed(fit: ShipFit, parameter: Parameter) -> Estimate:
    """Return the estimate, without interval, of a parameter that was given, assumed, or searched as a nuisance."""
    reason = ALONG if parameter.name in fit.likelihood.coordinates.free else "given"
    # Without a measured torque the load's gain is unknown, and `question_of` fixes it at 1.
    reason = ASSUMED if parameter.name in fit.question.assumed else reason
    return Estimate(parameter.start, unit=parameter.unit, status="fixed", reason=reason)


def _of_a_stiff_shaft(parameters: Mapping[str, Estimate], question: Question) -> dict[str, Estimate]:
    """Return tau_prop without an interval if a stiff shaft fits as well as a flexible one, else nothing."""
    part, twist = parameters.get("tau_prop"), parameters.get("tau_twist")
    if (
        question.gauge
        or question.structure is not None
        or part is None
        or twist is None
        or part.value is None
    ):
        return {}
    if twist.status == "fixed" or (twist.ci95 is not None and twist.ci95[0] > 0.0):
        return {}
    return {"tau_prop": Estimate(part.value, unit=part.unit, status="fixed", reason=ALONG)}


def _without_torque(parameters: Mapping[str, Estimate], question: Question) -> dict[str, Estimate]:
    """Return the estimates for data without torque, where the speed determines only ratios to the inertia."""
    found = dict(parameters)
    if question.loaded or "tau_n" in (question.priors or {}):
        return found
    reason = Sentence("the speed determines only ratios to tau_n; measure a torque or give the inertia")
    for name in ("tau_n", "g", "vK_p", "vK_i", "p"):
        if name in found:
            found[name] = unidentifiable(reason, found[name].unit)
    return found


def _identifiability(parameters: Mapping[str, Estimate], covariance: Mapping[str, Any]) -> Identifiability:
    """Return the number of known parameters; the condition is finite if all are known."""
    free = {name: one for name, one in parameters.items() if one.status != "fixed"}
    known = [name for name, one in free.items() if one.status in KNOWN]
    names, condition = covariance["names"], float("inf")
    if len(known) == len(free) and set(known) == set(names):
        size = np.array(
            [max(abs(free[name].value or 0.0), SMALL.get(free[name].unit, 0.0)) for name in names]
        )
        variances = np.linalg.eigvalsh(np.array(covariance["matrix"]) / np.outer(size, size))
        condition = float(np.sqrt(variances[-1] / variances[0])) if variances[0] > 0.0 else condition
    return Identifiability(rank=len(known), free=len(free), condition=condition)


def _covariance(profiles: Profiles, fit: ShipFit, parameters: Mapping[str, Estimate]) -> dict[str, Any]:
    """Return the covariances: standard deviations from the intervals, correlations from the deviance's curvature."""
    names = [
        name
        for name in (*fit.likelihood.coordinates.names, "K_p", "K_i")
        if name in parameters and parameters[name].status in KNOWN and parameters[name].std
    ]
    figures = figures_of(names)
    covariance = profiles.covariance(fit.best)
    slopes = np.array([profiles.gradient(figures[name], fit.best.vector) for name in names])
    if not names:
        return {"names": [], "matrix": []}
    matrix = slopes @ covariance @ slopes.T
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    deviations = np.array([parameters[name].std for name in names], dtype=float)
    matrix = matrix / np.outer(scale, scale)
    np.fill_diagonal(matrix, 1.0)
    return {"names": names, "matrix": (matrix * np.outer(deviations, deviations)).tolist()}


def _fit(
    fit: ShipFit, rows: Sequence[Sequence[float]], misses: Mapping[str, float]
) -> dict[str, dict[str, float | None]]:
    weights = [record.measured.shape[1] for record in fit.likelihood.records]
    table: dict[str, dict[str, float | None]] = {
        output: {
            "nrmse_pct": float(np.average([row[index] for row in rows], weights=weights)),
            "missed_pct": min(misses[output], 100.0),
        }
        for index, output in enumerate(fit.question.outputs)
    }
    table["overall"] = {"deviance": fit.total}
    return table


def _record(fit: ShipFit, index: int, row: Sequence[float]) -> dict[str, Any]:
    experiment, question = fit.question.experiments[index], fit.question
    signals = {output: question.signal_in(experiment, output) for output in question.outputs}
    used = int((~fit.likelihood.records[index].masked.any(axis=1)).sum())
    return record_row(experiment, signals, row, used)


def _settings(fit: ShipFit, intervals: str) -> dict[str, Any]:
    c, priors = fit.likelihood.coordinates, fit.question.priors if fit.question.structure is None else {}
    return {
        **({"priors": {name: list(prior) for name, prior in priors.items()}} if priors else {}),
        "structure": FULL_SHIP if fit.question.structure is None else fit.question.structure.name,
        "intervals": intervals,
        "set_point": fit.likelihood.records[0].between,
        "band_hz": max(record.band_hz for record in fit.likelihood.records),
        **search_settings(fit, _named(fit, structure_of(fit), {**c.given, **fit.values})),
    }
