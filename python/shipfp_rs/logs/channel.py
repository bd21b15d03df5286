"""A recorded channel: its metadata, and its samples in blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import attributes

Samples = npt.NDArray[Any]
Blocks = Callable[[str, int, int], Iterator[Samples]]
"""Function (channel, first row, block size) that yields the samples from the first row on, in blocks. All blocks have
the same dtype and at most the block size. Integers with gaps are masked arrays, since a conversion to NaN would lose
bits.
"""
BLOCK = 1 << 20
"""Default number of samples read or written at once."""


@dataclass(frozen=True)
class Channel:
    """One recorded channel.

    Parameters
    ----------
    name
        Name as written by the logger, without the unit.
    unit
        Unit as written by the logger; empty if none.
    rate_hz
        Sample rate [Hz].
    samples
        Number of samples.
    start_s
        Time of the first sample on the log's clock [s].
    resolution
        Step between adjacent values, in `unit`, for instance one bit of a bus signal; 0 if unknown. The variance of the
        rounding error is the squared step over twelve.
    """

    name: str
    unit: str
    rate_hz: float
    samples: int
    start_s: float = 0.0
    resolution: float = 0.0

    @property
    def told(self) -> dict[str, Any]:
        """Name, unit, rate, number of samples and start, for messages and tables."""
        return attributes(self, "name", "unit", "rate_hz", "samples", "start_s")

    @property
    def stop_s(self) -> float:
        """End of the last sample interval [s]."""
        return self.start_s + self.samples / self.rate_hz


def with_nan(block: Samples) -> Samples:
    """Convert masked samples of a block to NaN; integers with gaps become float64."""
    if not isinstance(block, np.ma.MaskedArray):
        return block
    return np.where(block.mask, np.nan, block.data) if np.ma.is_masked(block) else block.data


def first_of(blocks: Iterable[Any], count: int) -> Iterator[Any]:
    """Yield the first `count` rows of successive NumPy or Arrow blocks, and request no block after them."""
    for block in blocks if count > 0 else ():
        yield block[:count]
        count -= len(block)
        if count <= 0:
            return


def in_blocks(
    length: Callable[[str], int], read: Callable[[str, int, int], Samples], path: object = "log"
) -> Blocks:
    """Make `Blocks` from `read` (channel, first, stop), which returns rows [first, stop); a wrong length is an error."""

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        count = length(name)
        for start in range(first, count, size):
            stop = min(start + size, count)
            block = read(name, start, stop)
            # A block of another length would shift all later samples in time.
            _require_length(path, name, start, len(block), stop - start)
            yield block

    return blocks


def whole(path: object, channels: Mapping[str, Channel], blocks: Blocks) -> Blocks:
    """Wrap `blocks` to raise `InputError` where a channel ends before its last sample."""

    def read(name: str, first: int, size: int) -> Iterator[Samples]:
        count = 0
        for block in blocks(name, first, size):
            count += len(block)
            yield block
        expected = channels[name].samples - first
        _require_length(path, name, first, min(count, expected), expected)

    return read


def _require_length(path: object, name: str, first: int, found: int, expected: int) -> None:
    if found != expected:
        raise InputError(
            f"{path}: channel {name!r} gives {found} samples from sample {first} on, expected {expected}; is the file "
            "damaged or cut short?"
        )


def blocks_by_name(held: Mapping[str, Blocks], others: Blocks | None = None) -> Blocks:
    """Return `Blocks` that read a channel from its entry in `held`, and a channel without an entry from `others`."""
    return lambda name, first, size: (held.get(name, others) or held[name])(name, first, size)


def blocks_of(arrays: Mapping[str, Samples]) -> Blocks:
    """`Blocks` of arrays in memory."""
    return in_blocks(lambda name: len(arrays[name]), lambda name, first, stop: arrays[name][first:stop])
