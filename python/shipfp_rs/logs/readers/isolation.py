"""Readers based on third-party packages, run in a child process.

On damaged files, the native code of these packages may crash, loop forever or request any amount of memory. In a child
process this ends in an error message, not in the loss of the session.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import warnings
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import Channel, Samples
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.log import Log, Reader
from shipfp_rs.logs.readers.child_process import LOCK, Child, give_back, take

LIMIT_S = 30.0
"""Longest wait for a child's answer, plus one second for every 5 MB of the file."""


def in_child(package: str, *, extra: str) -> Callable[[Reader], Reader]:
    """Make a reader that needs `package` run in a child process; `extra` is the extra that installs the package."""

    def decorate(reader: Reader) -> Reader:
        @functools.wraps(reader)
        def open_in_child(path: Path, rate_hz: float | None, **options: str) -> Log:
            if importlib.util.find_spec(package) is None:
                raise InputError(
                    f"{path}: reading {path.suffix} needs the optional package {package}; "
                    f"pip install 'shipfp_rs[{extra}]'"
                )
            return _Source(package, reader, path, rate_hz, options).log()

        return open_in_child

    return decorate


class _Source:
    """A file, reopened by any available child while one of its channels is being read."""

    def __init__(
        self, package: str, reader: Reader, path: Path, rate_hz: float | None, options: dict[str, str]
    ) -> None:
        self.path = path
        self._package = package
        self._options = options
        self._where = [package, reader.__module__, reader.__name__, str(path.absolute()), rate_hz, options]
        self._child: Child | None = None
        self._readers = 0

    def log(self) -> Log:
        with self._reading() as child:
            facts = self._open(child)
        try:
            channels = [Channel(**channel) for channel in facts["channels"]]
            start = datetime.fromisoformat(facts["start_utc"]) if facts["start_utc"] else None
            told = [str(note) for note in facts["warnings"]]
            notes = tuple(str(note) for note in facts["notes"])
            faults = tuple(Fault(**fault) for fault in facts["faults"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{self.path}: the package {self._package} gives answers that make no sense; is the file damaged?"
            ) from error
        for note in told:
            warnings.warn(note, LogWarning, stacklevel=5)
        return Log(str(self.path), channels, self._blocks, start, faults, notes)

    def _open(self, child: Child) -> dict[str, Any]:
        facts, _ = self._ask(child, {"open": self._where})
        child.opened = self._key()
        return facts

    def _key(self) -> tuple[Any, ...]:
        status = self.path.stat()
        return (*self._where[:-1], *self._options.items(), status.st_mtime_ns, status.st_size)

    def _blocks(self, name: str, first: int, size: int) -> Iterator[Samples]:
        with self._reading() as child:
            with child.lock:  # reopening would end the streams of the first one
                if child.opened != self._key():
                    self._open(child)
            stream, start = child.next_stream(), True
            try:
                while True:
                    request = {"read": [stream, name, first, size], "start": start, "drop": child.dropped()}
                    _, block = self._ask(child, request)
                    if block is None:
                        return
                    yield block
                    start = False
            finally:
                # Sent with the next request, since another one may be in progress.
                child.drop.append(stream)

    @contextlib.contextmanager
    def _reading(self) -> Iterator[Child]:
        with LOCK:
            if self._child is None or not self._child.usable():
                self._child, self._readers = take(), 0
            child = self._child
            self._readers += 1
        try:
            yield child
        finally:
            with LOCK:
                if child is self._child:
                    self._readers -= 1
                    if not self._readers:
                        self._child = None
                        give_back(child)
                else:
                    child.end()

    def _ask(self, child: Child, request: dict[str, Any]) -> tuple[dict[str, Any], Samples | None]:
        limit_s = LIMIT_S + self.path.stat().st_size / 5e6
        try:
            facts, block = child.ask(request, limit_s)
        except TimeoutError:
            raise InputError(f"{self.path}: not read within {limit_s:.0f} s; is the file damaged?") from None
        except (OSError, EOFError, ValueError) as error:
            raise InputError(
                f"{self.path}: the package {self._package} crashes on it ({error}); is the file damaged or cut short?"
            ) from None
        if "error" in facts:
            raise InputError(str(facts["error"]))
        return facts, block
