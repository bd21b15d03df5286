"""Minimum and maximum of each short block of a channel, to read suspicious blocks alone again; rows written twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.arrays import Spans, joined

TAPS, KEPT_BITS = 8, 4
"""Successive samples in a hash, and number of its leading bits that are zero in the hashes that are kept, one in sixteen."""
HASHES = 2
"""Successive hashes that must recur at the same distance before the samples are compared."""
LONGEST = 1 << 20
"""Longest stretch that a logger may repeat [samples]: the size of its buffer."""
FACTORS = np.random.default_rng(1).integers(1 << 62, 1 << 64, TAPS, dtype=np.uint64) | np.uint64(1)
"""Odd factors of a hash; with multiples of each other, hashes of rounded signals would collide."""
LEAST = 128
"""Shortest repeated stretch [samples]."""


def repeated_rows(
    candidates: npt.NDArray[np.int64], equal: Callable[[int, int, int], npt.NDArray[np.bool_]], samples: int
) -> Spans:
    """Spans of second copies, shape (K, 2), among `candidates` (row, lag) of `RepeatScan`, compared by `equal`.

    A repeat longer than its own lag is not a copied buffer but a periodic signal without noise.
    """
    found: list[Spans] = []
    for place, lag in candidates.tolist():
        if not equal(place, place + TAPS, lag).all():
            continue
        first, stop = max(place - lag, 0), min(place + lag + LEAST, samples - lag)
        flags = equal(first, stop, lag)
        at = place - first
        if at >= len(flags) or not flags[at]:
            continue
        differs = np.flatnonzero(~flags)
        begin = first + int(differs[differs < at].max(initial=-1)) + 1
        end = first + int(differs[differs > at].min(initial=len(flags)))
        if LEAST <= end - begin <= lag:
            found.append(np.array([[begin + lag, end + lag]]))
    return joined(found)


Array = npt.NDArray[Any]
Places = npt.NDArray[np.int64]


class RepeatScan:
    """Hashes of successive samples, which recur in order in a copy; the result does not depend on the chunks fed."""

    def __init__(self) -> None:
        self._held = np.empty(0, dtype=np.uint64)
        self._at = 0
        self._hashes, self._places = np.empty(0, dtype=np.uint64), np.empty(0, dtype=np.int64)
        self._new: list[tuple[npt.NDArray[np.uint64], Places]] = []
        self._compared_to = 0
        self._pairs: list[Places] = []

    def feed(self, chunk: Array) -> None:
        """Add the next samples."""
        bits = np.ascontiguousarray(chunk, dtype=np.float32).view(np.uint32).astype(np.uint64)
        bits = np.concatenate([self._held, bits])
        count = max(len(bits) - TAPS, 0)
        hashes = np.zeros(count, dtype=np.uint64)
        for tap, factor in enumerate(FACTORS):
            hashes += factor * bits[tap : tap + count]
        # In a constant stretch all hashes are equal and indicate no repetition.
        kept = np.flatnonzero(
            (hashes >> np.uint64(64 - KEPT_BITS) == 0) & (bits[:count] != bits[1 : 1 + count])
        )
        self._new.append((hashes[kept], self._at + kept))
        self._held, self._at = bits[count:], self._at + count
        if self._at - self._compared_to >= 4 * LONGEST:
            self._compare()

    def _compare(self) -> None:
        """Pair equal hashes at most `LONGEST` apart, and drop those that no later one can match."""
        hashes = np.concatenate([self._hashes, *(one for one, _ in self._new)])
        places = np.concatenate([self._places, *(one for _, one in self._new)])
        order = np.lexsort((places, hashes))
        hashes, places = hashes[order], places[order]
        first, lag = places[:-1], np.diff(places)
        alike = (hashes[1:] == hashes[:-1]) & (lag <= LONGEST) & (places[1:] >= self._compared_to)
        self._pairs.append(np.column_stack([lag[alike], first[alike]]))
        recent = places + LONGEST >= self._at
        self._hashes, self._places, self._new = hashes[recent], places[recent], []
        self._compared_to = self._at

    def candidates(self) -> Places:
        """First sample and distance of each run of hashes that recur at one distance, shape (C, 2)."""
        self._compare()
        pairs = np.concatenate(self._pairs)
        lag, place = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].T
        # Hashes of one repetition are at most `lag` apart, since a repetition has at most that length.
        starts = np.flatnonzero(np.append(True, (np.diff(lag) != 0) | (np.diff(place) > lag[1:]))[: len(lag)])
        runs = starts[np.diff(np.append(starts, len(lag))) >= HASHES]
        return np.column_stack([place[runs], lag[runs]])


class BlockExtremes:
    """Extremes of blocks of equal length; the result does not depend on the chunks fed.

    Examples
    --------
    >>> extremes = BlockExtremes(2)
    >>> extremes.feed(np.array([1.0, 3.0, 2.0]))
    >>> extremes.feed(np.array([5.0, 4.0]))
    >>> extremes.low.tolist(), extremes.high.tolist()
    ([1.0, 2.0, 4.0], [3.0, 5.0, 4.0])
    """

    def __init__(self, block: int) -> None:
        self.block = block
        self.samples = 0
        self._parts: list[tuple[Array, Array]] = []
        self._rest = np.empty(0)

    def feed(self, chunk: Array) -> None:
        """Add the next samples."""
        self.samples += len(chunk)
        if len(self._rest):
            chunk = np.concatenate([self._rest, chunk])
        whole = len(chunk) // self.block * self.block
        if whole:
            blocks = chunk[:whole].reshape(-1, self.block)
            with np.errstate(invalid="ignore"):
                self._parts.append((blocks.min(axis=1), blocks.max(axis=1)))
        # A copy: a view would keep the whole chunk in memory.
        self._rest = chunk[whole:].copy()

    def _column(self, side: int) -> npt.NDArray[np.float64]:
        parts = [part[side] for part in self._parts]
        if len(self._rest):
            parts.append(np.array([(self._rest.min(), self._rest.max())[side]]))
        return np.concatenate([np.empty(0), *parts]).astype(np.float64)

    @property
    def typical(self) -> float:
        """Median magnitude of the block centres; NaN where all blocks have missing samples."""
        known = np.abs(0.5 * (self.low + self.high))
        known = known[np.isfinite(known)]
        return float(np.median(known)) if known.size else np.nan

    @property
    def low(self) -> npt.NDArray[np.float64]:
        """Minimum of each block, NaN with missing samples, shape (B,)."""
        return self._column(0)

    @property
    def high(self) -> npt.NDArray[np.float64]:
        """Maximum of each block, NaN with missing samples, shape (B,)."""
        return self._column(1)
