"""A long channel at a coarse rate: means over blocks of samples."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from shipfp_rs.logs.log import Log
from shipfp_rs.support.arrays import Array


def block_means(log: Log, name: str, block: int) -> Array:
    """Return the mean of each block of so many samples, shape (N // block,); NaN where one of them is missing."""
    return np.concatenate([np.empty(0), *mean_pieces(log, name, block)])


def mean_pieces(
    log: Log, name: str, block: int, start_s: float | None = None, stop_s: float | None = None
) -> Iterator[Array]:
    """Yield the means of a stretch's blocks, piece by piece; samples after the last whole block tell nothing."""
    held = np.empty(0)
    for chunk in log.chunks(name, start_s=start_s, stop_s=stop_s):
        held = np.concatenate([held, np.asarray(chunk, dtype=np.float64)])
        whole = len(held) // block * block
        yield held[:whole].reshape(-1, block).mean(axis=1)
        held = held[whole:]


def bridged(values: Array) -> Array:
    """Return values (N,) with straight lines over the gaps between those that are finite."""
    missing = np.flatnonzero(~np.isfinite(values))
    if not missing.size:
        return values
    known = np.flatnonzero(np.isfinite(values))
    filled = values.copy()
    filled[missing] = np.interp(missing, known, values[known])
    return filled
