"""`shipfp convert`: a log of any supported format to Parquet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shipfp_rs.cli.output import print_text


def convert(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log in any supported format.")],
    out: Annotated[Path, typer.Argument(metavar="OUT.parquet", help="File to write.")],
    rate_hz: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", help="Sample rate, where the file tells none.")
    ] = None,
) -> None:
    """Convert a log to Parquet, each channel with its unit, rate, start and type."""
    from shipfp_rs.logs.log import Log

    source = Log.open(log, rate_hz=rate_hz)
    source.write(out)
    print_text(f"wrote {out}: {len(source.channels)} channels")
    for channel in source.channels.values():
        unit = f" [{channel.unit}]" if channel.unit else ""
        print_text(f"  {channel.name}{unit}: {channel.samples} samples at {channel.rate_hz:g} Hz")
