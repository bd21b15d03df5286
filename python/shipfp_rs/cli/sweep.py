"""`shipfp sweep`: many simulated trials, each identified; resumable."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from shipfp_rs.cli.options import (
    MOST_WORKERS,
    Json,
    OtherSeed,
    as_typed,
    file_option,
    number_option,
    print_results,
    print_table,
    print_text,
)
from shipfp_rs.errors import InputError

if TYPE_CHECKING:
    from shipfp_rs.sweeps import Sweep

TYPED = {
    "draws_per_task": "--draws-per-task",
    "part": "--part",
    "accuracy_pct": "--accuracy",
    "workers": "--workers",
    "address": "--address",
}
SCREEN, FRAME = 27, 5
"""Lines on a screen for all tables, and lines of a table without its rows; three further lines are always printed."""
MOST_ROWS = SCREEN - FRAME


def sweep(
    plan: Annotated[
        str, typer.Argument(metavar="SWEEP.toml", help='Description of the sweep, or a study: "duration".')
    ],
    folders: Annotated[
        list[str] | None, typer.Argument(metavar="DIR", help="With --merge: folders of all parts.")
    ] = None,
    out: Annotated[
        Path, file_option("DIR", "Folder to write; an interrupted sweep in it is gone on with.")
    ] = Path("shipfp-sweep"),
    workers: Annotated[
        int | None,
        typer.Option(min=1, max=MOST_WORKERS, help="How many work at a time; default one for each core."),
    ] = None,
    executor: Annotated[
        Literal["processes", "threads", "dask"],
        typer.Option(help="What they are: processes, threads of one process, or a Dask cluster."),
    ] = "processes",
    address: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="Dask scheduler; without one, a cluster of this machine."),
    ] = None,
    draws_per_task: Annotated[
        int | None, typer.Option(min=1, help="Draws made in one go; default 50, fewer in a small sweep.")
    ] = None,
    part: Annotated[
        str | None, typer.Option(metavar="K/N", help="Compute only the K-th of N parts of the draws.")
    ] = None,
    merge: Annotated[bool, typer.Option("--merge", help="Join the parts in these folders.")] = False,
    accuracy: Annotated[
        float, number_option("PERCENT", "Wanted relative error, %, for the length that a trial must have.")
    ] = 10.0,
    seed: OtherSeed = None,
    figures: Annotated[bool, typer.Option(help="Draw figures into DIR/figures.")] = True,
    json: Json = False,
) -> None:
    """Simulate and identify many trials; show bias, spread, coverage, failures, and the necessary length of a trial."""
    from shipfp_rs.sweeps import Plan
    from shipfp_rs.sweeps import sweep as run

    if merge != bool(folders):
        raise InputError("found one of --merge and DIR, expected both or none")

    wanted = Plan.load(plan)
    if seed is not None:
        wanted = wanted.model_copy(update={"sweep": wanted.sweep.model_copy(update={"seed": seed})})
    try:
        with as_typed(TYPED):
            result = run(
                wanted,
                out,
                executor="dask" if address is not None else executor,
                workers=workers,
                address=address,
                draws_per_task=draws_per_task,
                part=part,
                merge=folders,
                accuracy_pct=accuracy,
            )
    except KeyboardInterrupt:
        print(f"shipfp: completed draws are in {out}; the same command continues", file=sys.stderr)
        raise
    if not result.summary["draws"]["done"]:
        raise InputError(f"{plan}: none of {result.plan.draws} draws was identified, {_why(result)}")
    if figures:
        from shipfp_rs.sweeps.pictures import write_figures

        write_figures(result, out / "figures")
    content = {"folder": str(out), **result.summary}
    print_results(content, lambda: _print(result.summary), out, json=json)


def _why(result: Sweep) -> str:
    """Error of the first failed draw."""
    rows = next(result.batches(["error", "message"])).slice(0, 1).to_pylist()
    error, message = rows[0]["error"], rows[0]["message"]
    # The class name of an input error tells nothing new; that of a defect may be the only information.
    said = message if error in ("InputError", "TimedOut") else f"{error}: {message}"
    return f"the first error: {said}; the rows of all draws are in {result.folder}"


def _print(summary: Mapping[str, Any]) -> None:
    """Print the results over all draws, and as many of the further tables as fit a screen; `summary.json` has all."""
    draws = summary["draws"]
    title = (
        f"{summary['name']}: {draws['total']} draws, {draws['done']} identified, {draws['failed']} failed, "
        f"{draws['timed_out']} timed out"
    )
    head = ["parameter", "estimates", "bias", "spread", "95 % within", "coverage"]
    overall = [[name, *_figures(row)] for name, row in summary["parameters"].items()]
    shown, left = overall[:MOST_ROWS], SCREEN
    more = [f"{len(overall) - MOST_ROWS} parameters"] if len(overall) > MOST_ROWS else []
    for name, columns, rows in ((title, head, shown), *_tables(summary)):
        if len(rows) + FRAME > left:
            more.append(name[0].lower() + name[1:])
            continue
        print_table(name, columns, rows)
        left -= len(rows) + FRAME
    if summary["errors"]:
        print_text(
            "failed: " + ", ".join(f"{count} with {name}" for name, count in summary["errors"].items())
        )
    if more:
        print_text(f"in summary.json: {'; '.join(more)}")


def _tables(summary: Mapping[str, Any]) -> Iterator[tuple[str, list[str], list[list[str]]]]:
    """Yield title, head and rows of the tables of trial lengths and of each factor."""
    if summary["trial_length"]:
        wanted = f"{summary['accuracy_pct']:.3g} %"
        title = f"Shortest trial in which 95 of 100 estimates are within {wanted} of the truth"
        table = []
        for row in summary["trial_length"]:
            at = ", ".join(f"{key} {_shown(value)}" for key, value in row["factors"].items())
            table.append([row["parameter"], at, row["note"]])
        yield title, ["parameter", "at", "duration"], table
    for key, rows in summary["by_factor"].items():
        head = ["", "parameter", "draws", "failed", "bias", "spread", "95 % within", "coverage"]
        table = []
        for row in rows:
            draws = (str(row["done"] + row["failed"]), _percent(row["failure_rate"]))
            for name, figures in row["parameters"].items():
                table.append([_shown(row["factors"][key]), name, *draws, *_figures(figures)[1:]])
        yield f"by {key}", head, table


def _figures(row: Mapping[str, Any]) -> list[str]:
    shares = (row[key] for key in ("bias", "spread", "error_95", "coverage"))
    return [str(row["estimates"]), *map(_percent, shares)]


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.3g} %"


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
