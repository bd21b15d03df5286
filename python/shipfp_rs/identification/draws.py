"""Draws of a fingerprint's parameters from their likelihood."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import Array, Brief
from shipfp_rs.support.tables import text_table

FEW = 400
"""Number of draws, counted from the first, that a prediction or a figure of the speed loop uses."""


@dataclass(frozen=True, repr=False)
class Draws(Brief):
    """Equally likely sets of parameters.

    Parameters
    ----------
    names
        Parameters and combinations of the fingerprint, in its order.
    table
        Their values in the parameters' units, shape (n, P).
    effective
        Effective number of independent sets. Weighting and resampling repeat some sets, so that it may be less than n.
    """

    names: tuple[str, ...]
    table: Array
    effective: int

    @property
    def parameters(self) -> dict[str, Array]:
        """Values (n,) of all draws by name, as `pandas.DataFrame` accepts them."""
        return dict(zip(self.names, self.table.T, strict=True))

    @property
    def sets(self) -> list[dict[str, float]]:
        """Values by name, for each draw."""
        return [dict(zip(self.names, row, strict=True)) for row in self.table.tolist()]

    def quantile(self, share: float, name: str) -> float:
        """Return a quantile of a parameter or combination; `InputError` for an unknown name, or a share outside 0 to 1."""
        if name not in self.names or not 0.0 <= share <= 1.0:
            raise InputError(
                f"quantile({share:g}, {name!r}): expected a share from 0 to 1 and one of {', '.join(self.names)}"
            )
        return float(np.quantile(self.parameters[name], share))

    def of(self, function: Callable[[Mapping[str, float]], Any]) -> list[Any]:
        """Return the values of a function of the parameters for each of the first 400 draws."""
        return [function(one) for one in self.sets[:FEW]]

    def __str__(self) -> str:
        parts = [(name, *np.quantile(row, [0.025, 0.5, 0.975])) for name, row in self.parameters.items()]
        rows = [(name, *(f"{one:.5g}" for one in ends)) for name, *ends in parts]
        return "\n".join(
            [
                *text_table(("", "2.5 %", "median", "97.5 %"), rows, left=1),
                f"{len(self.table)} draws, which tell as much as {self.effective} independent ones",
            ]
        )
