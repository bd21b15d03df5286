"""Child processes that open files for their parent and end with it."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from typing import IO, Any

import numpy as np

from shipfp_rs.logs.channel import Samples

TIRED_BYTES = 100_000_000
"""Memory growth above which a child gets no further file."""

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
        }  # buffers of each thread would count as used memory
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
        self._streams = 0
        self._grown = 0
        self.lock = threading.RLock()

    def usable(self) -> bool:
        """Whether the process is alive and was started by this process, not by one that forked it."""
        return self._owner == os.getpid() and self._process.poll() is None

    def fresh(self) -> bool:
        """Whether the process may get another file."""
        return self.usable() and self._grown < TIRED_BYTES

    def next_stream(self) -> int:
        """Number of the next stream of samples."""
        self._streams += 1
        return self._streams

    def dropped(self) -> list[int]:
        """Numbers of streams no longer read; each is returned only once."""
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
    """A child process for the next file."""
    while _idle:
        child = _idle.pop()
        if child.fresh():
            return child
        child.end()
    return Child()


def give_back(child: Child) -> None:
    """Keep a child for the next file, or end it."""
    if child.fresh() and not _idle:
        _idle.append(child)
    else:
        child.end()


def idle_process() -> int | None:
    """Process that would get the next file; None if one has to be started."""
    return _idle[-1].pid if _idle else None


@atexit.register
def end_idle() -> None:
    """End the idle child."""
    while _idle:
        _idle.pop().end()
