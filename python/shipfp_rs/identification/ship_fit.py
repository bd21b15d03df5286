"""The fit of a ship: the full model without limits is fitted first, then limits are tried.

Dead times, lag, sampling, the shaft's flexibility and the load's second-order coefficient are always fitted, since each has
a value without effect. Limits of torque and rate have no value without effect and are tried one by one.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from shipfp_rs.errors import IdentificationError
from shipfp_rs.identification.basins import (
    best_basins,
    descend,
    distinct,
    expected,
)
from shipfp_rs.identification.coordinates import WITHOUT_EFFECT
from shipfp_rs.identification.first_guesses import first_guesses
from shipfp_rs.identification.input_checks import require_excited
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.load_side import LoadSide, load_side_of
from shipfp_rs.identification.question import TRIED, Question
from shipfp_rs.identification.sampling import Between
from shipfp_rs.identification.ship_found import (
    DEFAULTS,
    ShipFit,
    settled,
)
from shipfp_rs.identification.trials import with_limits
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.progress import part, tell

EXPLAINED = 0.3
"""Share of the speed that the set point explains in the load's equation; above it, the speed follows the set point."""


def fit_ship(question: Question) -> ShipFit:
    """Search the ship that best explains the data; a given structure adds its declared start, and random ones on request."""
    side = load_side_of(question)
    # If torque and speed fit the load's law, the speed channel is right, whatever the governor does.
    explained = 0.0 if side is None else min(record.explained for record in side.records)
    require_excited(question.experiments, follows=explained < EXPLAINED)
    limit_s = question.options.time_limit_s
    until = None if limit_s is None else time.monotonic() + limit_s
    given = tuple(
        element
        for element in TRIED
        if element != "droop" and TRIED[element][0] in set(question.always) - set(question.fixed)
    )
    names = {name for element in given for name in TRIED[element]}
    # A limit of a given structure is searched like a tried one: the fit without limits comes first.
    question = replace(question, always=tuple(name for name in question.always if name not in names))
    with part(0.0, 0.4):
        fit = smooth_ship(question, until=until, side=side)
        if question.propeller and question.structure is None:
            # Pulses behind the gear may be those of either end of the flexible shaft: the likelier end is kept.
            other = replace(question, propeller=False)
            near = smooth_ship(other, until=until, side=side)
            fit = min((fit, near), key=lambda one: one.total)
            question = fit.question
    fit = replace(fit, side=load_side_of(question, fit.likelihood.records))
    with part(0.4, 0.8):
        fit = with_limits(fit, given, partial(smooth_ship, until=until), until)
    tell("settling", 0.8)
    return refined(fit, until)


def ship_at(question: Question, values: Mapping[str, float]) -> ShipFit:
    """Return the expected fit of a ship whose true parameters are known."""
    likelihood = question.likelihood()
    vector = likelihood.coordinates.vector({**DEFAULTS, **WITHOUT_EFFECT, **values})
    likelihood = likelihood.settled_at(vector)
    return ShipFit(likelihood, (expected(likelihood, vector),), question)


def first_look(
    question: Question,
    between: Between | None = None,
    *,
    until: float | None = None,
    side: LoadSide | None = None,
) -> ShipFit:
    """Descend from all starts, without the elements that are tried later; see `fit_ship`."""
    side = load_side_of(question) if side is None else side
    likelihood, vectors = _begun(question, between, side)
    likelihood, basins, _ = best_basins(likelihood, vectors, until=until)
    return ShipFit(likelihood, tuple(basins), question, side=side)


def smooth_ship(
    question: Question,
    *,
    until: float | None = None,
    side: LoadSide | None = None,
) -> ShipFit:
    """Search the ship without the elements that are tried later; see `fit_ship`."""
    tell("first look at the smooth ship", 0.0)
    # A simulation's set point is a straight line between its samples.
    undecided = any(
        one.hold == "first" and not one.is_low_passed and one.provenance.get("source") != "simulation"
        for one in question.experiments
    )
    between: Between | None = "band-limited" if undecided else None
    fit = first_look(question, between, until=until, side=side)
    tell("searching the smooth ship", 0.3)
    # With the parameters of the first look, gaps are filled and images of the set point are removed.
    ends = [fit.likelihood.corrected(fit.best.vector)]
    if undecided:
        # Without a low-pass, the set point may also be a straight line between its samples.
        straight = fit.likelihood.with_records(one.running("straight") for one in fit.likelihood.records)
        ends.append(straight.corrected(fit.best.vector))
    likelihood = min(ends, key=lambda end: descend(end, fit.best.vector, until=until).cost)
    points = [start for one in fit.basins for start in (one.vector, *_exchanged(likelihood, one.vector))]
    basins = distinct(likelihood, [descend(likelihood, start, until=until) for start in points])
    if not basins:
        raise IdentificationError("identify: the ship found is unstable")
    return settled(replace(fit, likelihood=likelihood, basins=tuple(basins)), until)


def _exchanged(likelihood: Likelihood, vector: Array) -> list[Array]:
    """Return the point with the lags of actuator and engine exchanged; with a small slope g their effects hardly differ."""
    names = likelihood.coordinates.names
    if not {"tau_act", "tau_eng"} <= set(names):
        return []
    places, other = [names.index("tau_act"), names.index("tau_eng")], vector.copy()
    other[places] = vector[places[::-1]]
    return [other]


def _begun(
    question: Question, between: Between | None, side: LoadSide | None
) -> tuple[Likelihood, list[Array]]:
    """Return the likelihood and the start vectors of the first descents."""
    likelihood = question.likelihood(between)
    law = None if side is None else side.law
    guesses = first_guesses(likelihood.records, question.outputs, question.gauge, law)
    drawn: list[dict[str, float]] = []
    if question.structure is not None:
        own, random = question.structure.parameters, np.random.default_rng(question.options.seed)
        guesses = [{one.name: one.start for one in own}, *guesses]
        drawn = [
            {one.name: one.start if one.fixed else one.drawn(random) for one in own}
            for _ in range((question.options.starts or 1) - 1)
        ]
    return likelihood, [
        likelihood.coordinates.vector({"c_2": 0.0, **DEFAULTS, **guess}) for guess in (*guesses, *drawn)
    ]


def refined(fit: ShipFit, until: float | None = None) -> ShipFit:
    """Settle the fit again, with the noise at its minimum; `IdentificationError` if the ship is unstable."""
    fit = settled(fit, until)
    if not np.isfinite(fit.best.cost):
        raise IdentificationError("identify: the ship found is unstable")
    return fit
