"""File formats: module by suffix or first bytes, and errors of damaged files."""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Iterator
from pathlib import Path

from shipfp_rs.errors import InputError, LogWarning, ShipfpError

MOST_PACKED = 10_000
"""Largest plausible number of samples per byte of a file, reached with compression where a channel hardly changes."""
MANY_SAMPLES = 1_000_000_000
"""Number of samples that is read within seconds, however small the file."""
SUFFIXES = {
    "parquet": ".parquet .pq",
    "arrow_ipc": ".feather .arrow .arrows",
    "delimited": ".csv .txt .tsv .tab .prn .lvm .log .asc .msl",
    "famos": ".raw .dat",
    "tdms": ".tdms",
    "dewesoft": ".d7d .dxd",
    "mdf": ".mf4 .mdf",
    "hdf5": ".h5 .hdf5",
    "matlab": ".mat",
    "can_file": ".blf .trc",
    "iso19848": ".json .xml",
    "nmea2000": ".jsonl",
}
MODULES = {suffix: module for module, suffixes in SUFFIXES.items() for suffix in suffixes.split()}
"""Module of `shipfp_rs.logs.readers` for each suffix, imported when such a file is first opened."""
FORMATS: tuple[tuple[re.Pattern[bytes], str], ...] = (
    (re.compile(rb"\s*date [A-Za-z0-9 :.]+\r?\n\s*base (?:hex|dec)", re.IGNORECASE), "can_file"),
    (
        re.compile(rb"\s*\([\d.: -]+\)\s+\S+\s+(?:[RT]X[ \-BE]+)?[0-9A-Fa-f]{3,8}(?:#|\s+\[\d+\])"),
        "can_file",
    ),
    (
        re.compile(rb"\s*(?:#.*\n)*\s*\d{4}-\d\d-\d\d[T-]\d\d:\d\d:[\d.]+Z?,\d,\d{4,6}(?:,\d{1,3}){3},"),
        "nmea2000",
    ),
    (re.compile(rb'(?:\s*\{"version"[^\n]*\n)?\s*\{[^\n]*"pgn"\s*:\s*\d'), "nmea2000"),
    (re.compile(rb"(?:\xef\xbb\xbf)?\s*[{<].{0,2000}?(?:TimeSeriesData|Package)", re.DOTALL), "iso19848"),
    (re.compile(rb"(?:\xef\xbb\xbf)?\s*\"?ShipID\"?\s*[,;]", re.IGNORECASE), "iso19848"),
)
"""First bytes of the text formats that are recognised under any suffix, and their modules."""
SIGNATURES = (
    (b"MDF     ", "mdf"),
    (b"UnFinMF ", "mdf"),
    (b"TDSm", "tdms"),
    (b"PAR1", "parquet"),
    (b"ARROW1", "arrow_ipc"),
    (b"\x89HDF", "hdf5"),
    (b"MATLAB 5.0", "matlab"),
    (b"MATLAB 7.3", "matlab"),
    (b"LOGG", "can_file"),
)
"""First bytes of formats that are recognised only under a suffix shared by several formats, and their modules."""
TEXTS = frozenset(f"{SUFFIXES['delimited']} .raw .dat .json .jsonl .xml .trc".split())
HINTS = {
    **dict.fromkeys(
        (".gz", ".zip", ".bz2", ".xz", ".zst", ".7z"), "a compressed file, expected a log; unpack it first"
    ),
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "a spreadsheet, expected a log; save it as CSV"),
    **dict.fromkeys((".toml",), "a configuration file, expected a log"),
}


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
    """Warn of what a file lacks, or of what was assumed about it."""
    warnings.warn(f"{path}: {text}", LogWarning, stacklevel=5)
