"""`shipfp export`: writes a fingerprint in the formats of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from shipfp_rs.cli.options import Json, Replace, file_argument, file_option, new_file, print_results


def export(
    fingerprint: Annotated[
        Path, file_argument("FINGERPRINT.json", "Fingerprint, as `shipfp run` writes it.")
    ],
    to: Annotated[
        Literal["fmu", "simulink", "control", "degov", "ggov1"],
        typer.Option(
            help="FMU, Simulink script, python-control script, or the governor as DEGOV or GGOV1 card.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None, file_option("FILE", "File to write; default ship or the card's name, and its suffix.")
    ] = None,
    force: Replace = False,
    json: Json = False,
) -> None:
    """Write a fingerprint's ship, or its governor, for another tool."""
    from shipfp_rs.exports import export as write
    from shipfp_rs.exports import files_of

    files = files_of(to, out)
    for path in files:
        new_file(path, force=force)
    write(fingerprint, to, files[0])
    content = {"to": to, "files": [str(path) for path in files]}
    print_results(content, lambda: None, files[0], json=json)
