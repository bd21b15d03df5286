"""Glossary of drive-train identification: symbol, meaning, formula, unit, and names elsewhere."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources


@dataclass(frozen=True)
class Term:
    """An entry of the glossary."""

    symbol: str  # in code, results and reports
    meaning: str
    unit: str = "-"  # in a fingerprint; "-" for a ratio
    formula: str = ""  # in symbols of the glossary; empty if the meaning is a sufficient definition
    elsewhere: str = ""  # name in the thesis, MATLAB's System Identification Toolbox or python-control


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
"""Combinations that data may determine although they do not determine each parameter."""
OBJECTS = _GROUPS["objects"]
"""Objects of the package, and the measure of fit."""
FORMULAS = _GROUPS["formulas"]
"""Symbols in the formulas of parameters that are not themselves parameters."""

GLOSSARY: Mapping[str, Term] = {term.symbol: term for term in (*SIGNALS, *LINEAR, *COMBINATIONS, *OBJECTS)}
"""All terms by symbol."""


def term(symbol: str) -> Term:
    """Return a symbol's entry, also for a component of a joint structure; an empty entry if there is none."""
    return GLOSSARY.get(symbol.partition(" (")[0], Term(symbol, ""))


def meaning(symbol: str) -> str:
    """Return the short description of a symbol; empty if the glossary has none."""
    return GLOSSARY[symbol].meaning if symbol in GLOSSARY else ""
