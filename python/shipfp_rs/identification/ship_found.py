"""The result of a ship's search, and descents with the noise re-estimated at each minimum."""

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
"""Largest number of descents, each with noise and corrections re-estimated, and the squared step, in standard deviations,
below which they stop."""
DEFAULTS: Mapping[str, float] = {one.name: one.start for one in QUANTITIES.values()}
"""Starting values of parameters that no regression estimates."""


@dataclass(frozen=True)
class ShipFit(Minima):
    """The result of the search of a ship."""

    likelihood: Likelihood
    question: Question
    elements: tuple[str, ...] = ()  # tried elements that act
    gains: Mapping[str, float] = field(default_factory=dict)  # decrease of the deviance by each tried element
    scores: Mapping[str, Score] = field(default_factory=dict)  # tests of engine-side effects, by kind
    side: LoadSide | None = None  # result of `load_side`, without engine and governor
    ramp: Interval | None = None  # interval of the set point's rate limit, if there is one
    alike: tuple[Array, ...] = ()  # other minima that the data do not reject, each with its own noise

    @property
    def is_smooth(self) -> bool:
        """Whether no limit acts."""
        return not self.likelihood.limited


def settled(fit: ShipFit, until: float | None) -> ShipFit:
    """Return the fit with the noise and corrections of its best minimum, iterated until this minimum no longer moves."""
    # Corrections: gaps, squares of a propeller's speed, and the speed that a governor with a limit saw.
    likelihood, best = settle(fit.likelihood, fit.best, rounds=RECORRECTED, still=STILL, until=until)
    ends = [descend(likelihood, one.vector, until=until) for one in fit.basins[1:]]
    return replace(fit, likelihood=likelihood, basins=tuple(distinct(likelihood, [best, *ends])) or (best,))
