"""Distribution of a sweep's tasks to workers. Lost workers, and draws that end their worker's process, are tolerated."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait

import pyarrow as pa

from shipfp_rs.support.threads import one_blas_thread
from shipfp_rs.sweeps.draw import lost_row, run_draws
from shipfp_rs.sweeps.plan import Plan
from shipfp_rs.sweeps.pools import AHEAD, Pool
from shipfp_rs.sweeps.store import Store

ATTEMPTS = 3
"""Number of workers that a draw may kill, when run alone, before it is recorded as failed."""


def run_task(plan: Plan, indices: Sequence[int]) -> pa.RecordBatch:
    """Compute some draws in the current process."""
    with one_blas_thread():
        return run_draws(plan, indices)


def run_parts(plan: Plan, store: Store, pool: Pool, arrived: Callable[[pa.RecordBatch], None]) -> None:
    """Run every missing part and store its rows."""
    waiting = store.to_do()
    again: deque[int] = deque()
    losses: Counter[int] = Counter()
    running: dict[Future[pa.RecordBatch], int] = {}

    def is_lost(future: Future[pa.RecordBatch]) -> bool:
        return isinstance(future.exception(), pool.lost)

    while True:
        # Submit only as many parts as the workers need, since submitted parts stay in memory until they are written.
        while len(running) < AHEAD * pool.workers():
            part = again.popleft() if again else next(waiting, None)
            if part is None:
                break
            running[pool.submit(run_task, plan, store.draws_of(part))] = part
        if not running:
            return
        back = wait(running, return_when=FIRST_COMPLETED).done
        if any(map(is_lost, back)):
            pool.renew()
            # If one process of a pool ends, all end, so the other running tasks are lost as well.
            back = {future for future in running if future.done()}
        for future in sorted(back, key=lambda one: running[one]):
            part = running.pop(future)
            if is_lost(future):
                losses[part] += 1
                if losses[part] < 2:
                    again.append(part)
                    continue
                # If a part lost its worker twice, each draw is computed alone, to find the draw that kills the worker.
                alone = [_alone(plan, pool, index) for index in store.draws_of(part)]
                rows = pa.Table.from_batches(alone).combine_chunks().to_batches()[0]
            else:
                rows = future.result()
            store.add(part, rows)
            arrived(rows)


def _alone(plan: Plan, pool: Pool, index: int) -> pa.RecordBatch:
    for _ in range(ATTEMPTS):
        try:
            return pool.submit(run_task, plan, [index]).result()
        except pool.lost:
            pool.renew()
    return lost_row(plan, index, f"the process that ran it ended {ATTEMPTS} times")
