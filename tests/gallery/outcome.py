"""What became of an input: its status, its lines, how long it took, and what of the contract it broke."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import signal
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from shipfp_rs import cli
from tests.gallery.inputs import Input

SLOW_S = 10.0
WORDS = re.compile(
    r"Error\b|after validation|NoneType|numpy|pydantic|Traceback|<class|__|object has no|\bfloat64\b|_pct\b|"
    r"argument must|got an unexpected"
)
"""Words of the code in a line that is for the user."""
KEPT = ("log.parquet", "TRIAL.toml", "SWEEP.toml", "vessel.toml", "fingerprint.json")


@dataclass(frozen=True)
class Outcome:
    """Of one input."""

    status: int | None
    """None: it raised."""
    line: str
    took_s: float

    @property
    def broken(self) -> list[str]:
        """What of the contract it broke."""
        found = []
        if self.status is None:
            found.append("panic" if "Panic" in self.line else "exception")
        elif self.status not in (0, 2):
            found.append(f"status {self.status}")
        if "Traceback" in self.line:
            found.append("traceback")
        if self.took_s > SLOW_S:
            found.append("slow")
        if self.status == 2:
            errors = [line for line in self.line.splitlines() if "warning:" not in line]
            if len(errors) != 1 or len(errors[0]) > 2000:
                found.append("not one line")
            elif WORDS.search(errors[0].replace("KeyError: ", "")):
                found.append("words of the code")
        return found


class Late(BaseException):
    """An input takes far too long."""


@contextlib.contextmanager
def _limit(seconds: float) -> Iterator[None]:
    def late(*_: object) -> None:
        raise Late

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def outcome(given: Input, folder: Path, limit_s: float = 120.0) -> Outcome:
    """Run an input in a folder that `prepare` has filled, and clean up after it."""
    for name, text in given.files.items():
        (folder / name).write_bytes(text.encode("utf-8", "surrogatepass"))
    said, here = io.StringIO(), Path.cwd()
    status: int | None = None
    began = time.process_time()  # what else the machine does is no fault of the input
    os.chdir(folder)
    try:
        with (
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(said),
            warnings.catch_warnings(),
            _limit(limit_s),
        ):
            # As in a process of its own: a warning is a line, and no error.
            warnings.simplefilter("default")
            status = cli.main(list(given.arguments))
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        said.write(f"{type(error).__name__}: {error}")
    finally:
        os.chdir(here)
        took_s = time.process_time() - began
        for path in folder.iterdir():
            if path.name not in KEPT:
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    return Outcome(status, said.getvalue(), took_s)
