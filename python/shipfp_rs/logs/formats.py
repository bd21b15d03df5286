"""Choice of the reader by a file's suffix and first bytes, and errors of damaged files."""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from shipfp_rs.errors import InputError, LogWarning, ShipfpError
from shipfp_rs.support.files import words_of

MOST_PACKED = 10_000
"""Largest plausible number of samples per byte of a file; a compressed channel that hardly changes reaches it."""
MANY_SAMPLES = 1_000_000_000
"""A file with at most this many samples is read within seconds, however strongly it is compressed."""
TOLD: Mapping[str, Any] = words_of("log_formats")
"""Suffixes and first bytes of all formats; `data/log_formats.toml` describes its tables."""
SUFFIXES: Mapping[str, str] = TOLD["suffixes"]
MODULES = {suffix: module for module, suffixes in SUFFIXES.items() for suffix in suffixes.split()}
"""Module of `shipfp_rs.logs.readers` for each suffix, imported when such a file is first opened."""
FORMATS = [
    (re.compile(begin.encode()), name) for name, begins in TOLD["patterns"].items() for begin in begins
]
SIGNATURES = [(mark.encode("latin-1"), name) for name, marks in TOLD["signatures"].items() for mark in marks]
TEXTS = frozenset(f"{SUFFIXES['delimited']} .raw .dat .json .jsonl .xml .trc".split())
HINTS = {suffix: hint for hint, suffixes in TOLD["hints"].items() for suffix in suffixes.split()}


def of_text(suffix: str, begin: bytes) -> tuple[str, str]:
    """Module and suffix for a text file, from its first bytes where several formats share a suffix."""
    module = MODULES[suffix]
    signed = next((name for mark, name in SIGNATURES if begin.startswith(mark)), None)
    if signed is not None:
        return signed, SUFFIXES[signed].split()[0]
    found = next((name for pattern, name in FORMATS if pattern.match(begin)), None)
    if found is not None:
        return found, {"can_file": ".trc", "nmea2000": ".jsonl", "iso19848": ".json"}[found]
    is_text = not re.search(rb"[\x00-\x08\x0e-\x1f]", begin) or begin[:2] in (b"\xff\xfe", b"\xfe\xff")
    if module == "famos" and is_text and not begin.lstrip().startswith(b"|C"):
        return "delimited", ".csv"
    return module, suffix


@contextlib.contextmanager
def one_line_errors(path: Path) -> Iterator[None]:
    """Turn any exception of a format's package into `InputError`."""
    try:
        yield
    except (ShipfpError, Warning):
        raise
    except Exception as error:  # on damaged files these packages raise anything from KeyError to MemoryError
        reason = " ".join(str(error).split())[:500] or type(error).__name__
        raise InputError(
            f"{path}: can't be read as {path.suffix}: {reason}; is the file damaged or cut short?"
        ) from error


def require_file(path: Path) -> None:
    """Raise `InputError` unless the path is a file with content."""
    if not path.is_file():
        kind = "a folder" if path.is_dir() else "a pipe or a device" if path.exists() else "no such file"
        raise InputError(f"{path}: {kind}, expected a log file")
    if not path.stat().st_size:
        raise InputError(f"{path}: the file is empty, expected a log file")


def require_size(path: Path, samples: int) -> None:
    """Raise `InputError` for a file whose metadata state more samples than its bytes can hold; reading it would not end."""
    size = path.stat().st_size
    if samples > max(MOST_PACKED * size, MANY_SAMPLES):
        raise InputError(f"{path}: announces {samples:.3g} samples in {size} bytes; is the file damaged?")


def warn(path: Path | str, text: object) -> None:
    """Warn of content that a file lacks, or of an assumption about it."""
    warnings.warn(f"{path}: {text}", LogWarning, stacklevel=5)
