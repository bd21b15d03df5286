"""Minimum and maximum of each short block of a channel, to read suspicious blocks alone again; rows written twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.arrays import Spans, joined

TAPS = 8
"""Successive samples in each hash of `shipfp_rs._core.RepeatScan`, which finds candidates of repeated rows."""
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
