"""A fingerprint as a mapping, as text and as tables: on a terminal, in a notebook, for CSV and pandas."""

from __future__ import annotations

import csv
import io
import itertools
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shipfp_rs.errors import UnknownNameError
from shipfp_rs.identification.estimate import STATUS, Estimate, Row, rounded, rounded_rows
from shipfp_rs.identification.fingerprint_content import Content
from shipfp_rs.structures.names import plain_name
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import between, checked
from shipfp_rs.support.files import ending_in, write_text_atomically
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.tables import package, shown
from shipfp_rs.support.units import unit_shown

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("symbol", "name", "value", "std", "low", "high", "unit", "status", "reason")
SHORT, WIDTH = 8, 80
"""Most parameters in the short text of a fingerprint; width of the long text in characters."""
LOAD_ALONE = "The load's side by itself (speed and torque alone, no model of the drive):"


class FingerprintTables(Content, hints.Hinted, Mapping[str, Estimate]):
    """Names, text and tables of a fingerprint."""

    @property
    def _all(self) -> dict[str, Estimate]:
        return {**self.parameters, **self.derived}

    def __getitem__(self, name: str) -> Estimate:
        """Return a parameter or derived combination by name."""
        known = self._all
        if name in known:
            return known[name]
        near = hints.nearest(name, [*known]) if isinstance(name, str) else ""
        raise UnknownNameError(f"no parameter {name!r} in the fingerprint; it holds {', '.join(known)}{near}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)

    def _ipython_key_completions_(self) -> list[str]:
        return [*self]

    @property
    def correlations(self) -> dict[str, dict[str, float]]:
        """Correlation between searched parameters [-], as ``fingerprint.correlations["tau_n"]["g"]``."""
        names = list(self.covariance["names"])
        matrix = np.array(self.covariance["matrix"], dtype=np.float64).reshape(len(names), len(names))
        spread = np.sqrt(np.diag(matrix))
        spread[spread == 0.0] = np.nan
        rows = (matrix / np.outer(spread, spread)).tolist()
        return {name: dict(zip(names, row, strict=True)) for name, row in zip(names, rows, strict=True)}

    def __repr__(self) -> str:
        told = [f"{name[:24]}={rounded(one.value, None) or '?'}" for name, one in self.parameters.items()]
        more = [f"{len(told) - SHORT} more"] if len(told) > SHORT else []
        found = ", ".join([*told[:SHORT], *more])
        text = f"Fingerprint({found}; rank {self.identifiability.rank}/{self.identifiability.free})"
        return text if len(text) < 200 else f"{text[:195]}...)"

    def __str__(self) -> str:
        lead = self.usable or (self.verdict[0] if self.verdict else "No verdict was given.")
        notes: dict[str, str] = {}
        rows = [(row.name, *_figures(row), row.unit, _mark(row, notes)) for row in self._rows()]
        lines = [*_wrapped(lead), "", *_aligned([("symbol", "value", "95 % interval", "unit", ""), *rows])]
        for note, mark in notes.items():
            lines += _wrapped(f"{mark} {note}", " " * (len(mark) + 1))
        return "\n".join([*lines, *self._load_lines()])

    def _load_lines(self) -> list[str]:
        """Return the table of the load's estimates from speed and torque alone; empty without such estimates."""
        if not self.load_side:
            return []
        head = ("symbol", "by itself", "95 % interval", "whole model", "95 % interval", "unit")
        rows = [
            (one.name, *_figures(one), *_figures(whole), one.unit) for one, whole in beside_the_whole(self)
        ]
        return ["", LOAD_ALONE, *_aligned([head, *rows]), *_wrapped(agreement(self))]

    def _repr_html_(self) -> str:
        head = ["symbol", "name", "value", "std", "95 % from", "to", "unit", "status"]
        rows = [
            [row.name, plain_name(row.name), row.value, row.std, row.low, row.high, row.unit, row.status]
            for row in self._rows()
        ]
        return shown(f"Fingerprint of {self.vessel or 'a drive train not named'}", head, rows, self.verdict)

    def _rows(self) -> Iterator[Row]:
        return (replace(row, unit=unit_shown(row.unit) or "-") for row in rounded_rows(self))

    @checked
    def fit_report(self, min_correl: float = 0.1) -> str:
        """Return values, deviations, and correlations of at least `min_correl`, as text like lmfit's `fit_report`."""
        between("min_correl", min_correl, 0.0, 1.0)
        points = sum(int(record.get("used", record.get("samples", 0))) for record in self.data)
        found = self.identifiability
        lines = ["[[Model]]", f"    {self.structure.get('name', '')}", "[[Fit Statistics]]"]
        for key, count in (("data points", points), ("variables", found.free), ("rank", found.rank)):
            lines += [f"    # {key:<24} = {count}"] if count else []
        lines += [
            f"    {key.replace('_', ' '):<26} = {value:.8g}"
            for key, value in self.fit.get("overall", {}).items()
            if value is not None
        ]
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
        pairs = [
            (related[one][other], f"C({one}, {other})") for one, other in itertools.combinations(related, 2)
        ]
        told = sorted((pair for pair in pairs if abs(pair[0]) >= min_correl), key=lambda pair: -abs(pair[0]))
        if told:
            lines.append(f"[[Correlations]] (unreported correlations are < {min_correl:.3f})")
        lines += [f"    {pair:<{2 * width + 4}} = {value:+.4f}" for value, pair in told]
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

    def _records(self) -> list[tuple[Any, ...]]:
        return [
            (name, plain_name(name), e.value, e.std, *(e.ci95 or (None, None)), e.unit, e.status, e.reason)
            for name, e in self.items()
        ]

    def to_pandas(self) -> pd.DataFrame:
        """Return a `pandas.DataFrame` with a row for each symbol: name, value, std, low, high, unit, status, reason."""
        make = package("pandas").DataFrame.from_records
        frame: pd.DataFrame = make(self._records(), columns=COLUMNS, index="symbol")
        return frame.astype(dict.fromkeys(["value", "std", "low", "high"], "float64"))

    def to_csv(self, path: str | Path | None = None) -> str | Path:
        """Return the columns of `to_pandas` as CSV, or write them to a file and return its path."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(["" if cell is None else cell for cell in row] for row in self._records())
        if path is None:
            return text.getvalue()
        return write_text_atomically(ending_in(path, ".csv"), text.getvalue())


def beside_the_whole(fingerprint: FingerprintTables) -> Iterator[tuple[Row, Row]]:
    """Yield two estimates of each parameter of the load: from speed and torque alone, and by the whole model."""
    known = {name: one for name, one in fingerprint.load_side.items() if name in fingerprint.parameters}
    for row in rounded_rows(known):
        left = fingerprint.settings.get("optimum", {}).get(row.name)
        whole = fingerprint.parameters[row.name]
        if not fingerprint.engine_described:
            whole = Estimate(left, None if left is None else known[row.name].std)
        yield row, next(rounded_rows({row.name: whole}))


def agreement(fingerprint: FingerprintTables) -> Sentence:
    """Say whether the fit of the load alone and that of the whole ship agree, as judged by `sides.undescribed`."""
    if fingerprint.engine_described:
        return Sentence("Both agree within their errors.")
    return Sentence(
        "The whole model does not describe drive and governor, so its values are no estimates: those of the load's side "
        "by itself are given."
    )


def _figures(row: Row) -> tuple[str, str]:
    """Return value and interval as text, or "< upper end" for a zero value at the lower end of its interval."""
    if row.low and float(row.low) == float(row.value) == 0.0 < float(row.high):
        return f"< {float(row.high):.2g}", ""
    return row.value or "-", f"{row.low} to {row.high}" if row.low else ""


def _mark(row: Row, notes: dict[str, str]) -> str:
    """Return "given", or the mark "[1]" of a note on an estimate's status or reason; equal notes share a mark."""
    if row.status in (STATUS["free"], STATUS["fixed"]):
        return "" if row.status == STATUS["free"] else row.status
    note = (row.reason if not row.value else "") or row.status
    return notes.setdefault(note, f"[{len(notes) + 1}]")


def _aligned(rows: Sequence[Sequence[str]]) -> Iterable[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def _wrapped(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(
        text, WIDTH, subsequent_indent=indent, break_on_hyphens=False, break_long_words=False
    )
