"""Inputs of the gallery, five hundred at night: every one is status 0 or 2, in one line, without a word of the code."""

from __future__ import annotations

import contextlib
import io
import itertools
import os
import re
import shutil
import signal
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest

from shipfp_rs import cli
from shipfp_rs.errors import InternalError, ShipfpError
from shipfp_rs.support.arguments import _hints
from tests.damage import peak, start_peak
from tests.gallery.calls import Call, table
from tests.gallery.inputs import KEPT, Input, inputs

MOST_MIB = 1024.0
WORDS = re.compile(
    r"Error\b|after validation|NoneType|numpy|pydantic|Traceback|<class|__|object has no|\bfloat64\b|_pct\b|"
    r"argument must|got an unexpected"
)
"""Words of the code in a line that is for the user."""
PYTHON_WORDS = re.compile(r"after validation|pydantic|Traceback|<class|object has no|ufunc|\n")
"""Those in a line for who calls from Python."""


@dataclass(frozen=True)
class Outcome:
    """Of one input."""

    status: int | None
    """None: it raised."""
    line: str
    peak_mib: float
    """Most memory that the process took meanwhile beyond what it had; 0 where the system does not tell."""
    left: tuple[str, ...]
    """Files that were not there before."""
    changed: tuple[str, ...]
    """Inputs that are not what they were."""
    python: bool = False

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
        if self.peak_mib > MOST_MIB:
            found.append("memory")
        # A sweep keeps the draws that are done, so that the next one goes on from them.
        if self.status != 0 and set(self.left) - {"out/manifest.json"} and "draws" not in self.line:
            found.append("half written")
        # Who calls `save` with the name of a file wants it replaced.
        if (self.changed and not self.python) or any(
            "/." in f"/{name}" and not name.endswith("/.lock") for name in self.left
        ):
            found.append("input changed" if self.changed else "temporary file")
        if self.status == 2:
            errors = [line for line in self.line.splitlines() if "warning:" not in line]
            if len(errors) != 1 or len(errors[0]) > 2000:
                found.append("not one line")
            elif (PYTHON_WORDS if self.python else WORDS).search(_without_keys(errors[0])):
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


def outcome(given: Input | Call, folder: Path, limit_s: float = 600.0) -> Outcome:
    """Run an input in a folder that `prepare` has filled, and clean up after it."""
    files = given.files if isinstance(given, Input) else {}
    for name, text in files.items():
        (folder / name).write_bytes(text.encode("utf-8", "surrogatepass"))
    before = _files(folder)
    said, here = io.StringIO(), Path.cwd()
    status: int | None = None
    had = start_peak(os.getpid())
    os.chdir(folder)
    try:
        with (
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(said),
            warnings.catch_warnings(),
            _limit(limit_s),
        ):
            # As in a process of its own: a warning is a line, and no error.
            warnings.simplefilter("default" if isinstance(given, Input) else "ignore")
            status = cli.main(list(given.arguments)) if isinstance(given, Input) else _called(given, said)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        said.write(f"{type(error).__name__}: {error}")
    finally:
        os.chdir(here)
        peak_mib = (peak(os.getpid()) - had) / 2**20
    after = _files(folder)
    for path in folder.iterdir():
        if path.name not in KEPT:
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    left = tuple(sorted(set(after) - set(before)))
    changed = tuple(name for name in before if after.get(name) != before[name])
    for name in changed:
        if name in KEPT:
            (folder / name).write_bytes(before[name])
    return Outcome(status, said.getvalue(), peak_mib, left, changed, isinstance(given, Call))


def _called(given: Call, said: io.StringIO) -> int:
    try:
        found = given.function(**given.arguments)
        # What is computed as it is asked for is asked for, and what is returned can be shown.
        repr(list(itertools.islice(found, 100)) if isinstance(found, Iterator) else found)
    except ShipfpError as error:
        if isinstance(error, InternalError):
            raise
        said.write(f"{error}\n")
        return 2
    return 0


def _without_keys(line: str) -> str:
    """Return an error without what stands in the user's own file: a key of a fingerprint, a file's missing key."""
    return re.sub(r"KeyError: |\b(fit|adequate|versions|settings)(\.\w+|\['\w+'\])+", "", line)


def _files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.is_symlink()
    }


COUNT = 500


@pytest.mark.parametrize(
    ("seed", "count"), [(0, 30), *(pytest.param(one, COUNT // 5, marks=pytest.mark.slow) for one in range(5))]
)
def test_breakage_d_slips_of_any_kind_cost_one_line(folder, seed, count):
    for given in inputs(folder, count, seed):
        found = outcome(given, folder)
        assert not found.broken, (given, found)


def test_inputs_without_a_slip_pass(folder):
    kept = [given for given in inputs(folder, 600, 0) if given.about == "nothing"]
    assert kept
    assert all(outcome(given, folder).status == 0 for given in kept[:2])


def test_breakage_d_a_word_that_is_none_of_those_known_is_refused(folder):
    tried = []
    for name, (function, arguments) in table(folder).items():
        hints = _hints(getattr(function, "__wrapped__", function))
        for key in [key for key, hint in hints.items() if key != "return" and _has_words(hint)]:
            given: list[Any] = ["auto", ""]
            if get_origin(hints[key]) is not Literal:
                given += [["auto"]]
            for value in given:
                call = Call(name, function, {**arguments, key: value}, f"{key} = {value!r}")
                found = outcome(call, folder)
                assert found.status == 2, (call, found)
            tried.append((name, key))
    assert {("Experiment", "hold"), ("identify, chosen", "noise"), ("chirp", "law")} <= set(tried)


def _has_words(hint: Any) -> bool:
    return get_origin(hint) is Literal or any(_has_words(inner) for inner in get_args(hint))
