"""Values with individual time stamps, by name, as the channels of a log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Blocks, Channel, Samples, blocks_of
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers.time_cells import EPOCH
from shipfp_rs.logs.time_axis import TimeAxis, time_axis


@dataclass
class Series:
    """Values of one name; times in seconds since 1970."""

    unit: str = ""
    resolution: float = 0.0
    times: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)


def log_of_series(path: Path, series: Mapping[str, Series], notes: Sequence[str] = ()) -> Log:
    """Log of series, each on its own even grid; the notes name those without one.

    Raises
    ------
    InputError
        If none has two values or more in order of time.
    """
    kept = {
        name: each for name, each in series.items() if len(each.values) > 1 and np.isfinite(each.values).any()
    }
    zero = min((each.times[0] for each in kept.values()), default=0.0)
    channels: list[Channel] = []
    held: dict[str, Blocks] = {}
    told = list(notes)
    faults: list[Fault] = []
    for name, each in kept.items():
        time = np.asarray(each.times) - zero
        order = np.argsort(time, kind="stable")
        samples = np.asarray(each.values, dtype=np.float64)[order]
        time = time[order]
        axis = own_axis(path, name, time, told, faults)
        if axis is None:
            continue
        channels.append(Channel(name, each.unit, axis.rate_hz, axis.samples, axis.start_s, each.resolution))
        held[name] = axis.on_grid(blocks_of({name: samples}))
    if not channels:
        why = told[-1] if len(told) > len(notes) else "no name has two values or more"
        raise InputError(f"{path}: no series of numbers in it ({why}); is it the right file?")

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        return held[name](name, first, size)

    start = EPOCH + timedelta(microseconds=round(zero * 1e6))
    return Log(str(path), channels, blocks, start if zero else None, tuple(faults), tuple(told))


def own_axis(
    path: Path, name: str, times: npt.NDArray[np.float64], notes: list[str], faults: list[Fault]
) -> TimeAxis | None:
    """Grid of a name's times [s]; None, with a note of the reason, if there is none. Appends to notes and faults."""
    try:
        axis = time_axis(path, name, partial(iter, (times,)))
    except InputError as error:
        notes.append(f"{name} left out: {str(error).removeprefix(f'{path}: ')}")
        return None
    notes += [axis.note] if axis.note else []
    faults += axis.faults
    return axis


def seconds_since_1970(text: str) -> float:
    """Seconds since 1970 of an instant in ISO 8601, or with canboat's dash before the clock; UTC without a zone."""
    text = text.strip()
    if len(text) > 10 and text[10] == "-":
        text = f"{text[:10]}T{text[11:]}"
    instant = datetime.fromisoformat(text)
    instant = instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant
    return (instant - EPOCH) / timedelta(seconds=1)
