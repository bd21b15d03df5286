"""What every process that makes draws is set up with: one thread for linear algebra, and an end with its sweep."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from multiprocessing.process import BaseProcess

from threadpoolctl import threadpool_limits

_held: list[object] = []
"""The limit that holds in this process, if one does."""


@contextlib.contextmanager
def one_thread_for_linear_algebra() -> Iterator[None]:
    """Hold BLAS to one thread in this process: matrices of a draw are small, and sums must not depend on threads."""
    with threadpool_limits(limits=1) as limit:
        _held.append(limit)
        try:
            yield
        finally:
            _held.remove(limit)


def hold_linear_algebra() -> None:
    """Do the same for good, in a process that does nothing else; nothing where it holds already."""
    if not _held:
        _held.append(threadpool_limits(limits=1))


def begin_process() -> None:
    """Set up a process of a pool: Ctrl-C is its parent's to answer, and it ends when its parent does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        # A parent that was killed can't tell; its children would wait for work for ever.
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    hold_linear_algebra()


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
