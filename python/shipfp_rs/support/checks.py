"""Checks of arguments that several rooms share."""

from __future__ import annotations

import math
from collections.abc import Iterable

from shipfp_rs.errors import InputError


def positive(name: str, value: float) -> None:
    """Refuse a value that is not a finite positive number."""
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} is {value}, expected a positive number")


def one_of(name: str, value: str, known: Iterable[str]) -> str:
    """Return a word that is among the known ones, or refuse it."""
    known = tuple(known)
    if value not in known:
        raise InputError(f"{name} is {value!r}, expected one of {', '.join(known)}")
    return value
