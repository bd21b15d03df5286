"""Types that all modules share: arrays, values by name, and what is sampled evenly."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence, Sized
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Numbers = npt.NDArray[Any]
"""Real or complex numbers, as samples or spectra have."""
Mask = npt.NDArray[np.bool_]
Values = Mapping[str, float]
"""Name of a parameter or signal to its value."""
Names = Sequence[str]
LONGEST = 70
"""Letters of a value in a short `repr`."""


class EvenlySampled(ABC):
    """What has samples at even times."""

    rate_hz: float

    @abstractmethod
    def __len__(self) -> int: ...

    @property
    def time(self) -> Array:
        """Time from the first sample [s], shape (N,)."""
        return np.arange(len(self)) / self.rate_hz

    @property
    def duration(self) -> float:
        """Length [s]."""
        return len(self) / self.rate_hz


class Brief:
    """A `repr` of a dataclass in a few lines: arrays by their shape, and what is long by its kind and number."""

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
    """Return a copy of samples as 64-bit floats, NaN where they are masked."""
    return np.asarray(np.ma.filled(np.ma.array(values, dtype=np.float64, copy=True), np.nan))


def attributes(thing: object, *names: str) -> dict[str, Any]:
    """Return attributes of an object by name, in this order."""
    return {name: getattr(thing, name) for name in names}


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal, arrays sample by sample, NaN like NaN, and mappings and sequences within them."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        a, b = np.asarray(one), np.asarray(other)
        return bool(np.array_equal(a, b, equal_nan=a.dtype.kind in "fc" and b.dtype.kind in "fc"))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(value, other[key]) for key, value in one.items())
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)
