"""One recorded channel: what is known of it, and in which pieces its samples come."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import attributes

Samples = npt.NDArray[Any]
Blocks = Callable[[str, int, int], Iterator[Samples]]
"""(channel, first row, block size) to blocks of samples from that row on, each at most the size, all of one type.

Numbers that can't be NaN have their gaps in a masked array, so that none of their bits is lost."""
BLOCK = 1 << 20
"""Samples read or written at once where the caller has no wish."""


@dataclass(frozen=True)
class Channel:
    """One recorded channel.

    Parameters
    ----------
    name
        As the logger wrote it, without its unit.
    unit
        Unit as the logger wrote it; empty where it wrote none.
    rate_hz
        Sample rate [Hz].
    samples
        Number of samples.
    start_s
        Time of the first sample on the log's clock [s].
    resolution
        Step in which values are told, in the unit: a bit of a bus; 0 where it is not known. Its square over twelve is
        the variance of the rounding.
    """

    name: str
    unit: str
    rate_hz: float
    samples: int
    start_s: float = 0.0
    resolution: float = 0.0

    @property
    def told(self) -> dict[str, Any]:
        """Name, unit, rate, samples and start, by name."""
        return attributes(self, "name", "unit", "rate_hz", "samples", "start_s")

    @property
    def stop_s(self) -> float:
        """Time just after the last sample [s]."""
        return self.start_s + self.samples / self.rate_hz


def with_nan(block: Samples) -> Samples:
    """Return samples as recorded, gaps as NaN: integers with gaps become float64."""
    if not isinstance(block, np.ma.MaskedArray):
        return block
    return np.where(block.mask, np.nan, block.data) if np.ma.is_masked(block) else block.data


def in_blocks(
    length: Callable[[str], int], read: Callable[[str, int, int], Samples], path: object = "log"
) -> Blocks:
    """Return a function that yields channels in blocks; `read` gives rows [first, stop) of one, all of them.

    `InputError` where a block has another length: what comes after it would stand at wrong times. `path` is told there.
    """

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        count = length(name)
        for start in range(first, count, size):
            stop = min(start + size, count)
            block = read(name, start, stop)
            _require_length(path, name, start, len(block), stop - start)
            yield block

    return blocks


def whole(path: object, channels: Mapping[str, Channel], blocks: Blocks) -> Blocks:
    """Return a function that yields what `blocks` does, with `InputError` where a channel ends before its last sample."""

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


def blocks_of(arrays: Mapping[str, Samples]) -> Blocks:
    """Return a function that yields arrays in memory in blocks."""
    return in_blocks(lambda name: len(arrays[name]), lambda name, first, stop: arrays[name][first:stop])
