"""Executors of draws: threads, processes, a Dask cluster, or an executor given by the user."""

from __future__ import annotations

import contextlib
import functools
import importlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from typing import Any, Literal

from shipfp_rs.errors import InputError
from shipfp_rs.support.threads import available_workers, hold_blas_for_good
from shipfp_rs.sweeps.draw import raise_in

Where = Literal["processes", "threads", "dask"]

AHEAD = 2
"""Number of tasks submitted per worker: one runs and one waits, so that no worker is idle."""

MOST_WORKERS = 1024
"""Largest number of workers. No machine has so many cores, and one process could not supply more with tasks."""

CONNECT_S = 10.0
"""Longest wait for a scheduler's answer [s]."""

QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
"""Settings of a local cluster: Dask's default bookkeeping every few ms would take a tenth of the workers' time."""


class Stopped(BaseException):
    """The sweep of this thread has ended. Not an `Exception`, so that `except Exception` in a draw does not catch it."""


@dataclass
class Pool:
    """Executor, number of its workers, and the exceptions by which it reports a lost worker."""

    executor: Executor
    workers: Callable[[], int]
    lost: tuple[type[BaseException], ...] = ()
    new: Callable[[], Executor] | None = None
    """Creates a replacement for an executor that is unusable after losing a worker."""

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Submit a task. If the executor is broken, the task fails as if its worker had died."""
        try:
            return self.executor.submit(work, *arguments)
        except self.lost as error:
            failed: Future[Any] = Future()
            failed.set_exception(error)
            return failed

    def renew(self) -> None:
        """Replace the executor after a worker was lost."""
        if self.new is not None:
            self.executor.shutdown(cancel_futures=True)
            self.executor = self.new()


def begin_process() -> None:
    """Initialise a process of a pool: it ignores Ctrl-C, which its parent handles, and ends with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        # A killed parent can't notify its children, which would wait for work forever.
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    hold_blas_for_good()


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def _processes(count: int) -> ProcessPoolExecutor:
    # Spawned, since a fork would copy a process with threads and held locks.
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, mp_context=context, initializer=begin_process)


def _end_at_once(executor: Executor) -> None:
    """End the workers; a resumed sweep repeats unfinished draws."""
    processes = list((getattr(executor, "_processes", None) or {}).values())
    executor.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.kill()
    for thread in getattr(executor, "_threads", ()):
        if thread.ident is not None:
            raise_in(thread.ident, Stopped)
    # Free queues and semaphores; this does not wait, since the processes have ended.
    executor.shutdown()


def check_pool(executor: Where | Executor, address: str | None) -> None:
    """Check that a pool is possible, before anything is written.

    Raises
    ------
    InputError
        If an address is given without executor "dask", Dask's packages are not installed, or no scheduler answers.
    """
    if address is not None and executor != "dask":
        raise InputError(f"address {address!r}: found with executor {executor!r}, expected executor 'dask'")
    if executor == "dask":
        _dask()
        if address is not None:
            with _client(address, 1):
                pass


@contextlib.contextmanager
def pool_of(executor: Where | Executor, workers: int | None, address: str | None) -> Iterator[Pool]:
    """Yield a pool and end it afterwards, except for a given executor.

    Raises
    ------
    InputError
        If there is no such pool, or its packages are missing.
    """
    count = workers or available_workers()
    if isinstance(executor, Executor):
        there = workers or int(getattr(executor, "_max_workers", count))
        yield Pool(executor, lambda: there)
    elif executor == "dask":
        with _client(address, count) as client:
            from distributed.scheduler import KilledWorker  # an optional package

            # The scheduler reassigns a lost worker's tasks, and abandons a task that kills several workers.
            known = client.get_executor(pure=False)
            yield Pool(known, lambda: max(int(sum(client.nthreads().values())), 1), (KilledWorker,))
    else:
        new = functools.partial(_processes if executor == "processes" else ThreadPoolExecutor, count)
        # If one process of the pool is killed, all of them end.
        pool = Pool(new(), lambda: count, (BrokenProcessPool,), new)
        try:
            yield pool
        except BaseException:
            _end_at_once(pool.executor)
            raise
        pool.executor.shutdown()


def _dask() -> tuple[Any, Any]:
    try:
        return importlib.import_module("dask"), importlib.import_module("distributed")
    except ImportError as error:
        raise InputError(
            f"a Dask cluster needs an optional package ({error}); pip install 'shipfp_rs[cluster]'"
        ) from error


@contextlib.contextmanager
def _client(address: str | None, workers: int) -> Iterator[Any]:
    dask, distributed = _dask()
    if address is not None:
        try:
            client = distributed.Client(address, timeout=CONNECT_S)
        except (OSError, ValueError) as error:
            raise InputError(f"{address}: no Dask scheduler answers at this address ({error})") from error
        with client:
            yield client
        return
    # Loopback only, so that the workers are not reachable from the network.
    with (
        dask.config.set(QUIET),
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address=None,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client
