"""Logs from tables (Parquet, Arrow, CSV) with one column per channel; times are from metadata, the caller or a column."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, Blocks, Channel, Samples, blocks_by_name, first_of
from shipfp_rs.logs.faults.clock import Same, same_rows
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.formats import one_line_errors, warn
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers.columns import Found, log_of_found, tell_left_out
from shipfp_rs.logs.readers.long_table import find_long_table, log_of_long_table
from shipfp_rs.logs.readers.status_columns import Batches, find_statuses, status_faults, without_bad
from shipfp_rs.logs.readers.time_cells import (
    TimePlan,
    is_date,
    is_time,
    looks_like_time,
    split_unit,
    stated_rate,
)
from shipfp_rs.logs.readers.time_column import SAMPLE_ROWS, Column, Wish, find_time, timed_key
from shipfp_rs.logs.time_axis import FAR_OFF, TimeAxis, time_axis
from shipfp_rs.support.arrays import Array, unmasked

# Arrow imports pandas at its first conversion; an interrupt during this import would look like a missing package.
with contextlib.suppress(ImportError):
    import pandas  # noqa: F401

LEAST_SCATTERED = 8
"""Least number of values in the first rows of a sparse column, for it to be read as a channel."""
LEAST_CHANGES = 100
"""Least number of rows in a table of state changes."""
CHANGING = 0.95
"""Least fraction of state changes among the rows of such a table: a logger repeats a state at its start and end."""
METADATA_KEY = b"shipfp"
"""Key of a field's metadata with unit, rate, start and length of its channel, as JSON."""


@dataclass(frozen=True)
class Options:
    """Options of reading a table: requested time column, decimal commas, named columns."""

    time: str | None = None
    european: bool = False
    nameless: bool = False
    blank: frozenset[str] | None = None
    """Columns with empty cells; None if the reader has not determined them."""
    stated_hz: float | None = None
    """Rate stated in the header [Hz]; a time column of about this rate with gaps takes precedence."""


def log_of_table(
    path: Path,
    schema: pa.Schema,
    rows: int,
    batches: Batches,
    rate_hz: float | None,
    options: Options | None = None,
    notes: Sequence[str] = (),
) -> Log:
    """Build a log from a table; columns without numbers are omitted with a warning."""
    options = options or Options()
    fields = _named_fields(path, schema, rows)
    statuses = find_statuses(schema, {name: field.name for name, (field, _) in fields.items()}, batches)
    told_by = {key for key, _ in statuses.values()}
    fields = {name: entry for name, entry in fields.items() if entry[0].name not in told_by}
    _refuse_equal(path, [facts["again"] for _, facts in fields.values() if "again" in facts])
    recorded, batches = batches, without_bad(batches, statuses)
    plans = find_plans(path, fields, rows, batches, options)
    times = {key for plan in plans for key in plan.keys}
    keys = {name: field.name for name, (field, _) in fields.items()}
    named = [timed_key(plan.keys[0], keys) for plan in plans]
    fields = {name: entry for name, entry in fields.items() if entry[0].name not in times}
    if plans and not fields:
        raise InputError(
            f"{path}: times in {plans[0].name!r} and no values beside them, expected a channel of numbers; if "
            "they are the edges of a tachometer, name this file with file = in [channels.NAME] of the log's TRIAL.toml"
        )
    if len(plans) == 1 and (long := find_long_table(path, fields, plans[0], batches)):
        return log_of_long_table(path, long, plans[0], rate_hz)
    same = same_rows(
        partial(_numbers, batches, field.name) for field, _ in fields.values() if _is_number(field.type)
    )
    apart: dict[str, tuple[TimeAxis, Blocks]] = {}
    lost_apart: list[str] = []
    given = rate_hz or options.stated_hz
    if len(plans) == 1 and given is None:
        apart, lost_apart = _rows_apart(path, fields, plans[0], batches, options)
    elsewhere = {*apart, *lost_apart}
    shared = [n for n, (field, _) in fields.items() if _is_number(field.type) and n not in elsewhere]
    changes = rows >= LEAST_CHANGES and _are_changes(batches, [fields[name][0].name for name in shared])
    rates = (rate_hz, options.stated_hz)
    axes = [_axis(path, plan, batches, rates, same, changes) for plan in plans if shared or not elsewhere]
    without = [name for name, (field, _) in fields.items() if not _is_number(field.type)]
    if without and len(without) == len(fields):
        raise InputError(f"{path}: no numbers in {', '.join(without)}; expected at least one channel of them")
    if lost := [name for name in without if not _is_other_time(fields[name][0], batches)]:
        warn(path, f"no numbers in {', '.join(lost)}; left out")

    def blocks(channel: str, first: int, size: int) -> Iterator[Samples]:
        field, facts = fields[channel]
        with one_line_errors(path):
            yield from map(_samples, first_of(batches(field.name, first, size), facts["samples"] - first))

    # long: one loop over columns with three kinds of time, and notes on the whole table
    found: list[Found] = []
    own_faults: tuple[Fault, ...] = ()
    for name, (field, facts) in fields.items():
        if name in without or name in lost_apart:
            continue
        resolution = float(facts.get("resolution", 0.0))
        if name in apart:
            found.append(Found.on(apart[name][0], name, facts["unit"], plans[0], resolution=resolution))
        elif axes and "rate_hz" not in facts:  # a column with its own rate needs no time column
            place = _time_before(field.name, plans, schema.names, named)
            found.append(Found.on(axes[place], name, facts["unit"], plans[place], resolution=resolution))
        else:
            rate = (
                facts.get("rate_hz", given) or _stated_rate(field.metadata) or _stated_rate(schema.metadata)
            )
            if rate is None:
                raise InputError(f"{path}: no time base for {name!r}: {_without_time(fields, without)}")
            count, begin = min(facts["samples"], rows), float(facts.get("start_s", 0.0))
            found.append(Found(Channel(name, facts["unit"], float(rate), count, begin, resolution)))
        axis = found[-1].axis
        own_faults += status_faults(
            recorded, statuses, field.name, name, axis.on_grid if axis else lambda each: each
        )
    recorded_rows = blocks_by_name({name: own for name, (_, own) in apart.items()}, blocks)
    log = log_of_found(path, found, recorded_rows, notes)
    for fault in own_faults:
        warn(path, fault)
    log.faults = own_faults + log.faults
    if changes:
        log.faults += tuple(one for name in shared for one in axes[0].doubled(blocks, name))
        if axes[0].samples > rows:
            held = f"each is held until the next, at {axes[0].rate_hz:.6g} Hz"
            log.notes += (f"rows where a state changes alone: {held}",)
    if clock := _json(path, schema.metadata).get("start_utc"):
        log.start_utc = datetime.fromisoformat(clock).astimezone(UTC)
    return log


def _named_fields(path: Path, schema: pa.Schema, rows: int) -> dict[str, tuple[pa.Field, dict[str, Any]]]:
    """Field and metadata of each column, by name without unit."""
    _refuse_equal(path, [name for name in schema.names if schema.names.count(name) > 1])
    fields: dict[str, tuple[pa.Field, dict[str, Any]]] = {}
    for field in schema:
        name, unit = split_unit(field.name)
        # Two columns may differ only by their unit.
        name = field.name if name in fields else name
        fields[name] = (field, {"unit": unit, "samples": rows, **_facts(path, field)})
    return fields


def _refuse_equal(path: Path, names: Sequence[str]) -> None:
    for name in names:
        raise InputError(f"{path}: column {name!r} appears twice; give each channel its own name")


def _rows_apart(
    path: Path,
    fields: Mapping[str, tuple[pa.Field, dict[str, Any]]],
    plan: TimePlan,
    batches: Batches,
    options: Options,
) -> tuple[dict[str, tuple[TimeAxis, Blocks]], list[str]]:
    """Grid and rows of channels with numbers in only some rows, and the names of omitted ones, which lack a time base."""
    columns = {
        name: field.name
        for name, (field, facts) in fields.items()
        if _is_number(field.type)
        and "rate_hz" not in facts
        and (options.blank is None or field.name in options.blank)
    }
    sample = {
        name: np.concatenate(
            [np.empty(0, bool), *map(_known, first_of(batches(key, 0, SAMPLE_ROWS), SAMPLE_ROWS))]
        )
        for name, key in columns.items()
    }
    if all(known.all() for known in sample.values()):
        return {}, []
    with one_line_errors(path):
        times = np.concatenate(list(plan.seconds(path, lambda key: batches(key, 0, BLOCK))))
    written = np.column_stack(list(sample.values()))
    again = (np.diff(times[: len(written)]) == 0.0) & (written[1:] == written[:-1]).all(axis=1)
    if not any(_is_scattered(known[np.append(True, ~again)]) for known in sample.values()):
        return {}, []
    apart: dict[str, tuple[TimeAxis, Blocks]] = {}
    lost: list[str] = []
    for name, key in columns.items():
        if sample[name].all():
            continue
        rows = np.flatnonzero(np.concatenate([_known(batch) for batch in batches(key, 0, BLOCK)]))

        def own(_: str, first: int, size: int, key: str = key, rows: Any = rows) -> Iterator[pa.Array]:
            with one_line_errors(path):
                for batch in batches(key, int(rows[first]), size):
                    yield batch.filter(pa.array(_known(batch)))

        def blocks(key: str, first: int, size: int, own: Batches = own) -> Iterator[Samples]:
            yield from map(_samples, own(key, first, size))

        try:
            told, same = f"{plan.name} of {name}", same_rows([partial(_numbers, own, key)])
            apart[name] = time_axis(path, told, partial(iter, (times[rows],)), same=same, held=True), blocks
        except InputError:
            lost.append(name)
    tell_left_out(path, "no time base in rows of their own", lost, all_of_them=False)
    return apart, lost


def _known(values: pa.Array) -> npt.NDArray[np.bool_]:
    return ~np.asarray(values.is_null(nan_is_null=True).to_numpy(zero_copy_only=False))


def _is_scattered(known: npt.NDArray[np.bool_]) -> bool:
    """Whether a column's numbers are mostly isolated, unlike those of a continuous column with gaps."""
    alone = np.count_nonzero(known & ~np.concatenate([[False], known[:-1]]))
    return bool(not known.all() and known.sum() >= LEAST_SCATTERED and 2 * alone >= known.sum())


def _are_changes(batches: Batches, columns: Sequence[str]) -> bool:
    """Whether all columns have two states, and almost every row is a change, as in a logic analyser's list of edges."""
    changed: list[npt.NDArray[np.bool_]] = []
    with contextlib.suppress(InputError):  # an error in a cell is reported when the column is read
        for name in columns:
            values = _numbers(batches, name, 0, SAMPLE_ROWS)
            if len(np.unique(values)) > 2:
                return False
            changed.append(values[1:] != values[:-1])
        return bool(changed) and bool(np.mean(np.any(changed, axis=0)) > CHANGING)
    return False


def _time_before(
    column: str, plans: Sequence[TimePlan], order: Sequence[str], named: Sequence[str | None]
) -> int:
    """Index of a column's time column: the one named after it, else the last one to its left, else the first."""
    if column in named:
        return named.index(column)
    before = (k for k, plan in enumerate(plans) if order.index(plan.keys[0]) <= order.index(column))
    return max(before, default=0)


def find_plans(
    path: Path,
    fields: Mapping[str, tuple[pa.Field, dict[str, Any]]],
    rows: int,
    batches: Batches,
    options: Options,
) -> list[TimePlan]:
    """Find the time columns; columns that can't be times are not read."""
    if not rows:
        return []
    columns: list[Column] = []
    first = next(iter(fields), "")
    names = {name: field.name for name, (field, _) in fields.items()}
    wished = Wish.of(options.time).columns if options.time else ()
    for name, (field, facts) in fields.items():
        asked = name in wished or field.name in wished or name.lower() in {text.lower() for text in wished}
        of_another = timed_key(field.name, names) is not None
        likely = (
            not wished
            and "rate_hz" not in facts
            and (is_time_like(field.type, name) or of_another or name == first)
        )
        if asked or likely:
            cells = pa.concat_arrays(first_of(batches(field.name, 0, SAMPLE_ROWS), SAMPLE_ROWS))
            own = f"time ({len(columns) + 1})" if of_another and not wished else name
            columns.append(Column(own, facts["unit"], field.name, cells))
    return find_time(
        path, columns, names, wish=options.time, european=options.european, nameless=options.nameless
    )


def is_time_like(kind: pa.DataType, name: str) -> bool:
    """Whether a column may hold times: timestamps, text, or numbers with a name that means time."""
    if pa.types.is_timestamp(kind) or pa.types.is_string(kind):
        return True
    return _is_number(kind) and not pa.types.is_boolean(kind) and (is_time(name) or is_date(name))


def _is_other_time(field: pa.Field, batches: Batches) -> bool:
    """Whether a column holds times although it was not chosen as the time column."""
    parts = first_of(batches(field.name, 0, SAMPLE_ROWS), SAMPLE_ROWS * pa.types.is_string(field.type))
    first = next((cell for part in parts for cell in part.to_pylist() if cell), None)
    return looks_like_time(first) if first else bool(pa.types.is_timestamp(field.type))


def _axis(
    path: Path,
    plan: TimePlan,
    batches: Batches,
    rates_hz: tuple[float | None, float | None],
    same: Same,
    changes: bool,
) -> TimeAxis:
    def cells(key: str) -> Iterator[pa.Array]:
        return batches(key, 0, BLOCK)

    def times() -> Iterator[npt.NDArray[np.float64]]:
        with one_line_errors(path):
            yield from plan.seconds(path, cells)

    given, stated = rates_hz
    if given is None and stated is not None:
        with contextlib.suppress(InputError):
            axis = time_axis(path, plan.name, times, same=same)
            if axis.faults and max(axis.rate_hz / stated, stated / axis.rate_hz) < FAR_OFF:
                return axis
    return time_axis(path, plan.name, times, rate_hz=given or stated, same=same, changes=changes)


def _without_time(fields: Mapping[str, tuple[pa.Field, dict[str, Any]]], without: Sequence[str]) -> str:
    """Error text for a table without times."""
    for name, (_, facts) in fields.items():
        if is_time(name) and facts["unit"]:
            return (
                f"column {name!r} is in {facts['unit']!r}, expected timestamps or a number of s, ms, us, ns, min or h; give "
                "its unit (--time 'COLUMN [ms]') or rate_hz (--rate)"
            )
    texts = ", ".join(repr(name) for name in without[:3])
    return (
        "neither a column 'time' nor a rate; add the column or give rate_hz (--rate), or name the column of time (--time)"
        + (f"; {texts} holds no time that is known here" if texts else "")
    )


def _numbers(batches: Batches, column: str, first: int, stop: int) -> Array:
    parts = first_of(batches(column, first, stop - first), stop - first)
    return np.concatenate([unmasked(_samples(part)) for part in parts])


def _samples(values: pa.Array) -> Samples:
    """Values as a NumPy array; gaps are NaN, or masked if the type has no NaN."""
    if not values.null_count or pa.types.is_floating(values.type):
        return np.asarray(values.to_numpy(zero_copy_only=False))
    numbers = values.fill_null(pa.scalar(0).cast(values.type)).to_numpy(zero_copy_only=False)
    return np.ma.MaskedArray(numbers, values.is_null().to_numpy(zero_copy_only=False))


def _facts(path: Path, field: pa.Field) -> dict[str, Any]:
    """Metadata of a channel written by this package."""
    facts = _json(path, field.metadata)
    numbers = dict.fromkeys(("rate_hz", "start_s", "resolution"), int | float)
    kinds = {"unit": str, "samples": int, **numbers}
    for key, kind in kinds.items():
        if key in facts and not isinstance(facts[key], kind):
            raise InputError(
                f"{path}: column {field.name!r} has {key} = {facts[key]!r}; is the file damaged?"
            )
    return facts


def _stated_rate(metadata: dict[bytes, bytes] | None) -> float | None:
    """Rate [Hz] given by another program for a column or a table, such as sample_rate_hz."""
    numbers = []
    for key, value in (metadata or {}).items():
        with contextlib.suppress(ValueError):  # words
            numbers.append((key.decode(errors="replace"), float(value)))
    return stated_rate(numbers)


def _json(path: Path, metadata: dict[bytes, bytes] | None) -> dict[str, Any]:
    facts = json.loads((metadata or {}).get(METADATA_KEY, b"{}"))
    if not isinstance(facts, dict):
        raise InputError(f"{path}: metadata {facts!r}, expected names and values; is the file damaged?")
    return facts


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind))
