"""Options of a search, and their requirements on the structure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

from shipfp_rs.errors import InputError
from shipfp_rs.structures.structure import Structure

NoiseModel = Literal["coloured", "white", "std"]
Intervals = Literal["profile", "symmetric"]
MOST_STARTS = 10_000
"""Most starts of a search; each takes about a second."""


@dataclass(frozen=True)
class Options:
    """Options of a search; see `identify`."""

    noise: NoiseModel | None = None
    intervals: Intervals = "profile"
    starts: int | None = None
    seed: int | None = 0
    time_limit_s: float | None = None
    at_rest: bool = False
    """Whether records were computed from rest, without initial state, offset or gauge error."""

    def starts_for(self, structure: Structure) -> int:
        """Return the number of starts; by default five where a dead time is free, since the cost then has several minima.

        A drive in open loop starts from regressions over a grid of dead times.
        """
        if self.starts is not None:
            return self.starts
        if structure.settings["kind"] == "commanded":
            return 1
        return 5 if any(parameter.name in ("T_d", "T_set") for parameter in structure.free) else 1

    def require(self) -> None:
        """Raise `InputError` for an unknown value."""
        if self.noise is not None:
            _require_one_of("noise", self.noise, NoiseModel)
        _require_one_of("intervals", self.intervals, Intervals)
        if self.starts is not None and not 1 <= self.starts <= MOST_STARTS:
            raise InputError(f"starts is {self.starts}, expected 1 to {MOST_STARTS}")


def _require_one_of(name: str, found: str, known: Any) -> None:
    if found not in get_args(known):
        raise InputError(f"{name} {found!r}, expected one of {', '.join(get_args(known))}")
