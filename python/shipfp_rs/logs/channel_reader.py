"""Sequential reading of a channel in slightly overlapping stretches."""

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
"""Samples kept in memory before the last one read: stretches overlap by a filter length of a second or two."""
STRETCH_BYTES = 1 << 26
"""Memory for a channel whose stretches are read more than once: over two hours at 2 kHz as float32."""


class Stopped(Exception):
    """Reading was cancelled."""


class Rows:
    """Rows of a channel by first and stop, less its delay; read in ascending order, each sample is decoded once."""

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
        self._held: list[tuple[int, Samples]] = []  # consecutive chunks up to the next row
        self._at = -1  # first row of the next chunk

    def within(self, start_s: float, stop_s: float) -> tuple[int, int]:
        """First row of a stretch and one past its last; `InputError` where the channel lacks it."""
        first, stop = self.log.rows(self.channel.name, start_s, stop_s)
        late = round((self._start_s - self.channel.start_s) * self.channel.rate_hz)
        last = self.channel.samples
        return min(max(first + late, 0), last - 1), min(max(stop + late, 1), last)

    def read(self, first: int, stop: int) -> Samples:
        """Rows as recorded, shape (stop - first,)."""
        parts = list(self.pieces(first, stop))
        if not parts:
            return np.empty(0)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def pieces(self, first: int, stop: int) -> Iterator[Samples]:
        """Yield rows in pieces of the lengths in which they were read."""
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
                f"{self.log.name}: channel {channel.name!r} ends at sample {self._at} of {channel.samples}; is it damaged?"
            )
        self._held.append((self._at, chunk))
        kept_from = self._at - max(KEPT, self._kept_bytes // chunk.itemsize)
        self._at += len(chunk)
        given_up = bisect_right(self._held, kept_from, key=itemgetter(0)) - 1
        del self._held[: max(given_up, 0)]
