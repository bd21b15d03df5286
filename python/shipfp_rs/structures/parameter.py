"""A parameter of a structure: name, start, bounds and prior knowledge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.structures import glossary
from shipfp_rs.structures.ties import Tie
from shipfp_rs.support.arguments import check_fields

DECADES = 30.0
"""Ratio of positive bounds above which the logarithm of a parameter is searched."""


@dataclass(frozen=True)
class Parameter:
    """A parameter: name, unit, start, bounds; optionally fixed at its start, with a prior (mean, deviation), or tied."""

    name: str
    unit: str
    start: float
    lower: float
    upper: float
    fixed: bool = False
    prior: tuple[float, float] | None = None
    tied: Tie | None = None

    def __post_init__(self) -> None:
        check_fields(self, f"parameter {self.name}")
        if not np.isfinite(self.start):
            raise InputError(f"parameter {self.name}: start is {self.start}, expected a finite number")
        if self.fixed or self.tied is not None:
            return
        if not self.lower < self.upper:
            raise InputError(
                f"parameter {self.name}: bounds {self.lower:g} to {self.upper:g} hold no value between them"
            )
        if not self.lower <= self.start <= self.upper:
            raise InputError(
                f"parameter {self.name}: start {self.start:g} is outside its bounds {self.lower:g} to {self.upper:g}; "
                "widen the bounds or move the start"
            )
        if self.prior is not None and not (np.isfinite(self.prior[0]) and self.prior[1] > 0):
            raise InputError(
                f"parameter {self.name}: prior {self.prior}, expected a finite mean and a positive standard deviation"
            )

    @property
    def scale(self) -> float:
        """Typical size, which makes sensitivities comparable."""
        return abs(self.start) if self.start else min(1.0, self.upper - self.lower)

    @property
    def logarithmic(self) -> bool:
        """Whether its logarithm is searched."""
        return self.lower > 0.0 and self.upper / self.lower > DECADES

    def drawn(self, random: np.random.Generator) -> float:
        """Return a random start within the bounds, or near the declared start if there are none."""
        if not np.isfinite([self.lower, self.upper]).all():
            return float(self.start * (1.0 + random.normal()))
        if self.logarithmic:
            return float(np.exp(random.uniform(np.log(self.lower), np.log(self.upper))))
        return float(random.uniform(self.lower, self.upper))

    @property
    def meaning(self) -> str:
        """Short description; empty for a user parameter."""
        return glossary.meaning(self.name)
