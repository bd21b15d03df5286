"""Parallel jobs on threads, with BLAS limited to one thread. Kernels and readers release the GIL."""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

ONE_BLAS_THREAD: Mapping[str, str] = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
"""Environment variables for a child process in which BLAS has one thread from the start."""

_own = threading.local()
"""Thread-local storage of the event that cancels the jobs."""


class _Held:
    """Count of callers that limit BLAS to one thread; the first sets the limit, the last removes it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._callers = 0
        self._limit: threadpool_limits | None = None

    def enter(self) -> None:
        with self._lock:
            if self._callers == 0:
                self._limit = threadpool_limits(limits=1)
            self._callers += 1

    def leave(self) -> None:
        with self._lock:
            self._callers -= 1
            if self._callers == 0 and self._limit is not None:
                self._limit.restore_original_limits()
                self._limit = None


_held = _Held()


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread: the matrices of a fit are small, and results must not depend on the number of threads.

    The limit applies to the whole process, until all threads that requested it have finished.
    """
    _held.enter()
    try:
        yield
    finally:
        _held.leave()


def with_one_blas_thread(function: F) -> F:
    """Decorator that limits BLAS to one thread during each call."""
    call = one_blas_thread()(function)
    call.__kwdefaults__ = function.__kwdefaults__
    return call


def hold_blas_for_good() -> None:
    """Limit BLAS to one thread until this process ends."""
    _held.enter()


def available_workers() -> int:
    """Number of cores available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def require_going() -> None:
    """Raise `CancelledError` in a job that was cancelled."""
    stopped = getattr(_own, "stopped", None)
    if stopped is not None and stopped.is_set():
        raise CancelledError


def side_by_side(jobs: Sequence[Callable[[], T]], stopped: threading.Event) -> list[T]:
    """Run jobs on as many threads as there are processors and return their results in order.

    Jobs start in order; put the longest first to balance the load. If several jobs fail, the error of the first in
    order is raised, independent of timing. After an error or Ctrl-C, `stopped` is set: jobs check it, or call
    `require_going`, and end.
    """
    workers = max(min(len(jobs), available_workers()), 1)
    with ThreadPoolExecutor(workers, initializer=setattr, initargs=(_own, "stopped", stopped)) as pool:
        futures = [pool.submit(job) for job in jobs]
        try:
            return [future.result() for future in futures]
        except BaseException:
            stopped.set()
            for future in futures:
                future.cancel()
            raise


def where_alone(jobs: Sequence[Callable[[], T]]) -> list[T]:
    """Run jobs in parallel if called from the main thread of the main process, else one after another.

    Other threads or processes, such as those of a sweep, already share the processors. The jobs call `require_going`.
    """
    alone = threading.current_thread() is threading.main_thread() and multiprocessing.parent_process() is None
    if alone and min(len(jobs), available_workers()) > 1:
        return side_by_side(jobs, threading.Event())
    return [job() for job in jobs]


def import_beside(*modules: str) -> None:
    """Import modules in a thread while the main thread computes without the GIL; later imports are then immediate."""

    def load() -> None:
        with contextlib.suppress(Exception):  # the later import raises the error again
            for module in modules:
                importlib.import_module(module)

    threading.Thread(target=load).start()
