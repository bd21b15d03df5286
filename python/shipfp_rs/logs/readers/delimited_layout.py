"""How a delimited text file is laid out, found from its first lines: mark, decimals, headings, units, rate."""

from __future__ import annotations

import csv
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from shipfp_rs.errors import InputError
from shipfp_rs.logs.readers.time_base import split_unit, stated_rate

SAMPLE = 1 << 16
"""Bytes from which the layout is found."""

SCORED = 200
"""Lines on which every delimiter is tried; more than a logger writes above its records."""

PREAMBLE = 5
"""Lines in a row that must hold a number where the records begin."""

DIALECTS = ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", "."), (" ", "."))
"""Delimiter and decimal mark, the likelier first where both fit."""

NUMBER = re.compile(
    r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)|true|false", re.IGNORECASE
)
STAMP = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?")
UNIT = re.compile(
    r"[\[(].*[\])]|-|%|°|°?[CFK]|deg[CF]?|[num kMGµ]?(s|V|A|m|g|N|Nm|N m|N\*m|Hz|W|Pa|bar|rad|l|L|Ohm|eps|strain)"
    r"|rpm|RPM|rev/s|1/min|min-1|min\^-1|1/s|rad/s|h|min|kn|kts?|[µu]m/m|[kcm]?m/(s|h|s2|s\^2|s²)|k?g/h|l/h|m3/h|ticks?|counts?"
)
RATE = re.compile(
    r"(?P<name>[A-Za-z][A-Za-z _-]*?)\s*[\[(]?(?P<unit>k?Hz|m?s)?[\])]?\s*[:=;,\t ]\s*"
    r"(?P<value>\d[\d.,eE+-]*)\s*(?P<after>k?Hz|m?s)?\b"
)
SCALES = {"kHz": 1e3, "ms": 1e-3}


@dataclass(frozen=True)
class Layout:
    """Where the records of a file begin and how they are written."""

    encoding: str
    delimiter: str
    decimal: str
    lines_before: int
    """Lines in front of the first record."""
    bytes_before: int
    headings: tuple[str, ...]
    units: tuple[str, ...]
    numeric: tuple[bool, ...]
    """Whether most cells of the column are numbers."""
    rate_hz: float | None
    """Sample rate, where a line above the headings states one [Hz]."""


def find_layout(path: Path) -> Layout:
    """Find the layout of a delimited file; `InputError` where its first lines hold no rows of numbers."""
    with path.open("rb") as file:
        sample = file.read(SAMPLE)
    if sample.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in sample:
        raise InputError(f"{path}: UTF-16 or no text at all, expected a text file; save it as UTF-8")
    ends = sample.rfind(b"\n") + 1
    raw = (sample[:ends] or sample).removeprefix(b"\xef\xbb\xbf")
    mark = len(sample[:ends] or sample) - len(raw)
    try:
        text, encoding = raw.decode(), "utf-8"
    except UnicodeDecodeError:  # older loggers write ° and µ in one byte each
        text, encoding = raw.decode("latin-1"), "latin-1"
    lines = text.split("\n")
    lines = [line.rstrip("\r") for line in (lines if lines[-1] else lines[:-1])]
    delimiter, decimal = max(DIALECTS, key=lambda dialect: _score(lines[:SCORED], *dialect))
    rows = [_cells(line, delimiter) for line in lines]
    width = _width(rows, decimal)
    holds_number = [any(_is_number(cell, decimal) for cell in row) for row in rows]
    # Lines like "Sample rate;2000" look like records, but the headings come soon after them.
    first = next(
        (
            k
            for k, row in enumerate(rows)
            if _is_record(row, width, decimal) and all(holds_number[k : k + PREAMBLE])
        ),
        None,
    )
    if first is None:
        raise InputError(
            f"{path}: empty or without rows of numbers; expected a header line with channel names and lines of numbers"
        )
    headings, units = _headings(rows[:first], width)
    full = [row for row in rows[first:] if len(row) == width]
    numeric = tuple(
        2 * sum(_is_number(row[k], decimal) or not row[k] for row in full) >= len(full) for k in range(width)
    )
    return Layout(
        encoding,
        delimiter,
        decimal,
        first,
        mark + sum(len(line) + 1 for line in raw.split(b"\n")[:first]),
        headings,
        units,
        numeric,
        stated_rate(fact for line in lines[:first] for fact in _facts(line, decimal)),
    )


def _cells(line: str, delimiter: str) -> list[str]:
    # A line is one record: a quote that damage left open must not swallow the lines after it.
    cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=delimiter == " "), [])
    return [cell.strip() for cell in cells]


def _is_number(cell: str, decimal: str) -> bool:
    if decimal != "." and "." in cell:
        return False
    return bool(NUMBER.fullmatch(cell.replace(decimal, ".")) or STAMP.fullmatch(cell))


def _score(lines: list[str], delimiter: str, decimal: str) -> tuple[int, int]:
    """Numbers less other cells over all lines, after the first few of which most are records."""
    rows = [_cells(line, delimiter) for line in lines]
    numbers = [sum(_is_number(cell, decimal) for cell in row) for row in rows]
    others = sum(sum(map(bool, row)) - count for row, count in zip(rows, numbers, strict=True))
    return sum(numbers) - others, _width(rows, decimal)


def _width(rows: list[list[str]], decimal: str) -> int:
    """Columns of most rows that hold numbers."""
    widths = Counter(len(row) for row in rows if any(_is_number(cell, decimal) for cell in row))
    return widths.most_common(1)[0][0] if widths else 0


def _is_record(row: list[str], width: int, decimal: str) -> bool:
    filled = [cell for cell in row if cell]
    return len(row) == width and 2 * sum(_is_number(cell, decimal) for cell in filled) >= len(filled) > 0


def _headings(above: list[list[str]], width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the columns out of the rows above the records."""
    full: list[list[str]] = []
    for row in reversed(above):
        if len(row) != width or len(full) == 2:
            break
        full.insert(0, row)
    units = [""] * width
    if len(full) == 2 and all(UNIT.fullmatch(cell) for cell in full[1] if cell) and any(full[1]):
        units = [cell.strip("[]()") for cell in full[1]]
        full = full[:1]
    names = full[-1] if full else [""] * width
    names = [names[0].lstrip("# "), *names[1:]]
    split = [split_unit(name or f"column {k + 1}") for k, name in enumerate(names)]
    return tuple(name for name, _ in split), tuple(
        unit or own for unit, (_, own) in zip(units, split, strict=True)
    )


def _facts(line: str, decimal: str) -> list[tuple[str, float]]:
    """Name and value [Hz or s] of what a line like "Sample rate: 2 kHz" states."""
    found = RATE.search(line)
    if found is None:
        return []
    try:
        value = float(found["value"].rstrip(".,").replace(decimal, "."))
    except ValueError:
        return []
    return [(found["name"], value * SCALES.get(found["unit"] or found["after"] or "", 1.0))]
