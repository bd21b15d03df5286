"""One structure fitted to the data, as the chooser compares it with others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.weighted_problem import Minimum

TRIAL_FALL = 0.02
"""Fall of the deviance that is not worth a step of a trial: what it is judged by is more than a hundred times as much."""


@dataclass(frozen=True)
class Fitted:
    """A structure fitted to the data."""

    elements: tuple[str, ...]
    search: Search
    minimum: Minimum

    @cached_property
    def base(self) -> Fitted:
        """The fit as one among its own trials: the same weights, the same passes, a sum of squares as its cost."""
        noise = replace(self.minimum.noise, sharp=False)
        search = replace(self.search, weights=noise, enough=TRIAL_FALL)
        sums = search.sums(self.minimum.vector, noise)
        criterion = float(search.gram(self.minimum.vector, noise, sums)[-1, -1])
        return Fitted(
            self.elements, search, replace(self.minimum, noise=noise, criterion=criterion, sums=sums)
        )

    @property
    def records(self) -> list[Experiment]:
        """Experiments of the search, cleared as they are."""
        return [block.data for block in self.search.blocks if isinstance(block.data, Experiment)]


def cost(fitted: Fitted) -> float:
    """Return the weighted sum of squares of a fit with given weights."""
    return fitted.minimum.criterion
