"""Validation of `fingerprint.json` before a fingerprint is made from it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, get_args

from shipfp_rs.identification.estimate import Usable, WhyNot
from shipfp_rs.identification.options import Intervals, NoiseModel
from shipfp_rs.identification.sampling import Between
from shipfp_rs.structures.stored import ROW, expect_row
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import Count, Positive, Whole, fits
from shipfp_rs.support.checks import expect, is_one_line
from shipfp_rs.support.sentences import Sentence

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
OPTIONAL_TABLES = ("residuals", "elements", "adequate", "load_side", "si")
ROWS = ("parameters", "derived", "fit", "residuals", "elements", "load_side", "si")
"""Keys whose values are tables of tables."""
REBUILT = ("linear", "ship", "commanded", "joint")
"""Kinds of structures that a file describes completely."""
STATES = ("on", "off", "open")
"""States of an element of the ship."""
WORDS: Mapping[str, tuple[str, ...]] = {
    "noise": get_args(NoiseModel),
    "intervals": get_args(Intervals),
    "set_point": (*get_args(Between), "straight lines"),
    "set_point_noise": ("left out", "taken for signal"),
}
"""Settings with a fixed set of words."""
SETTINGS: Mapping[str, tuple[Any, str]] = {
    "starts": (Count, "a whole number of 1 or more"),
    "time_limit_s": (Positive | None, "null or a positive number"),
    "structure": (str, "a text"),
    "optimum": (Mapping[str, float], "a table of numbers"),
    "criterion": (float | None, "null or a number"),
    "converged": (bool, "true or false"),
    "message": (str, "a text"),
    "minima": (Sequence[Mapping[str, Any]], "a list of tables"),
    "possible": (Sequence[Mapping[str, float]], "a list of tables of numbers"),
    "vessel_gives": (Sequence[str], "a list of texts"),
}
"""Annotation and description of the settings that a search writes; other settings are not checked."""
ADEQUATE: Mapping[str, tuple[Any, str]] = {
    "stands": (bool, "true or false"),
    "misses_pct": (Mapping[str, float | None], "a table of percentages of 0 or more"),
    "bias": (Mapping[str, float | None], "a table of numbers"),
    "dispersion": (Positive | None, "null or a positive number"),
    "sides": (Mapping[str, bool], "a table of true or false"),
    "engine": (Mapping[str, Mapping[str, float]], "a table of tables of numbers"),
    "engine_curves": (
        Mapping[str, Mapping[str, Sequence[float]]],
        "a table of tables of lists of numbers",
    ),
}
"""Annotation and description of each value of `adequate`."""
RANK: Mapping[str, tuple[Any, str]] = {
    "rank": (Whole, "a whole number of 0 or more"),
    "free": (Whole, "a whole number of 0 or more"),
    "condition": (float | None, "null or a number"),
    "null_space": (Sequence[Mapping[str, Any]], "a list of tables"),
    "closes_gap": (Sequence[str], "a list of texts"),
}
"""Annotation and description of each value of `identifiability`."""
FIGURES: Mapping[str, tuple[float, float, str]] = {
    "_p": (0.0, 1.0, "a probability"),
    "nrmse_pct": (-math.inf, 100.0, "100 % or less"),
    "_pct": (0.0, 100.0, "0 to 100 %"),
}
"""Suffix of a figure of `fit` to its range and description; the first match counts."""
LEAST_STD = 1e-100
"""Least standard deviation besides zero: the square of a smaller one underflows double precision."""
VERSION = re.compile(r"\d+(\.\w+)+([+-][\w.]+)*")
OF_A_SEARCH = ("optimum", "criterion", "converged", "message", "minima")
"""Settings that occur only together."""


def require_layout(content: Mapping[str, Any]) -> None:
    """Raise `ValueError`, with a line about one key, where the content of a file is no fingerprint's."""
    for key in (*TABLES, *(key for key in OPTIONAL_TABLES if key in content)):
        _table(content[key], key)
    for key in ROWS:
        for name, row in content.get(key, {}).items():
            _table(row, f"{key}.{name}")
    for key, texts in (
        ("parameters", ("unit", "status", "reason")),
        ("derived", ("unit", "status", "reason")),
        ("load_side", ("unit", "status", "reason")),
        ("si", ("unit",)),
    ):
        for name, row in content.get(key, {}).items():
            _require_estimate(f"{key}.{name}", row, texts)
    for name, row in content["fit"].items():
        for figure, found in row.items():
            _require_figure(f"fit.{name}.{figure}", found)
            low, high, said = next(
                (known for end, known in FIGURES.items() if figure.endswith(end)), (-math.inf, math.inf, "")
            )
            expect(found is None or low <= found <= high, f"fit.{name}.{figure}", found, said)
    for name, row in content.get("elements", {}).items():
        expect(row.get("state") in STATES, f"elements.{name}.state", row.get("state"), " or ".join(STATES))
    vessel, structure = content["vessel"], content["structure"]
    expect(vessel is None or isinstance(vessel, str), "vessel", vessel, "a text or null")
    for name, row in _table(structure.get("parameters", {}), "structure.parameters").items():
        expect_row(f"structure.parameters.{name}", row, ROW)
    if structure.get("kind") in REBUILT:
        Structure.from_dict(structure)
    expect(isinstance(structure.get("name", ""), str), "structure.name", structure.get("name"), "a text")
    outputs = structure.get("outputs", [])
    named = isinstance(outputs, list) and all(isinstance(output, str) for output in outputs)
    expect(named, "structure.outputs", outputs, "a list of texts")
    for key, words in (("usability", Usable), ("why_not", WhyNot)):
        found = content.get(key, "")
        expect(found in get_args(words), key, found, "one of " + ", ".join(map(repr, get_args(words))))
    for key, kind in (("verdict", str), ("data", dict)):
        entries = content[key]
        expect(
            isinstance(entries, list) and all(isinstance(one, kind) for one in entries),
            key,
            entries,
            "a list",
        )
    _require_covariance(content["covariance"], content["parameters"])
    _require_kinds("identifiability", content["identifiability"], RANK)
    _require_kinds("adequate", content.get("adequate", {}), ADEQUATE)
    for output, missed in content.get("adequate", {}).get("misses_pct", {}).items():
        expect(missed is None or missed >= 0.0, f"adequate.misses_pct.{output}", missed, "0 % or more")
    _require_settings(content["settings"])
    _require_software(content)
    _require_optimum(content)


def sentences_of(table: Any) -> dict[str, Sentence]:
    """Return the sentences of a file by their text, which their parts must reproduce."""
    made = {text: Sentence.from_dict(entry) for text, entry in _table(table, "sentences").items()}
    for text, sentence in made.items():
        expect(text == sentence, "sentences", str(sentence), f"parts that make {text[:60]!r}")
    return made


def _require_estimate(key: str, row: Mapping[str, Any], texts: Sequence[str]) -> None:
    """Check value, standard deviation and interval of an estimate; the latter two require the value."""
    for text in texts:
        expect(isinstance(row[text], str) and is_one_line(row[text]), f"{key}.{text}", row[text], "a text")
    for figure in ("value", "std"):
        _require_figure(f"{key}.{figure}", row[figure])
    std = row["std"]
    expect(not std or std >= LEAST_STD, f"{key}.std", std, f"null, 0 or a number of {LEAST_STD:g} or more")
    _require_interval(f"{key}.ci95", row["ci95"])
    value, ends = row["value"], row["ci95"]
    expect(
        row["std"] is None or value is not None,
        f"{key}.value",
        None,
        "a number, since there is a standard deviation",
    )
    if value is not None and ends is not None and None not in ends:
        width = ends[1] - ends[0]
        near = ends[0] - width <= value <= ends[1] + width
        expect(near, f"{key}.ci95", ends, f"an interval about the value, {value:.4g}")


def _require_figure(key: str, found: object) -> None:
    expect(found is None or _is_number(found), key, found, "null or a number")


def _require_interval(key: str, ends: object) -> None:
    two = isinstance(ends, list) and len(ends) == 2 and all(end is None or _is_number(end) for end in ends)
    expect(ends is None or two, key, ends, "null or two numbers")


def _require_kinds(key: str, table: Mapping[str, Any], kinds: Mapping[str, tuple[Any, str]]) -> None:
    for name, (kind, words) in kinds.items():
        expect(name not in table or fits(table[name], kind), f"{key}.{name}", table.get(name), words)


def _require_settings(settings: Mapping[str, Any]) -> None:
    _require_kinds("settings", settings, SETTINGS)
    for name, known in WORDS.items():
        expect(
            settings.get(name, known[0]) in known, f"settings.{name}", settings.get(name), " or ".join(known)
        )
    for name in OF_A_SEARCH if any(name in settings for name in OF_A_SEARCH) else ():
        expect(name in settings, f"settings.{name}", None, SETTINGS[name][1])


def _require_software(content: Mapping[str, Any]) -> None:
    seed = content["seed"]
    expect(seed is None or fits(seed, Whole), "seed", seed, "null or a whole number of 0 or more")
    for name, found in content["versions"].items():
        is_version = isinstance(found, str) and VERSION.fullmatch(found) is not None
        expect(is_version, f"versions.{name}", found, "a version, '1.2.3'")


def _require_optimum(content: Mapping[str, Any]) -> None:
    """Refuse an optimum that no search reaches: outside the bounds, or with a fixed parameter changed."""
    if "optimum" not in content["settings"]:
        return
    optimum = content["settings"]["optimum"]
    for name in content["parameters"]:
        expect(name in optimum, f"settings.optimum.{name}", None, "a number")
    rows = content["structure"].get("parameters", {})
    for name, value in optimum.items():
        _require_within(f"settings.optimum.{name}", value, rows.get(name, {}))
    for name, estimate in content["parameters"].items():
        if estimate["status"] in ("free", "prior") and estimate["value"] is not None:
            _require_within(f"parameters.{name}.value", estimate["value"], rows.get(name, {}))


def _require_within(key: str, value: float, row: Mapping[str, Any]) -> None:
    """Refuse a value outside its parameter's declaration."""
    if row.get("fixed"):
        expect(_is_near(value, row["start"]), key, value, f"{row['start']:.6g}, at which it is fixed")
    elif row.get("bounds") is not None:
        low, high = row["bounds"]
        above = low is None or value >= low or _is_near(value, low)
        below = high is None or value <= high or _is_near(value, high)
        expect(above and below, key, value, f"a number within its bounds, {low} to {high}")


def _is_near(value: float, other: float) -> bool:
    return math.isclose(value, other, rel_tol=1e-9, abs_tol=1e-9)


def _require_covariance(table: Mapping[str, Any], parameters: Mapping[str, Any]) -> None:
    names, matrix = table.get("names", []), table.get("matrix", [])
    known = isinstance(names, list) and all(isinstance(name, str) and name in parameters for name in names)
    expect(known, "covariance.names", names, "names of parameters")
    square = (
        isinstance(matrix, list)
        and len(matrix) == len(names)
        and all(_is_row(row, len(names)) for row in matrix)
    )
    expect(square, "covariance.matrix", matrix, f"{len(names)} rows of as many numbers")
    for place, row in enumerate(matrix):
        expect(row[place] >= 0.0, f"covariance.matrix[{place}][{place}]", row[place], "a variance, 0 or more")


def _is_row(row: object, size: int) -> bool:
    return isinstance(row, Sequence) and len(row) == size and all(map(_is_number, row))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e100


def _table(found: Any, key: str) -> Mapping[str, Any]:
    expect(isinstance(found, dict), key, found, "a table")
    return dict(found)
