"""Where draws run: threads, processes, a Dask cluster, or any executor that the user has."""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Literal, Protocol

from shipfp_rs.errors import InputError
from shipfp_rs.support.threads import available_workers
from shipfp_rs.sweeps.time_limit import raise_in
from shipfp_rs.sweeps.worker import begin_process

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


class Pool(Protocol):
    """An executor, how many workers it has, and what it raises when one of these is gone."""

    lost: tuple[type[BaseException], ...]

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Hand out a task."""

    @property
    def workers(self) -> int:
        """Number of workers at present."""

    def renew(self) -> None:
        """Make good for a lost worker."""


class Given:
    """An executor that is not ours to make or to end."""

    lost: tuple[type[BaseException], ...] = ()

    def __init__(self, executor: Executor, workers: int) -> None:
        self.executor, self.workers = executor, workers

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Hand out a task."""
        return self.executor.submit(work, *arguments)

    def renew(self) -> None:
        """Nothing to make good."""


class Processes:
    """Processes of this machine; when one is killed the others go down with it, and new ones are started."""

    lost: tuple[type[BaseException], ...] = (BrokenProcessPool,)

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._executor = self._new()

    def _new(self) -> ProcessPoolExecutor:
        # Spawned: a fork would copy a process that has threads, and locks that are held.
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.workers, mp_context=context, initializer=begin_process)

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Hand out a task. If the pool turns out to be broken, the task fails as if its worker had died."""
        try:
            return self._executor.submit(work, *arguments)
        except BrokenProcessPool as error:
            failed: Future[Any] = Future()
            failed.set_exception(error)
            return failed

    def renew(self) -> None:
        """Start new processes."""
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._executor = self._new()

    def close(self) -> None:
        """End the processes once what runs has run."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    def kill(self) -> None:
        """End the processes at once; what they were at is done anew when the sweep is gone on with."""
        processes = [*(self._executor._processes or {}).values()]
        self._executor.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()
        # They are gone, so this takes no time; it gives their queues and semaphores back.
        self._executor.shutdown(wait=True)


class Cluster:
    """A Dask cluster; its scheduler hands a lost worker's tasks to others, and gives up on one that kills several."""

    def __init__(self, client: Any) -> None:
        from distributed.scheduler import KilledWorker

        self.lost: tuple[type[BaseException], ...] = (KilledWorker,)
        self._client = client
        self._executor = client.get_executor(pure=False)

    @property
    def workers(self) -> int:
        """Threads of all workers that the scheduler knows at present, at least one."""
        return max(int(sum(self._client.nthreads().values())), 1)

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Hand out a task."""
        future: Future[Any] = self._executor.submit(work, *arguments)
        return future

    def renew(self) -> None:
        """Nothing to do: nannies start workers anew, and the scheduler takes any that comes."""


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
        yield Given(executor, workers or int(getattr(executor, "_max_workers", count)))
    elif executor == "threads":
        with ThreadPoolExecutor(count) as threads:
            try:
                yield Given(threads, count)
            except BaseException:
                threads.shutdown(wait=False, cancel_futures=True)
                for thread in threads._threads:
                    if thread.ident is not None:
                        raise_in(thread.ident, Stopped)
                raise
    elif executor == "processes":
        processes = Processes(count)
        try:
            yield processes
        except BaseException:
            processes.kill()
            raise
        processes.close()
    elif executor == "dask":
        with _client(address, count) as client:
            yield Cluster(client)
    else:
        raise InputError(f"executor {executor!r}, expected 'processes', 'threads', 'dask' or an Executor")


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
