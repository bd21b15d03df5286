"""Argument checks shared by several packages."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterable

from shipfp_rs.errors import InputError

MOST_SAMPLES = 200_000_000
"""Most samples of a generated signal."""
ACCURACIES_PCT = (1e-3, 1e3)
"""Range of target accuracies [%]."""
HIDDEN = frozenset(("Cc", "Cs", "Zl", "Zp"))
"""Unicode categories of control characters, surrogates, and separators of lines and paragraphs."""
TURNING = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that change the text direction, so that a text differs from its appearance."""
LINES = {ord("\n"): " ", ord("\t"): " "}
"""Translation table for the control characters permitted in texts of several lines."""


def is_one_line(text: str) -> bool:
    """Whether a text is one line without control characters."""
    return not any(unicodedata.category(letter) in HIDDEN or letter in TURNING for letter in text)


def at_most(name: str, samples: float) -> int:
    """Convert a number of samples to an integer; `InputError` above the limit of a signal."""
    if not 0.0 <= samples <= MOST_SAMPLES:
        raise InputError(f"{name}: {samples:.3g} samples, expected 0 to {MOST_SAMPLES}")
    return round(samples)


def positive(name: str, value: float) -> None:
    """Raise `InputError` unless a value is finite and positive."""
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} is {value}, expected a positive number")


def between(name: str, value: float, low: float, high: float) -> None:
    """Raise `InputError` for a number outside a range, or NaN."""
    if not low <= value <= high:
        raise InputError(f"{name} is {value:g}, expected {low:g} to {high:g}")


def accuracy(percent: float) -> None:
    """Raise `InputError` for a target accuracy outside the range of trials."""
    least, most = ACCURACIES_PCT
    if not least <= percent <= most:
        raise InputError(f"accuracy_pct is {percent:g}, expected {least:g} to {most:g} %")


def one_of(name: str, value: str, known: Iterable[str]) -> str:
    """Return a known word; `InputError` for any other."""
    known = tuple(known)
    if value not in known:
        raise InputError(f"{name} is {value!r}, expected one of {', '.join(known)}")
    return value


def expect(holds: bool, key: str, found: object, expected: str) -> None:
    """Raise `InputError` unless the condition holds: key, value found (shortened), and expectation."""
    if not holds:
        shown = repr(found)
        raise InputError(
            f"{key}: found {shown if len(shown) < 60 else shown[:57] + '...'}, expected {expected}"
        )
