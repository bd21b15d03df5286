"""`shipfp init`: a commented TRIAL.toml or SWEEP.toml to fill in."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shipfp_rs.cli.output import print_text
from shipfp_rs.errors import InputError


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the trial.")] = Path(),
    sweep: Annotated[bool, typer.Option("--sweep", help="Write a SWEEP.toml instead.")] = False,
) -> None:
    """Write a commented TRIAL.toml to fill in."""
    from shipfp_rs.files import write_text_atomically

    if sweep:
        from shipfp_rs.sweeps.template import SWEEP_TEMPLATE as text

        name, command = "SWEEP.toml", "sweep"
    else:
        from shipfp_rs.trial import TRIAL_TEMPLATE as text

        name, command = "TRIAL.toml", "run"
    path = folder / name
    if path.exists():
        raise InputError(f"{path}: is there already; rename it or choose another folder")
    write_text_atomically(path, text)
    print_text(f"wrote {path}", f"Fill it in, then: shipfp {command} {path}")
