"""Long tables from historians and databases: one value per row, with its time and signal name.

Also here:

- Values with individual time stamps, by name, as the channels of a log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, Blocks, Channel, Samples, blocks_of
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.formats import one_line_errors
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers.columns import tell_left_out
from shipfp_rs.logs.readers.time_cells import EPOCH, TimePlan, plain
from shipfp_rs.logs.time_axis import TimeAxis, time_axis
from shipfp_rs.support.units import told

NAMES_TEXT = """
name tag tagname tagid signal signalname channel channelname variable variablename parameter point
pointname bezeichnung kanal kanalname naam signaal variabele nom nombre señal nome segnale nazwa
sygnał navn namn nimi имя сигнал
"""
NAMES = frozenset(NAMES_TEXT.split())
VALUES_TEXT = "value val wert messwert waarde valeur valor valore wartość verdi værdi värde arvo значение"
VALUES = frozenset(VALUES_TEXT.split())
UNITS_TEXT = "unit units einheit eenheid unité unidad unità unidade jednostka enhet enhed yksikkö единица"
UNITS = frozenset(UNITS_TEXT.split())
"""Column names for signal names, values and units, in lower case without punctuation."""

Fields = Mapping[str, tuple[pa.Field, dict[str, Any]]]


def long_columns(fields: Fields) -> tuple[str, str, str | None] | None:
    """Fields of names, values and units (None without units); None if the table has no names or no values."""

    def first(words: frozenset[str], is_kind: Callable[[pa.DataType], bool]) -> str | None:
        found = (
            field.name for name, (field, _) in fields.items() if plain(name) in words and is_kind(field.type)
        )
        return next(found, None)

    names = first(NAMES, pa.types.is_string)
    values = first(VALUES, lambda kind: pa.types.is_floating(kind) or pa.types.is_integer(kind))
    return (names, values, first(UNITS, pa.types.is_string)) if names and values else None


def log_of_long_table(
    path: Path,
    columns: tuple[str, str, str | None],
    plan: TimePlan,
    batches: Callable[[str, int, int], Iterator[pa.Array]],
    rate_hz: float | None,
) -> Log:
    """Log with a channel for each name, at the times of its rows; names without a time base are omitted."""
    names, values, units = columns
    with one_line_errors(path):
        whole = {key: pa.chunked_array(list(batches(key, 0, BLOCK))) for key in columns if key}
        times = np.concatenate(list(plan.seconds(path, lambda key: batches(key, 0, BLOCK))))
    numbers = np.asarray(whole[values].to_numpy(), dtype=np.float64)
    coded = whole[names].combine_chunks().dictionary_encode()
    codes = np.asarray(coded.indices.fill_null(-1).to_numpy(zero_copy_only=False))
    channels: list[Channel] = []
    held: dict[str, Blocks] = {}
    axes: list[TimeAxis] = []
    lost: list[str] = []
    for code, name in enumerate(coded.dictionary.to_pylist()):
        rows = np.flatnonzero((codes == code) & np.isfinite(numbers) & np.isfinite(times))
        rows = rows[np.argsort(times[rows], kind="stable")]
        try:
            axis = time_axis(path, f"{plan.name} of {name}", partial(iter, (times[rows],)), rate_hz=rate_hz)
        except InputError:
            lost.append(name)
            continue
        unit = whole[units][int(rows[0])].as_py() if units else None
        channels.append(Channel(name, told(unit or ""), axis.rate_hz, axis.samples, axis.start_s))
        held[name] = axis.on_grid(blocks_of({name: numbers[rows]}))
        axes.append(axis)
    tell_left_out(path, "no time base in rows of their own", lost, all_of_them=not channels)
    for axis in axes:
        axis.tell(path)
    faults = tuple(fault for axis in axes for fault in axis.faults)
    notes = (f"one value a row, a channel for each {names!r}", *filter(None, (plan.note,)))
    return Log(
        str(path), channels, lambda name, *rows: held[name](name, *rows), plan.zero, faults, notes=notes
    )


@dataclass
class Series:
    """Values of one name; times in seconds since 1970."""

    unit: str = ""
    resolution: float = 0.0
    times: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)


def log_of_series(path: Path, series: Mapping[str, Series], notes: Sequence[str] = ()) -> Log:
    """Log of series, each on its own even grid. Series without such a grid are omitted with a note.

    Raises
    ------
    InputError
        If no series has two or more values at increasing times.
    """
    kept = {
        name: each for name, each in series.items() if len(each.values) > 1 and np.isfinite(each.values).any()
    }
    zero = min((each.times[0] for each in kept.values()), default=0.0)
    channels: list[Channel] = []
    held: dict[str, Blocks] = {}
    told = list(notes)
    faults: list[Fault] = []
    for name, each in kept.items():
        time = np.asarray(each.times) - zero
        order = np.argsort(time, kind="stable")
        samples = np.asarray(each.values, dtype=np.float64)[order]
        time = time[order]
        axis = own_axis(path, name, time, told, faults)
        if axis is None:
            continue
        channels.append(Channel(name, each.unit, axis.rate_hz, axis.samples, axis.start_s, each.resolution))
        held[name] = axis.on_grid(blocks_of({name: samples}))
    if not channels:
        why = told[-1] if len(told) > len(notes) else "no name has two values or more"
        raise InputError(f"{path}: no series of numbers in it ({why}); is it the right file?")

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        return held[name](name, first, size)

    start = EPOCH + timedelta(microseconds=round(zero * 1e6))
    return Log(str(path), channels, blocks, start if zero else None, tuple(faults), tuple(told))


def own_axis(
    path: Path, name: str, times: npt.NDArray[np.float64], notes: list[str], faults: list[Fault]
) -> TimeAxis | None:
    """Grid of a name's times [s], or None; appends the faults, and the reason for None, to `faults` and `notes`."""
    try:
        axis = time_axis(path, name, partial(iter, (times,)))
    except InputError as error:
        notes.append(f"{name} left out: {str(error).removeprefix(f'{path}: ')}")
        return None
    notes += [axis.note] if axis.note else []
    faults += axis.faults
    return axis


def seconds_since_1970(text: str) -> float:
    """Seconds since 1970 of an instant in ISO 8601 or canboat's form with a dash before the time of day.

    UTC without a zone.
    """
    text = text.strip()
    if len(text) > 10 and text[10] == "-":
        text = f"{text[:10]}T{text[11:]}"
    instant = datetime.fromisoformat(text)
    instant = instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant
    return (instant - EPOCH) / timedelta(seconds=1)
