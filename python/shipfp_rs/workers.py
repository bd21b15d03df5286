"""Jobs that run side by side on threads: kernels and readers leave the interpreter to the others."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


def side_by_side(jobs: Sequence[Callable[[], T]], stopped: threading.Event) -> list[T]:
    """Run jobs on a thread each and return their results in order.

    The first job in order that fails is the one whose error is raised, whichever failed first, so that a message does not
    depend on timing. `stopped` is set then, and on Ctrl-C: the jobs look at it and end.
    """
    with ThreadPoolExecutor(max_workers=max(len(jobs), 1)) as pool:
        futures = [pool.submit(job) for job in jobs]
        try:
            return [future.result() for future in futures]
        except BaseException:
            stopped.set()
            for future in futures:
                future.cancel()
            raise
