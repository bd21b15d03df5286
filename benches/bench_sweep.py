"""Sweeps: what a draw costs, two cores against one, Dask against plain processes, and what millions of draws would take.

`python -m benches.bench_sweep`; all figures come from one run, and with --scaling only those of two workers against one.
Wall times count from when all processes have made a draw, so that starting them is left out, and other people's work on
the machine is in; CPU times have neither.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from threadpoolctl import threadpool_limits

from benches.timing import print_table, spread
from shipfp_rs.support.threads import available_workers
from shipfp_rs.support.toml import validated
from shipfp_rs.sweeps import Plan, Progress, sweep
from shipfp_rs.sweeps.draw import run_draws
from shipfp_rs.sweeps.pools import begin_process, pool_of
from shipfp_rs.sweeps.store import opened

DRAWS_PER_TASK = 50
FEW_DRAWS = 8
"""Draws a task where two workers are compared with one: at the end one of them waits for the other's last."""
LARGE = (10**6, 10**9)


def plan_of(draws: int, duration_s: float = 30.0) -> Plan:
    return validated(
        {
            "sweep": {"vessel": "stan-launch-804", "draws": draws},
            "factors": {"noise.level": {"low": 0.5, "high": 2.0}},
            "excitation": {"duration_s": duration_s, "start_hz": 0.1, "rate_hz": 50.0},
            "noise": {"n_e": 0.001, "M_b": 0.005},
            "identify": {"noise": "white"},
        },
        Plan,
        "bench",
    )


def timed(folder: Path, work: Callable[..., Any], *arguments: Any) -> Any:
    """Do a task and note down its CPU time under the worker's number."""
    began = time.process_time()
    result = work(*arguments)
    with (folder / str(os.getpid())).open("a") as notes:
        notes.write(f"{time.process_time() - began}\n")
    return result


class Timed(Executor):
    """An executor whose workers note down the CPU time of their tasks."""

    def __init__(self, inner: Executor, folder: Path) -> None:
        self.inner, self.folder = inner, folder

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        return self.inner.submit(timed, self.folder, work, *arguments, **options)

    def cpu(self) -> list[float]:
        """Seconds of each worker."""
        return [sum(map(float, notes.read_text().split())) for notes in self.folder.iterdir()]


class Clock:
    """Notes when draws come back."""

    def __init__(self) -> None:
        self.marks: list[tuple[float, int]] = []

    def __call__(self, state: Progress) -> None:
        self.marks.append((time.perf_counter(), state.made))

    @property
    def wall_per_draw(self) -> float:
        (began, before), (ended, after) = self.marks[0], self.marks[-1]
        return (ended - began) / (after - before)


def measure(
    plan: Plan, executor: Executor, workers: int, draws_per_task: int, folder: Path
) -> dict[str, float]:
    """Make a sweep; wall seconds a draw, CPU seconds of all workers, of the busiest one, and of the driver."""
    notes, clock = folder / "notes", Clock()
    notes.mkdir(parents=True, exist_ok=True)
    timing = Timed(executor, notes)
    driver = time.process_time()
    sweep(
        plan,
        folder / "sweep",
        executor=timing,
        workers=workers,
        draws_per_task=draws_per_task,
        progress=clock,
    )
    driver = time.process_time() - driver
    cpu = timing.cpu()
    return {"wall": clock.wall_per_draw, "cpu": sum(cpu), "longest": max(cpu), "driver": driver}


def on_processes(plan: Plan, workers: int, draws_per_task: int, folder: Path) -> dict[str, float]:
    context = multiprocessing.get_context("spawn")
    there = folder / "there"
    there.mkdir(parents=True)
    with ProcessPoolExecutor(workers, mp_context=context, initializer=begin_process) as processes:
        for waiting in [processes.submit(begin, plan, there, workers) for _ in range(workers)]:
            waiting.result()
        return measure(plan, processes, workers, draws_per_task, folder)


def begin(plan: Plan, there: Path, workers: int) -> None:
    """Make a draw, then wait until every worker has."""
    run_draws(plan, range(1))
    (there / str(os.getpid())).touch()
    while len(list(there.iterdir())) < workers:
        time.sleep(0.01)


def scaling(plan: Plan, rounds: int, folder: Path) -> float:
    """Print how two processes and two threads fare against one; return the CPU seconds of a draw."""
    found: dict[int, list[dict[str, float]]] = {1: [], 2: []}
    # Alternating, so that a busy spell of the machine strikes both.
    for round_ in range(rounds):
        for workers, runs in found.items():
            runs.append(on_processes(plan, workers, FEW_DRAWS, folder / f"{workers}-{round_}"))

    def middle(workers: int, figure: Callable[[dict[str, float]], float]) -> float:
        return statistics.median(map(figure, found[workers]))

    print_table(
        ["workers", "ms a draw, wall", "CPU of the workers", "CPU of the driver", "cores in use"],
        [
            [
                str(workers),
                f"{1e3 * middle(workers, lambda run: run['wall']):.1f}",
                f"{1e3 * middle(workers, lambda run: run['cpu'] / plan.draws):.1f}",
                f"{1e3 * middle(workers, lambda run: run['driver'] / plan.draws):.1f}",
                f"{middle(workers, lambda run: (run['cpu'] + run['driver']) / plan.draws / run['wall']):.2f}",
            ]
            for workers in found
        ],
    )
    faster = [one["wall"] / two["wall"] for one, two in zip(found[1], found[2], strict=True)]
    print(
        f"two processes over one: {spread(faster)} times faster as it was, on {available_workers()} cores with a load of "
        f"{os.getloadavg()[0]:.1f}"
    )
    # On cores of their own the busier worker sets the pace, or else all work, the driver's too, over two cores.
    ideal = [
        one["cpu"] / max(two["longest"], 0.5 * (two["cpu"] + two["driver"]))
        for one, two in zip(found[1], found[2], strict=True)
    ]
    print(f"on cores of their own: {spread(ideal)}, one worker's CPU time over the longer of two paces:")
    print("that of the busier of two, or of all work shared by two cores, the driver's counted in")
    threads, fewer = [], plan_of(plan.draws // 3)
    for round_ in range(rounds):
        one, two = (on_threads(fewer, workers, folder / f"threads-{workers}-{round_}") for workers in (1, 2))
        threads.append(one / two)
    print(f"two threads over one, in one interpreter: {spread(threads)} times faster as it was")
    return min(run["cpu"] / plan.draws for runs in found.values() for run in runs)


def on_dask(plan: Plan, draws_per_task: int, folder: Path) -> dict[str, float]:
    # The scheduler of a local cluster runs in the driver's process, so the driver's CPU time is both's.
    with pool_of("dask", 1, None) as pool:
        there = folder / "there"
        there.mkdir(parents=True)
        pool.submit(begin, plan, there, 1).result()
        return measure(plan, pool.executor, 1, draws_per_task, folder)


def on_threads(plan: Plan, workers: int, folder: Path) -> float:
    # Threads start at once, so all of it counts.
    began = time.perf_counter()
    sweep(plan, folder, executor="threads", workers=workers, draws_per_task=5)
    return (time.perf_counter() - began) / plan.draws


def rows_of_a_task(plan: Plan) -> pa.RecordBatch:
    few = pa.Table.from_batches([run_draws(plan, range(10))])
    return pa.concat_tables([few] * (DRAWS_PER_TASK // 10)).combine_chunks().to_batches()[0]


def same_rows(rows: pa.RecordBatch, _plan: Plan, _indices: range) -> pa.RecordBatch:
    """Do no work and send back as much as a task does."""
    return rows


def empty_tasks(where: Any, plan: Plan, rows: pa.RecordBatch, tasks: int) -> tuple[float, float]:
    """Wall and CPU seconds of the driver that handing out a task and taking its rows back costs."""
    with pool_of(where, 1, None) as pool:
        pool.submit(same_rows, rows, plan, range(2)).result()
        began, cpu = time.perf_counter(), time.process_time()
        waiting: list[Future[Any]] = []
        for _ in range(tasks):
            waiting.append(pool.submit(same_rows, rows, plan, range(2)))
            if len(waiting) > 1:
                waiting.pop(0).result()
        waiting.pop().result()
        return (time.perf_counter() - began) / tasks, (time.process_time() - cpu) / tasks


def bytes_of_a_draw(folder: Path) -> float:
    """Bytes in the final table, its footer left out."""
    with pq.ParquetFile(folder / "results.parquet") as file:
        group = file.metadata.row_group(0)
        size = sum(group.column(index).total_compressed_size for index in range(group.num_columns))
        return size / group.num_rows


def writing(plan: Plan, rows: pa.RecordBatch, parts: int, folder: Path) -> float:
    """CPU seconds that keeping a part costs."""
    draws = parts * DRAWS_PER_TASK
    with opened(folder, plan.record(), rows.schema, range(draws), DRAWS_PER_TASK) as store:
        began = time.process_time()
        for part in range(parts):
            store.add(part, rows)
        store.finish()
        return (time.process_time() - began) / parts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--scaling", action="store_true", help="only two workers against one")
    parser.add_argument("--quick", action="store_true", help="a few draws, just to see that it runs")
    options = parser.parse_args()
    if options.quick:
        options.draws, options.rounds = 10, 1
    plan = plan_of(options.draws)
    with tempfile.TemporaryDirectory() as name, threadpool_limits(limits=1):
        folder = Path(name)
        cost = scaling(plan, options.rounds, folder)
        if options.scaling:
            return
        plain = on_processes(plan, 1, DRAWS_PER_TASK, folder / "plain")
        dask = on_dask(plan, DRAWS_PER_TASK, folder / "dask")
        more = (dask["cpu"] + dask["driver"]) / (plain["cpu"] + plain["driver"]) - 1.0
        print(
            f"Dask over plain processes, {DRAWS_PER_TASK} draws a task: {100.0 * more:+.1f} % CPU time in all"
        )

        rows, sample = [], rows_of_a_task(plan)
        tasks = 4 if options.quick else 200
        for where in ("processes", "dask"):
            wall, cpu = empty_tasks(where, plan, sample, tasks)
            share = wall / (DRAWS_PER_TASK * cost)
            rows.append([where, f"{1e3 * wall:.2f}", f"{1e3 * cpu:.2f}", f"{100.0 * share:.2f} %"])
        print(f"\nhanding out a task, {DRAWS_PER_TASK} draws of {1e3 * cost:.1f} ms CPU each")
        print_table(["to", "ms, wall", "ms, CPU of the driver", "of the draws' time"], rows)
        per_task = float(rows[-1][2]) * 1e-3
        kept = writing(plan, sample, 10 if options.quick else 200, folder / "kept")
        bytes_per_draw = bytes_of_a_draw(folder / "1-0" / "sweep")
        print(
            f"keeping its rows: {1e3 * kept:.2f} ms CPU, {bytes_per_draw:.0f} bytes a draw in results.parquet"
        )

        print("\nwhat large sweeps take")
        print_table(
            [
                "draws",
                "core hours",
                "hours on 64 cores",
                "driver, hours",
                "GB",
                "cores one driver keeps busy",
            ],
            [
                [
                    f"{draws:.0e}",
                    f"{draws * cost / 3600.0:.3g}",
                    f"{draws * cost / 3600.0 / 64.0:.3g}",
                    f"{draws / DRAWS_PER_TASK * (per_task + kept) / 3600.0:.3g}",
                    f"{draws * bytes_per_draw / 1e9:.3g}",
                    f"{DRAWS_PER_TASK * cost / (per_task + kept):.0f}",
                ]
                for draws in LARGE
            ],
        )


if __name__ == "__main__":
    main()
