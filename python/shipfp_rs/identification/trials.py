"""Tries elements that the full model lacks: limits of torque and rate.

An element stays in the fit where it lowers the deviance by more than chance does, so that intervals allow for it. The
element is called "on" where the deviance falls by much more (`ship_found.BELIEVED`). Minima are compared by their total
deviance, each with the noise estimated from its own residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from shipfp_rs.errors import IdentificationError, SimulationError
from shipfp_rs.identification.basins import Basin, descend
from shipfp_rs.identification.engine_tests import engine_tests, limit_to_try, touched
from shipfp_rs.identification.equation_likelihood import EquationLikelihood
from shipfp_rs.identification.first_guesses import guesses_by_bandwidth
from shipfp_rs.identification.limited_likelihood import WATERS_HZ, LimitedLikelihood
from shipfp_rs.identification.question import TRIED
from shipfp_rs.identification.ship_found import (
    BELIEVED,
    DEFAULTS,
    ShipFit,
    likelihood_of,
    settled,
)
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.progress import tell

CHANCE = 6.0
"""Decrease of the deviance that two parameters exceed by chance once in twenty; a smaller one is no evidence."""
LEAST_FALL = {"torque_limit": CHANCE, "rack_rate": 2.0 * BELIEVED}
"""Least decrease of the total deviance for a limit to stay in the fit; higher for rate limits, whose intervals are
approximate."""
LEAST_TOUCHED = 10.0
"""Least samples at a limit; a limit that the record hardly reaches may compensate for another error of the model."""
ROUNDS, STEPS, STILL = 6, 12, 1.0
"""Most rounds of descents with a limit, most steps of each, and decrease of the deviance below which they stop."""
BEHIND = 0.2
"""Deviance above the best after one round, over the decrease by the limit, up to which the other way to compute the limit's
effect is continued."""
KEPT = 5
"""Number of starts, those of least deviance, from which a descent begins."""
LEVELS, AHEAD = (0.9, 0.97, 0.995), 1.5
"""Quantiles of the torque at which limits are tried, and a factor on the last: a gauge behind the engine's inertia measures
less torque than the engine gives while the shaft accelerates."""
STEEP, RATES = 0.99, (0.6, 1.0, 1.6, 2.5)
"""Quantile of the torque's slope, and factors on it at which limits of the rate are tried: a gauge shows slopes down to 0.4
times the rack's, noise steeper ones."""
GAINS = (1.0, 2.0, 4.0)
"""Factors of the governor's gains in starts with a limited rate: a fit without the limit underestimates them."""


def with_limits(fit: ShipFit, until: float | None) -> ShipFit:
    """Add the limits that the data support, one after the other; the returned fit has its engine-side tests."""
    tried, scores = set(fit.question.tried), engine_tests(fit)
    falls = {name: scores[name].fall for name in sorted(tried) if name in scores}
    fit = replace(fit, scores=scores, gains={**fit.gains, **falls})
    while (suspect := limit_to_try(fit.scores, tried)) is not None:
        tell(f"trying {ELEMENTS[suspect].words}", 0.3 * len(fit.elements))
        tried.remove(suspect)
        taken = _worthy(fit, suspect, until)
        if taken is None:
            continue
        if suspect == "rack_rate" and "torque_limit" in tried:
            # The fit without limits has adapted its parameters to the effect of a torque limit. The rest of that effect may
            # look like the effect of a rate limit.
            other = _worthy(fit, "torque_limit", until)
            if other is not None and other.total < taken.total:
                tried = tried - {"torque_limit"} | {"rack_rate"}
                taken = other
        fit = replace(taken, scores=engine_tests(taken))
    return fit


def _worthy(fit: ShipFit, element: str, until: float | None) -> ShipFit | None:
    """Return the fit with a limit; None if the limit lowers the deviance too little or acts on too few samples."""
    taken = _limited(fit, element, until)
    if taken is None:
        return None
    gain = fit.total - taken.total
    if gain <= LEAST_FALL[element] or touched(taken, element) < LEAST_TOUCHED:
        return None
    return replace(taken, gains={**fit.gains, element: gain})


def with_given_limits(fit: ShipFit, given: Sequence[str], until: float | None) -> ShipFit:
    """Return the fit with given limits.

    Raises
    ------
    IdentificationError
        If no start leads to a ship with such a limit.
    """
    for element in given:
        taken = _limited(fit, element, until, surely=True)
        if taken is None:
            raise IdentificationError(f"identify: no start leads to a ship with {ELEMENTS[element].words}")
        gains = {**fit.gains, element: np.inf}
        fit = replace(taken, gains=gains)
    return fit


def _taken(
    fit: ShipFit, element: str, likelihood: EquationLikelihood, end: Basin, until: float | None
) -> ShipFit:
    """Return the fit with an element, settled again: with less residual noise, other elements may become significant."""
    elements = (*fit.elements, element)
    return settled(replace(fit, likelihood=likelihood, basins=(end,), elements=elements, also=()), until)


def _is_inside(likelihood: EquationLikelihood, end: Basin, element: str) -> bool:
    """Whether a minimum is inside the bounds of the element's first parameter."""
    low, high = likelihood.coordinates.bounds
    place = likelihood.coordinates.place(TRIED[element][0])
    return bool(np.isfinite(end.cost) and low[place] + 1e-6 < end.vector[place] < high[place] - 1e-6)


def _limited(fit: ShipFit, element: str, until: float | None, *, surely: bool = False) -> ShipFit | None:
    """Return the fit with a limit; None if the record is never near the limit, or, unless `surely`, it ends on its bound.

    Residuals of a fit without the limit have another noise spectrum, so each minimum is compared with its own noise.
    """
    starts = [start for basin in fit.basins[:2] for start in _starts(fit, element, basin)]
    if not starts:
        return None
    likelihood = likelihood_of(fit, (*fit.elements, element))
    assert isinstance(likelihood, LimitedLikelihood)
    c = likelihood.coordinates
    vectors = [c.vector({**DEFAULTS, **values}, states) for values, states in starts]
    best = lowest(likelihood, vectors, until)
    # Noise of the speed may hide a limit from the engine's equation; slow simulations still show it.
    simulated = replace(likelihood, water_hz=WATERS_HZ[0]).driven(vectors[0])
    pairs = (likelihood, best), (simulated, lowest(simulated, vectors, until))
    likelihood, best = min(pairs, key=lambda pair: pair[1].cost)
    if not surely and not best.cost < fit.total:
        return None
    likelihood, best = _other_way(likelihood, best, fit.total, until)
    if not (np.isfinite(best.cost) if surely else _is_inside(likelihood, best, element)):
        return None
    return _taken(fit, element, likelihood.resettled_at(best.vector), best, until)


def lowest(
    likelihood: LimitedLikelihood, vectors: Sequence[Array], until: float | None, kept: int = KEPT
) -> Basin:
    """Return the minimum of least total from several starts: the best `kept` descend for a round, the best two continue."""
    begun = sorted(vectors, key=partial(_total, likelihood))[:kept]
    ends = likelihood.each([partial(_by_own_noise, likelihood, start, 1, until) for start in begun])
    ends = sorted(ends, key=lambda end: end.cost)[:2]
    ends = likelihood.each([partial(_by_own_noise, likelihood, end.vector, ROUNDS, until) for end in ends])
    return min(ends, key=lambda end: end.cost)


def _other_way(
    likelihood: LimitedLikelihood, best: Basin, smooth: float, until: float | None
) -> tuple[LimitedLikelihood, Basin]:
    """Return the likelihood and minimum of the likeliest method of computing the limits' effect.

    A method with a much higher deviance than the best after one round is dropped.
    """
    if not np.isfinite(best.cost):
        return likelihood, best
    ways = [replace(likelihood, water_hz=hz) for hz in (None, *WATERS_HZ) if hz != likelihood.water_hz]
    ends = likelihood.each([partial(_by_own_noise, one, best.vector, 1, until) for one in ways])
    near = best.cost + BEHIND * max(smooth - best.cost, 0.0)
    kept = [(way, end) for way, end in zip(ways, ends, strict=True) if end.cost < near]
    jobs = [partial(_by_own_noise, way, end.vector, ROUNDS, until) for way, end in kept]
    moved = zip([way for way, _ in kept], likelihood.each(jobs), strict=True)
    return min(((likelihood, best), *kept, *moved), key=lambda pair: pair[1].cost)


def _total(likelihood: EquationLikelihood, vector: Array) -> float:
    """Total deviance at a point of the search, with corrections and noise estimated at that point."""
    try:
        return likelihood.resettled_at(vector).own_total(vector)
    except (SimulationError, np.linalg.LinAlgError):
        return np.inf


def _by_own_noise(likelihood: EquationLikelihood, start: Array, rounds: int, until: float | None) -> Basin:
    """Descend repeatedly, each round with the noise of the previous minimum; the cost is the total deviance."""
    end = Basin(np.inf, start, False)
    for _ in range(rounds):
        try:
            own = likelihood.resettled_at(end.vector)
        except (SimulationError, np.linalg.LinAlgError):
            break
        found = descend(own, end.vector, steps=STEPS, settled=STILL, until=until).vector
        total = _total(likelihood, found)
        if not total < end.cost - STILL:
            break
        end = Basin(total, found)
    return end


def _other_loops(fit: ShipFit) -> list[dict[str, float]]:
    """Starts with several loop bandwidths and the load of `load_side`, since a limit misleads a fit without limits."""
    if fit.side is None:
        return []
    return guesses_by_bandwidth(fit.side.law, fit.question.gauge, fit.values.get("T_set", 0.0))


def _starts(
    fit: ShipFit, element: str, basin: Basin
) -> list[tuple[dict[str, float], list[dict[str, float]]]]:
    """Starting values from plateaus and steepest slopes of the record."""
    c = fit.likelihood.coordinates
    values = c.values(basin.vector)
    states = c.states_at(basin.vector)
    if "dM" not in fit.question.outputs:
        return []
    records, place = fit.likelihood.records, fit.question.outputs.index("dM")
    every = [values, *({**values, **one} for one in _other_loops(fit))]
    if element == "torque_limit":
        # While the shaft slows, a gauge behind the engine's inertia measures more torque than the engine gives.
        levels = np.quantile(np.concatenate([one.decimated[place] for one in records]), LEVELS)
        limits = np.clip([*(1.0 + levels), 1.0 + AHEAD * levels[-1]], 1.02, 4.5).tolist()
        return [({**one, "M_max": limit}, states) for one in every for limit in limits]
    steep = np.concatenate([np.abs(np.diff(one.decimated[place])) for one in records])
    steepest = np.quantile(steep, STEEP) * records[0].data_hz / records[0].down
    rates = np.clip(steepest * np.array(RATES), 0.03, 50.0).tolist()
    loops = [
        *({**values, "vK_p": values["vK_p"] * more, "vK_i": values["vK_i"] * more} for more in GAINS),
        *every[1:],
    ]
    return [({**one, "rate": rate}, states) for one in loops for rate in rates]
