"""Elements that are tried beside the full smooth model: limits of torque and rate, and a shaft that twists.

An element is fitted along where the deviance falls by more than chance gives, so that intervals allow for it; it is called
on where the deviance falls by much more (`ship_found.BELIEVED`). Moving water decides, too, when a limit holds, so the ship
is driven by the water where that is likelier, and ends are compared under the noise of their own residuals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shipfp_rs.identification.basins import LIKELY, Basin, descend, distinct, each, settle
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.limits import falls_by_limits
from shipfp_rs.identification.question import TRIED
from shipfp_rs.identification.ship_found import (
    BELIEVED,
    DEFAULTS,
    LIMITED,
    PART,
    ShipFit,
    likelihood_of,
    settled,
    step_for,
)
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.support.progress import tell

CHANCE = 6.0
"""Fall of the deviance by two parameters that chance exceeds once in twenty: less says nothing of an element."""
LEAST_FALL = {"torque_limit": CHANCE, "rack_rate": 2.0 * BELIEVED}
"""Fall of the total from which a limit is fitted along; one of rate, whose intervals are rough, must be sure."""
TWISTS_S, DAMPINGS = (1e-3, 4e-3), (0.3, 2.0)
"""A shaft's stiffness and damping to begin with."""
KEPT = 5
"""Starts that go down, those of the least deviance."""
LEVELS, SLOPES, GAINS = (0.9, 0.97, 0.995), (0.9, 0.99), (1.0, 2.0, 4.0)
"""Quantiles of torque and of its slope at which limits are tried, and factors of the gains: without a rate limit they are
taken for too small."""


def with_elements(fit: ShipFit, until: float | None) -> ShipFit:
    """Return the fit with the limits that the data ask for, one after the other, and a twist unless it ends off."""
    smooth, gains = fit, dict[str, float]()
    limits = [element for element in fit.question.tried if element in LIMITED]
    if limits and fit.is_smooth:
        tell("looking for limits", 0.0)
        gains = falls_by_limits(fit)
        limits = [element for element in limits if gains[element] > LEAST_FALL[element]]
        fit = _simulated(fit, until) if limits else fit
    if limits:
        likelihood, best = settle(fit.likelihood, fit.best, until)
        others = [descend(likelihood, one.vector, until=until) for one in fit.basins[1:]]
        fit = replace(fit, likelihood=likelihood, basins=tuple(distinct(likelihood, [best, *others])))
    while limits:
        driven = fit.likelihood.with_water(fit.best.vector, always=True)
        before = driven.total(fit.best.vector)
        trials: list[tuple[float, str, ShipFit]] = []
        for place, element in enumerate(limits):
            tell(f"trying {ELEMENTS[element].words}", (len(gains) + place) / (len(limits) + 2))
            found = _trial(fit, driven, element, until)
            if found is not None:
                likelihood, end = found
                found_fit = _taken(fit, element, likelihood, end, until)
                gains[element] = before - found_fit.likelihood.total(found_fit.best.vector)
                trials.append((gains[element], element, found_fit))
        if not trials:
            break
        gain, element, taken = max(trials, key=lambda trial: trial[0])
        if gain <= LEAST_FALL[element]:
            break
        fit = taken
        limits.remove(element)
    if smooth.is_smooth and not fit.elements:
        fit = smooth
    if "twist" in fit.question.tried:
        tell(f"trying {ELEMENTS['twist'].words}", 0.8)
        fit, gains["twist"] = _with_twist(fit, until)
    return replace(fit, gains=gains)


def _with_twist(fit: ShipFit, until: float | None) -> tuple[ShipFit, float]:
    """Return the fit with a shaft that twists where the data ask for it, and by how much the deviance falls."""
    found = _trial(fit, fit.likelihood, "twist", until)
    if found is None:
        return fit, 0.0
    gain = fit.best.cost - found[1].cost
    if gain <= CHANCE:
        return fit, gain
    taken = replace(_taken(fit, "twist", *found, until), stiff=fit)
    return settled(taken, until), gain


def _simulated(fit: ShipFit, until: float | None) -> ShipFit:
    """Return the fit of a smooth ship by simulation, as limits need it."""
    c = fit.likelihood.coordinates
    step_s = step_for(fit.values, PART)
    likelihood = fit.question.simulated_likelihood((), step_s, fit.between)
    starts = [
        likelihood.coordinates.vector(c.values(one.vector), c.states_at(one.vector)) for one in fit.basins[:2]
    ]
    likelihood = likelihood.with_noise(starts[0])
    basins = distinct(likelihood, [descend(likelihood, start, until=until) for start in starts])
    return replace(fit, likelihood=likelihood, basins=tuple(basins)) if basins else fit


def _taken(fit: ShipFit, element: str, likelihood: Likelihood, end: Basin, until: float | None) -> ShipFit:
    """Return the fit with an element: with less left over the noise is less, and what else acts is seen."""
    likelihood, best = settle(likelihood, end, until)
    return replace(fit, likelihood=likelihood, basins=(best,), elements=(*fit.elements, element))


def _trial(
    fit: ShipFit, before: Likelihood, element: str, until: float | None
) -> tuple[Likelihood, Basin] | None:
    """Return the best end with an element beside those that act, with the noise and the water of before.

    None where the record comes near none, or the element ends on its bound: there it is off or stands in for something else.
    """
    starts = [start for basin in fit.basins[:2] for start in _starts(fit, element, basin)]
    if not starts:
        return None
    elements = (*fit.elements, element)
    rough = likelihood_of(fit, elements, "rough").with_noise_of(before)
    c = rough.coordinates
    vectors = [c.vector({**DEFAULTS, **values}, states) for values, states in starts]
    ends = each(rough, sorted(vectors, key=rough.cost)[:KEPT], until, 8, 10.0)
    bare = likelihood_of(fit, fit.elements, "rough").with_noise_of(before)
    without = descend(bare, fit.best.vector, steps=3, until=until)
    ends = [end for end in ends[:2] if end.cost < without.cost + LIKELY]
    if not ends:
        return None
    likelihood = likelihood_of(fit, elements).with_noise_of(before)
    best = each(likelihood, [end.vector for end in ends], until, 40, 0.1)[0]
    low, high = c.bounds
    place = c.place(TRIED[element][0])
    stands_in = best.vector[place] <= low[place] + 1e-6 or best.vector[place] >= high[place] - 1e-6
    return (likelihood, best) if np.isfinite(best.cost) and not stands_in else None


def _starts(
    fit: ShipFit, element: str, basin: Basin
) -> list[tuple[dict[str, float], list[dict[str, float]]]]:
    """Values to begin with: from the record's own plateaus and steepest slopes."""
    c = fit.likelihood.coordinates
    values = c.values(basin.vector)
    states = c.states_at(basin.vector)
    if element == "twist":
        behind = values["tau_prop"] if fit.question.gauge else max(values["tau_prop"], 0.3 * values["tau_n"])
        return [
            ({**values, "tau_twist": twist, "zeta_twist": damping, "tau_prop": behind}, states)
            for twist in TWISTS_S
            for damping in DAMPINGS
        ]
    if "dM" not in fit.question.outputs:
        return []
    records, place = fit.likelihood.records, fit.question.outputs.index("dM")
    if element == "torque_limit":
        # A gauge behind the engine's inertia shows more than the engine gives while the shaft slows.
        levels = np.quantile(np.concatenate([one.decimated[place] for one in records]), LEVELS)
        return [({**values, "M_max": float(np.clip(1.0 + level, 1.02, 4.5))}, states) for level in levels]
    steep = np.concatenate([np.abs(np.diff(one.decimated[place])) for one in records])
    rates = np.clip(np.quantile(steep, SLOPES) * records[0].data_hz / records[0].down, 0.03, 50.0)
    return [
        (
            {**values, "rate": float(rate), "vK_p": values["vK_p"] * more, "vK_i": values["vK_i"] * more},
            states,
        )
        for rate in rates
        for more in GAINS
    ]
