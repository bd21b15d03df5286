"""`shipfp run`: identification from the user's log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shipfp_rs.cli.options import Force, Json, OtherSeed, OutFolder, TrialFile, a_language
from shipfp_rs.cli.output import print_fingerprint, print_results, progress
from shipfp_rs.support.languages import LANGUAGES


def run(
    trial: TrialFile,
    out: OutFolder = Path("shipfp-run"),
    seed: OtherSeed = None,
    force: Force = False,
    language: Annotated[
        str | None,
        typer.Option(
            metavar="|".join(LANGUAGES), parser=a_language, help="Of the report; default the trial's."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Turn a raw log into a fingerprint: calibrate, clean, identify, report."""
    from shipfp_rs.runs import run

    with progress() as notify:
        result = run.run(trial, out, seed=seed, force=force, language=language, notify=notify)
    found = result.fingerprint
    content = {"folder": str(out), **found.to_dict()}
    print_results(content, lambda: print_fingerprint(found), out, json=json)
