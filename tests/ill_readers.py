"""Readers with the faults of third-party packages, for `test_isolation`; each runs in a child process."""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from shipfp_rs.errors import LogWarning
from shipfp_rs.logs.channel import Channel, Samples
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.child_process import in_child

SAMPLES = 1000


def act(what: str) -> None:
    match what:
        case "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "exit":
            os._exit(3)
        case "hang":
            time.sleep(600)
        case "devour":
            held = [np.ones(10_000_000) for _ in range(100)]
            raise AssertionError(len(held))
        case "print":
            print("the package talks")
            os.write(1, b"and its library, too\n")
        case "raise":
            raise KeyError("two\nlines")
        case "warn":
            warnings.warn("one channel is left out", LogWarning, stacklevel=1)
            warnings.warn("an old function", DeprecationWarning, stacklevel=1)


@register_reader(".ill")
@in_child("json", extra="ill")
def open_ill(path: Path, rate_hz: float | None) -> Log:
    """Do what the file's first word says on opening, what its second says while a channel is read."""
    on_open, on_read = path.read_text().split()
    act(on_open)

    def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
        for start in range(first, SAMPLES, size):
            if start > SAMPLES // 2:
                act(on_read)
            yield np.arange(start, min(start + size, SAMPLES), dtype=np.int32)

    return Log(
        str(path), [Channel(name, "V", 10.0, SAMPLES) for name in ("a", "b", str(os.getpid()))], blocks
    )


@register_reader(".lacking")
@in_child("a_package_that_nobody_has", extra="lacking")
def open_lacking(path: Path, rate_hz: float | None) -> Log:
    sys.exit("never called")
