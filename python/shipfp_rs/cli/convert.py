"""`shipfp convert`: a log of any supported format to Parquet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from shipfp_rs.cli.options import LogFile, Names, Rate, Replace, Time, file_argument, new_file
from shipfp_rs.cli.output import print_text
from shipfp_rs.errors import InputError


def convert(
    log: LogFile,
    out: Annotated[Path, file_argument("OUT.parquet", "File to write.")],
    rate_hz: Rate = None,
    time: Time = None,
    names: Names = None,
    force: Replace = False,
) -> None:
    """Convert a log to Parquet, each channel with its unit, rate, start and type."""
    from shipfp_rs.logs.log import Log

    if out.is_file() and log.exists() and out.samefile(log):
        raise InputError(f"{out}: is the log itself; choose another name")
    new_file(out, force=force)
    source = Log.open(log, rate_hz=rate_hz, time=time, names=names)
    source.write(out)
    print_text(f"wrote {out}: {len(source.channels)} channels")
    for channel in source.channels.values():
        unit = f" [{channel.unit}]" if channel.unit else ""
        print_text(f"  {channel.name}{unit}: {channel.samples} samples at {channel.rate_hz:g} Hz")
    print_text(*source.notes)
