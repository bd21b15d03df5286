"""How a search goes: the options of `identify`, and what they demand of the structure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.identification.blocks import Offsets
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support import hints

Weighting = Literal["determinant", "variance", "std", "none"]
NoiseModel = Literal["white", "ar", "innovations"]
Covariance = Literal["model", "sandwich"]
Intervals = Literal["profile", "symmetric"]
MOST_STARTS = 10_000
"""Starts of a search; each takes a second or so."""


@dataclass(frozen=True)
class Options:
    """How to search: the options of `identify`, where they are explained."""

    weighting: Weighting
    noise: NoiseModel | None
    covariance: Covariance | None
    intervals: Intervals
    huber: float | None
    ridge: Mapping[str, tuple[float, float]] | None
    offsets: Offsets | None
    initial_state: Literal["estimated", "zero"] | Mapping[str, float]
    random_search: int
    starts: int | None
    seed: int | None
    max_evaluations: int
    tolerance: float
    time_limit_s: float | None
    progress: Callable[[int, int], None] | None

    @property
    def given_state(self) -> dict[str, float]:
        """Return the initial state where it is given."""
        return dict(self.initial_state) if isinstance(self.initial_state, Mapping) else {}

    def starts_for(self, structure: Structure) -> int:
        """Return the number of starts; by default five where a dead time is free, since the cost has several minima then."""
        if self.starts is not None:
            return self.starts
        return 5 if any(parameter.name in ("T_d", "T_set") for parameter in structure.free) else 1

    def offsets_for(self, structure: Structure) -> Offsets:
        """Return the offsets; by default none where the structure has unknowns of its own for them."""
        return not structure.equations.own_offsets if self.offsets is None else self.offsets

    def require(self, structure: Structure) -> None:
        """Refuse what can't be, or not with this structure.

        Raises
        ------
        InputError
            For an unknown value, a name that the structure has not, or two options that exclude each other.
        """
        _require_one_of("weighting", self.weighting, Weighting)
        if self.noise is not None:
            _require_one_of("noise", self.noise, NoiseModel)
        if self.covariance is not None:
            _require_one_of("covariance", self.covariance, Covariance)
        _require_one_of("intervals", self.intervals, Intervals)
        if self.starts is not None and not 1 <= self.starts <= MOST_STARTS:
            raise InputError(f"starts is {self.starts}, expected 1 to {MOST_STARTS}")
        if self.offsets not in (None, True, False, "relative"):
            raise InputError(f"offsets {self.offsets!r}, expected True, False or 'relative'")
        if self.offsets == "relative" and structure.equations.own_offsets:
            # Together they make any response out of nothing: what is asked for as much too small as answered too large.
            raise InputError(
                f"offsets 'relative': structure {structure.name!r} has unknowns of its own for a set point and a torque "
                "that are read wrong by a part; leave offsets out"
            )
        _require_names(structure, self.ridge or {}, self.given_state)
        if self.weighting == "none" and any(parameter.prior is not None for parameter in structure.free):
            raise InputError(
                "a prior needs residuals in units of their deviation; choose weighting 'determinant' or 'variance'"
            )
        if self.noise == "innovations" and self.offsets == "relative":
            raise InputError("noise 'innovations' knows no relative offsets; leave offsets as they are")
        if self.noise == "innovations" and self.initial_state != "estimated":
            raise InputError("noise 'innovations' estimates the initial state; leave initial_state as it is")


def _require_one_of(name: str, found: str, known: Any) -> None:
    if found not in get_args(known):
        raise InputError(f"{name} {found!r}, expected one of {', '.join(get_args(known))}")


def _require_names(
    structure: Structure, ridge: Mapping[str, tuple[float, float]], initial: Mapping[str, float]
) -> None:
    free = [parameter.name for parameter in structure.free]
    for name, (nominal, weight) in ridge.items():
        if name not in free:
            raise InputError(f"ridge: no free parameter {name!r}, {hints.suggestion(name, free)}")
        if not (np.isfinite(nominal) and np.isfinite(weight) and weight >= 0):
            raise InputError(
                f"ridge of {name}: ({nominal}, {weight}), expected a finite value and a weight from 0 up"
            )
    for name in initial:
        if name not in structure.equations.states:
            known = ", ".join(structure.equations.states) or "none"
            raise InputError(
                f"initial_state: no state {name!r} in structure {structure.name!r}; it has {known}"
            )
