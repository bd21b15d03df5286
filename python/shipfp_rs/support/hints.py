"""Hints for error messages: misspelt names, and wrong units recognised by a value's size."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

Slip = tuple[str, float]
"""Possible mistakes in words, each with the factor that corrects the value."""

SPEED_RPM: Sequence[Slip] = (("rev/s for rpm", 60.0), ("rad/s for rpm", 9.549297))
SPEED_RPS: Sequence[Slip] = (("rpm for rev/s", 1.0 / 60.0), ("rad/s for rev/s", 0.1591549))
TORQUE: Sequence[Slip] = (("kNm for Nm", 1e3),)
LENGTH_M: Sequence[Slip] = (("mm for m", 1e-3),)
DENSITY: Sequence[Slip] = (("t/m3 for kg/m3", 1e3),)
TIME_S: Sequence[Slip] = (("ms for s", 1e-3),)
PEAK_TO_PEAK: Sequence[Slip] = (("peak to peak for amplitude", 0.5),)


def nearest(word: str, known: Sequence[str], cutoff: float = 0.6) -> str:
    """Text "; did you mean ...?" for the nearest known word, or an empty string."""
    near = difflib.get_close_matches(word, known, n=1, cutoff=cutoff)
    return f"; did you mean {near[0]!r}?" if near else ""


def suggestion(word: str, known: Sequence[str]) -> str:
    """Text "did you mean ...?" for the nearest known word, or the list of all known ones."""
    return nearest(word, known).removeprefix("; ") or f"expected one of {', '.join(known)}"


def likely(value: float, low: float, high: float, slips: Sequence[Slip], unit: str = "") -> str:
    """Text for the mistake whose correction brings `value` between `low` and `high`.

    Empty if no correction does, or if the value is already in this range.

    Examples
    --------
    >>> likely(21.667, 600.0, 2400.0, SPEED_RPM, "rpm")
    '; rev/s for rpm? that is 1300 rpm'
    """
    if low <= value <= high:
        return ""
    for name, factor in slips:
        if low <= value * factor <= high:
            return f"; {name}? that is {value * factor:.4g}{f' {unit}' if unit else ''}"
    return ""


def likely_ratio(ratio: float, slips: Sequence[Slip], within: float = 0.1) -> str:
    """Text for the mistake whose correction brings a ratio to 1; empty if no correction does."""
    return next((f"; {name}?" for name, factor in slips if abs(ratio * factor - 1.0) <= within), "")
