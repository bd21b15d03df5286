"""Jobs that run side by side on threads: kernels and readers leave the interpreter to the others."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


def available_workers() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def side_by_side(jobs: Sequence[Callable[[], T]], stopped: threading.Event) -> list[T]:
    """Run jobs on as many threads as there are processors and return their results in order.

    They begin in order: with the longest ones first no processor is left with one of them alone at the end.
    The first job in order that fails is the one whose error is raised, whichever failed first, so that a message does not
    depend on timing. `stopped` is set then, and on Ctrl-C: the jobs look at it and end.
    """
    with ThreadPoolExecutor(max_workers=max(min(len(jobs), available_workers()), 1)) as pool:
        futures = [pool.submit(job) for job in jobs]
        try:
            return [future.result() for future in futures]
        except BaseException:
            stopped.set()
            for future in futures:
                future.cancel()
            raise
