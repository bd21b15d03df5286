"""One channel of a log read once, front to back, in stretches that overlap a little."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace
from operator import itemgetter

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import BLOCK, Samples
from shipfp_rs.logs.log import Log

KEPT = 1 << 17
"""Samples kept in memory before the last one read, since stretches overlap by a filter's length of a second or two."""
STRETCH_BYTES = 1 << 26
"""Memory for a channel whose stretches are gone through more than once: over two hours at 2 kHz as float32."""


class Stopped(Exception):
    """Raised where the samples are not wanted any more."""


class Rows:
    """Rows of a channel, by first and stop; asked for in ascending order, each sample is decoded once.

    Parameters
    ----------
    log, channel
        The recording and the name of one of its channels.
    delay_s
        How late the channel tells what happened [s]; its samples are taken to be that much older.
    size
        Samples read at once; results do not depend on it.
    kept_bytes
        Memory in which samples stay at hand behind the last one read; whoever goes further back reads again.
    stopped
        Set by another thread to end the reading.
    """

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
        self._held: list[tuple[int, Samples]] = []  # one after the other, up to the row that comes next
        self._at = -1  # row that the next chunk begins with

    def within(self, start_s: float, stop_s: float) -> tuple[int, int]:
        """Return first row of a stretch and first one after it; `InputError` where the channel lacks it."""
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
        """Yield rows in pieces of whatever lengths they were read in."""
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
        """Read the next chunk into memory, and drop the oldest ones."""
        if self._stopped.is_set():
            raise Stopped
        chunk = next(self._chunks, None)
        if chunk is None:
            channel = self.channel
            raise InputError(
                f"{self.log.name}: channel {channel.name!r} ends at sample {self._at} of {channel.samples}; is it damaged?"
            )
        self._held.append((self._at, chunk))
        kept_from = self._at - max(KEPT, self._kept_bytes // chunk.itemsize)
        self._at += len(chunk)
        given_up = bisect_right(self._held, kept_from, key=itemgetter(0)) - 1
        del self._held[: max(given_up, 0)]
