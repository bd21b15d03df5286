"""Parallel jobs on threads, since kernels and readers release the interpreter's lock; BLAS is held to one thread."""

from __future__ import annotations

import contextlib
import functools
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
"""Environment of a process in which BLAS has one thread from the start."""

_own = threading.local()
"""Of a thread that runs one of several jobs: what tells it to end."""


class _Held:
    """How many callers hold BLAS to one thread; the first one sets the limit, the last one lifts it."""

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
    """Hold BLAS to one thread: a fit's matrices are small, and its sums must not depend on the number of threads.

    The limit is the process's. It lasts until the last of the threads that ask for it is through, so that none of them
    lifts it from another one.
    """
    _held.enter()
    try:
        yield
    finally:
        _held.leave()


def with_one_blas_thread(function: F) -> F:
    """Return a function during whose calls BLAS has one thread."""

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        with one_blas_thread():
            return function(*args, **kwargs)

    call.__kwdefaults__ = function.__kwdefaults__  # type: ignore[attr-defined]
    return call  # type: ignore[return-value]


def hold_blas_for_good() -> None:
    """Hold BLAS to one thread until this process ends."""
    _held.enter()


def available_workers() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def require_going() -> None:
    """Raise `CancelledError` in a job whose results nobody waits for any more."""
    stopped = getattr(_own, "stopped", None)
    if stopped is not None and stopped.is_set():
        raise CancelledError


def side_by_side(jobs: Sequence[Callable[[], T]], stopped: threading.Event) -> list[T]:
    """Run jobs on as many threads as there are processors and return their results in order.

    They begin in order: with the longest ones first no processor is left with one of them alone at the end.
    The first job in order that fails is the one whose error is raised, whichever failed first, so that a message does not
    depend on timing. `stopped` is set then, and on Ctrl-C: the jobs look at it, or call `require_going`, and end.
    """
    workers = max(min(len(jobs), available_workers()), 1)
    with ThreadPoolExecutor(workers, initializer=_begin, initargs=(stopped,)) as pool:
        futures = [pool.submit(job) for job in jobs]
        try:
            return [future.result() for future in futures]
        except BaseException:
            stopped.set()
            for future in futures:
                future.cancel()
            raise


def where_alone(jobs: Sequence[Callable[[], T]]) -> list[T]:
    """Run jobs side by side where the processors are this thread's: the main one's of a process that no other has started.

    Elsewhere, as in a job of its own, in a thread of a sweep or in a process of a pool, they run one after another: the
    others have the processors. The jobs call `require_going`.
    """
    alone = threading.current_thread() is threading.main_thread() and multiprocessing.parent_process() is None
    if alone and min(len(jobs), available_workers()) > 1:
        return side_by_side(jobs, threading.Event())
    return [job() for job in jobs]


def import_beside(*modules: str) -> None:
    """Import modules on a thread, while this one computes outside the interpreter; whoever needs them later waits less."""

    def load() -> None:
        with contextlib.suppress(Exception):  # the one who needs it is told
            for module in modules:
                importlib.import_module(module)

    threading.Thread(target=load).start()


def _begin(stopped: threading.Event) -> None:
    _own.stopped = stopped
