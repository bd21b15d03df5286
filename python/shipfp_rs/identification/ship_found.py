"""A ship as a search found it, and by which step its loop is simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.basins import Basin, descend, distinct
from shipfp_rs.identification.equation_likelihood import EquationLikelihood
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.load_side import LoadSide
from shipfp_rs.identification.question import TRIED, Question
from shipfp_rs.identification.record import STEP_S, Between
from shipfp_rs.identification.stretches import Score
from shipfp_rs.structures.elements import ELEMENTS

Grade = Literal["rough", "search", "fine"]
LIMITED = {"torque_limit", "rack_rate"}
"""Elements that have no closed form: a ship with one is simulated."""
ROUGH_STEP_S = 0.04
"""Longest step of descents from many starts [s]."""
COARSE_STEP_S = 0.01
"""Longest step of the minima that they lead to, and of profiles [s]; the last descent takes finer ones."""
LEAST_STEP_S = 1e-3
FINE_PART, PART, ROUGH_PART = 0.15, 0.4, 0.8
"""Step over the loop's quickest time constant, of the last descent, the search and its first descents."""
BELIEVED = 25.0
"""Fall of the deviance from which an element that is tried is called on. Chance gives 14 once in 1,000 with two parameters;
what the model leaves out elsewhere gives as much again."""
RECORRECTED, STILL = 8, 0.1
"""How often records are corrected by the model at most, and the square of a move, in deviations, that ends it."""
DEFAULTS: Mapping[str, float] = {
    **{parameter.name: parameter.start for element in ELEMENTS.values() for parameter in element.parameters},
    "tau_n": 1.2, "g": -0.5, "vK_p": 5.0, "vK_i": 5.0, "p": 2.0, "tau_prop": 0.4,
    "vK_d": 0.01, "damping": 0.0, "T_M": 1e-3, "T_n": 1e-3, "v": 1.2, "k_L": 1.0,
    "M_max": 1.2, "M_soft": 5e-3, "hold": 0.5, "rate": 1.0, "tau_twist": 2e-3, "zeta_twist": 0.5,
}  # fmt: skip
"""Where a parameter begins that no regression tells: an element's at its own start but for those named here."""


@dataclass(frozen=True)
class ShipFit:
    """The end of a search.

    `gains` tells of each element tried by how much the deviance fell with it; `elements` those that act in the model;
    `stiff` is the fit before a twist came in; `scores` what the engine's side shows beyond the model, by kind;
    `side` what the load's side tells by itself; `also` are other ends that are as likely, each under its own noise;
    `unlimited` is the fit before a limit came in.
    """

    question: Question
    likelihood: Likelihood
    basins: tuple[Basin, ...]
    elements: tuple[str, ...]
    gains: Mapping[str, float]
    between: Between | None
    stiff: ShipFit | None = None
    scores: Mapping[str, Score] = field(default_factory=dict)
    side: LoadSide | None = None
    also: tuple[ShipFit, ...] = ()
    unlimited: ShipFit | None = None

    @property
    def best(self) -> Basin:
        """The lowest minimum."""
        return self.basins[0]

    @cached_property
    def total(self) -> float:
        """Deviance of the best minimum under the noise of its own residuals, with that noise's determinant."""
        return self.likelihood.total(self.best.vector)

    @property
    def is_smooth(self) -> bool:
        """Whether the likelihood is that of the two equations."""
        return isinstance(self.likelihood, EquationLikelihood)

    @property
    def values(self) -> dict[str, float]:
        """Parameters at the best minimum."""
        return self.likelihood.coordinates.values(self.best.vector)

    @property
    def along(self) -> frozenset[str]:
        """Parameters of elements neither asked for nor excluded: fitted along, so that intervals allow for either."""
        names = {
            name
            for element in self.elements
            if self.gains[element] <= BELIEVED
            for name in (*TRIED[element], *(["tau_prop"] if element == "twist" else []))
        }
        return frozenset(names - set(self.question.always))


def likelihood_of(
    fit: ShipFit,
    elements: Sequence[str],
    grade: Grade = "search",
    between: Between | Literal["same"] | None = "same",
) -> Likelihood:
    """Return the likelihood of a fit's ship with some of the elements tried, under the fit's noise.

    Parameters
    ----------
    fit, elements
        What was found, and the elements that act.
    grade
        Of what is simulated the step: "rough" for first descents, "search", or "fine" for the last descent.
    between
        How the set points run between their samples; "same": as in the fit.
    """
    way = fit.between if between == "same" else between
    question, likelihood = fit.question, fit.likelihood
    if isinstance(likelihood, EquationLikelihood) and not LIMITED & set(elements):
        if way != fit.between:
            assert way is not None
            records = tuple(record.running(way) for record in likelihood.records)
            likelihood = replace(likelihood, records=records).corrected(fit.best.vector)
        return question.with_elements(likelihood, elements)
    part, longest_s = {
        "rough": (ROUGH_PART, ROUGH_STEP_S),
        "search": (PART, COARSE_STEP_S),
        "fine": (FINE_PART, STEP_S),
    }[grade]
    found = question.simulated_likelihood(elements, step_for(fit.values, part, longest_s), way)
    return found if isinstance(likelihood, EquationLikelihood) else found.with_noise_of(likelihood)


def step_for(values: Mapping[str, float], part: float, longest_s: float = COARSE_STEP_S) -> float:
    """Return the step for a loop [s]: a part of its quickest time constant."""
    quickest = (abs(values.get("p", 2.0) - values["g"]) + values["vK_p"]) / values["tau_n"]
    return float(np.clip(part / max(quickest, 1e-9), LEAST_STEP_S, longest_s))


def settled(fit: ShipFit, until: float | None) -> ShipFit:
    """Return the fit under the noise of each end in turn, until it moves no further.

    Gaps, and squares of a propeller's speed, are each end's, too.
    """
    likelihood, best = fit.likelihood, fit.best
    if not isinstance(likelihood, EquationLikelihood):
        return fit
    for _ in range(RECORRECTED):
        try:
            if likelihood.is_corrected_by_model:
                following = likelihood.corrected(best.vector).with_noise(best.vector)
            else:
                following = likelihood.with_noise(best.vector)
        except (SimulationError, np.linalg.LinAlgError):
            break
        end = descend(following, best.vector, until=until)
        moved = end.vector - best.vector
        likelihood, best = following, end
        if end.products is None or moved @ end.products.matrix @ moved < STILL:
            break
    ends = [descend(likelihood, one.vector, until=until) for one in fit.basins[1:]]
    return replace(fit, likelihood=likelihood, basins=tuple(distinct(likelihood, [best, *ends])))
