"""National Instruments TDMS files through the package npTDMS."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from shipfp_rs.errors import InputError
from shipfp_rs.log import Channel, Log, Samples, register_reader
from shipfp_rs.readers.third_party import load, one_line_errors


@register_reader(".tdms")
def open_tdms(path: Path, rate_hz: float | None) -> Log:
    """Open a TDMS file; a channel carries its group's name in front where another has the same name."""
    package = load(path, "nptdms", "tdms")
    channels: list[Channel] = []
    keys: dict[str, tuple[str, str]] = {}
    starts: dict[str, datetime] = {}
    skipped: list[str] = []
    with one_line_errors(path), package.TdmsFile.read_metadata(path) as file:
        found = [channel for group in file.groups() for channel in group.channels()]
        names = [channel.name for channel in found]
        for channel in found:
            once = names.count(channel.name) == 1
            name = channel.name if once else f"{channel.group_name}/{channel.name}"
            if channel.dtype.kind not in "iuf":
                skipped.append(name)
                continue
            step = float(channel.properties.get("wf_increment", math.nan))
            if rate_hz is None and not 0.0 < step < math.inf:
                raise InputError(f"{path}: channel {name!r} tells no wf_increment above 0; give rate_hz")
            offset = float(channel.properties.get("wf_start_offset", 0.0))
            if not math.isfinite(offset):
                raise InputError(f"{path}: channel {name!r} starts at {offset} s; is the file damaged?")
            if "wf_start_time" in channel.properties:
                starts[name] = channel.properties["wf_start_time"].astype("M8[us]").item().replace(tzinfo=UTC)
            unit = str(channel.properties.get("unit_string", ""))
            keys[name] = (channel.group_name, channel.name)
            channels.append(Channel(name, unit, rate_hz or 1.0 / step, len(channel), offset))
        start_utc = min(starts.values(), default=None)
        if start_utc is not None:
            channels = [
                Channel(
                    c.name,
                    c.unit,
                    c.rate_hz,
                    c.samples,
                    c.start_s + (starts.get(c.name, start_utc) - start_utc).total_seconds(),
                )
                for c in channels
            ]
    if skipped:
        warnings.warn(f"{path}: no numbers in {', '.join(skipped)}; left out", stacklevel=3)

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        group, key = keys[name]
        with one_line_errors(path):
            file = package.TdmsFile.open(path)
        with file:
            samples = len(file[group][key])
            for start in range(first, samples, size):
                with one_line_errors(path):
                    part = file[group][key].read_data(start, min(size, samples - start))
                    part = part.astype(part.dtype.newbyteorder("="), copy=False)
                yield part

    return Log(str(path), channels, blocks, start_utc)
