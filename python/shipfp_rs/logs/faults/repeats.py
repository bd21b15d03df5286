"""Rows that a logger wrote twice: samples that recur in the same order in every channel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.spans import Spans, joined

TAPS = 8
"""Samples in a hash of `shipfp_rs._core.RepeatScan`."""
LEAST = 128
"""Shortest repeated stretch [samples]."""


def repeated_rows(
    candidates: npt.NDArray[np.int64], equal: Callable[[int, int, int], npt.NDArray[np.bool_]], samples: int
) -> Spans:
    """Second copies among the candidates of `RepeatScan`, shape (K, 2), compared by `equal` (first, stop, lag).

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
