"""DEWESoft files (.d7d, .dxd), read by dwdatareader and its vendor's library."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel, Samples, in_blocks
from shipfp_rs.logs.faults.clock import same_rows
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.child_process import in_child
from shipfp_rs.logs.readers.columns import Found, log_of_found, tell_left_out
from shipfp_rs.logs.time_axis import time_axis


@register_reader(".d7d", ".dxd")
@in_child("dwdatareader", extra="dewesoft")
def open_dewesoft(path: Path, rate_hz: float | None) -> Log:
    """Open a DEWESoft file as scaled float64; channels that the library can't decode are omitted with a warning."""
    import dwdatareader

    found: list[Found] = []
    skipped: list[str] = []
    with dwdatareader.DWFile(str(path)) as file:
        start_utc = file.info.start_store_time
        for name, channel in file.items():
            try:
                rate = float(channel.sample_rate)
                if rate > 0.0:
                    start_s = float(channel.scaled(count=1)[0][0])  # raises an error if it can't be decoded
                    each = Found(Channel(name, channel.unit, rate, channel.number_of_samples, start_s))
                else:
                    times, values = map(np.asarray, channel.scaled())

                    def read(first: int, stop: int, values: Samples = values) -> Samples:
                        return values[first:stop]

                    axis = time_axis(
                        path, name, partial(iter, [times]), rate_hz=rate_hz, same=same_rows([read])
                    )
                    each = Found.on(axis, name, channel.unit)
            except (dwdatareader.DWError, InputError, IndexError):
                skipped.append(name)
                continue
            about = each.channel
            if channel.array_size != 1 or not (about.rate_hz < np.inf and np.isfinite(about.start_s)):
                skipped.append(name)
                continue
            found.append(replace(each, start_utc=start_utc))
    tell_left_out(path, "not decoded or without a uniform rate", skipped, all_of_them=not found)

    def rows(name: str, first: int, size: int) -> Iterator[Samples]:
        with dwdatareader.DWFile(str(path)) as file:
            channel = file[name]
            rate, count = channel.sample_rate, channel.number_of_samples
            # Channels without their own clock are read whole, since the library can't read parts of them.
            whole = None if rate > 0.0 else channel.scaled()[1]

            def part(_: str, start: int, stop: int) -> Samples:
                if whole is not None:
                    return np.asarray(whole[start:stop])
                return np.asarray(channel.scaled(T1=(start + 0.5) / rate, count=stop - start)[1])

            yield from in_blocks(lambda _: count, part, path)(name, first, size)

    return log_of_found(path, found, rows)
