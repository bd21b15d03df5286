"""Array types, bases of classes with samples, and operations on spans of samples."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.hints import Hinted

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Numbers = npt.NDArray[Any]
"""Real or complex numbers, such as samples or spectra."""
Mask = npt.NDArray[np.bool_]
Values = Mapping[str, float]
"""Values of parameters or signals by name."""
Names = Sequence[str]
LONGEST = 70
"""Longest value in a short `repr`, in characters."""


class EvenlySampled(Hinted):
    """Base of classes with evenly spaced samples."""

    rate_hz: float

    @abstractmethod
    def __len__(self) -> int: ...

    @property
    def time(self) -> Array:
        """Time from the first sample [s], shape (N,)."""
        return np.arange(len(self)) / self.rate_hz

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return len(self) / self.rate_hz


class Brief:
    """Base of dataclasses with a short `repr`: arrays by shape, long values by type and length."""

    def __repr__(self) -> str:
        assert is_dataclass(self)
        told = ", ".join(f"{one.name}={_brief(getattr(self, one.name))}" for one in fields(self))
        return f"{type(self).__name__}({told})"


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"<array {value.shape}>"
    text = repr(value)
    if len(text) <= LONGEST and "\n" not in text:
        return text
    return f"<{type(value).__name__}{f' of {len(value)}' if isinstance(value, Sized) else ''}>"


def unmasked(values: Any) -> Array:
    """Copy of samples as 64-bit floats, NaN where masked."""
    return np.asarray(np.ma.filled(np.ma.array(values, dtype=np.float64, copy=True), np.nan))


def attributes(thing: object, *names: str) -> dict[str, Any]:
    """Attributes of an object by name, in the order of `names`."""
    return {name: getattr(thing, name) for name in names}


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal: arrays by sample, NaN equal to NaN, mappings and sequences by entry."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        a, b = np.asarray(one), np.asarray(other)
        return bool(np.array_equal(a, b, equal_nan=a.dtype.kind in "fc" and b.dtype.kind in "fc"))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(value, other[key]) for key, value in one.items())
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


def even_parts(pieces: Iterable[Numbers], size: int) -> Iterator[list[Numbers]]:
    """Yield views of `size` successive samples each; the last view may be shorter."""
    held: list[Numbers] = []
    count = 0
    for piece in pieces:
        while len(piece):
            held.append(piece[: size - count])
            piece = piece[size - count :]
            count += len(held[-1])
            if count == size:
                yield held
                held, count = [], 0
    if held:
        yield held


DEVIATIONS_95 = 1.959963984540054
"""Half the width of a 95 % interval, in standard deviations: 1.96."""


Spans = npt.NDArray[np.int64]
"""Sample indices [first, stop) of each span, shape (K, 2)."""


def runs(flags: Mask) -> Spans:
    """Spans of True, shape (K, 2)."""
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    return edges.reshape(-1, 2).astype(np.int64)


def joined(spans: Iterable[Numbers], gap: float = 0) -> Numbers:
    """Spans in ascending order, shape (K, 2); overlapping spans, and spans at most `gap` apart, are joined."""
    every = np.concatenate([np.empty((0, 2), dtype=np.int64), *spans])
    every = every[np.argsort(every[:, 0], kind="stable")]
    if len(every) < 2:
        return every
    reach = np.maximum.accumulate(every[:, 1])
    apart = every[1:, 0] - reach[:-1] > gap
    return np.column_stack([every[np.r_[True, apart], 0], reach[np.r_[apart, True]]])


def apart_from(spans: Spans, others: Spans) -> Spans:
    """Spans that do not overlap any span in `others`, which must be ascending and must not overlap each other."""
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
