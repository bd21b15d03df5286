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
