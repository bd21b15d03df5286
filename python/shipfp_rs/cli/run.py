"""`shipfp run`: the main job on the user's own log."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from shipfp_rs.cli.options import MOST_SEED, Force, Json, OutFolder, a_path
from shipfp_rs.cli.output import print_fingerprint, print_json, print_text, progress


class Language(StrEnum):
    """Languages of a report."""

    en = "en"
    de = "de"


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
        Language | None, typer.Option("--language", help="Language of the report, in place of the trial's.")
    ] = None,
    json: Json = False,
) -> None:
    """Turn a raw log into a fingerprint: calibrate, clean, identify, report."""
    from shipfp_rs.runs import run

    said: Literal["en", "de"] | None = None
    if language is not None:
        said = "de" if language is Language.de else "en"
    with progress() as notify:
        result = run.run(trial, out, seed=seed, force=force, language=said, notify=notify)
    if json:
        print_json({"folder": str(out), **result.fingerprint.to_dict()})
        return
    print_fingerprint(result.fingerprint)
    print_text(f"wrote {out}")
