"""Long channels at a coarse rate: means over blocks of samples."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from shipfp_rs.logs.log import Log
from shipfp_rs.support.arrays import Array


def block_means(log: Log, name: str, block: int) -> Array:
    """Mean of each block of samples, shape (N // block,); NaN where one is missing."""
    return np.concatenate([np.empty(0), *mean_pieces(log, name, block)])


def mean_pieces(
    log: Log, name: str, block: int, start_s: float | None = None, stop_s: float | None = None
) -> Iterator[Array]:
    """Yield the block means of a stretch in pieces; samples after the last whole block are ignored."""
    held = np.empty(0)
    for chunk in log.chunks(name, start_s=start_s, stop_s=stop_s):
        held = np.concatenate([held, np.asarray(chunk, dtype=np.float64)])
        whole = len(held) // block * block
        yield held[:whole].reshape(-1, block).mean(axis=1)
        held = held[whole:]


def bridged(values: Array) -> Array:
    """Interpolate NaN linearly, shape (N,)."""
    missing = np.flatnonzero(~np.isfinite(values))
    if not missing.size:
        return values
    known = np.flatnonzero(np.isfinite(values))
    filled = values.copy()
    filled[missing] = np.interp(missing, known, values[known])
    return filled
