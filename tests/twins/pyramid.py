"""Least and greatest samples of blocks, in plain NumPy."""

import numpy as np


def extremes(samples: np.ndarray, block: int) -> np.ndarray:
    """Least and greatest finite sample of every block, shape (K, 2); NaN where there is none."""
    found = np.full((-(-len(samples) // block), 2), np.nan)
    for k in range(len(found)):
        part = samples[k * block : (k + 1) * block].astype(np.float64)
        part = part[np.isfinite(part)]
        if part.size:
            found[k] = part.min(), part.max()
    return found


def gaps(samples: np.ndarray) -> np.ndarray:
    """First sample and the one after the last of every stretch that is not finite, shape (G, 2)."""
    missing = np.concatenate([[0], ~np.isfinite(samples.astype(np.float64)), [0]]).astype(int)
    return np.flatnonzero(np.diff(missing)).reshape(-1, 2)
