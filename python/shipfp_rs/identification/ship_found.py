"""The ship that a search found, and the time step with which its loop is simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.basins import Basin, descend, distinct
from shipfp_rs.identification.equation_likelihood import EquationLikelihood
from shipfp_rs.identification.limited_likelihood import LimitedLikelihood
from shipfp_rs.identification.load_side import LoadSide
from shipfp_rs.identification.question import TRIED, Question
from shipfp_rs.identification.sampling import Between
from shipfp_rs.identification.stretches import Score
from shipfp_rs.structures.elements import ELEMENTS

LIMITED = {"torque_limit", "rack_rate", "rack_rate_down"}
"""Elements of which only simulations know what they take off."""
BELIEVED = 25.0
"""Fall of the deviance from which an element that is tried is called on. Chance gives 14 once in 1,000 with two parameters;
what the model leaves out elsewhere gives as much again."""
DISCREPANCY = 2.0
"""Factor on the standard deviations of a ship with a limit. Errors of its simulations, at corners and in the water's shape,
move all parameters together: on some twenty simulated ships the truth was twice as far away as chance explains."""
RECORRECTED, STILL = 8, 0.1
"""Most corrections of the records by the model; the squared move, in standard deviations, below which they end."""
DEFAULTS: Mapping[str, float] = {
    **{parameter.name: parameter.start for element in ELEMENTS.values() for parameter in element.parameters},
    "tau_n": 1.2, "g": -0.5, "vK_p": 5.0, "vK_i": 5.0, "p": 2.0, "tau_prop": 0.4,
    "vK_d": 0.01, "damping": 0.0, "T_M": 1e-3, "T_n": 1e-3, "v": 1.2, "k_L": 1.0,
    "M_max": 1.2, "M_soft": 5e-3, "hold": 0.5, "rate": 1.0, "tau_twist": 2e-3, "zeta_twist": 0.5,
}  # fmt: skip
"""Starting values of parameters that no regression gives: those of the elements, overridden by the ones named here."""


@dataclass(frozen=True)
class ShipFit:
    """The end of a search.

    `gains` tells of each element tried by how much the deviance fell with it; `elements` those that act in the model;
    `stiff` is the fit before a twist came in; `scores` what the engine's side shows beyond the model, by kind;
    `side` what the load's side tells by itself; `also` are other ends that are as likely, each under its own noise.
    """

    question: Question
    likelihood: EquationLikelihood
    basins: tuple[Basin, ...]
    elements: tuple[str, ...]
    gains: Mapping[str, float]
    between: Between | None
    stiff: ShipFit | None = None
    scores: Mapping[str, Score] = field(default_factory=dict)
    side: LoadSide | None = None
    also: tuple[ShipFit, ...] = ()

    @property
    def best(self) -> Basin:
        """The lowest minimum."""
        return self.basins[0]

    @cached_property
    def total(self) -> float:
        """Deviance of the best minimum, log determinant included, with the noise estimated from its own residuals."""
        return self.likelihood.total(self.best.vector)

    @property
    def is_smooth(self) -> bool:
        """Whether no limit acts."""
        return not isinstance(self.likelihood, LimitedLikelihood)

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
    between: Between | Literal["same"] | None = "same",
) -> EquationLikelihood:
    """Return the likelihood of a fit's ship with some of the elements tried, under the fit's noise.

    Parameters
    ----------
    fit, elements
        What was found, and the elements that act.
    between
        How the set points run between their samples; "same": as in the fit.
    """
    likelihood, way = fit.likelihood, fit.between if between == "same" else between
    if way != fit.between:
        assert way is not None
        records = tuple(record.running(way) for record in likelihood.records)
        likelihood = replace(likelihood, records=records).corrected(fit.best.vector)
    found = fit.question.with_elements(likelihood, elements)
    if isinstance(found, LimitedLikelihood) and fit.side is not None:
        told = {name: one.value for name, one in fit.side.parameters.items() if one.value is not None}
        found = replace(found, law=told)
    if isinstance(found, LimitedLikelihood) and isinstance(likelihood, LimitedLikelihood):
        found = replace(found, water_hz=likelihood.water_hz)
    return found


def settled(fit: ShipFit, until: float | None) -> ShipFit:
    """Return the fit under the noise of each end in turn, until it moves no further.

    Gaps, squares of a propeller's speed, and the water that moves a ship in its limit, are each end's, too.
    """
    likelihood, best = fit.likelihood, fit.best
    for _ in range(RECORRECTED):
        try:
            following = likelihood.resettled_at(best.vector)
        except (SimulationError, np.linalg.LinAlgError):
            break
        end = descend(following, best.vector, until=until)
        if not np.isfinite(end.cost):  # corrected by itself it runs away
            break
        moved = end.vector - best.vector
        likelihood, best = following, end
        if end.products is None or moved @ end.products.matrix @ moved < STILL:
            break
    ends = [descend(likelihood, one.vector, until=until) for one in fit.basins[1:]]
    return replace(fit, likelihood=likelihood, basins=tuple(distinct(likelihood, [best, *ends])) or (best,))
