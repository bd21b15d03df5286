"""Where draws run: threads, processes, a Dask cluster, or any executor that the user has."""

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
from shipfp_rs.sweeps.time_limit import raise_in

Where = Literal["processes", "threads", "dask"]

AHEAD = 2
"""Tasks for each worker that are handed out at a time: one runs, one waits, so that no worker ever does."""

MOST_WORKERS = 1024
"""More than any machine has cores, and than a driver can keep at work."""

CONNECT_S = 10.0
"""How long a scheduler may take to answer."""

QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
"""Settings of our own cluster: its bookkeeping every few ms would take a tenth of a worker that runs Python all the time."""


class Stopped(BaseException):
    """Raised in a thread whose sweep has ended. Not an `Exception`: no draw may take it for a failure of its own."""


@dataclass
class Pool:
    """An executor, how many workers it has, and what it raises when one of these is gone."""

    executor: Executor
    workers: Callable[[], int]
    lost: tuple[type[BaseException], ...] = ()
    new: Callable[[], Executor] | None = None
    """Makes an executor in place of one that lost a worker and is of no more use."""

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Hand out a task. If the executor turns out to be broken, the task fails as if its worker had died."""
        try:
            return self.executor.submit(work, *arguments)
        except self.lost as error:
            failed: Future[Any] = Future()
            failed.set_exception(error)
            return failed

    def renew(self) -> None:
        """Replace the pool after a worker was lost."""
        if self.new is not None:
            self.executor.shutdown(cancel_futures=True)
            self.executor = self.new()


def begin_process() -> None:
    """Set up a process of a pool: Ctrl-C is its parent's to answer, and it ends when its parent does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        # A parent that was killed can't tell; its children would wait for work for ever.
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    hold_blas_for_good()


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def _processes(count: int) -> ProcessPoolExecutor:
    # Spawned: a fork would copy a process that has threads, and locks that are held.
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, mp_context=context, initializer=begin_process)


def _end_at_once(executor: Executor) -> None:
    """End the workers; a sweep that is continued repeats what they had not finished."""
    processes = list((getattr(executor, "_processes", None) or {}).values())
    executor.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.kill()
    for thread in getattr(executor, "_threads", ()):
        if thread.ident is not None:
            raise_in(thread.ident, Stopped)
    # Processes are gone, so this takes no time; it gives their queues and semaphores back.
    executor.shutdown()


def check_pool(executor: Where | Executor, address: str | None) -> None:
    """Check that there can be such a pool, before anything is written.

    Raises
    ------
    InputError
        Where an address is given without executor "dask", Dask's packages are not installed, or no scheduler answers.
    """
    if address is not None and executor != "dask":
        raise InputError(f"address {address!r}: expected executor 'dask' with it")
    if executor == "dask":
        _dask()
        if address is not None:
            with _client(address, 1):
                pass


@contextlib.contextmanager
def pool_of(executor: Where | Executor, workers: int | None, address: str | None) -> Iterator[Pool]:
    """Give a pool and end it afterwards, a given executor excepted.

    Raises
    ------
    InputError
        Where there is no such pool, or the packages for it are missing.
    """
    count = workers or available_workers()
    if isinstance(executor, Executor):
        there = workers or int(getattr(executor, "_max_workers", count))
        yield Pool(executor, lambda: there)
    elif executor == "dask":
        with _client(address, count) as client:
            from distributed.scheduler import KilledWorker  # an optional package

            # The scheduler hands a lost worker's tasks to others, and gives up on one that kills several.
            known = client.get_executor(pure=False)
            yield Pool(known, lambda: max(int(sum(client.nthreads().values())), 1), (KilledWorker,))
    else:
        new = functools.partial(_processes if executor == "processes" else ThreadPoolExecutor, count)
        # When a process is killed the others go down with it.
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
            raise InputError(f"{address}: no Dask scheduler answers there ({error})") from error
        with client:
            yield client
        return
    # Loopback only: nobody else on the network is meant to reach the workers.
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
