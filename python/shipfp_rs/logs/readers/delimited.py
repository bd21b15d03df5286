"""Delimited text files (CSV): one pass finds records and number types, later ones read any stretch."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.delimited_layout import Layout, find_layout
from shipfp_rs.logs.readers.table import log_of_table

PART = 1 << 22
"""Bytes of text parsed at once."""


@register_reader(".csv", ".txt", ".asc")
def open_delimited(path: Path, rate_hz: float | None) -> Log:
    """Open a delimited file: delimiter, decimal mark, headings, units and rate are found in its first lines.

    A last line without a line end may have been cut anywhere, also within its last number: it is left out, with a
    warning.
    """
    layout = find_layout(path)
    index = _Index(path, layout)
    for start, text in _parts(path, layout.bytes_before):
        index.add(start, text)
    _warn_of_rest(path, index.end)
    schema = pa.schema(
        pa.field(f"{name} [{unit}]" if unit else name, kind)
        for name, unit, kind in zip(layout.headings, layout.units, index.kinds, strict=True)
    )
    places = {name: k for k, name in enumerate(schema.names)}

    def batches(column: str, first: int, size: int) -> Iterator[pa.Array]:
        part = int(np.searchsorted(index.rows, first, side="right")) - 1
        skip = first - index.rows[part]
        for row, (_, text) in zip(index.rows[part:], _parts(path, index.offsets[part]), strict=False):
            values = _parse(path, layout, text, row, {places[column]: schema.field(column).type})
            for start in range(skip, len(values), size):
                yield values.column(0)[start : start + size].combine_chunks()
            skip = max(skip - len(values), 0)

    return log_of_table(path, schema, index.rows[-1], batches, rate_hz or layout.rate_hz)


def _parts(path: Path, offset: int) -> Iterator[tuple[int, bytes]]:
    """Yield offset and text of about as many whole lines as make a part."""
    with path.open("rb") as file:
        file.seek(offset)
        rest = b""
        while read := file.read(PART):
            end = read.rfind(b"\n") + 1
            if not end and len(read) == PART:
                raise InputError(
                    f"{path}: no line end within {PART} bytes from byte {offset}; is the file damaged?"
                )
            if end:
                text = rest + read[:end]
                yield offset, text
                offset += len(text)
                rest = b""
            rest += read[end:]


def _warn_of_rest(path: Path, end: int) -> None:
    with path.open("rb") as file:
        file.seek(end)
        rest = file.read(60).decode("latin-1").strip()
    if rest:
        warnings.warn(
            f"{path}: the last line has no line end and may be cut: {rest!r} is left out; end it with one if it is "
            "whole",
            LogWarning,
            stacklevel=5,
        )


@dataclass
class _Index:
    """Rows and bytes at which the parts of a file begin, and the types of its columns so far."""

    path: Path
    layout: Layout
    rows: list[int] = field(default_factory=lambda: [0])
    offsets: list[int] = field(default_factory=list)
    kinds: list[pa.DataType] = field(default_factory=list)

    @property
    def end(self) -> int:
        """The byte after the last whole line."""
        return self._end

    def __post_init__(self) -> None:
        self.kinds = [pa.null()] * len(self.layout.headings)
        self._least = [0] * len(self.kinds)
        self._end = self.layout.bytes_before

    def add(self, offset: int, text: bytes) -> None:
        table = _parse(self.path, self.layout, text, self.rows[-1])
        for k, numeric in enumerate(self.layout.numeric):
            kind, values = table.schema.types[k], table.column(k)
            if numeric and not _is_known(kind):
                kind = pa.float64()  # reading the column names the cell that is no number
            elif kind == pa.float64() and (pc.max(pc.abs(values)).as_py() or 0.0) >= 2.0**63:
                kind = self._unsigned(text, k) or kind
            if kind == pa.int64():
                self._least[k] = min(self._least[k], pc.min(values).as_py())
            self.kinds[k] = _wider(self.kinds[k], kind, self._least[k] < 0)
        self.offsets.append(offset)
        self._end = offset + len(text)
        self.rows.append(self.rows[-1] + len(table))

    def _unsigned(self, text: bytes, column: int) -> pa.DataType | None:
        """Arrow takes integers above the range of int64 for floats."""
        try:
            _parse(self.path, self.layout, text, self.rows[-1], {column: pa.uint64()})
        except InputError:
            return None
        return pa.uint64()


def _is_known(kind: pa.DataType) -> bool:
    return kind in (pa.null(), pa.bool_(), pa.int64(), pa.float64()) or pa.types.is_timestamp(kind)


def _wider(one: pa.DataType, other: pa.DataType, negative: bool) -> pa.DataType:
    """Return the type that holds the values of both."""
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
    path: Path, layout: Layout, text: bytes, row: int, only: dict[int, pa.DataType] | None = None
) -> pa.Table:
    """Parse lines from record `row` on; all columns with the types they seem to have, or those in `only`."""
    names = [str(k) for k in range(len(layout.headings))]
    types: dict[str, Any] = {names[k]: kind for k, kind in (only or {}).items()}
    try:
        return pa.csv.read_csv(
            pa.BufferReader(text),
            read_options=pa.csv.ReadOptions(
                column_names=names, encoding=layout.encoding, use_threads=False, block_size=2 * PART
            ),
            parse_options=pa.csv.ParseOptions(delimiter=layout.delimiter, ignore_empty_lines=len(names) > 1),
            convert_options=pa.csv.ConvertOptions(
                include_columns=list(types), column_types=types, decimal_point=layout.decimal
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
        where = f"channel {layout.headings[next(iter(only))]!r}: " if only else ""
        raise InputError(f"{path}: {where}{message}") from error
