"""Parquet files, read and written by row group."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, Channel, Samples
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.table import METADATA_KEY, Options, log_of_table
from shipfp_rs.support.arrays import attributes, even_parts
from shipfp_rs.support.files import local, replacing


@register_reader(".parquet", ".pq", takes=("time",))
def open_parquet(path: Path, rate_hz: float | None, time: str | None = None) -> Log:
    """Open a Parquet file."""
    with path.open("rb") as stream:
        begin = stream.read(4)
        stream.seek(-min(4, path.stat().st_size), 2)
        end = stream.read(4)
    if begin == b"PARE" or end == b"PARE":
        raise InputError(f"{path}: the Parquet file is encrypted; decrypt it first")
    if begin == b"PAR1" and end != begin:
        raise InputError(
            f"{path}: the Parquet file has no footer and can't be read: it was cut short or never closed; "
            "fetch it again"
        )
    file = pa.parquet.ParquetFile(local(path))
    groups = [file.metadata.row_group(index).num_rows for index in range(file.metadata.num_row_groups)]
    if min(groups, default=0) < 0 or sum(groups) != file.metadata.num_rows:
        raise InputError(f"{path}: row groups of {groups} rows; is the file damaged?")
    starts = np.concatenate([[0], np.cumsum(groups, dtype=np.int64)])

    def batches(column: str, first: int, size: int) -> Iterator[pa.Array]:
        group = int(np.searchsorted(starts, first, side="right")) - 1
        skip = first - int(starts[group])
        # pre_buffer would load whole row groups, and the only row group may be the whole file.
        # Reading the footer of a long log takes as long as reading a stretch, so the footer is read once.
        stream = pa.parquet.ParquetFile(local(path), metadata=file.metadata, pre_buffer=False)
        while group < len(groups):
            # Select few row groups at a time: selecting all to the end takes longer than reading a short stretch.
            stop = min(max(int(np.searchsorted(starts, first + size)), group + 1), len(groups))
            for batch in stream.iter_batches(size, row_groups=range(group, stop), columns=[column]):
                if skip < len(batch):
                    yield batch.column(0)[skip:]
                skip = max(skip - len(batch), 0)
            group, first = stop, int(starts[stop])

    return log_of_table(path, file.schema_arrow, file.metadata.num_rows, batches, rate_hz, Options(time))


def write_parquet(log: Log, path: Path) -> Path:
    """Write a log; see `Log.write`."""
    if path.exists() and Path(log.name).exists() and path.samefile(log.name):
        raise InputError(f"{path}: is the log itself; choose another name")
    streams = {name: even_parts(log.raw_blocks(name), BLOCK) for name in log.channels}
    begins = {name: next(stream, [np.empty(0)]) for name, stream in streams.items()}
    clock = {} if log.start_utc is None else {"start_utc": log.start_utc.isoformat()}
    schema = pa.schema(
        [_field(c, begins[c.name][0].dtype) for c in log.channels.values()],
        metadata={METADATA_KEY: json.dumps(clock).encode()},
    )
    length = max(channel.samples for channel in log.channels.values())
    with (
        replacing(path) as temporary,
        pa.parquet.ParquetWriter(
            local(temporary), schema, compression="zstd", use_dictionary=False
        ) as writer,
    ):
        for first in range(0, length, BLOCK):
            rows = min(BLOCK, length - first)
            held = (begins.pop(name) if name in begins else next(streams[name], []) for name in schema.names)
            columns = [_column(parts, rows, kind) for parts, kind in zip(held, schema.types, strict=True)]
            writer.write_table(pa.Table.from_arrays(columns, schema=schema))
    return path


def _column(parts: list[Samples], rows: int, kind: pa.DataType) -> pa.Array:
    """Column of samples, filled up with nulls."""
    missing = pa.nulls(rows - sum(map(len, parts)), kind)
    return pa.concat_arrays([*(_stored(part, kind) for part in parts), missing])


def _stored(part: Samples, kind: pa.DataType) -> pa.Array:
    """Samples as an array of the given type; for integers, NaN becomes null."""
    lost = part.dtype.kind == "f" and not pa.types.is_floating(kind)
    return pa.array(np.ma.masked_invalid(part) if lost else part, type=None if lost else kind).cast(kind)


def _field(channel: Channel, dtype: np.dtype[Any]) -> pa.Field:
    told = ("unit", "rate_hz", "start_s", "samples", *["resolution"] * bool(channel.resolution))
    facts = attributes(channel, *told)
    return pa.field(
        channel.name, pa.from_numpy_dtype(dtype), metadata={METADATA_KEY: json.dumps(facts).encode()}
    )
