"""Plausible sizes of the numbers in a vessel file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from shipfp_rs.support import hints
from shipfp_rs.support.toml import unexpected


class Size(NamedTuple):
    """Range of a number in a vessel file, and common wrong units for it."""

    key: str
    low: float
    high: float
    slips: Sequence[hints.Slip]
    unit: str
    owner: str

    def require(self, value: float) -> None:
        """Refuse a value that a wrong unit explains, or that is ten times beyond its range."""
        hint = hints.likely(value, self.low, self.high, self.slips, self.unit)
        if hint or not 0.1 * self.low < value < 10.0 * self.high:
            expected = f"{self.low:.4g} to {self.high:.4g} {self.unit} as {self.owner} would have{hint}"
            raise unexpected(self.key, f"{value:g} {self.unit}", expected)
