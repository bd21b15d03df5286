"""Log of channels found by a reader, with their own rates or times."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import Blocks, Channel, Samples
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.time_axis import TimeAxis


@dataclass(frozen=True)
class Found:
    """Channel, grid of its times, and its start, if the file has one."""

    channel: Channel
    axis: TimeAxis | None = None
    start_utc: datetime | None = None

    @classmethod
    def on(cls, axis: TimeAxis, name: str, unit: str, start_utc: datetime | None = None) -> Found:
        """Channel on the grid of a time axis."""
        return cls(Channel(name, unit, axis.rate_hz, axis.samples, axis.start_s), axis, start_utc)


def log_of_found(path: Path, found: Sequence[Found], rows: Blocks, notes: Sequence[str] = ()) -> Log:
    """Log of the channels found. Its clock starts with the earliest channel; `rows` yields the recorded rows."""
    zero = min((each.start_utc for each in found if each.start_utc), default=None)
    channels = [
        replace(each.channel, start_s=each.channel.start_s + (each.start_utc - zero).total_seconds())
        if each.start_utc and zero
        else each.channel
        for each in found
    ]
    readers = {each.channel.name: each.axis.on_grid(rows) for each in found if each.axis}

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        return readers.get(name, rows)(name, first, size)

    return Log(str(path), channels, blocks, zero, notes=tuple(notes))


def tell_left_out(path: Path, why: str, names: Sequence[str], *, all_of_them: bool) -> None:
    """Warn of omitted channels; `InputError` if the file has no others."""
    if names and all_of_them:
        raise InputError(f"{path}: {why}: {', '.join(names)}; expected at least one channel of numbers")
    if names:
        warnings.warn(f"{path}: left out, {why}: {', '.join(names)}", LogWarning, stacklevel=3)
