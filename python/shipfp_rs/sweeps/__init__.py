"""Monte Carlo sweeps: many simulated trials ("draws") are identified in parallel, resumably; each gives a table row."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa

from shipfp_rs.errors import InputError, ShipfpError
from shipfp_rs.support.arguments import Count, Positive, accuracy, checked
from shipfp_rs.support.files import json_text, write_text_atomically
from shipfp_rs.support.progress import on_a_line
from shipfp_rs.support.progress import tell as report
from shipfp_rs.support.threads import one_blas_thread
from shipfp_rs.sweeps.analysis import ACCURACY_PCT, summarise
from shipfp_rs.sweeps.dispatch import run_parts
from shipfp_rs.sweeps.draw import schema_of
from shipfp_rs.sweeps.plan import Plan
from shipfp_rs.sweeps.pools import MOST_WORKERS, Where, check_pool, pool_of
from shipfp_rs.sweeps.store import SUMMARY, Store, joined, opened, share_of

__all__ = ["DRAWS_PER_TASK", "Plan", "Progress", "Sweep", "Where", "sweep"]

DRAWS_PER_TASK = 50
"""Draws per task of a large sweep. A small sweep is divided into at least `SHARES` tasks, so that all workers are busy."""
SHARES = 40
MOST_ROWS = 8
"""Largest number of parameters in the printed summary of a sweep."""


@dataclass(frozen=True)
class Progress:
    """Progress of a sweep or a part of it: draws done, draws done by this run, all draws, and failed draws."""

    done: int
    made: int
    draws: int
    failed: int


@dataclass(frozen=True, repr=False)
class Sweep:
    """Folder of a sweep and its results."""

    folder: Path
    plan: Plan
    summary: dict[str, Any]

    def __repr__(self) -> str:
        """Show draws, and errors relative to the truth, in at most ten lines; `summary` and `table` have all results."""
        counts = ", ".join(
            f"{count} {what.replace('_', ' ')}" for what, count in self.summary["draws"].items()
        )
        lines = [f"Sweep {self.summary['name']!r} in {self.folder}: {counts}"]
        lines.append(f"{'':12}{'bias':>10}{'spread':>10}{'95 % below':>12}{'coverage':>10}")
        rows = list(self.summary["parameters"].items())
        shown = rows if len(rows) <= MOST_ROWS else rows[: MOST_ROWS - 1]
        for name, row in shown:
            figures = (row[key] for key in ("bias", "spread", "error_95", "coverage"))
            told = ["-" if figure is None else f"{100.0 * figure:.3g} %" for figure in figures]
            lines.append(f"{name:12}{told[0]:>10}{told[1]:>10}{told[2]:>12}{told[3]:>10}")
        if len(shown) < len(rows):
            lines.append(f"... {len(rows) - len(shown)} more in summary")
        return "\n".join(lines)

    def batches(self, columns: list[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the rows in batches, for sweeps larger than memory."""
        from pyarrow.parquet import ParquetFile

        with ParquetFile(self.folder / "results.parquet") as file:
            yield from file.iter_batches(columns=columns)

    def table(self, columns: list[str] | None = None) -> pa.Table:
        """Table of rows, one per draw."""
        return pa.Table.from_batches(list(self.batches(columns)))


@checked
def sweep(
    plan: Plan | str | Path,
    out: str | Path,
    *,
    executor: Literal["processes", "threads", "dask"] | Executor = "processes",
    workers: int | None = None,
    address: str | None = None,
    draws_per_task: Count | None = None,
    part: str | None = None,
    merge: Sequence[str | Path] | None = None,
    accuracy_pct: Positive = ACCURACY_PCT,
    progress: Callable[[Progress], None] | None = None,
) -> Sweep:
    """Simulate and identify many trials; a repeated call resumes a sweep that was stopped or killed.

    Parameters
    ----------
    plan
        A plan, the path of a SWEEP.toml, or the name of a built-in study such as "duration".
    out
        Folder of `results.parquet` (one row per draw) and `summary.json`; an earlier run with the same plan is resumed.
    executor
        "processes" on this machine; "threads", which share one interpreter and so use little more than one core; "dask"
        for a Dask cluster; or any `concurrent.futures` executor.
    workers
        Number of workers; None: one per core. For an executor object, the number of its workers.
    address
        Address of a running Dask scheduler; None: a new cluster on this machine's loopback interface.
    draws_per_task
        Draws that a worker computes and saves as one task; a resumed sweep keeps its original number. None: 50, or
        fewer in a small sweep.
    part
        Part of the draws to compute: "3/20" is the third of twenty parts; None: all draws.
    merge
        Folders of all parts, which are joined in `out`, bitwise as from a single run; nothing is computed.
    accuracy_pct
        Relative error [%] for which the summary gives the necessary trial length.
    progress
        Function called at the start and after every task. None: a line on the terminal or in the notebook.

    Returns
    -------
    Sweep

    Raises
    ------
    InputError
        If the plan or the part is invalid, the folder contains other files, or the parts to merge are incomplete.
    ShipfpError
        If the executor or the cluster is lost; completed draws are kept.

    Notes
    -----
    Every draw depends only on the plan and its index, so `results.parquet` is bitwise identical for any executor, number
    of workers, draws per task, and number of interruptions; on other processors the last bits may differ. With a time
    limit, results depend on the machine.

    Examples
    --------
    >>> if __name__ == "__main__":  # processes import the script that starts them  # doctest: +SKIP
    ...     result = sweep("duration", "my-sweep")
    ...     print(result.summary["draws"])
    """
    plan = plan if isinstance(plan, Plan) else Plan.load(plan)
    accuracy(accuracy_pct)
    if workers is not None and not 1 <= workers <= MOST_WORKERS:
        raise InputError(f"workers is {workers}, expected 1 to {MOST_WORKERS}")
    check_pool(executor, address)
    draws, record, schema = range(plan.draws), plan.record(), schema_of(plan)
    rows = None
    if merge is not None and part is not None:
        raise InputError(f"part: found {part!r} beside merge, expected one of them")
    if merge is not None:
        rows = joined([Path(folder) for folder in merge], Store(Path(out), record, schema, draws, 1))
    elif part is not None:
        draws = share_of(part, plan.draws)
    part_draws = draws_per_task or min(DRAWS_PER_TASK, -(-len(draws) // SHARES))
    with opened(Path(out), record, schema, draws, part_draws, part) as store:
        try:
            if not store.finished:
                if rows is None:
                    _run(plan, store, executor, workers, address, progress)
                store.finish(rows)
        finally:
            # An interrupted run also writes a summary, of the draws so far.
            summary = summarise(plan, store.batches(), accuracy_pct)
            write_text_atomically(store.folder / SUMMARY, json_text(summary))
    return Sweep(Path(out), plan, summary)


def _run(
    plan: Plan,
    store: Store,
    executor: Where | Executor,
    workers: int | None,
    address: str | None,
    progress: Callable[[Progress], None] | None,
) -> None:
    done, made, failed, draws = store.rows, 0, 0, len(store.draws)

    def tell() -> None:
        if progress is not None:
            progress(Progress(done + made, made, draws, failed))
        else:
            report(f"{done + made} of {draws} draws, {failed} failed", (done + made) / draws)

    def arrived(rows: pa.RecordBatch) -> None:
        nonlocal made, failed
        made += len(rows)
        failed += sum(status != "done" for status in rows.column("status").to_pylist())
        tell()

    try:
        with on_a_line() if progress is None else nullcontext():
            tell()
            with one_blas_thread(), pool_of(executor, workers, address) as pool:
                run_parts(plan, store, pool, arrived)
    except (BrokenExecutor, CancelledError) as error:
        raise ShipfpError(
            f"{store.folder}: the workers ended ({type(error).__name__}) after {done + made} of {draws} draws; "
            "restart the workers and run the same command to continue"
        ) from error
