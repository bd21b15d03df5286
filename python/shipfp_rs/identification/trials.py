"""Trials of limits of torque and rate and of a droop, which the full model lacks, where engine-side tests suggest them.

A limit stays in the fit if it lowers the deviance by more than chance does, so that intervals allow for it. The limit is
reported as "on" only if the deviance falls by at least `ship_found.BELIEVED`. Minima are compared by their total deviance,
each with the noise estimated from its own residuals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from shipfp_rs.errors import IdentificationError, SimulationError
from shipfp_rs.identification.basins import Basin, descend, distinct, each
from shipfp_rs.identification.engine_tests import engine_tests, lacks_something, limits_to_try, touched
from shipfp_rs.identification.first_guesses import guesses_by_bandwidth
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.limited_ship import ways_of
from shipfp_rs.identification.profiles import RISE
from shipfp_rs.identification.question import TRIED
from shipfp_rs.identification.set_rate import Search, with_set_rate
from shipfp_rs.identification.ship_found import BELIEVED, DEFAULTS, DISCREPANCY, ShipFit, settled
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.progress import tell

CHANCE = 6.0
"""Decrease of the deviance that two parameters exceed by chance once in twenty; a smaller one is no evidence."""
LEAST_FALL = {"torque_limit": CHANCE, "rack_rate": 2.0 * BELIEVED}
"""Least decrease of the total deviance for a limit to stay in the fit; higher for rate limits, whose intervals are
approximate."""
LEAST_TOUCHED = 10.0
"""Least number of samples at a limit; a limit that the record hardly reaches may compensate for another error of the
model."""
ROUNDS, STEPS, STILL = 6, 12, 1.0
"""Largest number of rounds of descents with a limit, of steps of a descent, and decrease of the deviance below which both
stop."""
KEPT = 5
"""Number of starts from which descents begin, those of least deviance."""
LEVELS, AHEAD = (0.9, 0.97, 0.995), 1.5
"""Quantiles of the torque at which limits are tried, and a factor on the last: a gauge behind the engine's inertia measures
less torque than the engine gives while the shaft accelerates."""
STEEP, RATES = 0.99, (0.6, 1.0, 1.6, 2.5)
"""Quantile of the torque's slope, and factors on this slope at which limits of the rack's rate are tried. A gauge shows
slopes down to 0.4 times the rack's slope; noise shows slopes steeper than the rack's."""
REDIVIDED, REFINED = 3, 4
"""Largest number of rounds that redistribute delays, and number of minima that each round refines."""
FADED, INTEGRALS = 0.2, (0.5, 2.0)
"""Least share of a gain that a droop leaves in a start, and ratios of integral to proportional gain there [1/s]."""
GAINS = (1.0, 2.0, 4.0)
"""Factors of the governor's gains in starts with a limited rate: a fit without the limit underestimates them."""


def with_limits(fit: ShipFit, given: Sequence[str], search: Search, until: float | None) -> ShipFit:
    """Return the fit with the given limits and those that the data support; `search` fits the smooth ship behind a ramp."""
    for element in given:
        if element == "set_rate":
            fit = with_set_rate(fit, search, until, surely=True)
            continue
        taken = _limited(fit, element, until, surely=True)
        if taken is None:
            raise IdentificationError(f"identify: no start leads to a ship with {ELEMENTS[element].words}")
        fit = replace(taken, gains={**fit.gains, element: np.inf})
    fit = replace(fit, scores=engine_tests(fit))
    gains = {name: fit.scores[name].fall for name in fit.question.tried if name in fit.scores}
    fit = replace(fit, gains={**fit.gains, **gains})
    bare, droops = fit, "droop" in fit.question.tried
    while True:
        # The fit without a limit has adapted to the limit's effect, which may resemble another limit's: all are tried.
        suspects = limits_to_try(fit.scores, set(fit.question.tried) - set(fit.elements))
        found = []
        if droops and "droop" not in fit.elements and fit.is_smooth:
            drooping = _drooping(fit, until)
            fit = replace(fit, gains=drooping.gains)
            if drooping.gains["droop"] > CHANCE:
                found, scores = [drooping], engine_tests(drooping)
                if not lacks_something(scores):  # the droop leaves nothing that a limit could explain
                    return replace(drooping, scores=scores)
        if (
            "set_rate" in fit.question.tried
            and not fit.elements
            and fit.ramp is None
            and lacks_something(fit.scores)
        ):
            tell(f"trying {ELEMENTS['set_rate'].words}", 0.0)
            found += [one for one in [with_set_rate(fit, search, until)] if one is not fit]
        for element in suspects:
            tell(f"trying {ELEMENTS[element].words}", 0.3 * len(fit.elements))
            taken = _limited(fit, element, until)
            if taken is None or touched(taken, element) < LEAST_TOUCHED:
                continue
            if (gain := fit.total - taken.total) > LEAST_FALL[element]:
                found.append(replace(taken, gains={**fit.gains, element: gain}))
        if not found:
            break
        bare = bare if "droop" in fit.elements else fit
        fit = min(found, key=lambda one: one.total)
        if "droop" in fit.elements and not fit.is_smooth:
            # A limit's effect resembles a droop's, so no droop is reported beside a limit.
            limit, droops = fit.elements[-1], False
            other = _limited(bare, limit, until, near=fit.values[TRIED[limit][0]]) or bare
            gain = bare.total - other.total
            taken = other if gain > LEAST_FALL[limit] else bare
            fit = replace(taken, gains={**bare.gains, limit: gain, "droop": 0.0})
        fit = replace(fit, scores=engine_tests(fit))
    return fit if fit.is_smooth else _with_other_delays(fit, until)


def _drooping(fit: ShipFit, until: float | None) -> ShipFit:
    """Return the fit with a droop of the governor; its `gains` have the droop's decrease of the deviance."""
    elements = (*fit.elements, "droop")
    likelihood = fit.question.with_elements(fit.likelihood, elements)
    states = fit.likelihood.coordinates.states_at(fit.best.vector)
    known = {**DEFAULTS, **fit.values}
    # A fit without the droop underestimates the gain, and hardly finds a fast integral, which the droop makes fade.
    gain = known["vK_p"] / max(1.0 - known["droop"] * known["vK_p"], FADED)
    ways = [known, *({**known, "vK_p": gain, "vK_i": rate * gain} for rate in INTEGRALS)]
    starts = [likelihood.coordinates.vector(way, states) for way in ways]
    best = min(each(likelihood, starts, until), key=lambda end: end.cost)
    found = replace(fit, likelihood=likelihood, basins=(best,), elements=elements)
    gain = fit.best.cost - best.cost
    if gain > CHANCE:
        found = settled(found, until)
        gain = fit.total - found.total
    return replace(found, gains={**fit.gains, "droop": max(gain, 0.0)})


def _with_other_delays(fit: ShipFit, until: float | None) -> ShipFit:
    """Return the likeliest fit after descents with the total delay redistributed among dead times and lag."""
    # The data determine the total better than each delay, and the fit without limits has adapted its delays to the limit.
    c, every = fit.likelihood.coordinates, [fit]
    for _ in range(REDIVIDED if {"T_d", "T_set", "tau_act"} <= set(c.free) else 0):
        states = c.states_at(fit.best.vector)
        starts = [c.vector({**fit.values, **one}, states) for one in _redivided(fit.values)]
        jobs = [
            partial(descend, fit.likelihood, one, steps=STEPS, settled=STILL, until=until) for one in starts
        ]
        ends = distinct(fit.likelihood, [fit.best, *fit.likelihood.each(jobs)])[:REFINED]
        tried = [settled(replace(fit, basins=(end,)), until) for end in ends if end is not fit.best]
        every += tried
        best = min(every, key=lambda one: one.total)
        if best.total > fit.total - STILL:
            break
        fit = best
    # Errors of a limit's model leave many minima; those whose deviance these errors explain stay possible.
    most = fit.total + RISE * DISCREPANCY**2
    alike = tuple(one.best.vector for one in every if one is not fit and one.total < most)
    return replace(fit, alike=alike)


def _redivided(values: Mapping[str, float]) -> list[dict[str, float]]:
    """Starts with the total delay redistributed, some with another lead of the governor."""
    dead, late, lag = (values[name] for name in ("T_d", "T_set", "tau_act"))
    inside, lead = dead + lag, values["vK_p"] / values["vK_i"]
    less = lag - 0.5 * min(lead, lag)
    # Columns: the loop's dead time, the set point's, the lag, and the change of the lead.
    ways = [
        (late, dead, lag, 0.0),
        (inside, late, 0.0, 0.0),
        (0.3 * inside, late, 0.7 * inside, 0.0),
        (0.0, late, inside, 0.0),
        (inside + late, 0.0, 0.0, 0.0),
        (0.0, inside + late, 0.0, 0.0),
        (0.0, late + dead, less, less - lag),
        (dead, late, lag + lead, lead),
    ]
    return [
        {name: max(delay, 3e-3) for name, delay in zip(("T_d", "T_set", "tau_act"), delays, strict=True)}
        | {"vK_p": values["vK_i"] * (lead + shift)}
        for *delays, shift in ways
    ]


def _limited(
    fit: ShipFit, element: str, until: float | None, *, surely: bool = False, near: float | None = None
) -> ShipFit | None:
    """Return the fit with a limit; None if the record is never near it or, unless `surely`, the limit ends on its bound."""
    starts = [start for basin in fit.basins[:2] for start in _starts(fit, element, basin)]
    if near is not None:
        starts = [({**values, TRIED[element][0]: near}, states) for values, states in starts]
    if not starts:
        return None
    likelihood = fit.question.with_elements(fit.likelihood, (*fit.elements, element))
    c = likelihood.coordinates
    best = _lowest(likelihood, [c.vector({**DEFAULTS, **values}, states) for values, states in starts], until)
    (low, high), place = c.bounds, c.place(TRIED[element][0])
    inside = low[place] + 1e-6 < best.vector[place] < high[place] - 1e-6
    if not np.isfinite(best.cost) or not (surely or (best.cost < fit.total and inside)):
        return None
    found, ends = replace(fit, elements=(*fit.elements, element)), []
    for way in ways_of(likelihood):
        end = _by_own_noise(way, best.vector, ROUNDS, until)
        if np.isfinite(end.cost):
            own = way.resettled_at(end.vector)
            ends.append(settled(replace(found, likelihood=own, basins=(end,)), until))
    return min(ends, key=lambda one: one.total, default=None)


def _lowest(likelihood: Likelihood, vectors: Sequence[Array], until: float | None) -> Basin:
    """Return the minimum of least total deviance: the best `KEPT` starts descend for one round, the best two continue."""
    begun = sorted(vectors, key=partial(_total, likelihood))[:KEPT]
    ends = likelihood.each([partial(_by_own_noise, likelihood, start, 1, until) for start in begun])
    ends = sorted(ends, key=lambda end: end.cost)[:2]
    ends = likelihood.each([partial(_by_own_noise, likelihood, end.vector, ROUNDS, until) for end in ends])
    return min(ends, key=lambda end: end.cost)


def _total(likelihood: Likelihood, vector: Array) -> float:
    """Total deviance at a point of the search, with corrections and noise estimated at that point."""
    try:
        return likelihood.resettled_at(vector).own_total(vector)
    except (SimulationError, np.linalg.LinAlgError):
        return np.inf


def _by_own_noise(likelihood: Likelihood, start: Array, rounds: int, until: float | None) -> Basin:
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


def _starts(
    fit: ShipFit, element: str, basin: Basin
) -> list[tuple[dict[str, float], list[dict[str, float]]]]:
    """Starting values from plateaus and steepest slopes of the record, with the fit's loop and with other bandwidths."""
    c = fit.likelihood.coordinates
    # In the fit without the limit, lags of the torque imitate it.
    values = c.values(basin.vector) | {"tau_eng": 0.0}
    states = c.states_at(basin.vector)
    if "dM" not in fit.question.outputs:
        return []
    records, place = fit.likelihood.records, fit.question.outputs.index("dM")
    others = []
    if fit.side is not None:
        others = guesses_by_bandwidth(fit.side.law, fit.question.gauge, fit.values.get("T_set", 0.0))
    every = [values, *({**values, **one} for one in others)]
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
