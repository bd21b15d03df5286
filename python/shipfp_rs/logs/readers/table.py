"""Logs out of tables (Parquet, Arrow, CSV): one column a channel, time from metadata, the caller or a column."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import BLOCK, Channel, Samples
from shipfp_rs.logs.faults.clock import Clock, ClockScan, spliced
from shipfp_rs.logs.log import Log, one_line_errors
from shipfp_rs.logs.readers.time_base import TIME_NAMES, seconds_per, split_unit

METADATA_KEY = b"shipfp"
"""Key under which a field carries unit, rate, start and length of its channel, as JSON."""

Batches = Callable[[str, int, int], Iterator[pa.Array]]
"""(column, first row, size) to its values from that row on, in arrays of at most the size."""


def log_of_table(path: Path, schema: pa.Schema, rows: int, batches: Batches, rate_hz: float | None) -> Log:
    """Build a log from a table; columns without numbers are left out, with a warning."""
    if len(set(schema.names)) < len(schema.names):
        twice = next(name for name in schema.names if schema.names.count(name) > 1)
        raise InputError(f"{path}: column {twice!r} stands there twice; give each channel its own name")
    fields: dict[str, tuple[pa.Field, dict[str, Any]]] = {}
    for field in schema:
        name, unit = split_unit(field.name)
        # Two columns may differ by their unit only.
        name = field.name if name in fields else name
        fields[name] = (field, {"unit": unit, "samples": rows, **_facts(path, field)})

    start_s, start_utc = 0.0, _start_utc(path, schema)
    clock: Clock | None = None

    def same(row: int, earlier: int, count: int) -> bool:
        """Whether all numbers of some rows stand in earlier ones as well."""
        for field, _ in fields.values():
            if _is_number(field.type):
                here, before = (_rows(batches, field.name, first, count) for first in (row, earlier))
                if not np.array_equal(here, before, equal_nan=here.dtype.kind == "f"):
                    return False
        return True

    time = next((name for name in fields if name.lower() in TIME_NAMES), None)
    if rows and time is not None and "rate_hz" not in fields[time][1]:
        field, facts = fields.pop(time)
        start_utc = start_utc or _first_stamp(field, batches)
        scan = ClockScan()
        for times in _times(path, field, facts["unit"], batches, start_utc):
            scan.feed(times)
        clock = scan.finish(str(path), time, same, trusted=rate_hz is None)
        start_s, rate_hz = clock.start_s, rate_hz or clock.rate_hz

    without = [name for name, (field, _) in fields.items() if not _is_number(field.type)]
    if without and len(without) == len(fields):
        raise InputError(f"{path}: no numbers in {', '.join(without)}; expected at least one channel of them")
    if without:
        warnings.warn(f"{path}: no numbers in {', '.join(without)}; left out", LogWarning, stacklevel=5)
    channels = []
    for name, (_, facts) in fields.items():
        if name in without:
            continue
        rate = facts.get("rate_hz", rate_hz)
        if rate is None:
            raise InputError(
                f"{path}: no time base for {name!r}: neither a column {TIME_NAMES[0]!r} nor a rate; add the "
                "column or give rate_hz (--rate)"
            )
        begin = facts.get("start_s", start_s)
        # A column with a rate of its own does not go by the time column.
        count = clock.samples if clock and "rate_hz" not in facts else min(facts["samples"], rows)
        channels.append(Channel(name, facts["unit"], float(rate), count, float(begin)))

    def blocks(channel: str, first: int, size: int) -> Iterator[Samples]:
        field, facts = fields[channel]
        left = facts["samples"] - first
        with one_line_errors(path):
            for batch in batches(field.name, first, size):
                if left <= 0:
                    return
                yield _samples(batch[:left])
                left -= len(batch)

    if clock is None or not clock.faults:
        return Log(str(path), channels, blocks, start_utc)
    for fault in clock.faults:
        warnings.warn(f"{path}: {fault}", LogWarning, stacklevel=5)
    by_clock = spliced(blocks, clock.segments)

    def at_their_times(channel: str, first: int, size: int) -> Iterator[Samples]:
        return (blocks if "rate_hz" in fields[channel][1] else by_clock)(channel, first, size)

    return Log(str(path), channels, at_their_times, start_utc, clock.faults)


def _rows(batches: Batches, column: str, first: int, count: int) -> Samples:
    parts: list[Samples] = []
    for batch in batches(column, first, count):
        parts.append(_samples(batch)[: count - sum(map(len, parts))])
        if sum(map(len, parts)) == count:
            break
    return np.concatenate(parts)


def _samples(values: pa.Array) -> Samples:
    """Values as NumPy holds them; gaps are NaN, or masked where the type has no NaN."""
    if not values.null_count or pa.types.is_floating(values.type):
        return np.asarray(values.to_numpy(zero_copy_only=False))
    numbers = values.fill_null(pa.scalar(0).cast(values.type)).to_numpy(zero_copy_only=False)
    return np.ma.MaskedArray(numbers, values.is_null().to_numpy(zero_copy_only=False))


def _facts(path: Path, field: pa.Field) -> dict[str, Any]:
    """What this package wrote about a channel."""
    facts = _json(path, field.metadata)
    kinds = {"unit": str, "rate_hz": int | float, "start_s": int | float, "samples": int}
    for key, kind in kinds.items():
        if key in facts and not isinstance(facts[key], kind):
            raise InputError(
                f"{path}: column {field.name!r} has {key} = {facts[key]!r}; is the file damaged?"
            )
    return facts


def _start_utc(path: Path, schema: pa.Schema) -> datetime | None:
    clock = _json(path, schema.metadata).get("start_utc")
    return datetime.fromisoformat(clock).astimezone(UTC) if clock else None


def _json(path: Path, metadata: dict[bytes, bytes] | None) -> dict[str, Any]:
    facts = json.loads((metadata or {}).get(METADATA_KEY, b"{}"))
    if not isinstance(facts, dict):
        raise InputError(f"{path}: metadata {facts!r}, expected names and values; is the file damaged?")
    return facts


def _first_stamp(field: pa.Field, batches: Batches) -> datetime | None:
    """Return the first of a column of timestamps; those without a zone are taken as UTC."""
    if not pa.types.is_timestamp(field.type):
        return None
    first = next(batches(field.name, 0, 1))[0].cast(pa.timestamp("us"), safe=False).as_py()
    return first.replace(tzinfo=UTC) if first else None


def _times(
    path: Path, field: pa.Field, unit: str, batches: Batches, zero: datetime | None
) -> Iterator[npt.NDArray[np.float64]]:
    """Yield a time column in seconds; timestamps count from `zero`."""
    offset = 0
    if pa.types.is_timestamp(field.type):
        unit = field.type.unit
        offset = _microseconds(zero) * 1000 // round(seconds_per(path, unit) * 1e9)
    elif not _is_number(field.type):
        raise InputError(
            f"{path}: time column holds {field.type}, expected timestamps or a number of s, ms, us or ns"
        )
    factor = seconds_per(path, unit)
    with one_line_errors(path):
        for batch in batches(field.name, 0, BLOCK):
            if pa.types.is_timestamp(batch.type):
                batch = batch.cast(pa.int64())
            values = _samples(batch)
            values = values.filled(0) if isinstance(values, np.ma.MaskedArray) else values
            yield (values - offset if offset else values) * factor


def _microseconds(instant: datetime | None) -> int:
    return 0 if instant is None else (instant - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1)


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind))
