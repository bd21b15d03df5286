"""`shipfp check`: a dry run of a trial."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shipfp_rs.cli.options import Json, TrialFile
from shipfp_rs.cli.output import print_estimates, print_results, print_table, print_text, progress

if TYPE_CHECKING:
    from shipfp_rs.runs.dry_run import Check


def check(trial: TrialFile, json: Json = False) -> None:
    """Read a trial as a run would and stop before the fit: what was read, what would be fitted, what is missing."""
    from shipfp_rs.runs.dry_run import check as dry_run

    with progress() as notify:
        found = dry_run(trial, notify=notify)
    print_results(found.to_dict(), lambda: _print(found), json=json)


def _print(found: Check) -> None:
    print_table(
        f"Channels of {found.trial}, {found.vessel}",
        ["column", "read as", "unit", "rate [Hz]", "samples"],
        [[c["column"], c["what"], c["unit"], f"{c['rate_hz']:g}", f"{c['samples']}"] for c in found.channels],
    )
    print_table(
        "Windows",
        ["window", "kind", "start [s]", "stop [s]", "usable", "faults"],
        [
            [
                window["name"],
                window["kind"],
                f"{window['start_s']:g}",
                f"{window['stop_s']:g}",
                ", ".join(f"{name} {share:.1%}" for name, share in window["usable"].items()),
                ", ".join(f"{count} {kind}" for kind, count in window["faults"].items()) or "none",
            ]
            for window in found.windows
        ],
    )
    point = ", ".join(f"{name} {value:.5g}" for name, value in found.operating_point.items())
    print_text(f"Operating point: {point}.")
    print_text(f"Would be fitted: {found.structure}, outputs {', '.join(found.outputs)}.")
    if found.tried:
        print_text(f"Would be tried beside it: {', '.join(found.tried)}.")
    told = {**found.expected.parameters, **found.expected.derived}
    print_estimates("What the data are expected to determine, at a first look", told)
    print_text(*(f"{name}: {one.reason}." for name, one in told.items() if one.status == "unidentifiable"))
    if found.missing:
        print_text("Missing:", *(f"- {line}" for line in found.missing))
    else:
        print_text("Nothing is missing.")
