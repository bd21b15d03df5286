"""The fit of a ship: the full smooth model, and limits and a twist where the record comes near one.

Both dead times, the lag and the load's second-order coefficient are always there, each bounded by off. What goes to off only
in a jump, a limit of torque or rate, or off only in a limit, a shaft that twists, is tried beside them and stays where the
deviance falls by more than chance allows.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from shipfp_rs.errors import IdentificationError, SimulationError
from shipfp_rs.identification.adequacy import misses_pct
from shipfp_rs.identification.basins import Basin, best_basins, descend, distinct
from shipfp_rs.identification.first_guesses import first_guesses
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.question import TRIED, Question
from shipfp_rs.identification.record import STEP_S
from shipfp_rs.support.arrays import Array

COARSE_STEP_S = 0.01
"""Longest step of the search and of profiles [s]; the last descent takes finer ones."""
LEAST_STEP_S = 1e-3
PART, FINE_PART = 0.4, 0.15
"""Step over the loop's quickest time constant, of the search and of the last descent."""
UNSEEN_PCT = 0.3
"""Where the model misses less than this of every response no element is tried: gauge and calibration leave as much open."""
ROUNDS = 3
"""Descents with an element that was taken, the noise and the water from the end before."""
BELIEVED = 25.0
"""Fall of the deviance from which an element that is tried is taken. Chance gives 14 once in 1,000 with two parameters; what
the model leaves out elsewhere gives as much again."""


@dataclass(frozen=True)
class ShipFit:
    """The end of a search.

    `gains` tells of each element tried by how much the deviance fell with it; `elements` those that stayed.
    """

    question: Question
    likelihood: Likelihood
    basins: tuple[Basin, ...]
    elements: tuple[str, ...]
    gains: Mapping[str, float]
    smooth: bool | None

    @property
    def best(self) -> Basin:
        """The lowest minimum."""
        return self.basins[0]

    @property
    def values(self) -> dict[str, float]:
        """Parameters at the best minimum."""
        return self.likelihood.coordinates.values(self.best.vector)


def fit_ship(question: Question, *, time_limit_s: float | None = None) -> ShipFit:
    """Search the ship that explains the data best.

    Raises
    ------
    IdentificationError
        Where no start leads to a ship that can be simulated.
    """
    until = None if time_limit_s is None else time.monotonic() + time_limit_s
    # Not low-passed by processing, a set point may run straight between its samples or be band-limited: both are tried.
    undecided = any(one.hold == "first" and not one.is_low_passed for one in question.experiments)
    smooth: bool | None = True if undecided else None
    likelihood = question.likelihood((), COARSE_STEP_S, smooth)
    guesses = first_guesses(likelihood.records, question.outputs, question.gauge)
    likelihood = question.likelihood((), min(step_for(guess, PART) for guess in guesses), smooth)
    starts = [likelihood.coordinates.vector({"c_2": 0.0, **DEFAULTS, **guess}) for guess in guesses]
    try:
        likelihood, basins = best_basins(likelihood, starts, until=until)
    except SimulationError as error:
        raise IdentificationError(f"identify: {error}") from error
    if undecided:
        step_s = step_for(likelihood.coordinates.values(basins[0].vector), PART)
        straight = question.likelihood((), step_s, False).with_noise_of(likelihood)
        end = descend(straight, basins[0].vector, until=until)
        if end.cost < basins[0].cost - 1.0:
            smooth, likelihood = False, straight
            ends = [descend(straight, one.vector, until=until) for one in basins]
            basins = distinct(straight, ends)
    fit = ShipFit(question, likelihood, tuple(basins), (), {}, smooth)
    fit = _with_elements(fit, until)
    return refined(fit, until)


DEFAULTS: Mapping[str, float] = {
    "tau_n": 1.2, "g": -0.5, "vK_p": 5.0, "vK_i": 5.0, "p": 2.0, "tau_prop": 0.4,
    "vK_d": 0.01, "damping": 0.0, "T_M": 1e-3, "T_n": 1e-3, "v": 1.2, "k_L": 1.0,
    "M_max": 1.2, "M_soft": 5e-3, "hold": 0.5, "rate": 1.0, "tau_twist": 2e-3, "zeta_twist": 0.5,
}  # fmt: skip
"""Where a parameter begins that no regression tells."""


def _with_elements(fit: ShipFit, until: float | None) -> ShipFit:
    """Try the elements one after the other where something is missed, and keep those that the deviance asks for."""
    gains: dict[str, float] = {}
    while True:
        missing = max(misses_pct(fit.likelihood, fit.best.vector)) > UNSEEN_PCT
        trials: list[tuple[float, str, Likelihood, Basin]] = []
        for element in fit.question.tried:
            # A limit leaves a miss; a twist hides in the inertia behind the gauge and in the delays.
            if element in fit.elements or not (missing or element == "twist"):
                continue
            found = _trial(fit, element, until)
            if found is None:
                continue
            likelihood, end = found
            gains[element] = fit.best.cost - end.cost
            if gains[element] > BELIEVED:
                trials.append((end.cost, element, likelihood, end))
        if not trials:
            return replace(fit, gains=gains)
        _, element, likelihood, end = min(trials, key=lambda trial: trial[0])
        # With less left over the noise is less, and what else acts is seen.
        basin = end
        for _ in range(ROUNDS):
            likelihood = likelihood.with_noise(basin.vector).with_water(basin.vector)
            basin = descend(likelihood, basin.vector, until=until)
        fit = replace(fit, likelihood=likelihood, basins=(basin,), elements=(*fit.elements, element))


def _trial(fit: ShipFit, element: str, until: float | None) -> tuple[Likelihood, Basin] | None:
    """Return the best end with an element beside those that act; None where the record comes near none."""
    starts = [start for basin in fit.basins[:2] for start in _starts(fit, element, basin)]
    if not starts:
        return None
    elements = (*fit.elements, element)
    step_s = step_for(fit.values, PART)
    likelihood = fit.question.likelihood(elements, step_s, fit.smooth).with_noise_of(fit.likelihood)
    c = likelihood.coordinates
    vectors = []
    for values, states in starts:
        vectors.append(c.vector({**DEFAULTS, **values}, states))
    ends = sorted(
        (descend(likelihood, x, steps=8, settled=10.0, until=until) for x in vectors), key=lambda e: e.cost
    )
    ends = [descend(likelihood, end.vector, steps=40, settled=0.1, until=until) for end in ends[:2]]
    best = min(ends, key=lambda end: end.cost)
    low, high = c.bounds
    place = c.place(TRIED[element][0])
    # On its bound it stands in for something else.
    stands_in = best.vector[place] <= low[place] + 1e-6 or best.vector[place] >= high[place] - 1e-6
    return (likelihood, best) if np.isfinite(best.cost) and not stands_in else None


def _starts(fit: ShipFit, element: str, basin: Basin) -> list[tuple[dict[str, float], list[Array]]]:
    """Values to begin with: from the record's own plateaus and steepest slopes."""
    c = fit.likelihood.coordinates
    values = c.values(basin.vector)
    states = [basin.vector[c.states(record)] for record in range(c.records)]
    if element == "twist":
        return [
            (
                {
                    **values,
                    "tau_twist": twist,
                    "tau_prop": max(values["tau_prop"], 0.3 * values["tau_n"])
                    if not fit.question.gauge
                    else values["tau_prop"],
                },
                states,
            )
            for twist in (1e-3, 4e-3)
        ]
    if "dM" not in fit.question.outputs:
        return []
    torque = np.concatenate(
        [one.decimated[fit.question.outputs.index("dM")] for one in fit.likelihood.records]
    )
    if element == "torque_limit":
        # A gauge behind the engine's inertia shows more than the engine gives while the shaft slows.
        levels = np.quantile(torque, (0.9, 0.97, 0.995))
        return [({**values, "M_max": float(np.clip(1.0 + level, 1.02, 4.5))}, states) for level in levels]
    rate_hz = fit.likelihood.records[0].data_hz / fit.likelihood.records[0].down
    slopes = np.quantile(np.abs(np.diff(torque)) * rate_hz, (0.9, 0.99))
    # Without a rate limit the gains are taken for too small.
    return [
        (
            {
                **values,
                "rate": float(np.clip(slope, 0.03, 50.0)),
                "vK_p": values["vK_p"] * more,
                "vK_i": values["vK_i"] * more,
            },
            states,
        )
        for slope in slopes
        for more in (1.0, 2.0, 4.0)
    ]


def refined(fit: ShipFit, until: float | None = None) -> ShipFit:
    """Go down once more at the fine step, with the noise of the end."""
    step_s = min(STEP_S, step_for(fit.values, FINE_PART))
    likelihood = fit.question.likelihood(fit.elements, step_s, fit.smooth).with_noise_of(fit.likelihood)
    ends = distinct(likelihood, [descend(likelihood, one.vector, until=until) for one in fit.basins])
    if not ends:
        raise IdentificationError("identify: the ship found can't be simulated at a fine step")
    likelihood = likelihood.with_noise(ends[0].vector).with_water(ends[0].vector)
    ends = distinct(likelihood, [descend(likelihood, one.vector, until=until) for one in ends])
    return replace(fit, likelihood=likelihood, basins=tuple(ends))


def step_for(values: Mapping[str, float], part: float) -> float:
    """Return the step for a loop [s]: a part of its quickest time constant."""
    quickest = (abs(values.get("p", 2.0) - values["g"]) + values["vK_p"]) / values["tau_n"]
    return float(np.clip(part / max(quickest, 1e-9), LEAST_STEP_S, COARSE_STEP_S))
