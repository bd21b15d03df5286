"""Feather and Arrow IPC files, memory-mapped. Of a truncated file, the complete record batches are read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.ipc

from shipfp_rs.errors import InputError
from shipfp_rs.logs.formats import warn
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.table import Options, log_of_table

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
        read = f"read its {len(lengths)} whole record batches of {sum(lengths)} rows"
        warn(path, f"cut short ({lost}); {read}, what came after them is lost")
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
