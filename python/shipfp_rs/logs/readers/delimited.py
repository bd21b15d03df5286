"""Delimited text files (CSV). A first pass indexes the records and finds number types; later passes read any stretch."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv

from shipfp_rs.errors import InputError
from shipfp_rs.logs.formats import warn
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.delimited_layout import GROUPED, Layout, bare_number, find_layout
from shipfp_rs.logs.readers.table import METADATA_KEY, Options, log_of_table
from shipfp_rs.logs.readers.time_cells import is_date, is_time

PART = 1 << 22
"""Number of bytes of text parsed at once."""


@register_reader(".csv", ".txt", ".tsv", ".tab", ".prn", ".lvm", ".log", ".asc", ".msl", takes=("time",))
def open_delimited(path: Path, rate_hz: float | None, time: str | None = None) -> Log:
    """Open a delimited file; delimiter, decimal mark, headings, units, time and rate are detected in its first lines."""
    layout = find_layout(path)
    index = _Index(path, layout)
    for start, text, length in _parts(path, layout, layout.bytes_before):
        index.add(start, text, length)
    if layout.footer:
        shown = " | ".join(layout.footer)[:60]
        warn(path, f"{len(layout.footer)} lines after the last record are left out: {shown!r}")
    else:  # a last line without a line end may be truncated, even within a number
        _warn_of_rest(path, layout, index.end)
    for place, cells in index.others.items():
        if cells:
            shown = ", ".join(map(repr, sorted(set(cells))[:3]))
            warn(
                path,
                f"{len(cells)} cells of {layout.headings[place]!r} are no numbers and taken as missing: {shown}",
            )
    kept = [
        k
        for k, name in enumerate(layout.headings)
        if not (
            index.kinds[k] == pa.null() and (name == f"column {k + 1}" or (layout.rate_hz and is_time(name)))
        )
        and not (k == 0 and layout.counted and not time)
    ]
    named = _named(layout)
    schema = pa.schema(
        pa.field(named[k][0], index.kinds[k], metadata={METADATA_KEY: json.dumps(named[k][1]).encode()})
        for k in kept
    )
    places = {name: k for k, name in zip(kept, schema.names, strict=True)}

    def batches(column: str, first: int, size: int) -> Iterator[pa.Array]:
        part = int(np.searchsorted(index.rows, first, side="right")) - 1
        skip = first - index.rows[part]
        place, kind = places[column], schema.field(column).type
        for row, (_, text, _) in zip(
            index.rows[part:], _parts(path, layout, index.offsets[part]), strict=False
        ):
            if place in index.loose:
                values, _ = _numbers(layout, _parse(path, layout, text, row, {place: pa.string()}).column(0))
            else:
                values = _parse(path, layout, text, row, {place: kind}).column(0)
            for start in range(skip, len(values), size):
                part_of = values[start : start + size]
                yield part_of.combine_chunks() if isinstance(part_of, pa.ChunkedArray) else part_of
            skip = max(skip - len(values), 0)

    blank = frozenset(name for name, k in places.items() if k in index.blank)
    stated = None if time else layout.rate_hz
    options = Options(time, layout.decimal == ",", not layout.named, blank, stated)
    notes = () if layout.named else ("no headings: columns are counted",)
    return log_of_table(path, schema, index.rows[-1], batches, rate_hz, options, notes)


def _named(layout: Layout) -> list[tuple[str, dict[str, Any]]]:
    """Heading with unit, and metadata, of each column; a repeated heading, as of status columns, gets its column's name."""
    began = {"start_s": layout.start_s} if layout.start_s else {}
    named: list[tuple[str, dict[str, Any]]] = [(heading, began) for heading in layout.headings]
    count = Counter(heading for heading in layout.headings if not (is_time(heading) or is_date(heading)))
    for again in (heading for heading in count if count[heading] > 1):
        places = [k for k, heading in enumerate(layout.headings) if heading == again]
        for others in ((*layout.headings[1:], ""), ("", *layout.headings)):
            if all(count[others[k]] == 1 for k in places):
                for k in places:
                    named[k] = (f"{others[k]} {again}", {**began, "again": again})
    return [
        (f"{name} [{unit}]" if unit else name, facts)
        for (name, facts), unit in zip(named, layout.units, strict=True)
    ]


def _parts(path: Path, layout: Layout, offset: int) -> Iterator[tuple[int, bytes, int]]:
    """Yield offset in the file, text and number of bytes of each part, in whole lines; UTF-16 becomes UTF-8."""
    end_of_line = layout.line_end.encode(layout.encoding)
    with path.open("rb") as file:
        file.seek(offset)
        rest = b""
        while read := file.read(max(min(PART, layout.bytes_end - offset - len(rest)), 0)):
            end = read.rfind(end_of_line) + len(end_of_line)
            while layout.wide == 2 and end > 1 and (len(rest) + end) % 2:  # not a whole character
                end = read.rfind(end_of_line, 0, end - 1) + len(end_of_line)
            if end < len(end_of_line):
                end = 0
            if not end and len(read) == PART:
                raise InputError(
                    f"{path}: no line end within {PART} bytes from byte {offset}; is the file damaged?"
                )
            if end:
                text = rest + read[:end]
                yield offset, _plain(layout, text), len(text)
                offset += len(text)
                rest = b""
            rest += read[end:]


def _plain(layout: Layout, text: bytes) -> bytes:
    if layout.wide == 2:
        text = text.decode(layout.encoding, "replace").encode()
    text = text.replace(b"\r", b"\n") if layout.line_end == "\r" else text
    if layout.delimiter == " ":  # columns are padded with any number of spaces
        text = re.sub(rb"[ \t]+", b" ", text)
        text = re.sub(rb"(?m)^ | (?=\r?$)", b"", text)
    return text


def _warn_of_rest(path: Path, layout: Layout, end: int) -> None:
    with path.open("rb") as file:
        file.seek(end)
        rest = file.read(60 * layout.wide).decode(layout.encoding, "replace").strip()
    if rest:
        warn(
            path,
            f"the last line has no line end and may be cut: {rest!r} is left out; end it with one if it is whole",
        )


@dataclass
class _Index:
    """First row and byte of each part of a file, and the column types of the parts indexed so far."""

    path: Path
    layout: Layout
    rows: list[int] = field(default_factory=lambda: [0])
    offsets: list[int] = field(default_factory=list)
    kinds: list[pa.DataType] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.kinds = [pa.null()] * len(self.layout.headings)
        self._least = [0] * len(self.kinds)
        self.end = self.layout.bytes_before
        """Offset of the byte after the last whole line."""
        self.loose: set[int] = set()
        """Columns of numbers in which some cells have thousands separators or units, or are words."""
        self.others: dict[int, list[str]] = {}
        """Cells of the columns in `loose` that are not numbers."""
        self.blank: set[int] = set()
        """Columns with empty cells."""

    def add(self, offset: int, text: bytes, length: int) -> None:
        texts = {k: pa.string() for k, what in enumerate(self.layout.kinds) if what == "time"}
        table = _parse(self.path, self.layout, text, self.rows[-1], texts, all_columns=True)
        for k, what in enumerate(self.layout.kinds):
            kind, values = table.schema.types[k], table.column(k)
            if what == "number" and not _is_known(kind):
                if pa.types.is_string(kind):
                    self.loose.add(k)
                    values, others = _numbers(self.layout, values)
                    self.others.setdefault(k, []).extend(others)
                kind = pa.float64()
            elif not _is_known(kind):
                kind = pa.string()
            elif kind == pa.float64() and (pc.max(pc.abs(values)).as_py() or 0.0) >= 2.0**63:
                kind = self._unsigned(text, k) or kind
            if kind == pa.int64():
                self._least[k] = min(self._least[k], pc.min(values).as_py())
            if values.null_count:
                self.blank.add(k)
            self.kinds[k] = _wider(self.kinds[k], kind, self._least[k] < 0)
        self.offsets.append(offset)
        self.end = offset + length
        self.rows.append(self.rows[-1] + len(table))

    def _unsigned(self, text: bytes, column: int) -> pa.DataType | None:
        """Unsigned type of integers above the int64 range, which Arrow reads as floats; None for other columns."""
        try:
            _parse(self.path, self.layout, text, self.rows[-1], {column: pa.uint64()})
        except InputError:
            return None
        return pa.uint64()


def _numbers(layout: Layout, cells: pa.ChunkedArray | pa.Array) -> tuple[pa.Array, list[str]]:
    """Numbers in cells with thousands separators, units or a detached sign (null if not a number), and the other cells."""
    coded = pc.utf8_trim_whitespace(cells).dictionary_encode()
    coded = coded.combine_chunks() if isinstance(coded, pa.ChunkedArray) else coded
    others, values = [], []
    for cell in coded.dictionary.to_pylist():
        digits = bare_number(cell)[0]
        if grouped := GROUPED[layout.decimal].fullmatch(digits):
            digits = digits.replace(grouped[1], "")
        try:
            values.append(float(digits.replace(layout.decimal, ".")) if cell else None)
        except ValueError:
            values.append(None)
            others.append(cell)
    told = pc.is_in(coded.cast(pa.string()), value_set=pa.array(others, pa.string()))
    return pa.array(values, pa.float64()).take(coded.indices), coded.filter(told).to_pylist()


def _is_known(kind: pa.DataType) -> bool:
    return kind in (pa.null(), pa.bool_(), pa.int64(), pa.float64()) or pa.types.is_timestamp(kind)


def _wider(one: pa.DataType, other: pa.DataType, negative: bool) -> pa.DataType:
    """Type that can hold the values of both types."""
    if one == other or other == pa.null():
        return one
    if one == pa.null():
        return other
    if {one, other} == {pa.int64(), pa.uint64()} and not negative:
        return pa.uint64()
    numbers = {pa.int64(), pa.uint64(), pa.float64(), pa.bool_()}
    if {one, other} <= numbers:
        return pa.float64()
    return pa.timestamp("ns") if pa.types.is_timestamp(one) and pa.types.is_timestamp(other) else pa.string()


def _parse(
    path: Path,
    layout: Layout,
    text: bytes,
    row: int,
    only: dict[int, pa.DataType] | None = None,
    *,
    all_columns: bool = False,
) -> pa.Table:
    """Parse lines from record `row` on; types are those in `only`, else inferred; other columns only if `all_columns`."""
    names = [str(k) for k in range(len(layout.headings))]
    encoding = "utf-8" if layout.wide == 2 else layout.encoding
    types: dict[str, Any] = {names[k]: kind for k, kind in (only or {}).items()}
    try:
        return pa.csv.read_csv(
            pa.BufferReader(text),
            read_options=pa.csv.ReadOptions(
                column_names=names, encoding=encoding, use_threads=False, block_size=2 * PART
            ),
            parse_options=pa.csv.ParseOptions(delimiter=layout.delimiter, ignore_empty_lines=len(names) > 1),
            convert_options=pa.csv.ConvertOptions(
                include_columns=[] if all_columns else list(types),
                column_types=types,
                decimal_point=layout.decimal,
                strings_can_be_null=True,
            ),
        )
    except (OSError, ValueError, pa.ArrowException) as error:
        message = " ".join(str(error).split())
        cell = re.search(r"Row #(\d+)[:,]?\s*(.*)", message)
        line = layout.lines_before + row
        if cell:
            bad = re.search(r"invalid value '(.*)'", cell[2])
            told = f"holds {bad[1]!r}, expected a number" if bad else cell[2]
            message = f"line {line + int(cell[1])} {told}"
        else:
            message = f"from line {line + 1} on: {message}"
        where = f"channel {layout.headings[next(iter(only))]!r}: " if only and not all_columns else ""
        raise InputError(f"{path}: {where}{message}") from error
