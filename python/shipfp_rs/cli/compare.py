"""`shipfp compare`: what changed between two fingerprints, or over many, with significance."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shipfp_rs.cli.options import Json, Replace, a_path, new_file, probability
from shipfp_rs.cli.output import print_json, print_table, print_text, progress
from shipfp_rs.errors import InputError


def compare(
    before: Annotated[
        Path,
        typer.Argument(
            metavar="A.json", parser=a_path, help="Fingerprint before, as `shipfp run` writes it."
        ),
    ],
    after: Annotated[Path, typer.Argument(metavar="B.json", parser=a_path, help="Fingerprint after.")],
    level: Annotated[
        float, typer.Option(metavar="P", parser=probability, help="Probability of a false alarm.")
    ] = 0.05,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", parser=a_path, help="Picture of both step and frequency responses."),
    ] = None,
    force: Replace = False,
    json: Json = False,
) -> None:
    """Tell what changed between two fingerprints of a ship, and whether it is more than chance."""
    from shipfp_rs.assessment.comparison import compare as compare_fingerprints
    from shipfp_rs.experiments.parquet import read_experiments
    from shipfp_rs.identification.estimate import decimals, rounded
    from shipfp_rs.identification.fingerprint import Fingerprint
    from shipfp_rs.support.files import ending_in, replacing

    if out is not None:
        if any(out.exists() and path.exists() and out.samefile(path) for path in (before, after)):
            raise InputError(f"{out}: is a fingerprint that is compared; choose another name")
        new_file(ending_in(out, ".png"), force=force)
    first, second = Fingerprint.load(before), Fingerprint.load(after)
    beside = [path.parent / "experiments.parquet" for path in (before, after)]
    data = [read_experiments(path) for path in beside] if all(path.is_file() for path in beside) else None
    with progress() as notify:
        notify("comparing")
        comparison = compare_fingerprints(first, second, level=level, data=data)
    if out is not None:
        from shipfp_rs.plot.comparison import draw

        labels = [path.name if before.name != after.name else str(path) for path in (before, after)]
        figure = draw(dict(zip(labels, (first, second), strict=True)))
        with replacing(out) as temporary:
            figure.savefig(temporary, format="png")
    if json:
        print_json(comparison.to_dict())
        return
    print_table(
        f"Changes from {before} to {after}",
        ["quantity", "before", "after", "change", "95 % from", "to", "change [%]", "p", "unit"],
        [
            [
                change.name,
                *(
                    rounded(figure, decimals(change.ci95[1] - change.change))
                    for figure in (change.before, change.after, change.change, *change.ci95)
                ),
                f"{change.change_pct:+.2g}",
                f"{change.p:.2g}" + (" *" if change.significant else ""),
                change.unit,
            ]
            for change in comparison.changes
        ],
    )
    print_text(*comparison.verdict, *comparison.remarks)
    if out is not None:
        print_text(f"wrote {out}")
