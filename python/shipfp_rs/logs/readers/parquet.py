"""Parquet files, read and written by row group."""

from __future__ import annotations

import itertools
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.ipc
import pyarrow.parquet

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import BLOCK, Channel, Samples
from shipfp_rs.logs.log import Log, register_reader, register_writer
from shipfp_rs.logs.readers.table import METADATA_KEY, Options, log_of_table
from shipfp_rs.support.files import local, replacing

MAGIC = b"ARROW1\0\0"


@register_reader(".feather", ".arrow", ".arrows", takes=("time",))
def open_arrow(path: Path, rate_hz: float | None, time: str | None = None) -> Log:
    """Open an Arrow file or stream; a file without its footer is read as a stream, with a warning."""
    with path.open("rb") as file:
        begin = file.read(len(MAGIC))
        file.seek(-min(6, path.stat().st_size), 2)
        closed = file.read() == MAGIC[:6]
    if begin[:6] == b"FEA1":
        raise InputError(f"{path}: a Feather file of version 1; write it again as version 2")
    if begin == MAGIC and closed:
        return _open_file(path, rate_hz, time)
    return _open_stream(path, len(MAGIC) if begin == MAGIC else 0, rate_hz, time)


def _open_file(path: Path, rate_hz: float | None, time: str | None) -> Log:
    file = pa.ipc.open_file(pa.memory_map(str(path)))
    lengths = [file.get_batch(index).num_rows for index in range(file.num_record_batches)]

    def batches(column: str, first: int, size: int) -> Iterator[pa.Array]:
        only = pa.ipc.IpcReadOptions(included_fields=[file.schema.get_field_index(column)])
        source = pa.ipc.open_file(pa.memory_map(str(path)), options=only)
        skip = first
        for index, length in enumerate(lengths):
            if skip < length:
                yield from _pieces(source.get_batch(index).column(0), skip, size)
            skip = max(skip - length, 0)

    return log_of_table(path, file.schema, sum(lengths), batches, rate_hz, Options(time))


def _open_stream(path: Path, offset: int, rate_hz: float | None, time: str | None) -> Log:
    def stream(columns: list[int] | None = None) -> pa.RecordBatchStreamReader:
        source = pa.memory_map(str(path))
        source.seek(offset)
        return pa.ipc.open_stream(source, options=pa.ipc.IpcReadOptions(included_fields=columns))

    reader = stream()
    schema, lengths = reader.schema, list[int]()
    try:
        lengths.extend(batch.num_rows for batch in reader)
        lost = "the file has no footer" if offset else ""
    except (OSError, pa.ArrowException) as error:
        lost = " ".join(str(error).split())
    if lost and lengths:
        warnings.warn(
            f"{path}: cut short ({lost}); read its {len(lengths)} whole record batches of {sum(lengths)} rows, what "
            "came after them is lost",
            LogWarning,
            stacklevel=4,
        )
    elif lost:
        raise InputError(f"{path}: cut short within its first record batch ({lost}); fetch it again")

    def batches(column: str, first: int, size: int) -> Iterator[pa.Array]:
        skip = first
        for length, batch in zip(lengths, stream([schema.get_field_index(column)]), strict=False):
            if skip < length:
                yield from _pieces(batch.column(0), skip, size)
            skip = max(skip - length, 0)

    return log_of_table(path, schema, sum(lengths), batches, rate_hz, Options(time))


def _pieces(values: pa.Array, first: int, size: int) -> Iterator[pa.Array]:
    values.validate()  # offsets of a damaged file may point outside it
    for start in range(first, len(values), size):
        yield values[start : start + size]


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
            f"{path}: the Parquet file has no footer, without which nothing of it can be read: it was cut short or "
            "never closed; fetch it again"
        )
    file = pa.parquet.ParquetFile(local(path))
    groups = [file.metadata.row_group(index).num_rows for index in range(file.metadata.num_row_groups)]
    if min(groups, default=0) < 0 or sum(groups) != file.metadata.num_rows:
        raise InputError(f"{path}: row groups of {groups} rows; is the file damaged?")
    starts = np.concatenate([[0], np.cumsum(groups, dtype=np.int64)])

    def batches(column: str, first: int, size: int) -> Iterator[pa.Array]:
        group = int(np.searchsorted(starts, first, side="right")) - 1
        skip = first - int(starts[group])
        # pre_buffer would load whole row groups, of which a file may have only one.
        # The footer of a long log takes as long to read as a stretch of it, so it is read once.
        stream = pa.parquet.ParquetFile(local(path), metadata=file.metadata, pre_buffer=False)
        while group < len(groups):
            # Selecting all row groups up to the end takes longer than reading a short stretch.
            stop = min(max(int(np.searchsorted(starts, first + size)), group + 1), len(groups))
            for batch in stream.iter_batches(size, row_groups=range(group, stop), columns=[column]):
                if skip < len(batch):
                    yield batch.column(0)[skip:]
                skip = max(skip - len(batch), 0)
            group, first = stop, int(starts[stop])

    return log_of_table(path, file.schema_arrow, file.metadata.num_rows, batches, rate_hz, Options(time))


@register_writer(".parquet", ".pq")
def write_parquet(log: Log, path: Path) -> Path:
    """Write a log; see `Log.write`."""
    if path.exists() and Path(log.name).exists() and path.samefile(log.name):
        raise InputError(f"{path}: is the log itself; choose another name")
    queues = {name: _Rows(log.raw_blocks(name)) for name in log.channels}
    clock = {} if log.start_utc is None else {"start_utc": log.start_utc.isoformat()}
    schema = pa.schema(
        [_field(c, queues[c.name].dtype) for c in log.channels.values()],
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
            columns = [queues[field.name].take(rows, field.type) for field in schema]
            writer.write_table(pa.Table.from_arrays(columns, schema=schema))
    return path


class _Rows:
    """Samples of one channel in any number of rows, null after the end."""

    def __init__(self, stream: Iterator[Samples]) -> None:
        first = next(stream, np.empty(0))
        self.dtype = first.dtype
        self._stream = itertools.chain([first], stream)
        self._held = first[:0]

    def take(self, rows: int, kind: pa.DataType) -> pa.Array:
        parts, missing = [], rows
        while missing:
            if not len(self._held):
                self._held = next(self._stream, self._held)
            if not len(self._held):
                break
            parts.append(self._held[:missing])
            self._held = self._held[missing:]
            missing -= len(parts[-1])
        return pa.concat_arrays([*(pa.array(part, type=kind) for part in parts), pa.nulls(missing, kind)])


def _field(channel: Channel, dtype: np.dtype[Any]) -> pa.Field:
    facts = {
        "unit": channel.unit,
        "rate_hz": channel.rate_hz,
        "start_s": channel.start_s,
        "samples": channel.samples,
        **({"resolution": channel.resolution} if channel.resolution else {}),
    }
    return pa.field(
        channel.name, pa.from_numpy_dtype(dtype), metadata={METADATA_KEY: json.dumps(facts).encode()}
    )
