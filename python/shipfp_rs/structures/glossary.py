"""The words of drive-train identification: symbol, meaning, formula, unit, and what others call it."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources


@dataclass(frozen=True)
class Term:
    """One entry of the glossary.

    Parameters
    ----------
    symbol
        As in code, results and reports.
    meaning
        What it is, in a few words.
    unit
        As a fingerprint gives it; "-" for a ratio.
    formula
        Definition, in the symbols of the glossary; empty where the meaning says it all.
    elsewhere
        Word of the thesis, of MATLAB's System Identification Toolbox or of python-control.
    """

    symbol: str
    meaning: str
    unit: str = "-"
    formula: str = ""
    elsewhere: str = ""


def _read() -> dict[str, tuple[Term, ...]]:
    """Return the terms of `data/glossary.csv` by group."""
    groups: dict[str, tuple[Term, ...]] = {}
    with (resources.files("shipfp_rs") / "data" / "glossary.csv").open(encoding="utf-8") as lines:
        for entry in csv.DictReader(lines):
            group = entry.pop("group")
            groups[group] = (*groups.get(group, ()), Term(**entry))
    return groups


_GROUPS = _read()
SIGNALS = _GROUPS["signals"]
LINEAR = _GROUPS["linear"]
"""Parameters of the linear structure and of the ship."""
COMBINATIONS = _GROUPS["combinations"]
"""What is known where its members are not."""
OBJECTS = _GROUPS["objects"]
"""What the package hands around, and the figure that a fit is judged by."""
FORMULAS = _GROUPS["formulas"]
"""Symbols in the formulas of parameters that are no parameters themselves."""

GLOSSARY: Mapping[str, Term] = {term.symbol: term for term in (*SIGNALS, *LINEAR, *COMBINATIONS, *OBJECTS)}
"""All terms by symbol."""


def term(symbol: str) -> Term:
    """Return a symbol's entry; of a part of a joint structure its own, and an empty one where there is none."""
    return GLOSSARY.get(symbol.partition(" (")[0], Term(symbol, ""))


def meaning(symbol: str) -> str:
    """Return what a symbol means, in a few words; empty where the glossary has none."""
    return GLOSSARY[symbol].meaning if symbol in GLOSSARY else ""
