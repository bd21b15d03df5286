"""`shipfp run`: the main job on the user's own log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shipfp_rs.cli.options import MOST_SEED, Force, Json, OutFolder, a_language, a_path
from shipfp_rs.cli.output import print_fingerprint, print_json, print_text, progress
from shipfp_rs.support.languages import LANGUAGES


def run(
    trial: Annotated[
        Path, typer.Argument(metavar="TRIAL.toml", parser=a_path, help="Description of the trial.")
    ],
    out: OutFolder = Path("shipfp-run"),
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed", min=0, max=MOST_SEED, help="Seed of the random starts, in place of the trial's."
        ),
    ] = None,
    force: Force = False,
    language: Annotated[
        str | None,
        typer.Option(
            "--language",
            metavar="|".join(LANGUAGES),
            parser=a_language,
            help="Language of the report, in place of the trial's.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Turn a raw log into a fingerprint: calibrate, clean, identify, report."""
    from shipfp_rs.runs import run

    with progress() as notify:
        result = run.run(trial, out, seed=seed, force=force, language=language, notify=notify)
    if json:
        print_json({"folder": str(out), **result.fingerprint.to_dict()})
        return
    print_fingerprint(result.fingerprint)
    print_text(f"wrote {out}")
