"""Background work that a page starts, polls and stops: functions on a thread, jobs in a separate process."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO, Any, Generic, TypeVar

from shipfp_rs.errors import InputError, ShipfpError
from shipfp_rs.support.arrays import attributes
from shipfp_rs.support.threads import ONE_BLAS_THREAD

T = TypeVar("T")
Progress = Callable[[float], None]


class Background(Generic[T]):
    """Result of a slow function on a thread; the function reports its completed fraction, 0 to 1."""

    def __init__(self, function: Callable[[Progress], T]) -> None:
        self._function = function
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self.progress = 0.0
        self.error: str | None = None
        self.result: T | None = None
        self.done = threading.Event()

    def begin(self) -> Background[T]:
        """Start, unless already started."""
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, daemon=True)
                self._thread.start()
        return self

    def wait(self) -> T:
        """Wait for the result; `ShipfpError` on failure."""
        self.begin().done.wait()
        if self.result is None:
            raise ShipfpError(self.error or "no result")
        return self.result

    def state(self) -> dict[str, Any]:
        """State for the page: working and progress, failed and reason, or done."""
        if not self.done.is_set():
            return {"state": "working", "progress": round(self.progress, 3)}
        return {"state": "failed", "error": self.error} if self.error is not None else {"state": "done"}

    def _run(self) -> None:
        try:
            self.result = self._function(partial(setattr, self, "progress"))
        except (ShipfpError, OSError, MemoryError) as error:
            self.error = str(error) or type(error).__name__
        except Exception as error:  # every error must reach the waiting page
            self.error = f"internal error: {type(error).__name__}: {error}"
        finally:
            self.done.set()


AT_ONCE = 2
"""Largest number of concurrent jobs; each uses all cores."""
STOP_S = 15.0
"""Time for a job's clean-up after a stop [s]."""
KEPT_LINES = 50


@dataclass
class Job:
    """One check or run; a run's results are in `folder`."""

    id: int
    kind: str
    folder: Path | None
    process: subprocess.Popen[bytes]
    began: float = field(default_factory=time.monotonic)
    state: str = "working"
    progress: str = ""
    share: float = 0.0
    """Completed fraction, which does not decrease when a part of the job is repeated."""
    error: str = ""
    done: dict[str, Any] | None = None
    warnings: list[str] = field(default_factory=list)
    ended: float | None = None

    def told(self) -> dict[str, Any]:
        """State for the page."""
        return {
            **attributes(self, "id", "kind", "state", "progress", "share", "error", "done", "warnings"),
            "seconds": round((self.ended or time.monotonic()) - self.began, 1),
        }


class Jobs:
    """All jobs of a server."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jobs: dict[int, Job] = {}

    def begin(self, kind: str, trial: Path) -> Job:
        """Start to check or run a trial; a run writes a new folder beside the trial."""
        if not trial.is_file():
            raise InputError(f"{trial.name}: no such file; save the trial first")
        with self._lock:
            if sum(job.state == "working" for job in self._jobs.values()) >= AT_ONCE:
                raise InputError(f"{AT_ONCE} jobs are under way; wait for one of them, or stop it")
            folder = self._new_folder(trial) if kind == "run" else None
            arguments = [kind, str(trial), *([str(folder)] if folder else [])]
            process = subprocess.Popen(
                [sys.executable, "-m", "shipfp_rs.view.child", *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
                env={**ONE_BLAS_THREAD, **os.environ},
            )
            job = Job(len(self._jobs), kind, folder, process)
            self._jobs[job.id] = job
        assert process.stdout is not None
        threading.Thread(target=self._listen, args=(job, process.stdout), daemon=True).start()
        return job

    def job(self, number: int) -> Job:
        """Job with this number; `InputError` if there is none."""
        if number not in self._jobs:
            raise InputError(f"job {number}: no such job")
        return self._jobs[number]

    def stop(self, number: int) -> Job:
        """Stop a job as Ctrl-C does; the job leaves no files."""
        job = self.job(number)
        if job.state == "working":
            job.state = "stopping"
            _close(job)
            threading.Thread(target=self._end, args=(job,), daemon=True).start()
        return job

    def stop_all(self) -> None:
        """Stop all jobs and wait for them to end."""
        with self._lock:
            running = [job for job in self._jobs.values() if job.process.poll() is None]
        for job in running:
            _close(job)
        for job in running:
            self._end(job)

    def _new_folder(self, trial: Path) -> Path:
        """Name of a new folder beside the trial, unused by existing folders and active jobs."""
        taken = {job.folder for job in self._jobs.values() if job.state in ("working", "stopping")}
        stem = "shipfp" if trial.stem == "TRIAL" else trial.stem
        for number in range(1, 10_000):
            folder = trial.parent / (f"{stem}-run" if number == 1 else f"{stem}-run-{number}")
            if folder not in taken and not folder.exists():
                return folder
        raise InputError(f"{trial.parent}: has thousands of runs; move some of them elsewhere")

    def _listen(self, job: Job, stream: IO[bytes]) -> None:
        for line in stream:
            with contextlib.suppress(ValueError):
                message = json.loads(line)
                job.progress = message.get("progress", job.progress)
                job.share = max(message.get("share", 0.0), job.share)
                job.error = message.get("error", job.error)
                job.done = message.get("done", job.done)
                if "warning" in message and len(job.warnings) < KEPT_LINES:
                    job.warnings.append(message["warning"])
        stream.close()
        job.process.wait()
        job.ended = time.monotonic()
        if job.done is not None:
            job.state = "done"
        elif job.error:
            job.state = "failed"
        elif job.state == "stopping":
            job.state = "stopped"
        else:
            job.state, job.error = "failed", f"the process ended with status {job.process.returncode}"
        _close(job)

    def _end(self, job: Job) -> None:
        try:
            job.process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(OSError):
                if hasattr(os, "killpg"):
                    os.killpg(job.process.pid, signal.SIGKILL)
                else:
                    job.process.kill()
            job.process.wait()
        if job.folder is not None and job.done is None:
            for left in job.folder.parent.glob(f".{job.folder.name}.*"):
                shutil.rmtree(left, ignore_errors=True)


def _close(job: Job) -> None:
    """Close the pipe to the job's process, which then stops."""
    with contextlib.suppress(OSError):
        if job.process.stdin is not None:
            job.process.stdin.close()
