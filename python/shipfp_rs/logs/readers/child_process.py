"""Child processes that open files for their parent process and end with the parent.

On damaged files, the native code of third-party readers may crash, loop forever or request any amount of memory. In a
child process, such a failure becomes an error message and does not end the user's session.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib.util
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import Samples
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
        # One thread, since the buffers of more threads would count as used memory.
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
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

    def ask(self, request: dict[str, Any], limit_s: float) -> Any:
        """Send a request and return the answer; raises TimeoutError, EOFError or OSError if the child hangs or ends."""
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

    def _exchange(self, request: dict[str, Any]) -> Any:
        requests, answers = self._process.stdin, self._process.stdout
        if requests is None or answers is None or requests.closed:
            raise EOFError("it was ended")
        try:
            pickle.dump(request, requests)
            requests.flush()
            answer, self._grown = pickle.load(answers)
        except (EOFError, BrokenPipeError, pickle.UnpicklingError):
            raise EOFError(_ending(self._process.wait())) from None
        return answer

    def end(self) -> None:
        """End the process, even if it is busy."""
        if self._owner == os.getpid():
            self._process.kill()
            self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


def _ending(status: int) -> str:
    if status >= 0:
        return f"exit status {status}"
    try:
        return signal.Signals(-status).name
    except ValueError:
        return f"signal {-status}"


LOCK = threading.RLock()
_idle: list[Child] = []
"""The idle child process, kept for the next file; at most one."""


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
"""Longest wait for a child's answer [s]; one second is added for every 5 MB of the file."""


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
    """A file that is read by a child process; any available child can open it again."""

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
            facts, told = self._open(child)
        for note in told:
            warnings.warn(note, LogWarning, stacklevel=5)
        return Log(str(self.path), blocks=self._blocks, **facts)

    def _open(self, child: Child) -> Any:
        answer = self._ask(child, {"open": self._where})
        child.opened = self._key()
        return answer

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
                    drop, child.drop = child.drop, []
                    request = {"read": [stream, name, first, size], "start": start, "drop": drop}
                    block: Samples | None = self._ask(child, request)
                    if block is None:
                        return
                    yield block
                    start = False
            finally:
                # The stream's number is sent with the next request, since another request may be in progress.
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

    def _ask(self, child: Child, request: dict[str, Any]) -> Any:
        limit_s = LIMIT_S + self.path.stat().st_size / 5e6
        try:
            answer = child.ask(request, limit_s)
        except TimeoutError:
            raise InputError(f"{self.path}: not read within {limit_s:.0f} s; is the file damaged?") from None
        except (OSError, EOFError) as error:
            raise InputError(
                f"{self.path}: the package {self._package} crashes on it ({error}); is the file damaged or cut short?"
            ) from None
        if isinstance(answer, InputError):
            raise answer
        return answer
