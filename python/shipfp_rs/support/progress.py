"""Progress of long computations, sent to a listener in a context variable instead of an argument."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar

Listener = Callable[[str, float], None]
"""Listener: a function of the current activity and the completed fraction of all work, 0 to 1."""

_LISTENER: ContextVar[Listener | None] = ContextVar("progress", default=None)


def tell(what: str, share: float) -> None:
    """Report the current activity and the completed fraction of the current part; ignored without a listener."""
    if (listener := _LISTENER.get()) is not None:
        listener(what, share)


@contextlib.contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Send all reports of progress (`tell`) within the block to a listener, in the same thread.

    Examples
    --------
    >>> with heard_by(lambda what, share: print(what, share)), part(0.5, 1.0):
    ...     tell("intervals", 0.5)
    intervals 0.75
    """
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


@contextlib.contextmanager
def part(first: float, last: float) -> Iterator[None]:
    """Map progress reported within the block, 0 to 1, to the fractions `first` to `last` of the whole work."""
    outer = _LISTENER.get()
    if outer is None:
        yield
        return
    with heard_by(lambda what, share: outer(what, first + share * (last - first))):
        yield


def counted(what: str, steps: int) -> Callable[[], None]:
    """Return a function that threads call after each step, and that reports to the caller's listener."""
    listener, lock, done = _LISTENER.get(), threading.Lock(), 0

    def step() -> None:
        nonlocal done
        if listener is not None:
            with lock:
                done += 1
                listener(what, done / steps)

    tell(what, 0.0)
    return step


@contextlib.contextmanager
def on_a_line() -> Iterator[None]:
    """Show the reports within the block on one line of the terminal or notebook, unless there is a listener already."""
    stream = sys.stderr
    read = stream is not None and (stream.isatty() or type(stream).__module__.startswith("ipykernel"))
    if not read or _LISTENER.get() is not None:
        yield
        return
    first: tuple[float, float] | None = None

    def write(what: str, share: float) -> None:
        nonlocal first
        now = time.monotonic()
        since, done = first = first or (now, share)
        left = f", about {(now - since) * (1.0 - share) / (share - done):.0f} s left" if share > done else ""
        stream.write(f"\r{100.0 * share:.0f} %: {what}{left}".ljust(80))
        stream.flush()

    with heard_by(write):
        try:
            yield
        finally:
            if first is not None:
                stream.write("\n")
