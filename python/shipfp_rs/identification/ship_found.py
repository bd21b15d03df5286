"""The fitted ship, and its likelihood with other elements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from shipfp_rs.identification.basins import Minima, descend, distinct, settle
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.load_side import LoadSide
from shipfp_rs.identification.profiles import Interval
from shipfp_rs.identification.question import Question
from shipfp_rs.identification.stretches import Score
from shipfp_rs.structures.elements import QUANTITIES
from shipfp_rs.support.arrays import Array

BELIEVED = 25.0
"""Decrease of the deviance from which a tried element counts as on. By chance, two parameters
give a decrease of 14 once in 1000; other errors of the model may give another 14."""
DISCREPANCY = 2.0
"""Factor on the standard deviations of a ship with a limit: model errors at the limit's corners shift all parameters. In
some twenty simulated ships, the true values were twice as far from the estimates as chance explains."""
RECORRECTED, STILL = 8, 0.1
"""Most descents with noise and corrections re-estimated, and the squared step, in standard deviations, below which they
stop."""
DEFAULTS: Mapping[str, float] = {one.name: one.start for one in QUANTITIES.values()}
"""Starting values of parameters without a regression."""


@dataclass(frozen=True)
class ShipFit(Minima):
    """The result of the search of a ship.

    `gains` is the decrease of the deviance by each tried element; `elements` names the tried elements that act. `scores` has
    a test result for each kind of engine-side effect that the model lacks. `side` is the result of `load_side`, without
    engine and governor. `ramp` is the interval of the set point's rate limit, if there is one. `alike` are other minima of
    a ship with limits, each under its own noise, that the data do not reject.
    """

    likelihood: Likelihood
    question: Question
    elements: tuple[str, ...] = ()
    gains: Mapping[str, float] = field(default_factory=dict)
    scores: Mapping[str, Score] = field(default_factory=dict)
    side: LoadSide | None = None
    ramp: Interval | None = None
    alike: tuple[Array, ...] = ()

    @property
    def is_smooth(self) -> bool:
        """Whether no limit acts."""
        return not self.likelihood.limited


def settled(fit: ShipFit, until: float | None) -> ShipFit:
    """Return the fit with each minimum under its own noise, iterated until the minimum no longer moves.

    Gaps, squares of a propeller's speed, and the speed that a governor with a limit saw, are estimated again.
    """
    likelihood, best = settle(fit.likelihood, fit.best, rounds=RECORRECTED, still=STILL, until=until)
    ends = [descend(likelihood, one.vector, until=until) for one in fit.basins[1:]]
    return replace(fit, likelihood=likelihood, basins=tuple(distinct(likelihood, [best, *ends])) or (best,))
