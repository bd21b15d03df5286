"""The fit of a ship: the full model without limits, which are tried in addition.

Dead times, lag, sampling, the shaft's flexibility and the load's second-order coefficient are always fitted, since they have
a value without effect. Limits of torque and rate have none and are tried one by one.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from shipfp_rs.errors import IdentificationError
from shipfp_rs.identification.basins import (
    ALIKE,
    LIKELY,
    SAME,
    Basin,
    best_basins,
    by_own_noise,
    descend,
    distinct,
)
from shipfp_rs.identification.equation_likelihood import EquationLikelihood
from shipfp_rs.identification.first_guesses import first_guesses
from shipfp_rs.identification.load_side import LoadSide, load_side_of
from shipfp_rs.identification.question import TRIED, Question
from shipfp_rs.identification.sampling import Between
from shipfp_rs.identification.ship_found import (
    DEFAULTS,
    ShipFit,
    likelihood_of,
    settled,
)
from shipfp_rs.identification.trials import with_limits
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.progress import part, tell

DELAYS = {"T_d", "T_set", "tau_act"}
WAYS: tuple[Between, ...] = ("band-limited", "straight", "held")
"""Tried courses of a set point between samples, where processing did not low-pass it."""
HELD = 10.0
"""Least decrease of the deviance by a zero-order hold, compared with a smooth or piecewise linear course, for a set point
without steps to count as held. At low frequencies the hold acts as a delay of half a sample, which the dead time of the set
point compensates, so chance alone would often prefer the hold."""
STEPS_ELSEWHERE = 12
"""Most steps from a start with other delays, before noise and corrections are re-estimated."""
FAR = 100.0
"""Excess of the deviance above which such minima are dropped: re-estimated noise would not make them the lowest."""
LEVEL = 0.1
"""Largest difference in deviance between two minima that count as parts of one long minimum."""
COMMON_S = 0.1
"""Least time by which both the governor's lead and the lag are increased in other starts [s]."""
REDIVIDED, MORE = 3, 4
"""Most rounds of redistributed delays, and number of new minima in each that are refined."""


def fit_ship(
    question: Question,
    *,
    starts: int = 1,
    seed: int | None = 0,
    time_limit_s: float | None = None,
    side: LoadSide | None = None,
) -> ShipFit:
    """Search the ship that best explains the data; `side` is the load identified from its side alone, if any.

    For a given structure the search also starts from its declared start and `starts` - 1 random ones.

    Raises
    ------
    IdentificationError
        If no start leads to a ship that can be simulated.
    """
    until = None if time_limit_s is None else time.monotonic() + time_limit_s
    given = tuple(
        element
        for element in TRIED
        if TRIED[element][0] in question.always and TRIED[element][0] not in question.fixed
    )
    names = {name for element in given for name in TRIED[element]}
    # A given limit is searched like one that is tried: the fit without limits comes first.
    question = replace(question, always=tuple(name for name in question.always if name not in names))
    with part(0.0, 0.4):
        fit = smooth_ship(question, starts=starts, seed=seed, until=until, side=side)
        if question.propeller and question.structure is None:
            # Pulses behind the gear may be counted at either end of the flexible shaft: the likelier end is kept.
            other = replace(question, propeller=False)
            near = smooth_ship(other, starts=starts, seed=seed, until=until, side=side)
            fit = min((fit, near), key=lambda one: one.total)
            question = fit.question
    fit = replace(fit, side=load_side_of(question, fit.likelihood.records))
    with part(0.4, 0.8):
        fit = with_limits(fit, given, partial(smooth_ship, until=until), until)
        fit = fit if fit.is_smooth else with_other_delays(fit, until)
    tell("settling", 0.8)
    return refined(fit, until)


def first_look(
    question: Question,
    between: Between | None = None,
    *,
    starts: int = 1,
    seed: int | None = 0,
    until: float | None = None,
    side: LoadSide | None = None,
) -> ShipFit:
    """Descend from all starts, without the elements that are tried later; see `fit_ship`."""
    side = load_side_of(question) if side is None else side
    likelihood, vectors = _begun(question, between, starts, seed, side)
    likelihood, basins, _ = best_basins(likelihood, vectors, until=until)
    return ShipFit(likelihood, tuple(basins), question, between=between, side=side)


def smooth_ship(
    question: Question,
    *,
    starts: int = 1,
    seed: int | None = 0,
    until: float | None = None,
    side: LoadSide | None = None,
) -> ShipFit:
    """Search the ship without the elements that are tried later; see `fit_ship`."""
    # If processing did not low-pass the set point, its course between samples is unknown: all courses are tried.
    tell("first look at the smooth ship", 0.0)
    undecided = any(one.hold == "first" and not one.is_low_passed for one in question.experiments)
    way: Between | None = "band-limited" if undecided else None
    fit = first_look(question, way, starts=starts, seed=seed, until=until, side=side)
    tell("searching the smooth ship", 0.3)
    if not undecided:
        return _corrected(fit, fit.between, until)
    ends: list[ShipFit] = []
    for place, way in enumerate(WAYS):
        tell(f"trying a set point that runs {way} between its samples", 0.3 + 0.2 * place)
        ends.append(_corrected(replace(fit, basins=fit.basins[:1]), way, until))
    least = 0.0 if all(one.goes_in_steps for one in fit.likelihood.records) else HELD
    best = min(ends, key=lambda end: end.total + (least if end.between == "held" else 0.0))
    others = [descend(best.likelihood, one.vector, until=until) for one in fit.basins[1:]]
    return replace(best, basins=tuple(distinct(best.likelihood, [best.best, *others])))


def _corrected(fit: ShipFit, between: Between | None, until: float | None) -> ShipFit:
    """Refine the minima for a course of set points between samples, with gaps filled and images removed.

    Raises
    ------
    IdentificationError
        If no minimum is a ship that can be simulated.
    """
    likelihood = likelihood_of(fit, (), between)
    if between == fit.between:
        likelihood = likelihood.corrected(fit.best.vector)
    basins = distinct(likelihood, [descend(likelihood, one.vector, until=until) for one in fit.basins])
    if not basins:
        raise IdentificationError("identify: the ship found is unstable")
    fit = replace(fit, likelihood=likelihood, basins=tuple(basins), between=between)
    return settled(fit, until)


def _begun(
    question: Question, between: Between | None, starts: int, seed: int | None, side: LoadSide | None
) -> tuple[EquationLikelihood, list[Array]]:
    """Return the likelihood and the start vectors of the first descents."""
    likelihood = question.likelihood(between)
    law = None if side is None else side.law
    guesses = first_guesses(likelihood.records, question.outputs, question.gauge, law)
    drawn: list[dict[str, float]] = []
    if question.structure is not None:
        own, random = question.structure.parameters, np.random.default_rng(seed)
        guesses = [{one.name: one.start for one in own}, *guesses]
        drawn = [
            {one.name: one.start if one.fixed else one.drawn(random) for one in own}
            for _ in range(starts - 1)
        ]
    return likelihood, [
        likelihood.coordinates.vector({"c_2": 0.0, **DEFAULTS, **guess}) for guess in (*guesses, *drawn)
    ]


def with_other_delays(fit: ShipFit, until: float | None = None) -> ShipFit:
    """Return the fit after a search with the total delay redistributed among dead times, lag and hold.

    The data determine the total better than each delay, so a search may find the right total with wrong delays.
    """
    for _ in range(REDIVIDED):
        c, before = fit.likelihood.coordinates, fit.best
        if len(DELAYS & set(c.free)) < 2:
            break
        states = c.states_at(before.vector)
        starts = [c.vector({**fit.values, **one}, states) for one in _redivided(fit.values)]
        fit, fell = _elsewhere(fit, starts, until)
        if fell < 1.0:
            break
    return fit


def _elsewhere(fit: ShipFit, starts: Sequence[Array], until: float | None) -> tuple[ShipFit, float]:
    """Return the fit at its likeliest minimum, each with its own noise and corrections, and the decrease of the total."""
    ends = [descend(fit.likelihood, one, steps=STEPS_ELSEWHERE, settled=1.0, until=until) for one in starts]
    ends = [one for one in ends if one.cost < fit.best.cost + FAR]
    others = [one for one in distinct(fit.likelihood, [fit.best, *ends]) if one is not fit.best]
    own = [by_own_noise(fit.likelihood, one.vector, until=until) for one in others]
    likely = sorted((one for one in own if one.cost < fit.total + LIKELY), key=lambda one: one.cost)
    likely = [one for one in likely if _is_apart(fit, fit.basins, one)]
    tried = [settled(replace(fit, basins=(one,), also=()), until) for one in likely[:MORE]]
    # Minima of a ship without the elements that were added later are dropped.
    before = [one for one in fit.also if one.elements == fit.elements]
    tried = sorted((fit, *tried, *before), key=lambda one: one.total)
    best = tried[0]
    near = [*(() if best is fit else fit.basins), *(one.best for one in tried[1:]), *likely[MORE:]]
    near = [one for one in near if _is_apart(best, best.basins, one)]
    near = [descend(best.likelihood, one.vector, until=until) for one in near]
    # A minimum that is much lower, but only under this noise, was already compared under its own noise.
    near = [one for one in near if -LEVEL < one.cost - best.best.cost < ALIKE]
    basins = tuple(distinct(best.likelihood, [*best.basins, *near]))
    also = [one for one in tried[1:] if one.total < best.total + ALIKE and _is_apart(best, basins, one.best)]
    return replace(best, basins=basins, also=tuple(also)), fit.total - best.total


def _is_apart(fit: ShipFit, basins: Sequence[Basin], other: Basin) -> bool:
    """Whether a minimum, found with another estimate of the noise, differs from all minima of the fit."""
    known = fit.best.products or fit.likelihood.products(fit.best.vector)
    moves = [other.vector - one.vector for one in basins]
    return all(one @ known.matrix @ one > SAME and np.abs(one).max() > 1e-3 for one in moves)


def _redivided(values: Mapping[str, float]) -> list[dict[str, float]]:
    """Starts with the total delay redistributed, some with other values of the governor's lead and the lag."""
    dead, late, lag = (values.get(name, 0.0) for name in ("T_d", "T_set", "tau_act"))
    inside, lead = dead + lag, values["vK_p"] / values["vK_i"]
    both = min(lead, lag)
    less, least, more = lag - 0.5 * both, lag - 0.9 * both, lag + max(lead, COMMON_S)
    # Dead times, lag, common shift of lead and lag, and other changes.
    ways: list[tuple[float, float, float, float, dict[str, float]]] = [
        (late, dead, lag, 0.0, {}),
        (inside, late, 0.0, 0.0, {"T_s": 0.005}),
        (inside, late, 0.0, 0.0, {"T_s": min(2.0 * inside, 0.05)}),
        (0.3 * inside, late, 0.7 * inside, 0.0, {}),
        (inside + late, 0.0, 0.0, 0.0, {}),
        (0.0, inside + late, 0.0, 0.0, {}),
        (0.0, late, inside, 0.0, {}),
        (0.0, late + dead, less, less - lag, {}),
        (dead, late + less, 0.0, less - lag, {}),
        (0.0, late + 0.5 * dead, least + 0.5 * dead, least - lag, {}),
        (dead, late, more, more - lag, {}),
    ]
    return [
        {name: max(value, 3e-3) for name, value in zip(("T_d", "T_set", "tau_act"), delays, strict=True)}
        | {"vK_p": values["vK_i"] * (lead + shift)}
        | beside
        for *delays, shift, beside in ways
    ]


def refined(fit: ShipFit, until: float | None = None) -> ShipFit:
    """Settle the fit again, with the noise estimated at its minimum.

    Raises
    ------
    IdentificationError
        If the ship is unstable.
    """
    fit = settled(fit, until)
    if not np.isfinite(fit.best.cost):
        raise IdentificationError("identify: the ship found is unstable")
    return fit
