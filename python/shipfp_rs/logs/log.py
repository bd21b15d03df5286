"""Raw trial logs: channels as recorded, each with its own unit, rate and start, read in blocks or sequential stretches."""

from __future__ import annotations

import importlib
import logging
import threading
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, Blocks, Channel, Samples, blocks_of, first_of, whole, with_nan
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.formats import (
    HINTS,
    MODULES,
    TEXTS,
    of_text,
    one_line_errors,
    require_file,
    require_size,
    warn,
)
from shipfp_rs.support import hints, units
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.tables import package

if TYPE_CHECKING:
    import pandas as pd


KEPT = 1 << 17
"""Number of samples kept in memory after reading: successive stretches overlap by a filter's length, one or two
seconds.
"""
STRETCH_BYTES = 1 << 26
"""Memory for a channel whose stretches are read more than once [bytes]: over two hours at 2 kHz as float32."""


class Stopped(Exception):
    """Reading was cancelled."""


class Rows:
    """Reader of a channel's rows [first, stop), with its delay removed; ascending reads decode each sample only once."""

    def __init__(
        self,
        log: Log,
        channel: str,
        *,
        delay_s: float = 0.0,
        size: int | None = None,
        kept_bytes: int = 0,
        stopped: threading.Event | None = None,
    ) -> None:
        self.log = log
        recorded = log.channel(channel)
        self._start_s = recorded.start_s
        self.channel = replace(recorded, start_s=recorded.start_s - delay_s)
        self._size = size or BLOCK
        self._kept_bytes = kept_bytes
        self._stopped = stopped or threading.Event()
        self._chunks: Iterator[Samples] = iter(())
        self._held: list[tuple[int, Samples]] = []  # latest chunks, consecutive up to row `_at`
        self._at = -1  # first row of the next chunk

    def within(self, start_s: float, stop_s: float) -> tuple[int, int]:
        """Rows [first, stop) of a stretch of time; `InputError` if the stretch is empty or outside the channel."""
        first, stop = self.log.rows(self.channel.name, start_s, stop_s)
        late = round((self._start_s - self.channel.start_s) * self.channel.rate_hz)
        last = self.channel.samples
        return min(max(first + late, 0), last - 1), min(max(stop + late, 1), last)

    def read(self, first: int, stop: int) -> Samples:
        """Return rows as recorded, shape (stop - first,)."""
        parts = list(self.pieces(first, stop))
        if not parts:
            return np.empty(0)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def pieces(self, first: int, stop: int) -> Iterator[Samples]:
        """Yield rows [first, stop) in the blocks in which they were read."""
        if self._at < 0 or first < (self._held[0][0] if self._held else self._at):
            channel = self.channel
            self._chunks = self.log.chunks(
                channel.name, self._size, start_s=self._start_s + first / channel.rate_hz
            )
            self._at = first
            self._held.clear()
        while first < stop:
            while first >= self._at:
                self._read_on()
            start, chunk = self._held[bisect_right(self._held, first, key=itemgetter(0)) - 1]
            yield chunk[first - start : stop - start]
            first = start + len(chunk)

    def _read_on(self) -> None:
        """Read the next chunk and drop the oldest ones."""
        if self._stopped.is_set():
            raise Stopped
        chunk = next(self._chunks, None)
        if chunk is None:
            channel = self.channel
            raise InputError(
                f"{self.log.name}: channel {channel.name!r} ends at sample {self._at} of {channel.samples}; "
                "is the file damaged?"
            )
        self._held.append((self._at, chunk))
        kept_from = self._at - max(KEPT, self._kept_bytes // chunk.itemsize)
        self._at += len(chunk)
        given_up = bisect_right(self._held, kept_from, key=itemgetter(0)) - 1
        del self._held[: max(given_up, 0)]


class Pieces:
    """Reader of a channel's samples in any order; it keeps the latest pieces, since requests are mostly close together."""

    def __init__(self, log: Callable[[], Log], channel: Channel, size: int, kept: int) -> None:
        self._log, self._channel = log, channel
        self._size, self._kept = size, kept
        self._lock = threading.Lock()
        self._held: OrderedDict[int, Samples] = OrderedDict()

    def read(self, first: int, stop: int) -> Samples:
        """Samples [first, stop), as recorded."""
        parts = []
        for index in range(first // self._size, -(-stop // self._size)):
            start = index * self._size
            parts.append(self._piece(index)[max(first - start, 0) : stop - start])
        return parts[0] if len(parts) == 1 else np.concatenate(parts or [np.empty(0)])

    def _piece(self, index: int) -> Samples:
        channel = self._channel
        with self._lock:
            if index not in self._held:
                rows = (index * self._size, min((index + 1) * self._size, channel.samples))
                start_s, stop_s = (channel.start_s + row / channel.rate_hz for row in rows)
                self._held[index] = self._log().read(channel.name, start_s, stop_s)
            self._held.move_to_end(index)
            while len(self._held) > self._kept:
                self._held.popitem(last=False)
            return self._held[index]


LOGGER = logging.getLogger("shipfp_rs")


class Log(hints.Hinted):
    """Channels of one recording, whose samples are read from disk on demand.

    Readers of logger formats build a log from a list of channels and a function that yields blocks of samples;
    see `register_reader`.

    Examples
    --------
    >>> import numpy as np
    >>> log = Log.from_arrays({"torque": np.arange(6.0)}, rate_hz=2.0, units={"torque": "V"})
    >>> log.read("torque", start_s=1.0, stop_s=2.0)
    array([2., 3.])
    >>> log["torque"]
    array([0., 1., 2., 3., 4., 5.])
    >>> list(log)
    ['torque']
    """

    def __init__(
        self,
        name: str,
        channels: list[Channel],
        blocks: Blocks,
        start_utc: datetime | None = None,
        faults: tuple[Fault, ...] = (),
        notes: tuple[str, ...] = (),
    ) -> None:
        if not any(channel.samples for channel in channels):
            raise InputError(f"{name}: no samples in it; expected at least one channel with numbers")
        names = [channel.name for channel in channels]
        if len(set(names)) < len(names):
            twice = next(channel for channel in names if names.count(channel) > 1)
            raise InputError(f"{name}: channel {twice!r} appears twice; give each channel its own name")
        for channel in channels:
            # Samples are addressed by time, so successive samples must differ in time.
            last_s = max(abs(channel.start_s), abs(channel.stop_s)) if channel.rate_hz > 0.0 else np.inf
            if channel.samples < 0 or not last_s * channel.rate_hz < 2.0**50:
                raise InputError(
                    f"{name}: channel {channel.name!r} starts at {channel.start_s:g} s with {channel.rate_hz:g} Hz; "
                    "is the file damaged?"
                )
        self.name = name
        self.start_utc = start_utc  # date of the log's time zero, if the file has one
        self.faults = faults  # faults of the whole file, such as of its clock or its end
        self.notes = notes  # assumptions about the file, one line each
        self.channels: Mapping[str, Channel] = MappingProxyType(
            {channel.name: replace(channel, unit=units.told(channel.unit)) for channel in channels}
        )
        self._blocks = whole(name, self.channels, blocks)

    def counted(self, fault: Fault) -> Channel | None:
        """Channel to whose samples the spans of a fault refer; None if the log has no such channel."""
        return self.channels.get(fault.of or fault.channel)

    def faults_under(self, names: Mapping[str, str]) -> list[Fault]:
        """Faults of this log for another one that has its channels under new names: `names` maps old to new."""
        first = next(iter(self.channels.values()))
        return [replace(fault, of=names[(self.counted(fault) or first).name]) for fault in self.faults]

    def __repr__(self) -> str:
        shown = ", ".join(f"{c.name} [{c.unit}] {c.rate_hz:g} Hz" for c in self.channels.values())
        return f"Log({self.name!r}: {shown})"

    @classmethod
    @checked
    def open(
        cls,
        path: str | Path,
        *,
        rate_hz: float | None = None,
        time: str | None = None,
        names: str | Path | None = None,
    ) -> Log:
        """Open a log; its format follows from the suffix and the first bytes.

        Parameters
        ----------
        path
            Text, Parquet, Arrow, imc FAMOS, DEWESoft, TDMS, MDF, HDF5, MATLAB, CAN, NMEA 2000 or ISO 19848 file, or any
            format with a registered reader. A pattern with a star or a question mark joins the matching files, the
            pieces of one recording, into one log (`shipfp_rs.logs.joining.join`).
        rate_hz
            Sample rate of every column [Hz]; needed if the file has neither a rate nor times. A given rate takes
            precedence over a time column.
        time
            Time column, if it is not detected or the wrong one is: "COLUMN", "COLUMN [ms]", "DATE [d.m.y] + CLOCK".
        names
            File with the names of the channels: a DBC for a CAN log, a channel list for ISO 19848.

        Raises
        ------
        InputError
            If the file is missing, empty, unreadable, of unknown format, or without a time base.
        """
        path = Path(path)
        if any(mark in path.name for mark in "*?") and not path.exists():
            pieces: Log = _joining().open_pattern(path, rate_hz=rate_hz, time=time, names=names)
            return pieces
        if not path.is_dir():
            _require_known(path)
        require_file(path)
        if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0):
            raise InputError(f"{path}: rate_hz is {rate_hz}, expected a positive number")
        if time == "":
            raise InputError(f"{path}: time is empty, expected the name of a column (--time)")
        reader = _reader_of(path)
        wishes = {"time": time, "names": None if names is None else str(Path(names).absolute())}
        options = {key: value for key, value in wishes.items() if value is not None}
        for key in options:
            if key not in _TAKES.get(reader, ()):
                words = {"time": "a column of time (--time)", "names": "a file of names (--names)"}
                raise InputError(f"{path}: {words[key]} is of no use for this format; leave it out")
        with one_line_errors(path):
            log = reader(path, rate_hz, **options)
        require_size(path, sum(channel.samples for channel in log.channels.values()))
        rates = {channel.rate_hz for channel in log.channels.values()}
        if rate_hz is not None and not np.isclose(list(rates), rate_hz, rtol=1e-6).any():
            warn(
                path,
                f"a rate of {rate_hz:g} Hz is given but not used; the file tells {min(rates):g} Hz itself",
            )
        LOGGER.info("opened %s: %d channels", path, len(log.channels))
        for note in log.notes:
            LOGGER.info("%s: %s", path, note)
        return log

    @classmethod
    @checked
    def from_arrays(
        cls,
        arrays: Mapping[str, npt.ArrayLike],
        *,
        rate_hz: float,
        units: Mapping[str, str] | None = None,
        start_s: float = 0.0,
        name: str = "memory",
    ) -> Log:
        """Build a log of channels at one rate from arrays in memory.

        Parameters
        ----------
        arrays
            Samples of each channel by name, shape (N,).
        rate_hz
            Sample rate [Hz].
        units
            Units of channels by name.
        start_s
            Time of the first samples on the log's clock [s].
        name
            Label.

        Raises
        ------
        InputError
            If samples are not one-dimensional numbers.
        """
        held = {key: np.asanyarray(values) for key, values in arrays.items()}
        for key, values in held.items():
            if values.ndim != 1 or values.dtype.kind not in "biuf":
                raise InputError(
                    f"channel {key!r}: {values.dtype} of shape {values.shape}, expected numbers, 1-D"
                )
        units = units or {}
        channels = [Channel(key, units.get(key, ""), rate_hz, len(v), start_s) for key, v in held.items()]

        return cls(name, channels, blocks_of(held))

    @staticmethod
    @checked
    def merge(*logs: Log, name: str = "") -> Log:
        """Merge logs with a common clock by their time stamps; see `shipfp_rs.logs.joining.merge`.

        Examples
        --------
        >>> one = Log.from_arrays({"u": [1.0, 2.0]}, rate_hz=1.0, name="one")
        >>> two = Log.from_arrays({"n": [3.0, 4.0]}, rate_hz=1.0, name="two")
        >>> list(Log.merge(one, two).channels)
        ['u', 'n']
        """
        merged: Log = _joining().merge(logs, name)
        return merged

    @checked
    def channel(self, name: str) -> Channel:
        """Return the metadata of a channel.

        Raises
        ------
        InputError
            If there is no such channel; the message suggests the most similar name.
        """
        if name not in self.channels:
            known = list(self.channels)
            hint = hints.nearest(name, known)
            raise InputError(f"{self.name}: no channel {name!r}, found {', '.join(known)}{hint}")
        return self.channels[name]

    @checked
    def rows(self, name: str, start_s: float | None = None, stop_s: float | None = None) -> tuple[int, int]:
        """Return the sample indices [first, stop) of a stretch of time.

        Parameters
        ----------
        name
            Name of the channel.
        start_s, stop_s
            Stretch on the log's clock [s]; None for the channel's start or end.

        Raises
        ------
        InputError
            If there is no such channel, or the stretch is empty or outside it.
        """
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
        """Yield a channel in arrays of at most `size` samples, with the recorded dtype and gaps as NaN.

        Parameters
        ----------
        size
            Longest array, in samples.
        name, start_s, stop_s
            Channel and stretch; see `rows` for these and for errors.
        """
        first, last = self.rows(name, start_s, stop_s)
        if last > first:
            yield from map(with_nan, first_of(self._blocks(name, first, size), last - first))

    def raw_blocks(self, name: str, first: int = 0, size: int | None = None) -> Iterator[Samples]:
        """Yield a channel as stored by `write`: gaps masked, all arrays of one dtype.

        Parameters
        ----------
        name
            Name of the channel.
        first
            Index of the first sample.
        size
            Longest array, in samples.
        """
        return self._blocks(name, first, size or BLOCK)

    @checked
    def read(self, name: str, start_s: float | None = None, stop_s: float | None = None) -> Samples:
        """Return a channel as recorded, shape (N,).

        Parameters
        ----------
        name
            Name of the channel.
        start_s, stop_s
            Stretch [start_s, stop_s) on the log's clock [s]; None for the channel's start or end.

        Raises
        ------
        InputError
            If the channel is missing or holds text, or the stretch is empty or outside it.
        """
        first, last = self.rows(name, start_s, stop_s)
        parts = list(self.chunks(name, min(max(last - first, 1), BLOCK), start_s=start_s, stop_s=stop_s))
        if not parts:
            raise InputError(
                f"{self.name}: channel {name!r} has no sample in this stretch; read a longer one"
            )
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def __getitem__(self, name: str) -> Samples:
        """Return a whole channel as recorded, shape (N,); raises `InputError` as `read` does."""
        return self.read(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.channels)

    def to_pandas(self, names: Sequence[str] | None = None) -> pd.DataFrame:
        """Return channels as columns of a `pandas.DataFrame` with the log's clock [s] as index `time_s`.

        Units are in `attrs["units"]`. If rates or starts differ, there is a row for each sample time of any channel,
        with NaN where a channel has no sample.

        Parameters
        ----------
        names
            Names of the channels; None for all channels that have samples.

        Raises
        ------
        InputError
            If there is no such channel, or pandas is not installed.

        Examples
        --------
        >>> log = Log.from_arrays({"u": [1.0, 2.0]}, rate_hz=2.0, units={"u": "V"})
        >>> log.to_pandas().loc[0.5, "u"]  # doctest: +SKIP
        np.float64(2.0)
        """
        pandas = package("pandas")
        wanted = (
            [name for name, channel in self.channels.items() if channel.samples] if names is None else names
        )
        columns = []
        for channel in map(self.channel, wanted):
            time = channel.start_s + np.arange(channel.samples) / channel.rate_hz
            columns.append(
                pandas.Series(self[channel.name], pandas.Index(time, name="time_s"), name=channel.name)
            )
        alike = all(column.index.equals(columns[0].index) for column in columns)
        frame: pd.DataFrame = (
            pandas.DataFrame({column.name: column for column in columns})
            if alike
            else pandas.concat(columns, axis=1, sort=True).rename_axis("time_s")
        )
        frame.attrs["units"] = {name: self.channel(name).unit for name in wanted}
        return frame

    @checked
    def write(self, path: str | Path) -> Path:
        """Write all channels to Parquet, block by block; the file is written atomically.

        Unit, rate, start and length are in each field's metadata, as JSON under "shipfp". Shorter channels are padded
        with nulls to the length of the longest one; nulls take almost no space.

        Raises
        ------
        InputError
            If the name does not end in .parquet, or is that of the log's own file.
        """
        path = Path(path)
        if path.suffix.lower() not in (".parquet", ".pq"):
            raise InputError(f"{path}: logs are written as Parquet, expected a name ending in .parquet")
        written: Path = importlib.import_module("shipfp_rs.logs.readers.parquet").write_parquet(self, path)
        return written


Reader = Callable[..., Log]
"""Function (path, rate_hz) that returns a log; options for which it was registered are passed as keywords."""
_READERS: dict[str, Reader] = {}
_TAKES: dict[Reader, tuple[str, ...]] = {}


def suffixes() -> tuple[str, ...]:
    """Suffixes of all formats that `Log.open` reads."""
    return tuple(dict.fromkeys([*MODULES, *_READERS]))


def _require_known(path: Path) -> None:
    """Raise `InputError` for a suffix without a reader."""
    suffix = path.suffix.lower()
    if suffix in suffixes():
        return
    if suffix in HINTS:
        raise InputError(f"{path}: {HINTS[suffix]}")
    raise InputError(
        f"{path}: unknown log format {path.suffix!r}, expected one of {', '.join(suffixes())}"
        f"{hints.nearest(suffix, list(MODULES))}"
    )


def _reader_of(path: Path) -> Reader:
    """Reader of a file, by its first bytes where several formats share a suffix."""
    suffix = path.suffix.lower()
    if suffix not in MODULES:
        return _READERS[suffix]
    module = MODULES[suffix]
    if suffix in TEXTS:
        with path.open("rb") as file:
            module, suffix = of_text(suffix, file.read(4096))
    importlib.import_module(f"shipfp_rs.logs.readers.{module}")
    return _READERS[suffix]


@checked
def register_reader(*suffixes: str, takes: Sequence[str] = ()) -> Callable[[Reader], Reader]:
    """Register the decorated function (path, rate_hz) as the reader of files with these suffixes.

    `takes` lists the options of `Log.open` ("time", "names") that the reader accepts as keywords.
    """

    def register(reader: Reader) -> Reader:
        _READERS.update(dict.fromkeys(suffixes, reader))
        _TAKES[reader] = tuple(takes)
        return reader

    return register


def _joining() -> Any:
    """The module that builds one log from several; it imports this one."""
    return importlib.import_module("shipfp_rs.logs.joining")
