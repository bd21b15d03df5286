"""Validation of `fingerprint.json` before a fingerprint is made from it.

Also here:

- A fingerprint as text and tables: on a terminal, in a notebook, for CSV and pandas.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import ItemsView, Iterator, KeysView, Mapping, Sequence, ValuesView
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from shipfp_rs.errors import UnknownNameError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.driven import fitting, instead, pairs_of
from shipfp_rs.identification.estimate import Estimate, Identifiability, Row, Usable, WhyNot, rounded_rows
from shipfp_rs.identification.question import Intervals, NoiseModel
from shipfp_rs.identification.sampling import Between
from shipfp_rs.structures.names import plain_name
from shipfp_rs.structures.stored import ROW, expect_row
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import Count, Positive, Whole, between, checked, expect, fits, is_one_line
from shipfp_rs.support.files import ending_in, write_text_atomically
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.tables import package, shown
from shipfp_rs.support.units import unit_shown

if TYPE_CHECKING:
    import pandas as pd


HEAD = ("symbol", "name", "value", "95 % interval", "unit")
COLUMNS = ("symbol", "name", "value", "std", "low", "high", "unit", "status", "reason")
SHORT = 8
"""Most parameters in the short form of a fingerprint."""
LOAD_ALONE = "The load's side by itself (speed and torque alone, no model of the engine):"


WHOLE, LAWLESS = 0.8, 0.5
"""Least share of a shaft's torque that is all of it, and largest exponent of what is left of the load's law beside it."""


class FingerprintTables:
    """Text and tables of a fingerprint; mixed into `Fingerprint`."""

    parameters: Mapping[str, Estimate]
    derived: Mapping[str, Estimate]
    identifiability: Identifiability
    fit: Mapping[str, Mapping[str, float | None]]
    structure: Mapping[str, Any]
    vessel: str | None
    data: tuple[Mapping[str, Any], ...]
    verdict: tuple[str, ...]
    covariance: Mapping[str, Any]
    settings: Mapping[str, Any]
    adequate: Mapping[str, Any]
    load_side: Mapping[str, Estimate]
    usable: str
    experiments: tuple[Experiment, ...]

    @property
    def ends_at_meter(self) -> bool:
        """Whether the model ends at a torque meter: its load is all the torque of a shaft, with the load's law in it."""
        loads, p = [row.get("load", {}) for row in self.data], self.parameters.get("p")
        return (
            "load" in self.structure.get("elements", ())
            and all(one.get("quantity") == "torque" and one["share"] >= WHOLE for one in loads)
            and (p is None or p.value is None or abs(p.value) < LAWLESS)
        )

    @property
    def engine_described(self) -> bool:
        """Whether the model describes engine and governor, as far as was tested; else only the load is reported."""
        return bool(self.adequate.get("sides", {}).get("engine", True))

    @property
    def _all(self) -> dict[str, Estimate]:
        return {**self.derived, **self.parameters}

    def __getitem__(self, name: str) -> Estimate:
        """Return a parameter or derived combination by name."""
        found = self._all
        if name in found:
            return found[name]
        known = [*self.parameters, *self.derived]
        near = hints.nearest(name, known) if isinstance(name, str) else ""
        raise UnknownNameError(f"no parameter {name!r} in the fingerprint; it holds {', '.join(known)}{near}")

    def __contains__(self, name: object) -> bool:
        return name in self.parameters or name in self.derived

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[str]:
        return iter([*self.parameters, *self.derived])

    def keys(self) -> KeysView[str]:
        """Return the names of parameters, then of combinations."""
        return {**self.parameters, **self.derived}.keys()

    def values(self) -> ValuesView[Estimate]:
        """Return the estimates, in the order of `keys`."""
        return {**self.parameters, **self.derived}.values()

    def items(self) -> ItemsView[str, Estimate]:
        """Return names with estimates, in the order of `keys`."""
        return {**self.parameters, **self.derived}.items()

    def _ipython_key_completions_(self) -> list[str]:
        return [*self]

    @property
    def correlations(self) -> dict[str, dict[str, float]]:
        """Correlation between searched parameters [-]: ``fingerprint.correlations["tau_n"]["g"]``."""
        names = list(self.covariance["names"])
        matrix = np.array(self.covariance["matrix"], dtype=np.float64).reshape(len(names), len(names))
        spread = np.sqrt(np.diag(matrix))
        scale = np.outer(spread, spread)
        related = np.divide(matrix, scale, out=np.full_like(matrix, np.nan), where=scale > 0.0)
        return {
            name: dict(zip(names, map(float, row), strict=True))
            for name, row in zip(names, related, strict=True)
        }

    def __repr__(self) -> str:
        told = [
            f"{name[:24]}={estimate.value:.4g}" if estimate.value is not None else f"{name[:24]}=?"
            for name, estimate in self.parameters.items()
        ]
        more = [f"{len(told) - SHORT} more"] if len(told) > SHORT else []
        found = ", ".join([*told[:SHORT], *more])
        text = f"Fingerprint({found}; rank {self.identifiability.rank}/{self.identifiability.free})"
        return text if len(text) < 200 else f"{text[:195]}...)"

    def __str__(self) -> str:
        lead = self.usable or (self.verdict[0] if self.verdict else "No verdict was given.")
        rows = [HEAD, *((row.name, self._name(row.name), *_figures(row), row.unit) for row in self._rows())]
        widths = [max(len(row[column]) for row in rows) for column in range(len(HEAD))]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows
        ]
        return "\n".join([lead, "", *(line.rstrip() for line in lines), *self._load_lines()])

    def _load_lines(self) -> list[str]:
        """Return the table of the load's estimates from speed and torque alone; empty without such estimates."""
        if not self.load_side:
            return []
        rows = [("symbol", "by itself", "95 % interval", "whole model", "95 % interval", "unit")]
        rows += [
            (
                *(one.name, *_figures(one)),
                whole.value,
                f"{whole.low} to {whole.high}" if whole.low else "-",
                one.unit,
            )
            for one, whole in beside_the_whole(self)
        ]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in rows
        ]
        return ["", LOAD_ALONE, *lines, agreement(self)]

    def _repr_html_(self) -> str:
        return shown(
            f"Fingerprint of {self.vessel or 'a drive train not named'}",
            ["symbol", "name", "value", "std", "95 % from", "to", "unit", "status"],
            [
                [row.name, self._name(row.name), row.value, row.std, row.low, row.high, row.unit, row.status]
                for row in self._rows()
            ],
            self.verdict,
        )

    def _rows(self) -> Iterator[Row]:
        rows = rounded_rows({**self.parameters, **self.derived})
        return (replace(row, unit=unit_shown(row.unit) or "-") for row in rows)

    @checked
    def fit_report(self, min_correl: float = 0.1) -> str:
        """Return values, deviations and correlations as text, in the layout of lmfit's `fit_report`.

        Parameters
        ----------
        min_correl
            Least absolute correlation that is printed.
        """
        between("min_correl", min_correl, 0.0, 1.0)
        overall = self.fit.get("overall", {})
        counts = {
            "data points": sum(int(record.get("used", record.get("samples", 0))) for record in self.data),
            "variables": self.identifiability.free,
            "rank": self.identifiability.rank,
        }
        figures = {key: value for key, value in overall.items() if value is not None}
        lines = ["[[Model]]", f"    {self.structure.get('name', '')}", "[[Fit Statistics]]"]
        lines += [f"    # {key:<24} = {value}" for key, value in counts.items() if value]
        lines += [f"    {key.replace('_', ' '):<26} = {value:.8g}" for key, value in figures.items()]
        lines += [
            f"    fit of {output:<19} = {row['nrmse_pct']:.4g} %"
            for output, row in self.fit.items()
            if output != "overall" and row.get("nrmse_pct") is not None
        ]
        width = max((len(name) for name in self), default=0) + 1
        lines += ["[[Variables]]", *(self._variable(name, width) for name in self.parameters)]
        if self.derived:
            lines += ["[[Combinations]]", *(self._variable(name, width) for name in self.derived)]
        related = self.correlations
        names = list(related)
        pairs = {
            (one, other): related[one][other]
            for place, one in enumerate(names)
            for other in names[place + 1 :]
            if abs(related[one][other]) >= min_correl
        }
        if pairs:
            lines.append(f"[[Correlations]] (unreported correlations are < {min_correl:.3f})")
            lines += [
                f"    {f'C({one}, {other})':<{2 * width + 4}} = {value:+.4f}"
                for (one, other), value in sorted(pairs.items(), key=lambda pair: -abs(pair[1]))
            ]
        return "\n".join(lines)

    def _variable(self, name: str, width: int) -> str:
        estimate, label = self[name], f"    {f'{name}:':<{width}} "
        if estimate.value is None:
            return f"{label}not identifiable ({estimate.reason})"
        if estimate.status == "fixed":
            return f"{label}{estimate.value:.8g} (fixed)"
        spread = ""
        if estimate.std is not None:
            share = f" ({100.0 * estimate.std / abs(estimate.value):.2f}%)" if estimate.value else ""
            spread = f" +/- {estimate.std:.8g}{share}"
        start = self.structure.get("parameters", {}).get(name, {}).get("start")
        began = "" if start is None else f" (init = {start:.6g})"
        return f"{label}{estimate.value:.8g}{spread}{began}"

    def _name(self, symbol: str) -> str:
        """Return a symbol's plain name in the vocabulary of the drive and its load."""
        return fitting(plain_name(symbol), pairs_of(instead(self, self.experiments)))

    def _records(self) -> list[tuple[Any, ...]]:
        return [
            (name, self._name(name), e.value, e.std, *(e.ci95 or (None, None)), e.unit, e.status, e.reason)
            for name, e in self.items()
        ]

    def to_pandas(self) -> pd.DataFrame:
        """Return a `pandas.DataFrame` with a row for each symbol: name, value, std, low, high, unit, status, reason.

        Raises `InputError` if pandas is not installed.
        """
        pandas = package("pandas")
        frame: pd.DataFrame = pandas.DataFrame.from_records(self._records(), columns=COLUMNS, index="symbol")
        numbers = ["value", "std", "low", "high"]
        return frame.astype(dict.fromkeys(numbers, "float64"))

    def to_csv(self, path: str | Path | None = None) -> str | Path:
        """Return the columns of `to_pandas` as CSV, or write them to a file and return its path."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(["" if cell is None else cell for cell in row] for row in self._records())
        return (
            text.getvalue()
            if path is None
            else write_text_atomically(ending_in(path, ".csv"), text.getvalue())
        )


def beside_the_whole(fingerprint: FingerprintTables) -> Iterator[tuple[Row, Row]]:
    """Yield each parameter's estimate by the load's side alone and by the whole model."""
    known = {name: one for name, one in fingerprint.load_side.items() if name in fingerprint.parameters}
    for row in rounded_rows(known):
        left = fingerprint.settings.get("optimum", {}).get(row.name)
        whole = fingerprint.parameters[row.name]
        if not fingerprint.engine_described:
            whole = Estimate(left, None if left is None else known[row.name].std)
        yield row, next(rounded_rows({row.name: whole}))


def agreement(fingerprint: FingerprintTables) -> Sentence:
    """Say whether the load's side alone and the whole model agree, as determined by `sides.undescribed`."""
    if fingerprint.engine_described:
        return Sentence("Both agree within their errors.")
    return Sentence(
        "The whole model does not describe engine and governor, so its values are no estimates: those of the load's side "
        "by itself are given."
    )


def _figures(row: Row) -> tuple[str, str]:
    """Return value and interval as text, or the reason for none."""
    if not row.value:
        return "", row.status
    return row.value, f"{row.low} to {row.high}" if row.low else row.status


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
    "sides": (Mapping[str, bool], "a table of true or false"),
    "engine": (Mapping[str, Mapping[str, float]], "a table of tables of numbers"),
    "limit": (Mapping[str, float], "a table of numbers"),
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
