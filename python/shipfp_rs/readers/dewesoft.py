"""DEWESoft files (.d7d, .dxd) through the package dwdatareader and its vendor's library."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.log import Channel, Log, Samples, _time_base, register_reader
from shipfp_rs.readers.third_party import load, one_line_errors, rehearse

REHEARSAL = """
import sys, dwdatareader
with dwdatareader.DWFile(sys.argv[1]) as file:
    for channel in file.values():
        try: channel.scaled()
        except dwdatareader.DWError: pass
"""
"""The vendor's library is native code that need not survive a damaged file."""


@register_reader(".d7d", ".dxd")
def open_dewesoft(path: Path, rate_hz: float | None) -> Log:
    """Open a DEWESoft file; the library gives scaled float64. Channels it can't decode are left out, with a warning."""
    package = load(path, "dwdatareader", "dewesoft")
    rehearse(path, REHEARSAL)
    channels: list[Channel] = []
    skipped: list[str] = []
    with one_line_errors(path), package.DWFile(str(path)) as file:
        start_utc = file.info.start_store_time
        for name, channel in file.items():
            try:
                rate, start_s = float(channel.sample_rate), 0.0
                if rate > 0.0:
                    channel.scaled(count=1)  # raises where the library can't decode the channel
                else:
                    start_s, rate = _time_base(path, name, iter([channel.scaled()[0]]), check=rate_hz is None)
                    rate = rate_hz or rate
            except (package.DWError, InputError):
                rate = np.nan
            if channel.array_size != 1 or not (0.0 < rate < np.inf and np.isfinite(start_s)):
                skipped.append(name)
                continue
            channels.append(Channel(name, channel.unit, rate, channel.number_of_samples, start_s))
    if skipped:
        warnings.warn(
            f"{path}: left out, not decoded or without a uniform rate: {', '.join(skipped)}", stacklevel=3
        )

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        # Channels without a clock of their own are read whole: the library can't cut them.
        with one_line_errors(path), package.DWFile(str(path)) as file:
            channel = file[name]
            samples: Samples = channel.scaled()[1]
        for start in range(first, len(samples), size):
            yield samples[start : start + size]

    return Log(str(path), channels, blocks, start_utc)
