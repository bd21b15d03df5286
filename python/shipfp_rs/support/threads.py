"""Jobs that run side by side on threads: kernels and readers leave the interpreter to the others."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

_own = threading.local()
"""Of a thread that runs one of several jobs: what tells it to end."""


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


def _begin(stopped: threading.Event) -> None:
    _own.stopped = stopped
