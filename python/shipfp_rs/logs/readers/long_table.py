"""Long tables of historians and databases, with one value per row; series of values with their own time stamps, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, blocks_of
from shipfp_rs.logs.faults.clock import same_rows
from shipfp_rs.logs.formats import one_line_errors
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers.columns import Found, log_of_found, tell_left_out
from shipfp_rs.logs.readers.status_columns import QUALITY, Batches, is_value
from shipfp_rs.logs.readers.time_cells import EPOCH, TimePlan, split_unit
from shipfp_rs.logs.time_axis import TimeAxis, time_axis
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.units import is_unit, told

Fields = Mapping[str, tuple[pa.Field, dict[str, Any]]]
EVEN = 0.1
"""Largest deviation of an even step from the median step, relative to the median."""


@dataclass(frozen=True)
class LongTable:
    """Rows of a long table: times, codes of their names, and values; name and unit of each code."""

    times: Array
    codes: npt.NDArray[np.int64]
    values: Array
    names: Sequence[str]
    units: Sequence[str]


def find_long_table(path: Path, fields: Fields, plan: TimePlan, batches: Batches) -> LongTable | None:
    """Find the names, values and units of a table with one value per row; None for other tables."""
    # A table is long if its only column of values stands beside words or small integers that repeat as signal names do.
    numbers = [field for field, facts in fields.values() if is_value(field.type) and "rate_hz" not in facts]
    words = [field for field, _ in fields.values() if pa.types.is_string(field.type)]
    counted = [
        field.name
        for field, facts in fields.values()
        if field in numbers
        and len(numbers) <= MOST_NUMBERS
        and pa.types.is_integer(field.type)
        and not facts["unit"]
        if len(next(batches(field.name, 0, BLOCK), pa.array([])).unique()) <= MOST_NAMES
    ]
    if not 1 <= len(numbers) <= MOST_NUMBERS or not (words or (counted and len(numbers) > 1)):
        return None

    def whole(key: str) -> pa.Array:
        return pa.chunked_array([*batches(key, 0, BLOCK)]).combine_chunks()

    with one_line_errors(path):
        times = np.concatenate(list(plan.seconds(path, lambda key: batches(key, 0, BLOCK))))
        columns = {field.name: whole(field.name) for field in (*numbers, *words)}
    coded = {key: _coded(cells) for key, cells in columns.items()}
    floats = [field.name for field in numbers if pa.types.is_floating(field.type)]
    texts = sorted((field.name for field in words), key=lambda key: -len(coded[key][1]))
    candidates = [*((key,) for key in texts), *combinations(texts, 2)]
    candidates += [(key,) for key in counted]
    for rising, keys in product((True, False), candidates):
        codes = _joined([coded[key][0] for key in keys])
        rest = [field.name for field in numbers if field.name not in keys]
        rest = [key for key in rest if len(rest) == 1 or not _follows(coded[key][0], codes)]
        rest = [key for key in rest if key in floats] or rest
        if len(rest) != 1:
            continue
        values = np.array(columns[rest[0]].to_numpy(zero_copy_only=False), dtype=np.float64)
        for own, told_by in (coded[key] for key in texts):
            if told_by and all(QUALITY.match(word) for word in told_by):
                bad = np.append([word.lower().startswith("bad") for word in told_by], False)[own]
                values[bad] = np.nan
        worded = pa.types.is_string(columns[keys[0]].type)
        if not _are_names(times, codes, values, worded=worded, rising=rising):
            continue
        rows = np.unique(codes, return_index=True)[1]
        rows = rows[codes[rows] >= 0]
        own_names = [" ".join(_name(key, columns[key][int(row)]) for key in keys) for row in rows]
        split = [split_unit(text) for text in own_names]
        if len({name for name, _ in split}) < len(split):  # some names differ only in their unit
            split = [(text, split_unit(text)[1]) for text in own_names]
        beside = next(
            (f.name for f in words if f.name not in keys and _are_units(*coded[f.name], codes)), None
        )
        units = [str(columns[beside][int(row)].as_py() or "") if beside else "" for row in rows]
        units = [told(unit) or own for unit, (_, own) in zip(units, split, strict=True)]
        return LongTable(times, codes, values, [name for name, _ in split], units)
    return None


MOST_NUMBERS, MOST_NAMES = 4, 256
"""Largest number of numeric columns of a long table (value, name, quality, row number), and of integers that are
names.
"""


def _name(key: str, cell: pa.Scalar) -> str:
    value = cell.as_py()
    return value if isinstance(value, str) else f"{key} {value}"


def _coded(cells: pa.Array) -> tuple[npt.NDArray[np.int64], list[Any]]:
    """Code of each cell in order of appearance (-1 for an empty cell), and the cell of each code."""
    told = cells.dictionary_encode()
    codes = np.asarray(told.indices.fill_null(-1).to_numpy(zero_copy_only=False), dtype=np.int64)
    return codes, told.dictionary.to_pylist()


def _joined(codes: Sequence[npt.NDArray[np.int64]]) -> npt.NDArray[np.int64]:
    """Code of each combination in order of appearance; -1 if a part is empty."""
    if len(codes) == 1:
        return codes[0]
    _, first, each = np.unique(np.column_stack(codes), axis=0, return_index=True, return_inverse=True)
    known = np.all([part >= 0 for part in codes], axis=0)
    places = np.argsort(np.argsort(np.where(known[first], first, len(known))))
    return np.asarray(np.where(known, places[each.reshape(-1)], -1))


def _follows(own: npt.NDArray[np.int64], names: npt.NDArray[np.int64]) -> bool:
    """Whether a column has one value for each name."""
    pairs = np.unique(np.column_stack([names, own])[own >= 0], axis=0)
    return len(np.unique(pairs[:, 0])) == len(pairs)


def _are_units(own: npt.NDArray[np.int64], words: list[str], names: npt.NDArray[np.int64]) -> bool:
    return bool(words) and _follows(own, names) and 2 * sum(map(is_unit, words)) >= len(words)


def _are_names(
    times: Array, codes: npt.NDArray[np.int64], values: Array, *, worded: bool, rising: bool
) -> bool:
    """Whether codes name signals, by their rows' times and (unless `worded`) values; `rising` requires rising times."""
    known = np.isfinite(times) & np.isfinite(values) & (codes >= 0)
    times, codes, values = times[known], codes[known], values[known]
    count = len(np.unique(codes))
    if not 1 < count <= len(codes) // 2:
        return False
    changed = np.diff(codes) != 0
    order = np.lexsort((np.arange(len(codes)), codes))
    news = np.any([np.diff(each[order]) != 0 for each in (times, codes, values)], axis=0)
    order = order[np.append(True, news)]  # a logger may write each row twice
    inside = np.diff(codes[order]) == 0
    if not inside.any() or not (worded or np.diff(values[order])[inside].any()):
        return False
    steps, own = np.diff(times), np.diff(times[order])[inside]
    across, within = np.abs(np.diff(values))[changed], np.abs(np.diff(values[order]))[inside]
    finer = float(np.median(within)) / max(float(np.median(across)) if len(across) else 0.0, 1e-300)
    # Either names share times that rise within each name, or each name has steps at least as even as those of all rows.
    shared = int(np.count_nonzero((steps <= 0.0) & changed))
    if 20 * np.count_nonzero(own <= 0.0) > len(own) and (rising or not worded):
        return False
    if shared >= count - 1 and rising:
        return worded or finer < 2.0
    each, ends = np.unique(codes[order][1:][inside], return_inverse=True)
    middle = np.array([np.median(own[ends == k]) for k in range(len(each))])[ends]
    uneven = np.abs(own - middle) > EVEN * middle
    mixed = np.abs(steps - np.median(steps)) > EVEN * np.median(steps)
    gained = int(np.count_nonzero(mixed)) - int(np.count_nonzero(uneven))
    often = 2 * np.count_nonzero(changed) >= len(changed) and -4 * gained <= len(steps)
    return bool((gained >= count or often) and (worded or finer < 0.5))


def log_of_long_table(path: Path, table: LongTable, plan: TimePlan, rate_hz: float | None) -> Log:
    """Log with one channel per name, at the times of its rows; names without a time base are omitted."""
    found: list[Found] = []
    held: dict[str, Array] = {}
    lost: list[str] = []
    present = np.unique(table.codes[table.codes >= 0])
    for code, name, unit in zip(present.tolist(), table.names, table.units, strict=True):
        rows = np.flatnonzero((table.codes == code) & np.isfinite(table.values) & np.isfinite(table.times))
        told = f"{plan.name} of {name}"
        try:
            axis, held[name] = own_grid(path, told, table.times[rows], table.values[rows], rate_hz)
        except InputError:
            lost.append(name)
        else:
            found.append(Found.on(axis, name, unit, plan))
    tell_left_out(path, "no time base in rows of their own", lost, all_of_them=not found)
    return log_of_found(path, found, blocks_of(held), ["one value a row, a channel for each name"])


@dataclass
class Series:
    """Values of one name and their times [s], as lists or arrays."""

    unit: str = ""
    resolution: float = 0.0
    times: Any = field(default_factory=list)
    values: Any = field(default_factory=list)


def log_of_series(
    path: Path,
    series: Mapping[str, Series],
    notes: Sequence[str] = (),
    zero: datetime | None = None,
    *,
    none: str = "no name has two values or more",
) -> Log:
    """Log of series, each on its own even grid; series without one are omitted with a note, `InputError` if none is left."""
    found: list[Found] = []
    held: dict[str, Array] = {}
    told = list(notes)
    for name, each in series.items():
        if len(each.values) < 2 or not np.isfinite(each.values).any():
            continue
        try:
            axis, held[name] = own_grid(path, name, np.asarray(each.times), np.asarray(each.values))
        except InputError as error:
            told.append(f"{name} left out: {str(error).removeprefix(f'{path}: ')}")
            continue
        told += [axis.note] if axis.note else []
        found.append(Found.on(axis, name, each.unit, start_utc=zero, resolution=each.resolution))
    if not found:
        why = told[-1] if len(told) > len(notes) else none
        raise InputError(f"{path}: no series of numbers in it ({why}); is it the right file?")
    return log_of_found(path, found, blocks_of(held), told, quiet=True)


def log_since_1970(path: Path, series: Mapping[str, Series], notes: Sequence[str]) -> Log:
    """Log of series with times in seconds since 1970; the earliest first time becomes the log's time zero."""
    zero = min((each.times[0] for each in series.values() if len(each.values) > 1), default=0.0)
    for each in series.values():
        each.times = np.asarray(each.times) - zero
    return log_of_series(path, series, notes, EPOCH + timedelta(seconds=zero) if zero else None)


def own_grid(
    path: Path, column: str, times: Array, values: Array, rate_hz: float | None = None
) -> tuple[TimeAxis, Array]:
    """Grid of a channel's own times [s], and its values in order of time; rows written twice count once."""
    order = np.argsort(times, kind="stable")
    times, values = times[order], np.asarray(values, dtype=np.float64)[order]
    same = same_rows([lambda first, stop: values[first:stop]])
    return time_axis(path, column, lambda: [times], rate_hz=rate_hz, same=same, held=True), values


def seconds_since_1970(text: str) -> float:
    """Seconds since 1970 of an instant in ISO 8601 or canboat's form, with a dash before the time of day; UTC by default."""
    text = text.strip()
    if len(text) > 10 and text[10] == "-":
        text = f"{text[:10]}T{text[11:]}"
    instant = datetime.fromisoformat(text)
    instant = instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant
    return (instant - EPOCH) / timedelta(seconds=1)
