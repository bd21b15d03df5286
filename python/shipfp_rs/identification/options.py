"""How a search goes: the options of `identify`, and what they demand of the structure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

from shipfp_rs.errors import InputError
from shipfp_rs.structures.structure import Structure

Weighting = Literal["determinant", "variance", "std", "none"]
NoiseModel = Literal["white", "ar"]
Intervals = Literal["profile", "symmetric"]
MOST_STARTS = 10_000
"""Starts of a search; each takes a second or so."""


@dataclass(frozen=True)
class Options:
    """How to search: the options of `identify`, where they are explained."""

    weighting: Weighting = "determinant"
    noise: NoiseModel | None = None
    intervals: Intervals = "profile"
    starts: int | None = None
    seed: int | None = 0
    time_limit_s: float | None = None
    at_rest: bool = False
    """Whether records start at rest and at their operating points, so that no initial state or offset is estimated."""

    def starts_for(self, structure: Structure) -> int:
        """Return the number of starts; by default five where a dead time is free, since the cost has several minima then."""
        if self.starts is not None:
            return self.starts
        return 5 if any(parameter.name in ("T_d", "T_set") for parameter in structure.free) else 1

    def require(self, structure: Structure) -> None:
        """Refuse what can't be, or not with this structure.

        Raises
        ------
        InputError
            For an unknown value, or a prior without weights.
        """
        _require_one_of("weighting", self.weighting, Weighting)
        if self.noise is not None:
            _require_one_of("noise", self.noise, NoiseModel)
        _require_one_of("intervals", self.intervals, Intervals)
        if self.starts is not None and not 1 <= self.starts <= MOST_STARTS:
            raise InputError(f"starts is {self.starts}, expected 1 to {MOST_STARTS}")
        if self.weighting == "none" and any(parameter.prior is not None for parameter in structure.free):
            raise InputError(
                "a prior needs residuals in units of their deviation; choose weighting 'determinant' or 'variance'"
            )


def _require_one_of(name: str, found: str, known: Any) -> None:
    if found not in get_args(known):
        raise InputError(f"{name} {found!r}, expected one of {', '.join(get_args(known))}")
