"""Rebuilds the fit of a fingerprint: the likelihood and the likelihood's minima, from the fingerprint and experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.basins import Basin, Minima, descend, distinct
from shipfp_rs.identification.coordinates import WITHOUT_EFFECT, Itself
from shipfp_rs.identification.estimate import ALONG
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.limited_ship import ways_of
from shipfp_rs.identification.question import Options, question_of, question_of_ship
from shipfp_rs.identification.ship_estimates import FULL_SHIP
from shipfp_rs.identification.ship_found import DEFAULTS, DISCREPANCY
from shipfp_rs.identification.stretches import Stretches
from shipfp_rs.identification.structure_fit import StructureQuestion, likelihood_of
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.structure import Structure

ALIKE = 20.0
"""Largest difference from the fingerprint's deviance at which the given data count as those of its fit."""
ROUNDS = 8
"""Number of estimates of the noise and the records' unknowns at the fingerprint's parameters."""


@dataclass(frozen=True)
class Rebuilt(Minima):
    """Minima of a rebuilt fit, and the largest factor by which model errors widen its intervals."""

    widening: float = 1.0


def rebuilt(fingerprint: Fingerprint, structure: Structure | None = None) -> Rebuilt:
    """Return the likelihood of a fingerprint at its minima; `InputError` without the experiments of its fit."""
    experiments, settings = fingerprint.experiments, fingerprint.settings
    rows = [row["name"] for row in fingerprint.data]
    if [one.name for one in experiments] != rows or "criterion" not in settings:
        found = ", ".join(one.name for one in experiments) or "none"
        raise InputError(
            f"experiments: found {found}, expected {', '.join(rows) or 'some'}, the experiments that were fitted; keep "
            "experiments.parquet of its run beside fingerprint.json"
        )
    start, criterion = _start(fingerprint), settings["criterion"]
    ways = _likelihoods(fingerprint, experiments, structure or Structure.from_dict(fingerprint.structure))
    minima = [one for one in map(partial(_settled, start), ways) if one]
    best = min(minima, key=lambda one: abs(one.total - criterion), default=None)
    # The effect of a limit depends on the speed that the governor saw. Each way of computing the effect estimates this speed
    # from other residuals, so the rebuilt deviance differs more.
    alike = ALIKE * DISCREPANCY**2 if best is not None and best.likelihood.limited else ALIKE
    if best is None or not abs(best.total - criterion) < alike + 1e-6 * abs(criterion):
        raise InputError(
            f"experiments: found a deviance of {best.total if best else np.inf:.6g}, expected the fingerprint's, "
            f"{criterion:.6g}; give the experiments that it was fitted to"
        )
    return _widened(best, fingerprint)


def _likelihoods(
    fingerprint: Fingerprint, experiments: Sequence[Experiment], structure: Structure
) -> list[Likelihood]:
    """Return the likelihood for each way of computing a limit's effect."""
    settings = fingerprint.settings
    if "noise" in settings:
        options = Options(noise=settings["noise"])
        return [likelihood_of(StructureQuestion(tuple(experiments), structure, options))[1]]
    question = question_of_ship(experiments, structure)
    if settings["structure"] == FULL_SHIP:
        along = {name for name, one in fingerprint.parameters.items() if one.reason == ALONG}
        full = question_of(
            experiments,
            torque="gauge" if question.gauge else "brake",
            outputs=structure.outputs,
            elements={name: name in fingerprint.structure["elements"] for name in ELEMENTS},
            fixed={
                one.name: one.start for one in structure.parameters if one.fixed and one.name not in along
            },
            priors={name: (mean, std) for name, (mean, std) in settings.get("priors", {}).items()},
        )
        question = replace(full, propeller=question.propeller and full.propeller)
    found = question.likelihood(settings.get("set_point"))
    return ways_of(found) if found.limited else [found]


def _start(fingerprint: Fingerprint, values: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return start values of all parameters that a search may have: from `values`, the optimum, or the defaults."""
    known = {**fingerprint.optimum, **(values or {})}
    # With a measured rack, the search has vK_p and vK_i, the fingerprint K_p, K_i and v.
    gains = {f"v{name}": known["v"] * known[name] for name in ("K_p", "K_i") if {"v", name} <= known.keys()}
    return {**DEFAULTS, **WITHOUT_EFFECT, **gains, **known}


def _settled(start: dict[str, float], likelihood: Likelihood) -> Minima | None:
    """Return the minimum at the fingerprint's parameters under the noise of its own residuals; None if there is none."""
    c, vector = likelihood.coordinates, likelihood.coordinates.vector(start)
    states = slice(len(c.names), c.size)
    try:
        for _ in range(ROUNDS):
            likelihood = likelihood.settled_at(vector)
            now = likelihood.products(vector)
            vector[states] += np.linalg.solve(now.matrix[states, states], now.downhill[states])
        # A descent along a flat valley may end where the re-estimated noise differs.
        here = likelihood.products(vector)
        ends = descend(likelihood, vector), Basin(here.cost, vector, products=here)
        end = min(ends, key=lambda one: likelihood.total(one.vector))
    except (SimulationError, np.linalg.LinAlgError):
        return None
    return Minima(likelihood, (end,)) if np.isfinite(end.cost) else None


def _widened(minima: Minima, fingerprint: Fingerprint) -> Rebuilt:
    """Add the other minima of the search, and the factor by which errors of the model widen the intervals."""
    likelihood, best, settings = minima.likelihood, minima.best, fingerprint.settings
    c, states = likelihood.coordinates, likelihood.coordinates.states_at(best.vector)
    starts = [c.vector(_start(fingerprint, one["parameters"]), states) for one in settings["minima"][1:]]
    ends = [descend(likelihood, start) for start in starts]
    others = [one for one in distinct(likelihood, [best, *ends]) if one is not best]
    widening = 1.0
    if "noise" not in settings and settings["intervals"] == "profile":
        stretches = Stretches(likelihood, best.vector)
        inside = (best.vector > c.bounds[0] + 1e-9) & (best.vector < c.bounds[1] - 1e-9)
        told = [name for name in c.names if inside[c.place(name)] and name in fingerprint.parameters]
        scatter = [stretches.widening(c.gradient(Itself(name), best.vector)) for name in told]
        widening = max(scatter, default=1.0) * (DISCREPANCY if likelihood.limited else 1.0)
    return Rebuilt(likelihood, (best, *others), widening)
