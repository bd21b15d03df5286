"""The layout of `fingerprint.json`, held against what a file holds before anything is made of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, get_args

from shipfp_rs.identification.estimate import Usable, WhyNot
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.checks import is_one_line

TABLES = (
    "parameters",
    "derived",
    "identifiability",
    "fit",
    "structure",
    "settings",
    "versions",
    "covariance",
)
OPTIONAL_TABLES = ("residuals", "elements", "adequate", "si")
ROWS = ("parameters", "derived", "fit", "residuals", "elements", "si")
"""Tables of tables."""
REBUILT = ("linear", "ship")
"""Kinds of structures that a file tells whole."""
STATES = ("on", "off", "open")
"""What the data can say of an element of the ship."""


def require_layout(content: Mapping[str, Any]) -> None:
    """Raise `ValueError`, a line about one key, where a file is not laid out as a fingerprint is."""
    for key in (*TABLES, *(key for key in OPTIONAL_TABLES if key in content)):
        _table(content[key], key)
    for key in ROWS:
        for name, row in content.get(key, {}).items():
            _table(row, f"{key}.{name}")
    for key, texts in (
        ("parameters", ("unit", "status", "reason")),
        ("derived", ("unit", "status", "reason")),
        ("si", ("unit",)),
    ):
        for name, row in content.get(key, {}).items():
            _require_estimate(f"{key}.{name}", row, texts)
    for name, row in content["fit"].items():
        for figure, found in row.items():
            _require_figure(f"fit.{name}.{figure}", found)
            is_share = not figure.endswith("_p") or found is None or 0.0 <= found <= 1.0
            _require(is_share, f"fit.{name}.{figure}", found, "a probability")
    for name, row in content.get("elements", {}).items():
        _require(row.get("state") in STATES, f"elements.{name}.state", row.get("state"), " or ".join(STATES))
    vessel, structure = content["vessel"], content["structure"]
    _require(vessel is None or isinstance(vessel, str), "vessel", vessel, "a text or null")
    for name, row in _table(structure.get("parameters", {}), "structure.parameters").items():
        _table(row, f"structure.parameters.{name}")
    if structure.get("kind") in REBUILT:
        Structure.from_dict(structure)
    _require(isinstance(structure.get("name", ""), str), "structure.name", structure.get("name"), "a text")
    outputs = structure.get("outputs", [])
    named = isinstance(outputs, list) and all(isinstance(output, str) for output in outputs)
    _require(named, "structure.outputs", outputs, "a list of texts")
    for key, words in (("usability", Usable), ("why_not", WhyNot)):
        found = content.get(key, "")
        _require(found in get_args(words), key, found, "one of " + ", ".join(map(repr, get_args(words))))
    for key, kind in (("verdict", str), ("data", dict)):
        entries = content[key]
        _require(
            isinstance(entries, list) and all(isinstance(one, kind) for one in entries),
            key,
            entries,
            "a list",
        )
    _require_covariance(content["covariance"], content["parameters"])
    optimum = _table(content["settings"].get("optimum", {}), "settings.optimum")
    for name, value in optimum.items():
        _require(_is_number(value), f"settings.optimum.{name}", value, "a number")
    for name in content["parameters"] if "optimum" in content["settings"] else ():
        _require(name in optimum, f"settings.optimum.{name}", "nothing", "a number")


def _require_estimate(key: str, row: Mapping[str, Any], texts: Sequence[str]) -> None:
    """Value, standard deviation and interval, none of which can be told without the value."""
    for text in texts:
        _require(isinstance(row[text], str) and is_one_line(row[text]), f"{key}.{text}", row[text], "a text")
    for figure in ("value", "std"):
        _require_figure(f"{key}.{figure}", row[figure])
    _require_interval(f"{key}.ci95", row["ci95"])
    value, ends = row["value"], row["ci95"]
    _require(
        row["std"] is None or value is not None,
        f"{key}.value",
        None,
        "a number, since there is a standard deviation",
    )
    if value is not None and ends is not None and None not in ends:
        width = ends[1] - ends[0]
        near = ends[0] - width <= value <= ends[1] + width
        _require(near, f"{key}.ci95", ends, f"an interval about the value, {value:.4g}")


def _require_figure(key: str, found: object) -> None:
    _require(found is None or _is_number(found), key, found, "null or a number")


def _require_interval(key: str, ends: object) -> None:
    fits = ends is None or (
        isinstance(ends, list) and len(ends) == 2 and all(end is None or _is_number(end) for end in ends)
    )
    _require(fits, key, ends, "null or two numbers")


def _require_covariance(table: Mapping[str, Any], parameters: Mapping[str, Any]) -> None:
    names, matrix = table.get("names", []), table.get("matrix", [])
    known = isinstance(names, list) and all(isinstance(name, str) and name in parameters for name in names)
    _require(known, "covariance.names", names, "names of parameters")
    square = (
        isinstance(matrix, list)
        and len(matrix) == len(names)
        and all(_is_row(row, len(names)) for row in matrix)
    )
    _require(square, "covariance.matrix", matrix, f"{len(names)} rows of as many numbers")
    for place, row in enumerate(matrix):
        _require(
            row[place] >= 0.0, f"covariance.matrix[{place}][{place}]", row[place], "a variance, 0 or more"
        )


def _is_row(row: object, size: int) -> bool:
    return isinstance(row, Sequence) and len(row) == size and all(map(_is_number, row))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e100


def _table(found: Any, key: str) -> Mapping[str, Any]:
    _require(isinstance(found, dict), key, found, "a table")
    return dict(found)


def _require(holds: bool, key: str, found: object, expected: str) -> None:
    if not holds:
        shown = repr(found)
        raise ValueError(
            f"{key}: found {shown if len(shown) < 60 else shown[:57] + '...'}, expected {expected}"
        )
