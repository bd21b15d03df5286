"""Comparison of the load's and the engine's side: which estimates remain valid if the model does not describe the engine.

The load's side is identified without a governor. If the engine's side shows effects that no model explains, the fit's
estimates of the engine are invalid. Then only the estimates from the load's side are reported (cut inference, Plummer 2015,
doi:10.1007/s11222-014-9503-z).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from shipfp_rs.identification.adequacy import LARGE_MISS_PCT, LEAST_EXPLAINED_PCT
from shipfp_rs.identification.coordinates import COMBINED
from shipfp_rs.identification.engine_tests import suspected
from shipfp_rs.identification.estimate import ASSUMED, Estimate, unidentifiable
from shipfp_rs.identification.limited_ship import removed_share
from shipfp_rs.identification.load_side import LoadSide
from shipfp_rs.identification.ship_found import DISCREPANCY, ShipFit
from shipfp_rs.support.sentences import Sentence

APART = 3.5
"""Distance from a prior's mean, in standard deviations, beyond which an estimate is implausible; chance exceeds it once in
two thousand."""
MOST_REMOVED = 0.5
"""Standard deviation of the torque that limits remove, relative to the torque's, above which no model of an actuator is
accurate enough: its errors, some per cent of the removed torque, exceed the noise tenfold."""
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
}
"""Sentence about the engine's side for each kind of contradiction."""


def undescribed(fit: ShipFit, misses_pct: Sequence[float], explained_pct: Sequence[float]) -> str | None:
    """Return the key of `KINDS` for which the data contradict the model of drive and governor, or None."""
    likelihood = fit.likelihood
    if likelihood.limited and removed_share(likelihood, fit.best.vector) > MOST_REMOVED:
        return "limit"
    if (kind := suspected(fit.scores, 1.0 if fit.is_smooth else DISCREPANCY)) is not None:
        return kind
    poor = max(misses_pct) > LARGE_MISS_PCT or min(explained_pct) < LEAST_EXPLAINED_PCT
    # A torque that certainly rises with the speed is a load.
    if poor and fit.side is not None and (fit.side.parameters["p"].ci95 or (0.0,))[0] > 0.0:
        return "misfit"
    return "prior" if _contradicts_priors(fit) else None


def _contradicts_priors(fit: ShipFit) -> bool:
    """Whether a parameter is far from its prior: it then compensates for an effect that the model lacks."""
    values, known = fit.values, fit.likelihood.priors
    return any(
        abs((COMBINED[name](values)[0] if name in COMBINED else values[name]) - mean) > APART * deviation
        for name, (mean, deviation) in known.items()
        if name not in fit.question.priors and name != "g"
    )


def load_alone(
    parameters: Mapping[str, Estimate],
    side: LoadSide | None,
    kind: str,
    bounds: Mapping[str, tuple[float, float]],
) -> dict[str, Estimate]:
    """Return the load's estimates from its side alone, within bounds; all others are unidentifiable unless fixed."""
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
