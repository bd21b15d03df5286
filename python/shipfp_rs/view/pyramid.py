"""Pyramid of a log's minima and maxima in a file beside it: a page draws any zoom from a few thousand numbers.

The file consists of pairs of float64, level by level, followed by a description as JSON. A pyramid is valid for one state
of the log, identified by size, time of change and version of this format; else it is rebuilt.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel, Samples
from shipfp_rs.logs.log import Log
from shipfp_rs.support.arrays import runs
from shipfp_rs.support.threads import side_by_side

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

BASE = 64
"""Samples per block of the finest stored level; finer levels are computed from samples."""
FACTOR = 4
"""Number of blocks of a level that are combined into one block of the next level."""
COARSEST = 256
"""Largest number of blocks of the last level, which shows a whole log."""
PIECE = FACTOR << 16
"""Blocks of a level that are combined per call."""
SUFFIX = ".shipfp-pyramid"
VERSION = 1
KEPT = 4096
"""Largest number of stretches of missing samples that are kept; further ones are only counted."""
_END = b"SHIPFPYR"


def extremes(samples: Samples, block: int) -> Array:
    """Least and greatest finite sample of each block of `block` samples, shape (K, 2); the last block may be shorter.

    Examples
    --------
    >>> extremes(np.array([1.0, 3.0, np.inf, 2.0, np.nan]), 2).tolist()
    [[1.0, 3.0], [2.0, 2.0], [nan, nan]]
    """
    sides: tuple[np.ufunc, np.ufunc] = (np.minimum, np.maximum)
    finite = np.isfinite(samples)
    if not finite.all():
        samples, sides = np.where(finite, samples, np.nan), (np.fmin, np.fmax)
    starts = np.arange(0, len(samples), block)
    return np.column_stack([side.reduceat(samples, starts) for side in sides]).astype(np.float64)


def coarser(pairs: Array) -> Array:
    """Extremes of each group of four blocks; the last group may be smaller."""
    return np.column_stack([extremes(pairs[:, side], FACTOR)[:, side] for side in (0, 1)])


class Extremes:
    """Extremes of a channel's blocks of 64 samples and its stretches of missing samples, collected chunk by chunk."""

    def __init__(self) -> None:
        self.seen, self.gap_count = 0, 0
        self.gaps = np.empty((0, 2), dtype=np.int64)
        self._rest: Samples = np.empty(0)
        self._last_gap_stop = -1

    def feed(self, chunk: Samples) -> Array:
        """Return the blocks that the next samples complete, shape (K, 2)."""
        found = runs(~np.isfinite(chunk)) + self.seen
        if len(found):
            goes_on = found[0, 0] == self._last_gap_stop
            if goes_on and self.gap_count <= KEPT:
                self.gaps[-1, 1] = found[0, 1]
            self._last_gap_stop, found = found[-1, 1], found[int(goes_on) :]
            self.gap_count += len(found)
            self.gaps = np.concatenate([self.gaps, found])[:KEPT]
        self.seen += len(chunk)
        samples = np.concatenate([self._rest, chunk]) if len(self._rest) else chunk
        whole = len(samples) // BASE * BASE
        self._rest = samples[whole:].copy()
        return extremes(samples[:whole], BASE)

    def finish(self) -> Array:
        """Return the last, incomplete block, if any, shape (0 or 1, 2)."""
        return extremes(self._rest, BASE)


@dataclass(frozen=True)
class Stored:
    """Channel, its missing samples, and its stored levels."""

    channel: Channel
    """Name, unit, rate, samples, start."""
    gaps: npt.NDArray[np.int64]
    """The first stretches of missing samples, each as its first index and one past its last, shape (G, 2)."""
    gap_count: int
    """Total number of stretches."""
    levels: tuple[Array, ...]
    """Minimum and maximum of every 64, 256, 1024, ... samples, each of shape (K, 2); NaN without finite samples."""


@dataclass(frozen=True)
class Pyramid:
    """Stored levels of a log."""

    path: Path
    start_utc: datetime | None
    channels: tuple[Stored, ...]


def key_of(path: Path, rate_hz: float | None) -> dict[str, Any]:
    """Identification of the state of a log."""
    state = path.stat()
    return {"version": VERSION, "size": state.st_size, "mtime_ns": state.st_mtime_ns, "rate_hz": rate_hz}


def places(path: Path) -> Iterator[Path]:
    """Yield possible paths of a log's pyramid, in order of preference: beside the log, user's cache, temporary folder."""
    name = path.name + SUFFIX
    yield path.parent / name
    digest = hashlib.sha256(str(path.absolute()).encode()).hexdigest()[:16]
    cache = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    yield Path(cache) / "shipfp" / f"{digest}-{name}"
    yield (
        Path(tempfile.gettempdir()) / f"shipfp-{os.getuid() if hasattr(os, 'getuid') else 0}-{digest}{SUFFIX}"
    )


def stored(path: Path, rate_hz: float | None = None) -> Pyramid | None:
    """Pyramid of a log in its present state; None if there is none."""
    key = key_of(path, rate_hz)
    for place in places(path):
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            found = _opened(place, key) if place.is_file() else None
            if found is not None:
                return found
    return None


def made(log: Log, path: Path, rate_hz: float | None = None, progress: Progress = lambda _: None) -> Pyramid:
    """Read a log once and write its pyramid atomically; `InputError` if no place can be written."""
    key = key_of(path, rate_hz)
    reason = ""
    for place in places(path):
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            with _appearing(place) as file:
                _Builder(log, file, progress).build(key)
        except OSError as error:
            reason = f"{place.parent}: {error.strerror or error}"
            continue
        found = _opened(place, key)
        if found is not None:
            return found
        reason = "it was changed while it was read"
        break
    raise InputError(
        f"{path}: its pyramid file can't be written ({reason}); make room beside it or in the cache folder"
    )


@contextlib.contextmanager
def _appearing(place: Path) -> Iterator[IO[bytes]]:
    """Yield an unnamed file that gets its name at the end; if the process is killed earlier, no file remains."""
    if not hasattr(os, "O_TMPFILE") or not Path("/proc/self/fd").exists():
        from shipfp_rs.support.files import replacing

        with replacing(place) as temporary, temporary.open("w+b") as file:
            yield file
        return
    with open(os.open(place.parent, os.O_TMPFILE | os.O_RDWR, 0o666), "w+b") as file:  # noqa: PTH123
        yield file
        file.flush()
        beside = place.with_name(f".{place.name}.{os.getpid()}-{threading.get_ident()}")
        beside.unlink(missing_ok=True)
        # Python follows the link in /proc, and so links the file itself, only if a folder descriptor is given.
        folder = os.open(place.parent, os.O_RDONLY)
        try:
            os.link(f"/proc/self/fd/{file.fileno()}", beside, src_dir_fd=folder, follow_symlinks=True)
        finally:
            os.close(folder)
        beside.replace(place)


class _Builder:
    """Writes the levels of all channels in parallel into one file of known layout."""

    def __init__(self, log: Log, file: IO[bytes], progress: Progress) -> None:
        self.log, self.file, self.progress = log, file, progress
        self._lock = threading.Lock()
        self._read, self._all = 0, max(sum(channel.samples for channel in log.channels.values()), 1)

    def build(self, key: dict[str, Any]) -> None:
        at, jobs, stopped = 0, [], threading.Event()
        for channel in self.log.channels.values():
            counts = level_counts(channel.samples)
            jobs.append(partial(self._channel, channel, counts, at, stopped))
            at += sum(counts)
        channels = side_by_side(jobs, stopped)
        start = None if self.log.start_utc is None else self.log.start_utc.isoformat()
        told = json.dumps({"key": key, "start_utc": start, "channels": channels}).encode()
        self._write(at, told + len(told).to_bytes(8, "little") + _END)

    def _write(self, pair: int, data: bytes) -> None:
        with self._lock:
            self.file.seek(16 * pair)
            self.file.write(data)

    def _pairs(self, first: int, stop: int) -> Array:
        with self._lock:
            self.file.seek(16 * first)
            return np.frombuffer(self.file.read(16 * (stop - first))).reshape(-1, 2)

    def _channel(
        self, channel: Channel, counts: list[int], start: int, stopped: threading.Event
    ) -> dict[str, Any]:
        blocks, at = Extremes(), start
        chunks = self.log.chunks(channel.name) if channel.samples else iter(())
        for chunk in chunks:
            if stopped.is_set():
                break
            pairs = blocks.feed(chunk)
            self._write(at, pairs.tobytes())
            at += len(pairs)
            with self._lock:
                self._read += len(chunk)
            self.progress(self._read / self._all)
        self._write(at, blocks.finish().tobytes())
        if blocks.seen != channel.samples and not stopped.is_set():
            raise InputError(
                f"{self.log.name}: channel {channel.name!r} has {blocks.seen} samples, expected {channel.samples}; "
                "is the file damaged?"
            )
        starts = np.cumsum([start, *counts]).tolist()
        for begin, end in itertools.pairwise(starts[:-1]):
            for first in range(begin, end, PIECE):
                pairs = coarser(self._pairs(first, min(first + PIECE, end)))
                self._write(end + (first - begin) // FACTOR, pairs.tobytes())
        return {
            **channel.told,
            "gaps": blocks.gaps.tolist(),
            "gap_count": blocks.gap_count,
            "first": start,
            "levels": counts,
        }


def level_counts(samples: int) -> list[int]:
    """Number of blocks in each stored level of a channel."""
    counts = [-(-samples // BASE)]
    while counts[-1] > COARSEST:
        counts.append(-(-counts[-1] // FACTOR))
    return counts


def _opened(place: Path, key: dict[str, Any]) -> Pyramid | None:
    with place.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(-16, os.SEEK_END)
        tail = file.read(16)
        length = int.from_bytes(tail[:8], "little")
        if tail[8:] != _END or not 0 < length <= size - 16:
            return None
        file.seek(-16 - length, os.SEEK_END)
        told = json.loads(file.read(length))
    if told["key"] != key:
        return None
    rows = (size - 16 - length) // 16
    pairs: Array = np.memmap(place, dtype=np.float64, mode="r", shape=(rows, 2)) if rows else np.empty((0, 2))
    channels = []
    for facts in told["channels"]:
        edges = np.cumsum([facts["first"], *facts["levels"]]).tolist()
        if edges[-1] > len(pairs):
            return None
        names = ("name", "unit", "rate_hz", "samples", "start_s")
        gaps = np.array(facts["gaps"], dtype=np.int64).reshape(-1, 2)
        levels = tuple(pairs[first:stop] for first, stop in itertools.pairwise(edges))
        channels.append(
            Stored(Channel(**{name: facts[name] for name in names}), gaps, facts["gap_count"], levels)
        )
    start = told["start_utc"]
    return Pyramid(place, datetime.fromisoformat(start) if start else None, tuple(channels))
