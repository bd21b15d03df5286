"""A limit of time for a piece of Python, in whatever thread or process it runs."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from typing import TypeVar

Result = TypeVar("Result")


class TimedOut(BaseException):
    """The limit was reached. Not an `Exception`: no handler on the way up may take it for a failure of its own."""


def within(limit_s: float | None, work: Callable[[], Result]) -> Result:
    """Return what `work` returns, or raise `TimedOut` in it once the limit has passed.

    It is raised between two steps of the interpreter: a kernel that runs finishes first.
    """
    if limit_s is None:
        return work()
    thread, running, lock = threading.get_ident(), True, threading.Lock()

    def stop() -> None:
        with lock:
            if running:
                raise_in(thread, TimedOut)

    timer = threading.Timer(limit_s, stop)
    timer.daemon = True
    timer.start()
    try:
        result = work()
    finally:
        timer.cancel()
        with lock:
            running = False
            # Asked for but not yet raised: the work is done, so it must not strike whatever comes next.
            raise_in(thread, None)
    return result


def raise_in(thread: int, error: type[BaseException] | None) -> None:
    """Have the interpreter raise an exception in a thread; None takes back one that waits."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(
        ctypes.c_ulong(thread), None if error is None else ctypes.py_object(error)
    )
