"""Minimum and maximum of each block of a channel, to select blocks that are read again; detection of rows written twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.arrays import Spans, joined

TAPS, KEPT_BITS = 8, 4
"""Number of successive samples in a hash; number of leading zero bits by which one hash in sixteen is selected and
kept.
"""
HASHES = 2
"""Least number of successive hashes that recur at the same distance, before samples are compared."""
LONGEST = 1 << 20
"""Longest stretch that a logger may repeat [samples]: the size of its buffer."""
FACTORS = np.random.default_rng(1).integers(1 << 62, 1 << 64, TAPS, dtype=np.uint64) | np.uint64(1)
"""Random odd factors of a hash. If factors were multiples of each other, hashes of rounded signals would collide."""
LEAST = 128
"""Shortest repeated stretch [samples]."""


def repeated_rows(
    candidates: npt.NDArray[np.int64], equal: Callable[[int, int, int], npt.NDArray[np.bool_]], samples: int
) -> Spans:
    """Spans of second copies, shape (K, 2), among `candidates` (row, lag) of `RepeatScan`; `equal` compares rows."""
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
        # A repeat longer than its lag is a periodic signal without noise, not a copied buffer.
        if LEAST <= end - begin <= lag:
            found.append(np.array([[begin + lag, end + lag]]))
    return joined(found)


Array = npt.NDArray[Any]
Places = npt.NDArray[np.int64]


class RepeatScan:
    """Search for copies by hashes of successive samples, fed in chunks of any length."""

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
        """Pair equal hashes at most `LONGEST` samples apart; drop the hashes that are too old to match later ones."""
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
        """First sample and lag of each run of hashes that recur at the same lag, shape (C, 2)."""
        self._compare()
        pairs = np.concatenate(self._pairs)
        lag, place = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].T
        # Hashes of one repetition are at most `lag` apart, since a repetition has at most that length.
        starts = np.flatnonzero(np.append(True, (np.diff(lag) != 0) | (np.diff(place) > lag[1:]))[: len(lag)])
        runs = starts[np.diff(np.append(starts, len(lag))) >= HASHES]
        return np.column_stack([place[runs], lag[runs]])


class BlockExtremes:
    """Minimum and maximum of blocks of equal length; samples are fed in chunks of any length.

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
        # A copy, since a view would keep the whole chunk in memory.
        self._rest = chunk[whole:].copy()

    def _column(self, side: int) -> npt.NDArray[np.float64]:
        parts = [part[side] for part in self._parts]
        if len(self._rest):
            parts.append(np.array([(self._rest.min(), self._rest.max())[side]]))
        return np.concatenate([np.empty(0), *parts]).astype(np.float64)

    @property
    def typical(self) -> float:
        """Median magnitude of the block centres; NaN if all blocks have missing samples."""
        known = np.abs(0.5 * (self.low + self.high))
        known = known[np.isfinite(known)]
        return float(np.median(known)) if known.size else np.nan

    @property
    def low(self) -> npt.NDArray[np.float64]:
        """Minimum of each block, shape (B,); NaN for a block with missing samples."""
        return self._column(0)

    @property
    def high(self) -> npt.NDArray[np.float64]:
        """Maximum of each block, shape (B,); NaN for a block with missing samples."""
        return self._column(1)
