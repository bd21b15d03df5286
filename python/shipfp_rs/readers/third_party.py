"""What every reader does with the package it leans on: load it, and keep its exceptions and warnings in."""

from __future__ import annotations

import contextlib
import importlib
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from shipfp_rs.errors import InputError


def load(path: Path, module: str, extra: str) -> Any:
    """Import an optional package; `InputError` with the command that installs it where it is missing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return importlib.import_module(module)
    except (ImportError, OSError) as error:
        raise InputError(
            f"{path}: reading {path.suffix} needs an optional package ({error}); pip install 'shipfp_rs[{extra}]'"
        ) from error


@contextlib.contextmanager
def one_line_errors(path: Path) -> Iterator[None]:
    """Turn whatever a format's package raises over a file into `InputError`, and hold its warnings back."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except Exception as error:  # these packages raise anything from KeyError to MemoryError on damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: can't be read as {path.suffix}: {reason}; is the file damaged?") from error


def rehearse(path: Path, code: str) -> None:
    """Run `code` over the file, `sys.argv[1]`, in a process of its own; `InputError` where that crashes or hangs.

    For packages whose native code ends the process on damaged files. An exception there is left to the real
    reading, which words it.
    """
    limit_s = 30.0 + path.stat().st_size / 5e6
    try:
        status = subprocess.run(
            [sys.executable, "-c", code, str(path)], capture_output=True, check=False, timeout=limit_s
        ).returncode
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: not read within {limit_s:.0f} s; is the file damaged?") from None
    if status not in (0, 1):
        raise InputError(f"{path}: the package that reads {path.suffix} crashes on it; is the file damaged?")
