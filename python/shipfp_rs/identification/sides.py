"""Comparison of the load's and the engine's side: which estimates remain valid if the model does not describe the engine.

The load's side is identified without a governor. If the engine's side shows effects that no model explains, or the load's
side alone differs from the whole fit, that fit's estimates of the engine are invalid. Then only those of the load's side
are reported (cut inference, Plummer 2015, doi:10.1007/s11222-014-9503-z).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from shipfp_rs.identification.coordinates import COMBINED
from shipfp_rs.identification.engine_tests import suspected
from shipfp_rs.identification.estimate import ASSUMED, Estimate, unidentifiable
from shipfp_rs.identification.limited_likelihood import LimitedLikelihood
from shipfp_rs.identification.load_side import SHARED, LoadSide
from shipfp_rs.identification.ship_found import DISCREPANCY, ShipFit
from shipfp_rs.identification.stretches import Stretches, by_stretch
from shipfp_rs.identification.usability import LARGE_MISS_PCT, LEAST_EXPLAINED_PCT
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.sentences import Sentence

APART = 3.5
"""Difference of the two estimates, in its standard deviations, above which the sides disagree; chance exceeds it once in two
thousand."""
MOST_REMOVED = 0.5
"""Standard deviation of the torque that limits remove, over the torque's, above which no actuator's model is good enough:
its errors of some per cent of that torque exceed the noise tenfold."""
KINDS: Mapping[str, Sentence] = {
    "gain": Sentence("the governor's gain changes with the error: a dead band, or a gain in steps"),
    "asymmetry": Sentence("the governor is faster in one direction than in the other"),
    "lag": Sentence("the governor's command acts with another lag than the model's, as behind an inner loop"),
    "torque_limit": Sentence("the drive's torque is limited, but by no limit that was tried"),
    "rack_rate": Sentence("the actuator's rate is limited, but by no limit that was tried"),
    "limit": Sentence("a limit removes more of the torque than half of what the torque itself moves"),
    "misfit": Sentence("the model misses too much of the drive train's response"),
    "prior": Sentence(
        "a channel's delay, the shaft or the share of the inertia behind it would be as in no ship"
    ),
    "sides": Sentence("speed and torque alone give another load than the whole model"),
}
"""Sentence about the engine's side for each kind of contradiction."""


def undescribed(fit: ShipFit, misses_pct: Sequence[float], explained_pct: Sequence[float]) -> str | None:
    """Return the kind, of `KINDS`, of a contradiction to the model's drive and governor; None if there is none."""
    likelihood = fit.likelihood
    if isinstance(likelihood, LimitedLikelihood) and likelihood.removed_share(fit.best.vector) > MOST_REMOVED:
        return "limit"
    if (kind := suspected(fit.scores, 1.0 if fit.is_smooth else DISCREPANCY)) is not None:
        return kind
    poor = max(misses_pct) > LARGE_MISS_PCT or min(explained_pct) < LEAST_EXPLAINED_PCT
    # A torque that certainly rises with the speed is a load.
    if poor and fit.side is not None and (fit.side.parameters["p"].ci95 or (0.0,))[0] > 0.0:
        return "misfit"
    if _contradicts_priors(fit):
        return "prior"
    return None if fit.side is None or _agree(fit, fit.side) else "sides"


def _contradicts_priors(fit: ShipFit) -> bool:
    """Whether a parameter is far from what is known of every ship: it has taken over what the model lacks."""
    values, known = fit.values, fit.likelihood.priors
    return any(
        abs((COMBINED[name](values)[0] if name in COMBINED else values[name]) - mean) > APART * deviation
        for name, (mean, deviation) in known.items()
        if name not in fit.question.priors and name != "g"
    )


def _agree(fit: ShipFit, side: LoadSide) -> bool:
    """Whether the load's side alone and the whole fit agree on p and on the inertia behind the torque sensor."""
    c, vector, values = fit.likelihood.coordinates, fit.best.vector, fit.values
    stretches = Stretches(fit.likelihood, vector)
    for name in ("p", "tau_prop" if fit.question.gauge else "tau_n"):
        if name not in c.free:
            continue

        def figure(known: Mapping[str, float], name: str = name) -> float:
            return known[name] + (known.get("damping", 0.0) if name == "p" else 0.0)

        alone = side.parameters[name].value
        assert alone is not None
        if abs(figure(values) - alone) > APART * _deviation_apart(
            fit, side, name, c.gradient(figure, vector), stretches
        ):
            return False
    return True


def _deviation_apart(fit: ShipFit, side: LoadSide, name: str, gradient: Array, stretches: Stretches) -> float:
    """Standard deviation of the difference of two estimates that share data, systematic errors and priors.

    Each stretch of the records, systematic error and prior has an influence on both estimates; equal influences cancel in
    the difference (Hampel 1974, doi:10.1080/01621459.1974.10482962).
    """
    likelihood, equation, unknown = fit.likelihood, side.equation, side.places[name]
    apart, errors, priors = stretches.influence(gradient)
    alone, first = [], likelihood.records[0].outputs
    speed, torque = first.index("dn"), first.index("dM")
    for index, record in enumerate(likelihood.records):
        along = equation.influence(unknown, index)
        count = len(along)
        rows = np.zeros((2, 1, len(record.frequency_hz)), complex)
        rows[:, 0, :count] = along, equation.records[index].noise
        alone.append(by_stretch(record, rows[:1], rows[1])[0])
        shapes = likelihood._shapes[index][..., :count]
        bent = shapes[:, torque] - np.array([equation.answer_to(one, index) for one in shapes[:, speed]])
        errors = errors - (bent @ along.conj()).real
    own = equation.inverse[unknown, : equation.main] * np.sqrt(equation.prior[: equation.main])
    rows_of = {key: row for row, key in enumerate(likelihood.priors)}
    for key in {"c_2", "T_M"} & rows_of.keys():
        priors[rows_of[key]] -= own[SHARED.index(key)]
        own[SHARED.index(key)] = 0.0
    parts = (apart - np.concatenate(alone), errors, priors, own)
    return float(np.sqrt(sum(float(one @ one) for one in parts)))


def load_alone(
    parameters: Mapping[str, Estimate],
    side: LoadSide | None,
    kind: str,
    bounds: Mapping[str, tuple[float, float]],
) -> dict[str, Estimate]:
    """Return estimates with the load's from its side alone, within bounds, and without the engine's."""
    reason = Sentence("drive and governor are not described: {what}", what=KINDS[kind])
    found = {}
    for name, one in parameters.items():
        if one.status == "fixed" and one.reason in ("given", ASSUMED):
            found[name] = one
        elif side is not None and name in side.parameters:
            found[name] = _within(side.parameters[name], one.unit, bounds.get(name, (-np.inf, np.inf)))
        else:
            found[name] = unidentifiable(reason, one.unit)
    return found


def _within(estimate: Estimate, unit: str, bounds: tuple[float, float]) -> Estimate:
    assert estimate.value is not None
    assert estimate.ci95 is not None
    value, low, high = (float(np.clip(one, *bounds)) for one in (estimate.value, *estimate.ci95))
    return replace(estimate, value=value, ci95=(low, high), unit=unit)


def covariance_of(parameters: Mapping[str, Estimate], side: LoadSide) -> dict[str, object]:
    """Return names and covariance of the parameters that the load's side determines."""
    every = list(side.parameters)
    names = [name for name in every if name in parameters and parameters[name].status in ("free", "prior")]
    places = [every.index(name) for name in names]
    return {"names": names, "matrix": side.covariance[np.ix_(places, places)].tolist()}
