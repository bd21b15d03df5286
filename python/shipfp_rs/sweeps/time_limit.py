"""Time limit for Python code, in any thread or process."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from typing import TypeVar

Result = TypeVar("Result")


class TimedOut(BaseException):
    """The limit was reached. Not an `Exception`, so that no handler catches it as its own failure."""


def within(limit_s: float | None, work: Callable[[], Result]) -> Result:
    """Return the result of `work`, or raise `TimedOut` in it after the limit.

    It is raised between two steps of the interpreter; a running kernel finishes first.
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
            # Requested but not yet raised: the work is done, so later code must not be interrupted.
            raise_in(thread, None)
    return result


def raise_in(thread: int, error: type[BaseException] | None) -> None:
    """Raise an exception in a thread; None cancels a pending one."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(
        ctypes.c_ulong(thread), None if error is None else ctypes.py_object(error)
    )
