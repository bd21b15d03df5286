"""DEWESoft files (.d7d, .dxd) through the package dwdatareader and its vendor's library."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import Channel, Samples
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.isolation import in_child
from shipfp_rs.logs.time_axis import TimeAxis, time_axis


@register_reader(".d7d", ".dxd")
@in_child("dwdatareader", extra="dewesoft")
def open_dewesoft(path: Path, rate_hz: float | None) -> Log:
    """Open a DEWESoft file; the library gives scaled float64. Channels it can't decode are left out, with a warning."""
    import dwdatareader

    channels: list[Channel] = []
    skipped: list[str] = []
    axes: dict[str, TimeAxis] = {}
    with dwdatareader.DWFile(str(path)) as file:
        start_utc = file.info.start_store_time
        for name, channel in file.items():
            try:
                rate = float(channel.sample_rate)
                if rate > 0.0:
                    start_s = float(channel.scaled(count=1)[0][0])  # raises where the library can't decode it
                else:
                    times = np.asarray(channel.scaled()[0])
                    axis = time_axis(path, name, partial(iter, [times]), rate_hz=rate_hz)
                    start_s, rate = axis.start_s, axis.rate_hz
            except (dwdatareader.DWError, InputError, IndexError):
                rate = np.nan
            if channel.array_size != 1 or not (0.0 < rate < np.inf and np.isfinite(start_s)):
                skipped.append(name)
                continue
            count = channel.number_of_samples
            if not float(channel.sample_rate) > 0.0:
                axis.tell(path)
                axes[name], count = axis, axis.samples
            channels.append(Channel(name, channel.unit, rate, count, start_s))
    if skipped:
        warnings.warn(
            f"{path}: left out, not decoded or without a uniform rate: {', '.join(skipped)}",
            LogWarning,
            stacklevel=2,
        )

    def rows(name: str, first: int, size: int) -> Iterator[Samples]:
        with dwdatareader.DWFile(str(path)) as file:
            channel = file[name]
            rate, count = channel.sample_rate, channel.number_of_samples
            # Channels without a clock of their own are read whole: the library can't cut them.
            whole = None if rate > 0.0 else channel.scaled()[1]
            for start in range(first, count, size):
                if whole is None:
                    yield channel.scaled(T1=(start + 0.5) / rate, count=size)[1]
                else:
                    yield whole[start : start + size]

    readers = {name: axis.on_grid(rows) for name, axis in axes.items()}

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        return readers.get(name, rows)(name, first, size)

    return Log(str(path), channels, blocks, start_utc)
