"""Raw trial logs: channels as recorded, each with its own unit, rate and start, read piece by piece."""

from __future__ import annotations

import csv
import difflib
import importlib
import itertools
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.csv
import pyarrow.ipc
import pyarrow.parquet

from shipfp_rs.errors import InputError
from shipfp_rs.files import replacing

Samples = npt.NDArray[Any]
Blocks = Callable[[str, int, int], Iterator[Samples]]
"""(channel, first row, block size) to blocks of samples from that row on, each at most the size."""

METADATA_KEY = b"shipfp"
"""Key under which a Parquet field carries unit, rate, start and length of its channel, as JSON."""

BLOCK = 1 << 20
"""Samples read or written at once where the caller has no wish."""

TIME_NAMES = ("time", "time_s", "t")
SECONDS = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Of the units that a time column may have."""


@dataclass(frozen=True)
class Channel:
    """One recorded channel.

    Parameters
    ----------
    name
        As the logger wrote it, without its unit.
    unit
        Unit as the logger wrote it; empty where it wrote none.
    rate_hz
        Sample rate [Hz].
    samples
        Number of samples.
    start_s
        Time of the first sample on the log's clock [s].
    """

    name: str
    unit: str
    rate_hz: float
    samples: int
    start_s: float = 0.0

    @property
    def stop_s(self) -> float:
        """Time just after the last sample [s]."""
        return self.start_s + self.samples / self.rate_hz


class Log:
    """The channels of one recording; samples stay on disk until asked for.

    Readers of logger formats build one from a list of channels and a function that yields blocks of samples;
    see `register_reader`.

    Examples
    --------
    >>> import numpy as np
    >>> log = Log.from_arrays({"torque": np.arange(6.0)}, rate_hz=2.0, units={"torque": "V"})
    >>> log.read("torque", start_s=1.0, stop_s=2.0)
    array([2., 3.])
    """

    def __init__(
        self, name: str, channels: list[Channel], blocks: Blocks, start_utc: datetime | None = None
    ) -> None:
        if not any(channel.samples for channel in channels):
            raise InputError(f"{name}: no samples in it; expected at least one channel with numbers")
        self.name = name
        self.start_utc = start_utc  # when the log's clock stood at zero, where the file tells
        self.channels: Mapping[str, Channel] = MappingProxyType(
            {channel.name: channel for channel in channels}
        )
        self._blocks = blocks

    def __repr__(self) -> str:
        shown = ", ".join(f"{c.name} [{c.unit}] {c.rate_hz:g} Hz" for c in self.channels.values())
        return f"Log({self.name!r}: {shown})"

    @classmethod
    def open(cls, path: str | Path, *, rate_hz: float | None = None) -> Log:
        """Open a log; the suffix names the format.

        Parameters
        ----------
        path
            Parquet, Feather or CSV file, or any format a reader was registered for.
        rate_hz
            Sample rate of every column [Hz]; needed where the file tells neither rate nor time, and trusted
            above a time column.

        Raises
        ------
        InputError
            Where the file is missing, empty, unreadable, of unknown suffix, or without a uniform time base.
        """
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix in _MODULES:
            importlib.import_module(f"shipfp_rs.readers.{_MODULES[suffix]}")
        reader = _READERS.get(suffix)
        if reader is None:
            known = ", ".join(dict.fromkeys([*_READERS, *_MODULES]))
            raise InputError(f"{path}: unknown log format {path.suffix!r}, expected one of {known}")
        if not path.is_file():
            raise InputError(f"{path}: no such log file")
        if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0):
            raise InputError(f"{path}: rate_hz is {rate_hz}, expected a positive number")
        try:
            return reader(path, rate_hz)
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"{path}: can't be read as {path.suffix}: {_one_line(error)}") from error

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, npt.ArrayLike],
        *,
        rate_hz: float,
        units: Mapping[str, str] | None = None,
        start_s: float = 0.0,
        name: str = "memory",
    ) -> Log:
        """Build a log of channels at one rate from arrays in memory, each of shape (N,)."""
        held = {key: np.asarray(values) for key, values in arrays.items()}
        for key, values in held.items():
            if values.ndim != 1 or values.dtype.kind not in "iuf":
                raise InputError(
                    f"channel {key!r}: {values.dtype} of shape {values.shape}, expected numbers, 1-D"
                )
        units = units or {}
        channels = [Channel(key, units.get(key, ""), rate_hz, len(v), start_s) for key, v in held.items()]

        def blocks(channel: str, first: int, size: int) -> Iterator[Samples]:
            for start in range(first, len(held[channel]), size):
                yield held[channel][start : start + size]

        return cls(name, channels, blocks)

    def channel(self, name: str) -> Channel:
        """Return what is known of a channel; `InputError` with the nearest name where there is none."""
        if name not in self.channels:
            near = difflib.get_close_matches(name, self.channels, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(f"{self.name}: no channel {name!r}, found {', '.join(self.channels)}{hint}")
        return self.channels[name]

    def rows(self, name: str, start_s: float | None = None, stop_s: float | None = None) -> tuple[int, int]:
        """Return first sample of a stretch and first one after it; the whole channel by default."""
        channel = self.channel(name)
        tolerance = 0.5 / channel.rate_hz
        start = channel.start_s if start_s is None else start_s
        stop = channel.stop_s if stop_s is None else stop_s
        if not (channel.start_s - tolerance <= start < stop <= channel.stop_s + tolerance):
            raise InputError(
                f"{self.name}: {start:g} to {stop:g} s is empty or outside channel {name!r}, which runs from "
                f"{channel.start_s:g} to {channel.stop_s:g} s"
            )
        first = round((start - channel.start_s) * channel.rate_hz)
        last = round((stop - channel.start_s) * channel.rate_hz)
        return max(first, 0), min(last, channel.samples)

    def chunks(
        self, name: str, size: int = BLOCK, *, start_s: float | None = None, stop_s: float | None = None
    ) -> Iterator[Samples]:
        """Yield a channel in arrays of at most `size` samples, dtype as recorded."""
        first, last = self.rows(name, start_s, stop_s)
        left = last - first
        for block in self._blocks(name, first, size):
            yield block[:left]
            left -= len(block)
            if left <= 0:
                return

    def read(self, name: str, start_s: float | None = None, stop_s: float | None = None) -> Samples:
        """Return a channel from `start_s` up to, not including, `stop_s` on the log's clock, as recorded.

        Raises
        ------
        InputError
            Where the channel is missing, holds text, or the stretch is empty or outside it.
        """
        parts = list(self.chunks(name, start_s=start_s, stop_s=stop_s))
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def write(self, path: str | Path) -> Path:
        """Write all channels to Parquet, block by block; the file appears whole or not at all.

        Each field carries unit, rate, start and length as JSON in its metadata under "shipfp". Channels
        shorter than the longest end in nulls, which cost next to nothing.
        """
        path = Path(path)
        if path.suffix.lower() not in (".parquet", ".pq"):
            raise InputError(f"{path}: logs are written as Parquet, expected a name ending in .parquet")
        streams = {name: self._blocks(name, 0, BLOCK) for name in self.channels}
        queues = {name: _Rows(stream) for name, stream in streams.items()}
        clock = {} if self.start_utc is None else {"start_utc": self.start_utc.isoformat()}
        schema = pa.schema(
            [_field(c, queues[c.name].dtype) for c in self.channels.values()],
            metadata={METADATA_KEY: json.dumps(clock).encode()},
        )
        length = max(channel.samples for channel in self.channels.values())
        with (
            replacing(path) as temporary,
            pa.parquet.ParquetWriter(temporary, schema, compression="zstd", use_dictionary=False) as writer,
        ):
            for first in range(0, length, BLOCK):
                rows = min(BLOCK, length - first)
                columns = [queues[field.name].take(rows, field.type) for field in schema]
                writer.write_table(pa.Table.from_arrays(columns, schema=schema))
        return path


class _Rows:
    """Samples of one channel handed out in any number of rows, null after the end."""

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
        # from_pandas makes NaN null, the only gap that integers have; both read back as NaN.
        arrays = [pa.array(part, type=kind, from_pandas=True) for part in parts]
        return pa.concat_arrays([*arrays, pa.nulls(missing, kind)])


def _field(channel: Channel, dtype: np.dtype[Any]) -> pa.Field:
    facts = {
        "unit": channel.unit,
        "rate_hz": channel.rate_hz,
        "start_s": channel.start_s,
        "samples": channel.samples,
    }
    return pa.field(
        channel.name, pa.from_numpy_dtype(dtype), metadata={METADATA_KEY: json.dumps(facts).encode()}
    )


Reader = Callable[[Path, float | None], Log]
_READERS: dict[str, Reader] = {}
_MODULES = {
    ".raw": "famos",
    ".dat": "famos",
    ".tdms": "tdms",
    ".d7d": "dewesoft",
    ".dxd": "dewesoft",
}
"""Modules of `shipfp_rs.readers` that register for a suffix once a file of it is opened."""


def register_reader(*suffixes: str) -> Callable[[Reader], Reader]:
    """Make `Log.open` use the decorated function (path, rate_hz) for files of these suffixes."""

    def register(reader: Reader) -> Reader:
        _READERS.update(dict.fromkeys(suffixes, reader))
        return reader

    return register


@register_reader(".parquet", ".pq")
def _open_parquet(path: Path, rate_hz: float | None) -> Log:
    file = pa.parquet.ParquetFile(path)
    groups = [file.metadata.row_group(index).num_rows for index in range(file.metadata.num_row_groups)]
    starts = np.concatenate([[0], np.cumsum(groups, dtype=np.int64)])

    def batches(column: str, first: int, size: int) -> Iterator[pa.Array]:
        group = int(np.searchsorted(starts, first, side="right")) - 1
        skip = first - int(starts[group])
        # pre_buffer would load whole row groups; a logger may have written a file of only one.
        for batch in pa.parquet.ParquetFile(path, pre_buffer=False).iter_batches(
            batch_size=size, row_groups=list(range(group, len(groups))), columns=[column]
        ):
            if skip < len(batch):
                yield batch.column(0)[skip:]
            skip = max(skip - len(batch), 0)

    return _log_of_table(path, file.schema_arrow, file.metadata.num_rows, batches, rate_hz)


@register_reader(".feather", ".arrow")
def _open_feather(path: Path, rate_hz: float | None) -> Log:
    file = pa.ipc.open_file(pa.memory_map(str(path)))
    lengths = [file.get_batch(index).num_rows for index in range(file.num_record_batches)]

    def batches(column: str, first: int, size: int) -> Iterator[pa.Array]:
        only = pa.ipc.IpcReadOptions(included_fields=[file.schema.get_field_index(column)])
        source = pa.ipc.open_file(pa.memory_map(str(path)), options=only)
        skip = first
        for index, length in enumerate(lengths):
            if skip < length:
                values = source.get_batch(index).column(0)
                for start in range(skip, length, size):
                    yield values[start : start + size]
            skip = max(skip - length, 0)

    return _log_of_table(path, file.schema, sum(lengths), batches, rate_hz)


@register_reader(".csv", ".txt")
def _open_csv(path: Path, rate_hz: float | None) -> Log:
    """Open a CSV file: a header line, units in brackets; comma, or semicolon or tab with decimal commas.

    Every read runs through the file from its top; convert long logs to Parquet first.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header, sample = file.readline().rstrip("\r\n"), file.readline()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text ({error}); save it as UTF-8") from error
    if not header.strip() or not sample.strip():
        raise InputError(f"{path}: empty; expected a header line with channel names and lines of numbers")
    delimiter = max(",;\t", key=header.count)
    decimal = "," if delimiter != "," and "," in sample else "."
    headings = [heading.strip() for heading in next(csv.reader([header], delimiter=delimiter))]
    schema = pa.schema([pa.field(heading, pa.float64()) for heading in headings])

    def batches(column: str, first: int, size: int) -> Iterator[pa.Array]:
        reader = pa.csv.open_csv(
            path,
            read_options=pa.csv.ReadOptions(column_names=headings, skip_rows=1, use_threads=False),
            parse_options=pa.csv.ParseOptions(delimiter=delimiter),
            convert_options=pa.csv.ConvertOptions(
                include_columns=[column], column_types={column: pa.float64()}, decimal_point=decimal
            ),
        )
        skip = first
        for batch in reader:
            for start in range(skip, len(batch), size):
                yield batch.column(0)[start : start + size]
            skip = max(skip - len(batch), 0)

    rows = sum(len(batch) for batch in _arrow_errors(path, headings[0], batches(headings[0], 0, BLOCK)))
    return _log_of_table(path, schema, rows, batches, rate_hz)


def _log_of_table(
    path: Path,
    schema: pa.Schema,
    rows: int,
    batches: Callable[[str, int, int], Iterator[pa.Array]],
    rate_hz: float | None,
) -> Log:
    """Build a log from a table: one column a channel, time from metadata, the caller or a time column."""
    if len(set(schema.names)) < len(schema.names):
        twice = next(name for name in schema.names if schema.names.count(name) > 1)
        raise InputError(f"{path}: column {twice!r} stands there twice; give each channel its own name")
    fields: dict[str, tuple[pa.Field, dict[str, Any]]] = {}
    for field in schema:
        facts = json.loads((field.metadata or {}).get(METADATA_KEY, b"{}"))
        name, unit = _split_unit(field.name)
        fields[name] = (field, {"unit": unit, **facts})

    def blocks(channel: str, first: int, size: int) -> Iterator[Samples]:
        field, facts = fields[channel]
        if not _is_number(field.type):
            raise InputError(f"{path}: channel {channel!r} holds {field.type}, expected numbers")
        left = facts.get("samples", rows) - first
        for batch in _arrow_errors(path, channel, batches(field.name, first, size)):
            if left <= 0:
                return
            yield batch[:left].to_numpy(zero_copy_only=False)
            left -= len(batch)

    time = next((name for name in fields if name.lower() in TIME_NAMES), None)
    start_s = 0.0
    if rows and time is not None and not fields[time][1].get("rate_hz"):
        field, facts = fields.pop(time)
        clock = (
            _seconds(path, batch, facts["unit"])
            for batch in _arrow_errors(path, time, batches(field.name, 0, BLOCK))
        )
        start_s, measured = _time_base(path, time, clock, check=rate_hz is None)
        rate_hz = rate_hz or measured
    channels = []
    for name, (_, facts) in fields.items():
        rate = facts.get("rate_hz", rate_hz)
        if rate is None:
            raise InputError(
                f"{path}: no time base for {name!r}: neither a column {TIME_NAMES[0]!r} nor a rate; add the "
                "column or give rate_hz"
            )
        channels.append(
            Channel(
                name, facts["unit"], float(rate), facts.get("samples", rows), facts.get("start_s", start_s)
            )
        )
    clock = json.loads((schema.metadata or {}).get(METADATA_KEY, b"{}")).get("start_utc")
    return Log(str(path), channels, blocks, datetime.fromisoformat(clock) if clock else None)


def _time_base(
    path: Path, name: str, blocks: Iterator[npt.NDArray[np.float64]], *, check: bool
) -> tuple[float, float]:
    """Return start [s] and mean rate [Hz] of a time column in one pass.

    With `check`, raise where a step differs from the median step of the first block by more than half of it.
    """
    start = last = interval = np.nan
    count = 0
    for block in blocks:
        if not count:
            start = float(block[0])
            interval = float(np.nanmedian(np.diff(block))) if len(block) > 1 else np.nan
            last = start - interval
            if check and not interval > 0.0:
                raise InputError(
                    f"{path}: time column {name!r} does not increase from row to row; give rate_hz"
                )
        if check:
            steps = np.diff(block, prepend=last)
            bad = np.flatnonzero(~(np.abs(steps - interval) < 0.5 * interval))
            if bad.size:
                raise InputError(
                    f"{path}: time column {name!r} is not uniform at row {count + int(bad[0]) + 1}: a step "
                    f"of {steps[bad[0]]:g} s, expected {interval:g} s; cut the file there or give rate_hz"
                )
        last = float(block[-1])
        count += len(block)
    return start, (count - 1) / (last - start) if last != start else np.nan


def _seconds(path: Path, values: pa.Array, unit: str) -> npt.NDArray[np.float64]:
    """Time column as float seconds; timestamps count from 1970 (UTC)."""
    if pa.types.is_timestamp(values.type):
        values, unit = values.cast(pa.int64()), values.type.unit
    if unit not in SECONDS or not _is_number(values.type):
        found = f"unit {unit!r}" if unit not in SECONDS else str(values.type)
        raise InputError(
            f"{path}: time column holds {found}, expected timestamps or a number of s, ms, us or ns"
        )
    return np.asarray(values.to_numpy(zero_copy_only=False) * SECONDS[unit])


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


def _split_unit(heading: str) -> tuple[str, str]:
    """Split "torque [V]" into name and unit."""
    match = re.fullmatch(r"(.*\S)\s*\[(.*)\]", heading)
    return (match[1], match[2].strip()) if match else (heading, "")


def _arrow_errors(path: Path, channel: str, batches: Iterator[pa.Array]) -> Iterator[pa.Array]:
    """Pass batches on; turn Arrow's complaint about a cell into one line that names column and row."""
    try:
        yield from batches
    except (OSError, pa.ArrowException) as error:
        message = _one_line(error)
        cell = re.search(r"Row #(\d+).*invalid value '(.*)'", message)
        if cell:
            message = f"line {int(cell[1])} holds {cell[2]!r}, expected a number"
        raise InputError(f"{path}: channel {channel!r}: {message}") from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
