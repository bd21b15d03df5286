"""Progress of a long computation: reported where it runs, received by a listener that no function has to pass on."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar

Listener = Callable[[str, float], None]
"""Hears what is being done, and the share of all that is done, 0 to 1."""

_LISTENER: ContextVar[Listener | None] = ContextVar("progress", default=None)


def tell(what: str, share: float) -> None:
    """Say what is begun, and the share of the present part that is done; nothing where nobody listens."""
    if (listener := _LISTENER.get()) is not None:
        listener(what, share)


@contextlib.contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Call a function on each report of progress (`tell`) in the block, in the same thread.

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
def said_as(words: Callable[[str], str]) -> Iterator[None]:
    """Say what is reported in the block in other words."""
    outer = _LISTENER.get()
    if outer is None:
        yield
        return
    with heard_by(lambda what, share: outer(words(what), share)):
        yield


@contextlib.contextmanager
def part(first: float, last: float) -> Iterator[None]:
    """Scale progress that is reported in the block to a part of the work, from one share of it to another."""
    outer = _LISTENER.get()
    if outer is None:
        yield
        return
    with heard_by(lambda what, share: outer(what, first + share * (last - first))):
        yield


def counted(what: str, steps: int) -> Callable[[], None]:
    """Return a function that threads call after each of so many steps, which the listener of the caller hears of."""
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
    """Keep one line of the terminal or notebook at what is reported in the block, unless somebody listens already."""
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
