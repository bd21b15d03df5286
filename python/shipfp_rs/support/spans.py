"""Spans of samples: found from flags, joined, cut, and converted to flags."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.arrays import Mask

Spans = npt.NDArray[np.int64]
"""First sample and one past the last, shape (K, 2)."""


def runs(flags: Mask) -> Spans:
    """Spans of True, shape (K, 2)."""
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    return edges.reshape(-1, 2).astype(np.int64)


def joined(spans: Iterable[Spans], gap: int = 0) -> Spans:
    """Spans in order; overlapping ones and those at most `gap` samples apart are joined, shape (K, 2)."""
    every = np.concatenate([np.empty((0, 2), dtype=np.int64), *spans])
    every = every[np.argsort(every[:, 0], kind="stable")]
    if len(every) < 2:
        return every
    reach = np.maximum.accumulate(every[:, 1])
    apart = every[1:, 0] - reach[:-1] > gap
    return np.column_stack([every[np.r_[True, apart], 0], reach[np.r_[apart, True]]])


def apart_from(spans: Spans, others: Spans) -> Spans:
    """Spans that do not touch any of `others`, which must be ordered and must not overlap."""
    if not (len(spans) and len(others)):
        return spans
    next_one = np.searchsorted(others[:, 1], spans[:, 0], side="right")
    begins = np.append(others[:, 0], np.iinfo(np.int64).max)[next_one]
    return spans[begins >= spans[:, 1]]


def clipped_to(spans: Spans, first: int, stop: int) -> Spans:
    """Cut spans to [first, stop)."""
    cut = np.clip(spans, first, stop)
    return cut[cut[:, 1] > cut[:, 0]]


def marks(spans: Spans, first: int, stop: int) -> Mask:
    """Whether each sample of [first, stop) is in a span."""
    flags = np.zeros(stop - first, dtype=np.bool_)
    for start, end in (clipped_to(spans, first, stop) - first).tolist():
        flags[start:end] = True
    return flags
