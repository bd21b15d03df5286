"""Checks of arguments that several rooms share."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterable

from shipfp_rs.errors import InputError

MOST_SAMPLES = 200_000_000
"""Most samples of a signal that is made."""
ACCURACIES_PCT = (1e-3, 1e3)
"""Relative accuracies between which a wanted one lies [%]."""
HIDDEN = frozenset(("Cc", "Cs", "Zl", "Zp"))
"""Unicode's categories of control characters, halves of characters, and separators of lines."""
TURNING = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that turn the direction of what follows, so that a text is not what it shows."""
LINES = {ord("\n"): " ", ord("\t"): " "}
"""What a text of several lines may hold, for `str.translate`."""


def is_one_line(text: str) -> bool:
    """Whether a text is one line without characters that control, rather than show."""
    return not any(unicodedata.category(letter) in HIDDEN or letter in TURNING for letter in text)


def at_most(name: str, samples: float) -> int:
    """Return a number of samples as a whole one; refuse more than a signal can have."""
    if not 0.0 <= samples <= MOST_SAMPLES:
        raise InputError(f"{name}: {samples:.3g} samples, expected 0 to {MOST_SAMPLES}")
    return round(samples)


def positive(name: str, value: float) -> None:
    """Refuse a value that is not a finite positive number."""
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} is {value}, expected a positive number")


def between(name: str, value: float, low: float, high: float) -> None:
    """Refuse a number outside a range; NaN is outside of any."""
    if not low <= value <= high:
        raise InputError(f"{name} is {value:g}, expected {low:g} to {high:g}")


def accuracy(percent: float) -> None:
    """Refuse a wanted accuracy that no trial has, and one that is none."""
    least, most = ACCURACIES_PCT
    if not least <= percent <= most:
        raise InputError(f"accuracy_pct is {percent:g}, expected {least:g} to {most:g} %")


def one_of(name: str, value: str, known: Iterable[str]) -> str:
    """Return a word that is among the known ones, or refuse it."""
    known = tuple(known)
    if value not in known:
        raise InputError(f"{name} is {value!r}, expected one of {', '.join(known)}")
    return value


def expect(holds: bool, key: str, found: object, expected: str) -> None:
    """Refuse what a file holds under a key: the key, what was found, shortened, and what was expected."""
    if not holds:
        shown = repr(found)
        raise InputError(
            f"{key}: found {shown if len(shown) < 60 else shown[:57] + '...'}, expected {expected}"
        )
