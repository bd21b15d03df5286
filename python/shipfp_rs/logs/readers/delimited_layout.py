"""How a delimited text file is laid out, found from its first lines: mark, decimals, headings, units, rate."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from shipfp_rs.errors import InputError
from shipfp_rs.logs.readers.time_cells import looks_like_time
from shipfp_rs.logs.readers.time_words import is_date, is_time, split_unit, stated_rate
from shipfp_rs.support import units

SAMPLE = 1 << 16
"""Bytes from which the layout is found."""

SCORED = 200
"""Number of lines on which delimiters are tried; loggers write fewer above the records."""

PREAMBLE = 5
"""The records begin where so many lines in a row hold a number."""

HEADING_ROWS = 4
"""Most lines of names, units and descriptions right above the records."""

DIALECTS = (
    (",", "."),
    (";", "."),
    (";", ","),
    ("\t", "."),
    ("\t", ","),
    ("|", "."),
    ("|", ","),
    (" ", "."),
    (" ", ","),
    (",", ","),
)
"""Delimiter and decimal mark, the likelier first where both fit; decimal commas between commas stand in quotes."""

NUMBER = re.compile(
    r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)|true|false", re.IGNORECASE
)
GROUPED = {
    ".": re.compile(r"[+-]?[1-9]\d{0,2}([, '\u2019\u00a0\u202f])\d{3}(?:\1\d{3})*(?:\.\d*)?"),
    ",": re.compile(r"[+-]?[1-9]\d{0,2}([. '\u2019\u00a0\u202f])\d{3}(?:\1\d{3})*(?:,\d*)?"),
}
"""Numbers with marks between thousands, by the decimal mark."""
RATE = re.compile(
    r"(?P<name>[^\W\d][^\W\d_' .-]*(?:[' _.-]+[^\W\d][^\W\d_' .-]*)*)\s*[\[(]?(?P<unit>k?Hz|m?s|S/s)?[\])]?\s*[:=;,\t ]\s*"
    r"(?P<value>\d[\d.,eE+-]*)\s*(?P<after>k?Hz|m?s|S/s)?\b"
)
SCALES = {"kHz": 1e3, "ms": 1e-3}
COMMENT = "#%!/"


@dataclass(frozen=True)
class Layout:
    """Where the records of a file begin and end, and how they are written."""

    encoding: str
    delimiter: str
    decimal: str
    lines_before: int
    """Lines in front of the first record."""
    bytes_before: int
    bytes_end: int
    """Where a footer begins, or the file's end."""
    headings: tuple[str, ...]
    units: tuple[str, ...]
    numeric: tuple[bool, ...]
    """Whether most cells of the column are numbers."""
    timelike: tuple[bool, ...]
    """Whether most cells of the column are dates or times of day."""
    named: bool
    """Whether the file has headings."""
    footer: tuple[str, ...]
    rate_hz: float | None
    """Sample rate, where a line above the headings states one [Hz]."""

    def named_column(self, place: int) -> bool:
        """Whether a column has a name of its own; one without, and without a number, is the end of a line."""
        return self.headings[place] != f"column {place + 1}"

    @property
    def wide(self) -> int:
        """Least number of bytes of a character."""
        return 2 if self.encoding.startswith("utf-16") else 1


def find_layout(path: Path) -> Layout:
    """Find the layout of a delimited file; `InputError` where its first lines hold no rows of numbers."""
    with path.open("rb") as file:
        sample = file.read(SAMPLE)
    encoding, mark = _encoding(path, sample)
    wide = 2 if encoding.startswith("utf-16") else 1
    text = sample[mark : len(sample) // wide * wide].decode(encoding, "replace" if wide == 2 else "strict")
    whole = text[: text.rfind("\n") + 1] or text
    lines = whole.split("\n")
    lines = [line.rstrip("\r") for line in (lines if lines[-1] else lines[:-1])]
    delimiter, decimal = max(DIALECTS, key=lambda dialect: _score(lines[:SCORED], *dialect))
    rows = [cells_of(line, delimiter) for line in lines]
    width = _width(rows, decimal)
    holds_number = [any(is_number(cell, decimal) for cell in row) for row in rows]
    filled = [k for k, row in enumerate(rows) if any(row)]
    # Lines like "Sample rate;2000" look like records, but the headings come soon after them.
    first = next(
        (
            k
            for place, k in enumerate(filled)
            if _is_record(rows[k], width, decimal)
            and all(
                holds_number[j] or (j > filled[-1] - PREAMBLE and not _is_record(rows[j], width, decimal))
                for j in filled[place : place + PREAMBLE]
            )
        ),
        None,
    )
    if first is None:
        raise InputError(
            f"{path}: empty or without rows of numbers; expected a header line with channel names and lines of numbers"
        )
    headings, own, named = _headings([_uncommented(line, delimiter) for line in lines[:first]], width)
    full = [row for row in rows[first:] if len(row) == width]

    def most(k: int, what: str) -> bool:
        cells = [row[k] for row in full if row[k]]
        times = sum(looks_like_time(cell) for cell in cells)
        hits = times if what == "time" else sum(is_number(cell, decimal) for cell in cells) - times
        return bool(cells) and 2 * hits >= len(cells)

    timelike = tuple(most(k, "time") for k in range(width))
    numeric = tuple(
        (not any(row[k] for row in full) or most(k, "number")) and not timelike[k] for k in range(width)
    )
    before = mark + sum(len((line + "\n").encode(encoding)) for line in whole.split("\n")[:first])
    end, footer = _footer(path, encoding, delimiter, decimal, before)
    return Layout(
        encoding,
        delimiter,
        decimal,
        first,
        before,
        end,
        headings,
        own,
        numeric,
        timelike,
        named,
        footer,
        stated_rate(fact for line in lines[:first] for fact in _facts(line, decimal)),
    )


def _encoding(path: Path, sample: bytes) -> tuple[str, int]:
    """Return the encoding of a text file and the length of its byte order mark."""
    for mark, name in ((b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be"), (b"\xef\xbb\xbf", "utf-8")):
        if sample.startswith(mark):
            return name, len(mark)
    zeros = [sample[k::2].count(0) for k in (0, 1)]
    if sum(zeros):
        for name, place in (("utf-16-le", 1), ("utf-16-be", 0)):
            if zeros[place] > 0.8 * len(sample) / 2 and not zeros[1 - place]:
                return name, 0
        raise InputError(
            f"{path}: no text, it holds zero bytes; expected a text file, or the suffix of its format"
        )
    try:
        sample[: sample.rfind(b"\n") + 1 or None].decode()
    except UnicodeDecodeError:  # older loggers write ° and µ in one byte each
        return "latin-1", 0
    return "utf-8", 0


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line, without the space around them."""
    if delimiter == " ":
        line = line.strip()
    # A line is one record: a quote that damage left open must not swallow the lines after it.
    cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    return [cell.strip() for cell in cells]


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number, with or without marks between thousands, or a time."""
    if NUMBER.fullmatch(cell.replace(decimal, ".") if decimal == "." or "." not in cell else "no"):
        return True
    return bool(GROUPED[decimal].fullmatch(cell)) or looks_like_time(cell)


def _uncommented(line: str, delimiter: str) -> list[str]:
    return cells_of(line.lstrip(COMMENT).strip(" ") if line[:1] in COMMENT else line, delimiter)


def _score(lines: list[str], delimiter: str, decimal: str) -> tuple[int, int]:
    """Return the number of numeric cells less that of other cells; most lines after the first few are records."""
    rows = [cells_of(line, delimiter) for line in lines]
    numbers = [sum(is_number(cell, decimal) for cell in row) for row in rows]
    others = sum(sum(map(bool, row)) - count for row, count in zip(rows, numbers, strict=True))
    return sum(numbers) - others, _width(rows, decimal)


def _width(rows: list[list[str]], decimal: str) -> int:
    """Return the number of columns that most rows with numbers have."""
    widths = Counter(len(row) for row in rows if any(is_number(cell, decimal) for cell in row))
    return widths.most_common(1)[0][0] if widths else 0


def _is_record(row: list[str], width: int, decimal: str) -> bool:
    filled = [cell for cell in row if cell]
    return len(row) == width and 2 * sum(is_number(cell, decimal) for cell in filled) >= len(filled) > 0


def _headings(above: list[list[str]], width: int) -> tuple[tuple[str, ...], tuple[str, ...], bool]:
    """Names and units of the columns out of the rows above the records, and whether there are any names."""
    full: list[list[str]] = []
    for row in reversed(above):
        if not any(row):
            if full and len(full) > 1:
                break
            continue
        short = width - len(row)
        # A delimiter that ends every record may be missing after the names.
        if len(full) == HEADING_ROWS or not (short == 0 or (short == 1 and len(row) > 1)):
            break
        full.insert(0, [*row, *[""] * short])
    own = [""] * width
    at = next((k for k in reversed(range(len(full))) if _are_units(full[k])), None)
    if at is not None and (len(full) > 1 or _is_bracketed(full[at])):
        own = [cell.strip("[](){}<>") for cell in full[at]]
        full = full[:at] or full[at + 1 :]
    names = full[-1] if full else [""] * width
    split = [split_unit(name or f"column {k + 1}") for k, name in enumerate(names)]
    both = [unit or inner for unit, (_, inner) in zip(own, split, strict=True)]
    return tuple(_unique([name for name, _ in split])), tuple(map(units.told, both)), any(names)


def _is_bracketed(row: Sequence[str]) -> bool:
    return all(re.fullmatch(r"[\[({<].*[\])}>]", cell) for cell in row if cell)


def _are_units(row: Sequence[str]) -> bool:
    filled = [cell for cell in row if cell]
    return bool(filled) and (
        _is_bracketed(row) or all(units.is_unit(cell.strip("[](){}<>")) or cell in "[]" for cell in filled)
    )


def _unique(names: list[str]) -> list[str]:
    """Number columns of time that share a name; two other channels may not share one."""
    seen: Counter[str] = Counter()
    found = []
    for name in names:
        seen[name] += 1
        again = seen[name] > 1 and (is_time(name) or is_date(name))
        found.append(f"{name} ({seen[name]})" if again else name)
    return found


def _facts(line: str, decimal: str) -> list[tuple[str, float]]:
    """Name and value [Hz or s] of what a line like "Sample rate: 2 kHz" states."""
    found = RATE.search(line.lstrip(COMMENT + ' "'))
    if found is None:
        return []
    try:
        value = float(found["value"].rstrip(".,").replace(decimal, "."))
    except ValueError:
        return []
    return [(found["name"], value * SCALES.get(found["unit"] or found["after"] or "", 1.0))]


def _footer(
    path: Path, encoding: str, delimiter: str, decimal: str, before: int
) -> tuple[int, tuple[str, ...]]:
    """Return where the lines after the last record begin, and these: lines whose first word is no number."""
    size = path.stat().st_size
    wide = 2 if encoding.startswith("utf-16") else 1
    start = max(before, size - SAMPLE)
    start += (start - before) % wide
    with path.open("rb") as file:
        file.seek(start)
        text = file.read().decode(encoding, "replace")
    lines = text.split("\n")
    cut = len(lines)
    while cut > 1:
        cells = [cell for cell in cells_of(lines[cut - 1].rstrip("\r"), delimiter) if cell]
        if cells and is_number(cells[0], decimal):
            break
        cut -= 1
    left = [line.strip() for line in lines[cut:] if line.strip()]
    # A last line that was cut within a column of words is no footer.
    if not left or cut <= 1:
        return size, ()
    return size - len("\n".join(lines[cut:]).encode(encoding)), tuple(left)
