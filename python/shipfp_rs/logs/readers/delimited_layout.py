"""Layout of a delimited text file, detected in its first lines: delimiter, decimal mark, headings, units, rate."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.readers.time_cells import (
    SECONDS,
    is_date,
    is_time,
    looks_like_time,
    split_unit,
    stated_rate,
    stated_start,
)
from shipfp_rs.support import units

Kind = Literal["number", "time", "text"]

SAMPLE = 1 << 16
"""Number of bytes at the start of a file in which the layout is detected."""
SCORED = 200
"""Number of lines on which delimiters are tried; the headers of loggers are shorter."""
PREAMBLE = 5
"""The records start at this many successive lines with a number."""
HEADING_ROWS = 4
"""Largest number of lines with names, units and descriptions directly above the records."""
DIALECTS = tuple(
    (each[0], each[1]) for each in (",.", ";.", ";,", "\t.", "\t,", "|.", "|,", " .", " ,", ",,")
)
"""Pairs of delimiter and decimal mark, most likely first. In files where both are commas, the numbers are quoted."""
NUMBER = re.compile(
    r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)|true|false", re.IGNORECASE
)
LOOSE = re.compile(
    r"(?P<sign>[+-])?\s*(?P<digits>\d[\d.,]*(?:[eE][+-]?\d+)?)(?:\s+(?P<unit>[^\W\d_%°][^\s\d]*|[%°]\S*))?"
)
"""Pattern of a number with a detached sign, or followed by a unit."""
GROUPED = {
    ".": re.compile(r"[+-]?[1-9]\d{0,2}([, '\u2019\u00a0\u202f])\d{3}(?:\1\d{3})*(?:\.\d*)?"),
    ",": re.compile(r"[+-]?[1-9]\d{0,2}([. '\u2019\u00a0\u202f])\d{3}(?:\1\d{3})*(?:,\d*)?"),
}
"""Patterns of numbers with thousands separators, by decimal mark."""
RATE = re.compile(
    r"(?P<name>[^\W\d][^\W\d_' .-]*(?:[' _.-]+[^\W\d][^\W\d_' .-]*)*)\s*[\[(]?(?P<unit>k?Hz|m?s|S/s)?[\])]?\s*[:=;,\t ]\s*"
    r"(?P<value>\d[\d.,eE+-]*)\s*(?P<after>k?Hz|m?s|S/s)?\b"
)
INLINE = re.compile(r"(?P<name>\w+)\s*=\s*(?P<value>[+-]?\d[\d.]*(?:[eE][+-]?\d+)?)\s*s?")
SCALES = {"kHz": 1e3, "ms": 1e-3}
COMMENT = "#%!/"
TITLE = re.compile(r"\s*\[[^\[\]]+\]\s*")
"""Pattern of a section title, such as "[data]"."""
NAME_LINES = frozenset(("label", "labels", "tracename"))
UNIT_LINES = frozenset(("vertical units", "y_unit_label", "vunit"))
"""First words of header lines with the names or units of the columns."""


@dataclass(frozen=True)
class Layout:
    """Position and format of the records of a file."""

    encoding: str
    line_end: str
    """Last character of a line."""
    delimiter: str
    decimal: str
    lines_before: int
    """Number of lines before the first record."""
    bytes_before: int
    bytes_end: int
    """Offset of the footer, or of the file's end."""
    headings: tuple[str, ...]
    units: tuple[str, ...]
    kinds: tuple[Kind, ...]
    """Kind of most cells of each column; "time" stands for dates and times of day."""
    named: bool
    """Whether the file has headings."""
    footer: tuple[str, ...]
    rate_hz: float | None
    """Sample rate given in the header [Hz]."""
    start_s: float
    """Time of the first record [s] if the header states it together with a rate, else 0."""
    counted: bool
    """Whether the first column counts the records, so that their times follow from the rate."""

    @property
    def wide(self) -> int:
        """Least number of bytes per character."""
        return 2 if self.encoding.startswith("utf-16") else 1


def find_layout(path: Path) -> Layout:
    """Detect the layout of a delimited file; `InputError` if its first lines have no rows of numbers."""
    with path.open("rb") as file:
        sample = file.read(SAMPLE)
    encoding, mark = _encoding(path, sample)
    wide = 2 if encoding.startswith("utf-16") else 1
    text = sample[mark : len(sample) // wide * wide].decode(encoding, "replace" if wide == 2 else "strict")
    line_end = "\r" if "\r" in text and "\n" not in text else "\n"
    whole = text[: text.rfind(line_end) + 1] or text
    lines = whole.split(line_end)
    lines = [line.rstrip("\r") for line in (lines if lines[-1] else lines[:-1])]
    delimiter, decimal = max(DIALECTS, key=lambda dialect: _score(lines[:SCORED], *dialect))
    rows = [cells_of(line, delimiter) for line in lines]
    width = _width(rows, decimal)
    first = _first_record(rows, width, decimal)
    if first is None:
        raise InputError(
            f"{path}: empty or without rows of numbers; expected a header line with channel names and lines of numbers"
        )
    full = [row for row in rows[first:] if len(row) == width]
    plain = (line.lstrip(COMMENT).strip(" ") if line[:1] in COMMENT else line for line in lines[:first])
    above = [[] if TITLE.fullmatch(line) else cells_of(line, delimiter) for line in plain]
    # long: evaluates the header lines step by step
    columns = [[row[k] for row in full if row[k]] for k in range(width)]
    beside = _taken_facts(above, list(map(bool, columns)), decimal)
    headings, own, named = _headings(above, width)

    kinds = tuple(_kind(cells, decimal) for cells in columns)
    own = tuple(
        unit or (_unit_of_cells(cells) if kind == "number" else "")
        for unit, kind, cells in zip(own, kinds, columns, strict=True)
    )
    before = mark + sum(len((line + line_end).encode(encoding)) for line in whole.split(line_end)[:first])
    form = (encoding, line_end, delimiter, decimal)
    end, footer = _footer(path, *form, before)
    pairs = [pair for row in above for pair in pairwise(row)]
    numbers = [pair for pair in pairs if is_number(pair[1], decimal) and not looks_like_time(pair[1])]
    across = [(name, _number(cell, decimal)) for name, cell in numbers]
    rate = stated_rate(
        [*beside, *(fact for line in lines[:first] for fact in _facts(line, decimal)), *across]
    )
    start = stated_start([*beside, *across]) if rate else 0.0
    counted = bool(rate) and is_time(headings[0]) and (not own[0] or own[0].lower() not in SECONDS)
    counts = [_number(row[0], decimal) for row in full if is_number(row[0], decimal)]
    counted = counted and len(counts) == len(full) > 1 and bool((np.diff(counts) == 1.0).all())
    if rate and counted:
        start += counts[0] / rate
    return Layout(*form, first, before, end, headings, own, kinds, named, footer, rate, start, counted)


def _kind(cells: Sequence[str], decimal: str) -> Kind:
    """Kind of most filled cells of a column; a column without filled cells may have numbers later."""
    times = sum(looks_like_time(cell) for cell in cells)
    if cells and 2 * times >= len(cells):
        return "time"
    numbers = sum(is_number(cell, decimal) for cell in cells) - times
    return "number" if 2 * numbers >= len(cells) else "text"


def _first_record(rows: Sequence[list[str]], width: int, decimal: str) -> int | None:
    """Index of the first record; None if no line is a record."""
    holds_number = [any(is_number(cell, decimal) for cell in row) for row in rows]
    filled = [k for k, row in enumerate(rows) if any(row)]
    # If records start with a number, a line that starts with a word is not a record: it describes the channels.
    worded = [bool(row and row[0]) and not is_number(row[0], decimal) for row in rows]
    records = [_is_record(row, width, decimal) for row in rows]
    full = [worded[k] for k in filled if records[k]]
    may_begin_with_word = 2 * sum(full) > len(full)
    # Lines like "Sample rate;2000" look like records, but are followed soon by the headings.
    for place, k in enumerate(filled):
        if records[k] and (may_begin_with_word or not worded[k]):
            near = filled[place : place + PREAMBLE]
            if all(holds_number[j] or (j > filled[-1] - PREAMBLE and not records[j]) for j in near):
                return k
    return None


def _encoding(path: Path, sample: bytes) -> tuple[str, int]:
    """Encoding of a text file and length of its byte order mark."""
    for mark, name in ((b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be"), (b"\xef\xbb\xbf", "utf-8")):
        if sample.startswith(mark):
            return name, len(mark)
    zeros = [sample[k::2].count(0) for k in (0, 1)]
    if sum(zeros):
        for name, place in (("utf-16-le", 1), ("utf-16-be", 0)):
            if zeros[place] > 0.8 * len(sample) / 2 and not zeros[1 - place]:
                return name, 0
        raise InputError(
            f"{path}: not a text file, since it contains zero bytes; expected a text file, or the suffix of its format"
        )
    try:
        sample[: sample.rfind(b"\n") + 1 or None].decode()
    except UnicodeDecodeError:  # older loggers write ° and µ as one byte
        return "latin-1", 0
    return "utf-8", 0


def cells_of(line: str, delimiter: str) -> list[str]:
    """Split a line into cells without surrounding spaces."""
    if delimiter == " ":
        line = line.strip()
    # A line is one record: an unclosed quote in a damaged file must not absorb the following lines.
    cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    return [cell.strip() for cell in cells]


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number, with or without thousands separators, or a time."""
    cell = bare_number(cell)[0]
    if NUMBER.fullmatch(cell.replace(decimal, ".") if decimal == "." or "." not in cell else "no"):
        return True
    return bool(GROUPED[decimal].fullmatch(cell)) or looks_like_time(cell)


def bare_number(cell: str) -> tuple[str, str]:
    """Number and unit of a cell such as "1500 rpm" or "+ 1499.75"; other cells as they are.

    Examples
    --------
    >>> bare_number("1500 rpm"), bare_number("+ 1499.75"), bare_number("5 Fish")
    (('1500', 'rpm'), ('+1499.75', ''), ('5 Fish', ''))
    """
    found = LOOSE.fullmatch(cell)
    if found is None or (found["unit"] and not units.is_unit(found["unit"])):
        return cell, ""
    return (found["sign"] or "") + found["digits"], units.told(found["unit"] or "")


def _score(lines: list[str], delimiter: str, decimal: str) -> tuple[int, int]:
    """Score of a pair of delimiter and decimal mark: numeric cells minus other cells, then the number of columns."""
    rows = [cells_of(line, delimiter) for line in lines]
    numbers = [sum(is_number(cell, decimal) for cell in row) for row in rows]
    others = sum(sum(map(bool, row)) - count for row, count in zip(rows, numbers, strict=True))
    return sum(numbers) - others, _width(rows, decimal)


def _width(rows: list[list[str]], decimal: str) -> int:
    """Most frequent number of columns among rows with numbers."""
    widths = Counter(len(row) for row in rows if any(is_number(cell, decimal) for cell in row))
    return widths.most_common(1)[0][0] if widths else 0


def _is_record(row: list[str], width: int, decimal: str) -> bool:
    filled = [cell for cell in row if cell]
    return len(row) == width and 2 * sum(is_number(cell, decimal) for cell in filled) >= len(filled) > 0


def _headings(above: list[list[str]], width: int) -> tuple[tuple[str, ...], tuple[str, ...], bool]:
    """Names and units of the columns, from the rows above the records, and whether there are any names."""
    full: list[list[str]] = []
    for row in reversed(above):
        if not any(row):
            if full and len(full) > 1:
                break
            continue
        if len(row) == width + 1 and row[-1].lower() == "comment":  # records may lack this column
            row = row[:-1]
        short = width - len(row)
        # Records may end with a delimiter that the line of names lacks.
        if len(full) == HEADING_ROWS or not (short == 0 or (short == 1 and len(row) > 1)):
            break
        full.insert(0, [*row, *[""] * short])
    own = [""] * width
    places = range(len(full) - 1, -1, -1)
    at = next((k for k in places if _are_units(full[k])), None)
    if at is None:
        at = next((k for k in places if k and _are_under_names(full[k - 1], full[k])), None)
    if at is not None and (len(full) > 1 or _is_bracketed(full[at])):
        own = [_bare(cell) for cell in full[at]]
        full = full[:at] or full[at + 1 :]
    names = _in_pairs(above, width) or (full[-1] if full else [""] * width)
    names = [label or name for label, name in zip(_line_of(NAME_LINES, above, width), names, strict=True)]
    own = [unit or cell for unit, cell in zip(_line_of(UNIT_LINES, above, width), own, strict=True)]
    split = [split_unit(name or f"column {k + 1}") for k, name in enumerate(names)]
    both = [
        "" if unit == "-" and is_time(name) else unit or inner
        for unit, (name, inner) in zip(own, split, strict=True)
    ]
    return tuple(_unique([name for name, _ in split])), tuple(map(units.told, both)), any(names)


def _in_pairs(above: list[list[str]], width: int) -> list[str]:
    """Headings of pairs of columns (time, value) below header lines that repeat one key; empty for other headers."""
    lines = [row for row in above if len(row) == width > 3 and row[0] and len(set(row[::2])) == 1]
    if width % 2 or len(lines) < 2 or len(set(lines[0][1::2])) < width // 2:
        return []
    # The first such line has the names; a key with a unit, "SampleTime[ms];1", gives the unit of the times.
    steps = (split_unit(row[0]) for row in lines)
    unit = next((f" [{unit}]" for name, unit in steps if unit.lower() in SECONDS and unit), "")
    return [cell for name in lines[0][1::2] for cell in (f"time{unit}", name)]


def _unit_of_cells(cells: Iterable[str]) -> str:
    """Unit that most cells of a column have; empty if there is none."""
    found = Counter(bare_number(cell)[1] for cell in cells)
    (unit, count), *_ = found.most_common(1) or [("", 0)]
    return unit if 2 * count > found.total() else ""


def _line_of(words: frozenset[str], above: list[list[str]], width: int) -> list[str]:
    """Cells, by column, of the header line that starts with one of `words`; empty cells if there is none."""
    # The last line above the records is the heading line.
    row = next((row for row in above[:-1] if row and row[0].lower() in words), [])
    return ["", *row[1:width], *[""] * width][:width]


def _is_bracketed(row: Sequence[str]) -> bool:
    return all(re.fullmatch(r"[\[({<].*[\])}>]", cell) for cell in row if cell)


def _are_units(row: Sequence[str]) -> bool:
    filled = [cell for cell in row if cell]
    return bool(filled) and (
        _is_bracketed(row) or all(units.is_unit(_bare(cell)) or cell in "[]" for cell in filled)
    )


def _are_under_names(names: Sequence[str], row: Sequence[str]) -> bool:
    """Whether a row below the names holds units; unknown ones count if the time's unit is known or a unit repeats."""
    filled = [cell for cell in row if cell]
    given = [name for name in names if name and not is_time(name)]
    below = list(zip(names, row, strict=True))
    if any(cell and not name for name, cell in below) or any(map(looks_like_time, names)):
        return False
    timed = any(is_time(split_unit(name)[0]) for name in names) and all(
        not is_time(cell) or (is_time(split_unit(name)[0]) and _bare(cell).lower() in SECONDS)
        for name, cell in below
    )
    known = sum(units.is_unit(_bare(cell)) for cell in filled)
    others = [cell for cell in filled if not is_time(cell)]
    told = timed or 2 * known >= len(filled) or len(set(others)) < len(others)
    return bool(filled) and len(set(given)) == len(given) and told


def _bare(unit: str) -> str:
    return unit.strip("[](){}<>")


def _unique(names: list[str]) -> list[str]:
    """Append numbers to equal names of time columns; equal names of other channels cause an error later."""
    seen: Counter[str] = Counter()
    found = []
    for name in names:
        seen[name] += 1
        again = seen[name] > 1 and (is_time(name) or is_date(name))
        found.append(f"{name} ({seen[name]})" if again else name)
    return found


def _number(cell: str, decimal: str) -> float:
    try:
        return float("".join(re.findall(r"[0-9eE+\-" + decimal + "]", cell)).replace(decimal, "."))
    except ValueError:  # a date, or a word such as true
        return np.nan


def _taken_facts(above: list[list[str]], holds: Sequence[bool], decimal: str) -> list[tuple[str, float]]:
    """Remove metadata (a value below its name, or "tInc = 2e-6 s" in one cell) from heading rows; return name and value."""
    facts: list[tuple[str, float]] = []
    for upper, lower in pairwise([*above, []]):
        for k, cell in enumerate(upper):
            if k < len(holds) and holds[k]:
                continue
            inline = INLINE.fullmatch(cell)
            if inline:
                facts.append((inline["name"], float(inline["value"].replace(decimal, "."))))
                upper[k] = ""
            elif cell and k < len(lower) and is_number(lower[k], decimal) and not is_number(cell, decimal):
                facts.append((cell, _number(lower[k], decimal)))
                upper[k] = lower[k] = ""
        while len(upper) > len(holds) and not upper[-1]:
            upper.pop()
    return facts


def _facts(line: str, decimal: str) -> list[tuple[str, float]]:
    """Names and values [Hz or s] in a line like "Sample rate: 2 kHz"."""
    found = RATE.search(line.lstrip(COMMENT + ' "'))
    if found is None:
        return []
    try:
        value = float(found["value"].rstrip(".,").replace(decimal, "."))
    except ValueError:
        return []
    return [(found["name"], value * SCALES.get(found["unit"] or found["after"] or "", 1.0))]


def _footer(
    path: Path, encoding: str, line_end: str, delimiter: str, decimal: str, before: int
) -> tuple[int, tuple[str, ...]]:
    """Offset and lines of the footer, which are all lines after the last line that starts with a number."""
    size = path.stat().st_size
    wide = 2 if encoding.startswith("utf-16") else 1
    start = max(before, size - SAMPLE)
    start += (start - before) % wide
    with path.open("rb") as file:
        file.seek(start)
        text = file.read().decode(encoding, "replace")
    lines = text.split(line_end)
    cut = len(lines)
    while cut > 1:
        cells = [cell for cell in cells_of(lines[cut - 1].rstrip("\r"), delimiter) if cell]
        if cells and is_number(cells[0], decimal):
            break
        cut -= 1
    left = [line.strip() for line in lines[cut:] if line.strip()]
    # A truncated last line in a column of words is not a footer.
    if not left or cut <= 1:
        return size, ()
    return size - len(line_end.join(lines[cut:]).encode(encoding)), tuple(left)
