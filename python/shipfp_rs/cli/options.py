"""The options that several subcommands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON, and nothing else, on stdout.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of everything that is drawn.")]
Force = Annotated[
    bool, typer.Option("--force", help="Write into a folder that holds other files, too; these stay.")
]
OutFolder = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Folder to write; it appears only when the run is complete."),
]

Time = Annotated[
    str | None,
    typer.Option(
        "--time",
        metavar="COLUMN",
        help="Column of time, where it is not found: 'COLUMN', 'COLUMN [ms]', 'DATE [d.m.y] + CLOCK'.",
    ),
]
Names = Annotated[
    Path | None,
    typer.Option("--names", metavar="FILE", help="DBC of a CAN log, or channel list of ISO 19848."),
]
Rate = Annotated[
    float | None, typer.Option("--rate", metavar="HZ", help="Sample rate, where the log tells none.")
]
