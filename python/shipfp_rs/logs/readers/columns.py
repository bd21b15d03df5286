"""Channels in nested variables: structs, matrices with named columns, and the times of each channel."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, Blocks, Channel, blocks_by_name, in_blocks
from shipfp_rs.logs.faults.clock import same_rows
from shipfp_rs.logs.formats import warn
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers.time_cells import TimePlan, is_time, split_bracketed, stated_rate, timed_by
from shipfp_rs.logs.readers.time_column import SAMPLE_ROWS, Column, find_time
from shipfp_rs.logs.time_axis import TimeAxis, time_axis


@dataclass(frozen=True)
class Found:
    """Channel with its time grid, its start if the file has one, and a note on its time column."""

    channel: Channel
    axis: TimeAxis | None = None
    start_utc: datetime | None = None
    note: str = ""

    @classmethod
    def on(
        cls,
        axis: TimeAxis,
        name: str,
        unit: str,
        plan: TimePlan | None = None,
        *,
        start_utc: datetime | None = None,
        resolution: float = 0.0,
    ) -> Found:
        """Make a channel on the grid of a time axis; `plan` is the interpretation of its times."""
        channel = Channel(name, unit, axis.rate_hz, axis.samples, axis.start_s, resolution)
        return cls(channel, axis, (plan and plan.zero) or start_utc, plan.note if plan else "")


def log_of_found(
    path: Path, found: Sequence[Found], rows: Blocks, notes: Sequence[str] = (), *, quiet: bool = False
) -> Log:
    """Log of the channels found, whose clock starts with the earliest one; `quiet` suppresses warnings of clock faults."""
    zero = min((each.start_utc for each in found if each.start_utc), default=None)
    channels = [
        replace(each.channel, start_s=each.channel.start_s + (each.start_utc - zero).total_seconds())
        if each.start_utc and zero
        else each.channel
        for each in found
    ]
    readers = {each.channel.name: each.axis.on_grid(rows) for each in found if each.axis}
    axes = {id(each.axis): (each.axis, each.channel.name) for each in found if each.axis}
    for axis, _ in axes.values():
        if not quiet:
            axis.tell(path)
    faults = tuple(fault for axis, name in axes.values() for fault in axis.faults_of(name))

    told = (*notes, *filter(None, dict.fromkeys(each.note for each in found)))
    return Log(str(path), channels, blocks_by_name(readers, rows), zero, faults, told)


def tell_left_out(path: Path, why: str, names: Sequence[str], *, all_of_them: bool) -> None:
    """Warn of omitted channels; `InputError` if no channel is left."""
    if names and all_of_them:
        raise InputError(f"{path}: {why}: {', '.join(names)}; expected at least one channel of numbers")
    if names:
        warn(path, f"left out, {why}: {', '.join(names)}")


VALUES = ("data", "values", "value", "y", "signal", "samples")
"""Possible names of the field with the samples in a struct that describes one channel."""
LABELS = re.compile("names|labels|channels|headers?|columns|colheaders|channel_?names|signals")
"""Possible names of a variable that lists the names of a matrix's columns."""
MOST_COLUMNS = 256
LEAST_ROWS = 8
"""A matrix with more columns, fewer rows, or fewer than two rows per column is not a table of channels."""


def is_table(shape: tuple[int, ...]) -> bool:
    """Whether a matrix may have channels as columns."""
    return (
        len(shape) == 2 and 1 < min(shape) <= MOST_COLUMNS and max(shape) >= max(LEAST_ROWS, 2 * min(shape))
    )


@dataclass(frozen=True)
class Row:
    """A vector of numbers: name without unit, unit, length, and a function that reads it."""

    name: str
    unit: str
    length: int
    read: Callable[[int, int], npt.NDArray[Any]]


def column_names(count: int, beside: Mapping[str, Sequence[str]], base: str) -> list[str]:
    """Names of a matrix's columns: a list of this length in the same struct, else `base` with a number."""
    fitting = {name: words for name, words in beside.items() if len(words) == count}
    chosen = next(
        (fitting[name] for name in fitting if LABELS.fullmatch(posixpath.basename(name).lower())), None
    )
    if chosen is None and len(fitting) == 1:
        chosen = next(iter(fitting.values()))
    if chosen is None or len(set(chosen)) < count:
        return [f"{base} {k + 1}" for k in range(count)]
    return [str(word).strip() or f"{base} {k + 1}" for k, word in enumerate(chosen)]


def named_time(row: Row, rows: Mapping[str, Row]) -> str:
    """Key of the time vector named after a row; "" if there is none."""
    fits = (key for key in rows if row.name.lower() in timed_by(key) and rows[key].length == row.length)
    return next(fits, "")


def times_among(keys: Collection[str]) -> set[str]:
    """Keys of time vectors: their last part means time, or they are named after another key."""
    lower = {key.lower() for key in keys}
    return {key for key in keys if is_time(split_bracketed(_last(key))[0]) or timed_by(key) & lower}


def time_of(
    row: Row, rows: Mapping[str, Row], scalars: Sequence[tuple[str, Any]] = ()
) -> tuple[str, float | None]:
    """Return the key of a row's time vector, or "" and the sample rate if that is stated instead."""
    if named := named_time(row, rows):
        return named, None
    # The nearest times are used: in the row's struct, else in a neighbouring struct of only times, else in the outer one.
    # Ambiguous times are ignored.
    times = {key for key in rows if is_time(split_bracketed(_last(key))[0])}
    plain = {posixpath.dirname(key) for key in rows if key not in times}
    above = row.name  # start with the fields of the row itself, which may be a struct of one channel
    while True:
        fitting = [key for key in rows if key in times and rows[key].length == row.length]
        own = next((key for key in fitting if posixpath.dirname(key) == above), "")
        holders = [(key, posixpath.dirname(key)) for key in fitting]
        beside = [key for key, at in holders if at and posixpath.dirname(at) == above and at not in plain]
        if own or len(beside) == 1:
            return own or beside[0], None
        rate = stated_rate(
            (_last(name), value) for name, value in scalars if posixpath.dirname(name) == above
        )
        if rate is not None:
            return "", rate
        if not above:
            return "", None
        above = posixpath.dirname(above)


def _last(key: str) -> str:
    return posixpath.basename(key)


def axis_of(
    path: Path, key: str, row: Row, rows: Mapping[str, Row], *, trusted: bool = False
) -> tuple[TimeAxis, TimePlan]:
    """Grid and interpretation of a time vector; with `trusted`, numbers without a unit are seconds."""
    import pyarrow as pa

    def cells(_: str) -> Iterator[Any]:
        for start in range(0, row.length, BLOCK):
            values = np.asarray(row.read(start, min(start + BLOCK, row.length)))
            yield pa.array(values.astype("M8[ns]") if values.dtype.kind == "M" else values)

    name, unit = split_bracketed(_last(key))
    column = Column(name, row.unit or unit, key, next(cells(key))[:SAMPLE_ROWS])
    wish = f"{name} [{column.unit or 's'}]" if trusted else name
    (plan,) = find_time(path, [column], {name: key}, wish=wish)
    same = same_rows(one.read for name, one in rows.items() if name != key and one.length == row.length)
    return time_axis(path, key, lambda: plan.seconds(path, cells), same=same), plan


def blocks_of_rows(path: Path, rows: Mapping[str, Row]) -> Blocks:
    """`Blocks` of the given rows."""
    return in_blocks(lambda name: rows[name].length, lambda name, *ends: rows[name].read(*ends), path)


def tell_no_time(path: Path, rows: Sequence[Row], *, all_of_them: bool) -> None:
    """Warn of rows without times, which are omitted; `InputError` if all rows of the file lack times."""
    if rows and all_of_them:
        raise InputError(
            f"{path}: no time base for {rows[0].name!r}: neither a scalar rate_hz nor a vector time of its "
            f"{rows[0].length} samples; add one or give rate_hz (--rate)"
        )
    tell_left_out(path, "no time base", [row.name for row in rows], all_of_them=False)
