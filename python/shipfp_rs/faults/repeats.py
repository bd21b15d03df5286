"""Rows that a logger wrote twice: found by samples whose bits recur in the same order."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.spans import Spans, joined

Samples = npt.NDArray[Any]

TAPS = 8
"""Samples in a print."""
KEPT_BITS = 4
"""Prints that begin with so many zeros are kept, one in 16: both copies keep the same ones, some 7 in 128 samples."""
PRINTS = 2
"""Prints in a row that recur at one distance before the samples themselves are compared."""
LEAST = 128
"""Shortest stretch that counts as written twice [samples]."""
LONGEST = 1 << 20
"""Longest stretch that a logger may write twice [samples]; its buffer."""
# Multiples of one another would make the prints of a coarsely rounded signal collide.
_MIX = np.random.default_rng(0x5EED).integers(2**63, size=TAPS, dtype=np.uint64) * np.uint64(2) + np.uint64(1)


class RepeatScan:
    """Prints of a channel's samples, fed in chunks of any length with the same answer."""

    def __init__(self) -> None:
        self._held = np.empty(0, dtype=np.uint64)
        self._at = 0
        self._prints: list[npt.NDArray[np.uint64]] = []
        self._places: list[npt.NDArray[np.int64]] = []

    def feed(self, chunk: Samples) -> None:
        """Take the next samples."""
        bits = np.ascontiguousarray(chunk, dtype=np.float32).view(np.uint32).astype(np.uint64)
        bits = np.concatenate([self._held, bits])
        count = len(bits) - TAPS
        if count <= 0:
            self._held = bits
            return
        prints = bits[:count] * _MIX[0]
        for k in range(1, TAPS):
            prints += bits[k : count + k] * _MIX[k]
        # Where nothing changes every print is the same and tells nothing.
        kept = np.flatnonzero(
            (prints >> np.uint64(64 - KEPT_BITS) == 0) & (bits[:count] != bits[1 : count + 1])
        )
        self._prints.append(prints[kept])
        self._places.append(kept + self._at)
        self._at += count
        self._held = bits[count:].copy()

    def candidates(self) -> list[tuple[int, int]]:
        """Return places and distances (sample, lag) at which prints recur in a row, first copy's sample."""
        if not self._prints:
            return []
        prints, places = np.concatenate(self._prints), np.concatenate(self._places)
        order = np.argsort(prints, kind="stable")
        same = prints[order][1:] == prints[order][:-1]
        first, lag = places[order][:-1][same], np.diff(places[order])[same]
        order = np.lexsort((first, lag))
        first, lag = first[order], lag[order]
        first, lag = first[lag <= LONGEST], lag[lag <= LONGEST]
        # Prints of one repetition stand a lag or less apart: it is no longer than that.
        breaks = np.flatnonzero((np.diff(lag) != 0) | (np.diff(first) > lag[1:])) + 1
        begins, ends = np.append(0, breaks), np.append(breaks, len(first))
        return [
            (int(first[begin]), int(lag[begin]))
            for begin, end in zip(begins, ends, strict=True)
            if end - begin >= PRINTS
        ]


def repeated_rows(
    candidates: list[tuple[int, int]], equal: Callable[[int, int, int], npt.NDArray[np.bool_]], samples: int
) -> Spans:
    """Return the second copies among the candidates, shape (K, 2).

    Parameters
    ----------
    candidates
        (sample, lag) as from `RepeatScan.candidates`.
    equal
        (first, stop, lag) to whether the rows from first to stop equal those a lag later in every channel.
    samples
        Length of the channels.

    Notes
    -----
    What recurs for longer than its own lag is no copy of a buffer but a signal without noise that is periodic.
    """
    found: list[Spans] = []
    for place, lag in candidates:
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
