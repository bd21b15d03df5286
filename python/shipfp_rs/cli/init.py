"""`shipfp init`: a commented TRIAL.toml to fill in."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shipfp_rs.cli.output import print_text
from shipfp_rs.errors import InputError


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the trial.")] = Path(),
) -> None:
    """Write a commented TRIAL.toml to fill in."""
    from shipfp_rs.files import write_text_atomically
    from shipfp_rs.trial import TRIAL_TEMPLATE

    path = folder / "TRIAL.toml"
    if path.exists():
        raise InputError(f"{path}: is there already; rename it or choose another folder")
    write_text_atomically(path, TRIAL_TEMPLATE)
    print_text(f"wrote {path}", "Fill it in, then: shipfp run " + str(path))
