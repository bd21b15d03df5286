"""`shipfp compare`: significant changes between two fingerprints, or over many."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from shipfp_rs.cli.options import (
    Json,
    Replace,
    file_argument,
    file_option,
    new_file,
    number_option,
    print_results,
    print_table,
    print_text,
    probability,
    progress,
)
from shipfp_rs.errors import InputError

if TYPE_CHECKING:
    from shipfp_rs.assessment.comparison import Comparison


def compare(
    before: Annotated[Path, file_argument("A.json", "Fingerprint before, as `shipfp run` writes it.")],
    after: Annotated[Path, file_argument("B.json", "Fingerprint after.")],
    level: Annotated[float, number_option("P", "Probability of a false alarm.", probability)] = 0.05,
    out: Annotated[
        Path | None, file_option("FILE.png", "Picture of both step and frequency responses.")
    ] = None,
    force: Replace = False,
    json: Json = False,
) -> None:
    """Compare two fingerprints of a ship: what changed, and whether it is more than chance."""
    from shipfp_rs.assessment.comparison import compare as compare_fingerprints
    from shipfp_rs.experiments.parquet import read_experiments
    from shipfp_rs.identification.fingerprint import Fingerprint
    from shipfp_rs.support.files import ending_in, replacing

    if out is not None:
        if any(out.exists() and path.exists() and out.samefile(path) for path in (before, after)):
            raise InputError(f"{out}: is a fingerprint that is compared; choose another name")
        new_file(ending_in(out, ".png"), force=force)
    first, second = Fingerprint.load(before), Fingerprint.load(after)
    beside = [path.parent / "experiments.parquet" for path in (before, after)]
    data = [read_experiments(path) if path.is_file() else () for path in beside]
    with progress() as notify:
        notify("comparing")
        comparison = compare_fingerprints(first, second, level=level, data=data)
    if out is not None:
        from shipfp_rs.plot.estimates import draw

        labels = [path.name if before.name != after.name else str(path) for path in (before, after)]
        figure = draw(dict(zip(labels, (first, second), strict=True)))
        with replacing(out) as temporary:
            figure.savefig(temporary, format="png")
    title = f"Changes from {before} to {after}"
    print_results(comparison.to_dict(), lambda: _print(title, comparison), out, json=json)


def _print(title: str, comparison: Comparison) -> None:
    from shipfp_rs.identification.estimate import decimals, rounded
    from shipfp_rs.support.units import unit_shown

    print_table(
        title,
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
                unit_shown(change.unit) or "-",
            ]
            for change in comparison.changes
        ],
    )
    print_text(*comparison.verdict, *comparison.remarks)
