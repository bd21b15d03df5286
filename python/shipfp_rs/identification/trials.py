"""Elements that are tried beside the full smooth model: limits of torque and rate, and a shaft that twists.

An element is fitted along where the deviance falls by more than chance gives, so that intervals allow for it; it is called
on where the deviance falls by much more (`ship_found.BELIEVED`). Ends are compared under the noise of their own residuals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shipfp_rs.identification.basins import LIKELY, Basin, each
from shipfp_rs.identification.engine_tests import engine_tests, limit_to_try
from shipfp_rs.identification.equation_likelihood import EquationLikelihood
from shipfp_rs.identification.limited_likelihood import LimitedLikelihood
from shipfp_rs.identification.question import TRIED
from shipfp_rs.identification.ship_found import (
    BELIEVED,
    DEFAULTS,
    LIMITED,
    ShipFit,
    likelihood_of,
    settled,
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


def with_limits(fit: ShipFit, until: float | None) -> ShipFit:
    """Return the fit with the limits that the data ask for, one after the other, and what its engine's side still shows."""
    tried, scores = set(fit.question.tried) & LIMITED, engine_tests(fit)
    falls = {name: scores[name].fall for name in sorted(tried) if name in scores}
    fit = replace(fit, scores=scores, gains={**fit.gains, **falls})
    while (suspect := limit_to_try(fit.scores, tried)) is not None:
        tell(f"trying {ELEMENTS[suspect].words}", 0.3 * len(fit.elements))
        tried.remove(suspect)
        found = _trial(fit, suspect, until)
        if found is None:
            continue
        taken = _taken(fit, suspect, *found, until)
        gain = fit.total - taken.total
        if gain <= LEAST_FALL[suspect]:
            continue
        gains = {**fit.gains, suspect: gain}
        fit = replace(taken, gains=gains, unlimited=fit if fit.is_smooth else fit.unlimited)
        fit = replace(fit, scores=engine_tests(fit))
    return fit


def with_twist(fit: ShipFit, before: ShipFit, until: float | None) -> ShipFit:
    """Return the fit with a shaft that twists where the data ask for it.

    `before` is the fit with delays parted otherwise: a twist that is left out leads the search for them astray.
    """
    if "twist" not in fit.question.tried:
        return fit
    tell(f"trying {ELEMENTS['twist'].words}", 0.0)
    gain, best = 0.0, fit
    least = fit.total
    for one in (fit,) if before is fit else (fit, before):
        found = _trial(one, "twist", until)
        if found is None or one.best.cost - found[1].cost <= CHANCE:
            continue
        taken = _taken(one, "twist", *found, until)
        if taken.total < least - CHANCE:
            gain, best, least = fit.total - taken.total, replace(taken, stiff=fit), taken.total
    return replace(best, gains={**fit.gains, "twist": gain})


def _taken(
    fit: ShipFit, element: str, likelihood: EquationLikelihood, end: Basin, until: float | None
) -> ShipFit:
    """Return the fit with an element: with less left over the noise is less, and what else acts is seen."""
    elements = (*fit.elements, element)
    return settled(replace(fit, likelihood=likelihood, basins=(end,), elements=elements), until)


def _trial(fit: ShipFit, element: str, until: float | None) -> tuple[EquationLikelihood, Basin] | None:
    """Return the best end with an element beside those that act, with the noise of before.

    None where the record comes near none, or the element ends on its bound: there it is off or stands in for something else.
    """
    starts = [start for basin in fit.basins[:2] for start in _starts(fit, element, basin)]
    if not starts:
        return None
    likelihood = likelihood_of(fit, (*fit.elements, element))
    c = likelihood.coordinates
    vectors = [c.vector({**DEFAULTS, **values}, states) for values, states in starts]
    if isinstance(likelihood, LimitedLikelihood):
        likelihood = likelihood.driven(vectors[0])
    ends = each(likelihood, sorted(vectors, key=likelihood.cost)[:KEPT], until, 8, 10.0)
    ends = [end for end in ends[:2] if end.cost < fit.best.cost + LIKELY]
    if not ends:
        return None
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
