"""Child processes that open files for their parent process and end with the parent.

On damaged files, the native code of readers' packages may crash, loop forever or request any amount of memory. In a child
process, such a failure becomes an error message and does not end the user's session.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib.util
import json
import os
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import IO, Any

import numpy as np

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import Channel, Samples
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.log import Log, Reader

TIRED_BYTES = 100_000_000
"""Growth of a child's memory [bytes] above which the child opens no further file and is ended."""
START = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from shipfp_rs.logs.readers import child
child.serve()
"""


class Child:
    """Child process that answers requests; see `child.py`."""

    def __init__(self) -> None:
        environment = {
            **os.environ,
            "OPENBLAS_NUM_THREADS": "1",
        }  # the buffers of more threads would count as used memory
        self._process = subprocess.Popen(
            [sys.executable, "-c", START, json.dumps(sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        self.pid = self._process.pid
        self.opened: tuple[Any, ...] | None = None
        self.drop: list[int] = []
        self._owner = os.getpid()
        self.streams = 0
        self._grown = 0
        self.lock = threading.RLock()

    def usable(self) -> bool:
        """Whether the process is alive and was started by this process, not by one that forked it."""
        return self._owner == os.getpid() and self._process.poll() is None

    def fresh(self) -> bool:
        """Whether the process may get another file."""
        return self.usable() and self._grown < TIRED_BYTES

    def dropped(self) -> list[int]:
        """Return the numbers of the streams closed since the last call."""
        gone, self.drop = self.drop, []
        return gone

    def ask(self, request: dict[str, Any], limit_s: float) -> tuple[dict[str, Any], Samples | None]:
        """Send a request; return the answer's metadata and samples.

        Raises
        ------
        TimeoutError, EOFError, OSError, ValueError
            If the child hangs, ends, or gives an invalid answer; it is then ended.
        """
        with self.lock:
            late = threading.Event()

            def expire() -> None:
                late.set()
                self._process.kill()

            timer = threading.Timer(limit_s, expire)
            timer.daemon = True
            timer.start()
            try:
                return self._exchange(request)
            except BaseException:  # after an interrupted exchange the pipes are out of step
                self.end()
                if late.is_set():
                    raise TimeoutError from None
                raise
            finally:
                timer.cancel()

    def _exchange(self, request: dict[str, Any]) -> tuple[dict[str, Any], Samples | None]:
        requests, answers = self._pipes()
        try:
            requests.write(json.dumps(request).encode() + b"\n")
            requests.flush()
            line = answers.readline(1 << 26)
            if not line.endswith(b"\n"):
                raise EOFError  # noqa: TRY301  as when a read of samples ends
            facts = json.loads(line)
            if not isinstance(facts, dict):
                raise ValueError("answer without facts")  # noqa: TRY004  the child's mistake, not the caller's
            self._grown = int(facts.get("grown", self._grown))
            if "dtype" not in facts:
                return facts, None
            dtype, count = np.dtype(str(facts["dtype"])), int(facts["count"])
            if dtype.kind not in "biuf" or not 0 <= count <= request["read"][3]:
                raise ValueError(f"{count} samples of {dtype}")
            block = _receive(answers, count, dtype)
            if facts["masked"]:
                block = np.ma.MaskedArray(block, _receive(answers, count, np.dtype(bool)))
        except (EOFError, BrokenPipeError):
            raise EOFError(_ending(self._process.wait())) from None
        return facts, block

    def _pipes(self) -> tuple[IO[bytes], IO[bytes]]:
        if self._process.stdin is None or self._process.stdout is None or self._process.stdin.closed:
            raise EOFError("it was ended")
        return self._process.stdin, self._process.stdout

    def end(self) -> None:
        """End the process, even if it is busy."""
        if self._owner == os.getpid():
            self._process.kill()
            self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


def _receive(pipe: IO[bytes], count: int, dtype: np.dtype[Any]) -> Samples:
    block = np.empty(count, dtype)
    memory: Any = block.view(np.uint8)
    view = memoryview(memory)
    while len(view):
        got = pipe.readinto(view)  # type: ignore[attr-defined]
        if not got:
            raise EOFError
        view = view[got:]
    return block


def _ending(status: int) -> str:
    if status >= 0:
        return f"exit status {status}"
    try:
        return signal.Signals(-status).name
    except ValueError:
        return f"signal {-status}"


LOCK = threading.RLock()
_idle: list[Child] = []
"""At most one child, kept for the next file."""


def take() -> Child:
    """Return the idle child process or a new one."""
    while _idle:
        child = _idle.pop()
        if child.fresh():
            return child
        child.end()
    return Child()


def idle_process() -> int | None:
    """Process number of the idle child; None if there is none."""
    return _idle[-1].pid if _idle else None


@atexit.register
def end_idle() -> None:
    """End the idle child."""
    while _idle:
        _idle.pop().end()


LIMIT_S = 30.0
"""Longest wait for a child's answer [s], without the additional second for every 5 MB of the file."""


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
                f"{self.path}: the package {self._package} returned invalid metadata; is the file damaged?"
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
            with child.lock:  # opening the file again would end the streams of other threads
                if child.opened != self._key():
                    self._open(child)
            child.streams += 1
            stream, start = child.streams, True
            try:
                while True:
                    request = {"read": [stream, name, first, size], "start": start, "drop": child.dropped()}
                    _, block = self._ask(child, request)
                    if block is None:
                        return
                    yield block
                    start = False
            finally:
                # The number is sent with the next request, since another request may be in progress.
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
                        if child.fresh() and not _idle:
                            _idle.append(child)
                        else:
                            child.end()
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
