"""Hints for error messages: misspelt names, names used by other packages, and wrong units recognised by a value's size."""

from __future__ import annotations

import csv
import difflib
from abc import ABCMeta
from collections.abc import Iterable, Sequence
from functools import cache
from importlib import resources
from types import ModuleType
from typing import TYPE_CHECKING, Any

Slip = tuple[str, float]
"""A possible mistake in words, and the factor that corrects the value."""

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
    """Text that names a likely mistake: the one whose correction brings `value` between `low` and `high`.

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
    """Text that names the mistake whose correction brings a ratio to 1; empty if no correction does."""
    return next((f"; {name}?" for name, factor in slips if abs(ratio * factor - 1.0) <= within), "")


@cache
def _guesses() -> dict[tuple[str, str], str]:
    """Replacements for names used by other packages, by class ("fp" for this package) and name."""
    text = (resources.files("shipfp_rs") / "data" / "guesses.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(text.splitlines())
    return {(row["where"], name): row["instead"] for row in rows for name in row["guesses"].split()}


def no_attribute(owner: object, name: str) -> AttributeError:
    """Return the error for a missing attribute of a class, an instance or the package; its text suggests a replacement."""
    kind = owner if isinstance(owner, type) else type(owner)
    label = kind.__name__ if kind is not ModuleType else "fp"
    if name.startswith("_"):
        return AttributeError(f"{label} has no attribute {name!r}")
    found = [_guesses().get((place, name)) for place in (label, *(one.__name__ for one in kind.__mro__))]
    if getattr(owner, "__dict__", None) and isinstance(owner, Iterable) and name in owner:
        found = [f'{{owner}}["{name}"]']
    told = [f"; type {one.format(owner=label.lower(), name=name)}" for one in found if one]
    near = told[0] if told else nearest(name, [one for one in dir(owner) if not one.startswith("_")])
    return AttributeError(f"{label} has no attribute {name!r}{near}")


class HintedType(ABCMeta):
    """Metaclass of `Hinted`, which suggests replacements for missing attributes of the class itself."""

    if not TYPE_CHECKING:

        def __getattr__(cls, name: str) -> Any:
            raise no_attribute(cls, name)


class Hinted(metaclass=HintedType):
    """Base of public classes: the error of a missing attribute suggests a replacement."""

    if not TYPE_CHECKING:  # else type checkers would accept every name

        def __getattr__(self, name: str) -> Any:
            if hasattr(type(self), name):  # a property failed: raise its error again
                return object.__getattribute__(self, name)
            raise no_attribute(self, name)
