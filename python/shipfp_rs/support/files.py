"""Reading of text and JSON files, and atomic writing of files and folders."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import re
import secrets
import shutil
import stat
import tempfile
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import is_dataclass
from importlib import resources
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from shipfp_rs.errors import InputError

MOST_BYTES = 64 * 2**20
"""Largest size of a configuration or result file [bytes]; a longer file is probably of another kind."""
LONGEST_NAME = 255
"""Longest file name in bytes."""
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
"""System error codes for a file that can't be written completely; these errors often lack the file name."""


def read_text(path: Path, expected: str) -> str:
    """Read a UTF-8 text file.

    Pipes and devices, which may never end, are rejected. Errors mention the `expected` content.
    """
    try:
        kind = path.stat().st_mode
        content = None
        if stat.S_ISREG(kind) or stat.S_ISDIR(kind):
            with path.open("rb") as file:
                content = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: invalid file name
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: {reason}; expected {expected}") from error
    if content is None:
        raise InputError(f"{path}: a pipe or a device, expected {expected}; write it to a file first")
    if len(content) > MOST_BYTES:
        raise InputError(f"{path}: more than {MOST_BYTES / 2**20:.0f} MB, expected {expected}")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: found bytes that are not UTF-8 at {error.start}, expected {expected}; save it as UTF-8"
        ) from error


def ending_in(path: str | Path, *suffixes: str) -> Path:
    """Path to write; `InputError` if its suffix is that of another kind of file, such as a log."""
    path = Path(path)
    if path.suffix and path.suffix.lower() not in suffixes:
        raise InputError(
            f"{path}: expected a name ending in {' or '.join(suffixes)}, since such a file is written"
        )
    return path


def local(path: Path) -> Path:
    """Absolute path, since Arrow interprets a relative name with a colon, "log 12:30", as a network address."""
    return path.absolute()


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary file in the folder of `path`, which is renamed to `path` on success and removed on error.

    If `path` is a link, the file it points to is replaced. If it is a device or a pipe, the content is copied into it.

    Raises
    ------
    InputError
        If such a file can't be created.
    """
    with _creating(path):
        target = path.resolve()
        special = target.exists() and not target.is_file()
    if special:
        _require_stream(path, target)
        with tempfile.TemporaryDirectory() as folder:
            temporary = Path(folder) / path.name
            yield temporary
            _write_into(path, target, temporary)
        return
    with _creating(path):
        target.parent.mkdir(parents=True, exist_ok=True)
    temporary = _beside(target)
    try:
        with _creating(path):
            temporary.touch(0o600, exist_ok=False)
        yield temporary
        # The temporary file is private; the result gets the usual permissions.
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    except OSError as error:
        raise _of_writing(path, temporary, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _beside(target: Path) -> Path:
    """Name of a temporary file or folder; it is known before creation, which allows removal after Ctrl-C during creation."""
    return target.with_name(f"{f'.{target.name}'[:100]}.{secrets.token_hex(4)}")


@contextlib.contextmanager
def _creating(path: Path) -> Iterator[None]:
    """Replace errors by an `InputError` which says that the user's path can't be written."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # RuntimeError: circular links, in older Pythons
        raise _cannot(path, error) from error


def _cannot(path: Path, error: Exception) -> InputError:
    reason = getattr(error, "strerror", None) or error
    return InputError(f"{path}: can't be written, {reason}; choose another folder")


def _of_writing(path: Path, temporary: Path, error: OSError) -> Exception:
    """Replace the temporary name by the user's path in errors of writing; other errors are unchanged."""
    about_it = str(error.filename or "").startswith(str(temporary)) or error.filename2 is not None
    return _cannot(path, error) if about_it or error.errno in NO_ROOM else error


def _require_stream(path: Path, target: Path) -> None:
    """Reject folders, disks and sockets as files to write."""
    kind = target.stat().st_mode
    if not (stat.S_ISCHR(kind) or stat.S_ISFIFO(kind)):
        what = "a folder" if stat.S_ISDIR(kind) else "a disk or a socket"
        raise InputError(f"{path}: is {what}, expected the name of a file")


def _write_into(path: Path, target: Path, source: Path) -> None:
    try:
        with source.open("rb") as content, target.open("wb", buffering=0) as stream:
            shutil.copyfileobj(content, stream)
    except OSError as error:
        raise InputError(f"{path}: can't be written, {error.strerror or error}; choose a file") from error


def write_text_atomically(path: Path, text: str) -> Path:
    """Write UTF-8 text to a temporary file and rename it to `path`; return `path`."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


@contextlib.contextmanager
def replacing_folder(
    path: Path, *, marker: str, others: Collection[str] = (), force: bool = False
) -> Iterator[Path]:
    """Yield a temporary folder in the parent of `path`; its files are moved to `path` on success.

    A new folder is created by one rename. In an existing folder each file is replaced by one rename, and no other file is
    changed. A folder with `marker` and no files other than `others` is a previous result, which may be replaced; with
    `force` any folder is written into. `InputError` if `path` can't be made, is a file, or contains other files.
    """
    with _creating(path):
        _check_replaceable(path, {marker, *others}, marker, force)
        path.parent.mkdir(parents=True, exist_ok=True)
    temporary = _beside(path)
    try:
        with _creating(path):
            temporary.mkdir(0o700)
        yield temporary
        temporary.chmod(0o777 & ~_umask())
        if path.exists():
            for file in sorted(temporary.iterdir()):
                file.replace(path / file.name)
        else:
            temporary.rename(path)
    except InputError as error:
        raise InputError(str(error).replace(str(temporary), str(path))) from error
    except OSError as error:
        raise _of_writing(path, temporary, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _check_replaceable(path: Path, names: Collection[str], marker: str, force: bool) -> None:
    if not path.exists():
        if path.is_symlink():
            raise InputError(f"{path}: is a link to a missing file, expected a folder or a new name")
        if len(os.fsencode(path.name)) > LONGEST_NAME:
            raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
        return
    if not path.is_dir():
        raise InputError(f"{path}: is a file, expected a folder or a new name")
    found = {entry.name for entry in path.iterdir()}
    if force or not found or (marker in found and found <= set(names)):
        return
    what = ", ".join(sorted(found - set(names))[:3]) or f"no {marker}"
    raise InputError(
        f"{path}: the folder is not empty and not a previous result (found {what}); choose another folder, "
        "or --force to write into this one"
    )


def _umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask


HALF = re.compile(r"\\u[dD][89a-fA-F]")
"""JSON escape of a surrogate (half of a UTF-16 pair), which UTF-8 files can't contain."""


def finite(content: Any) -> Any:
    """Convert content for JSON: non-finite numbers to None, NumPy numbers to Python numbers, dataclasses to tables."""
    if isinstance(content, np.generic | np.ndarray) and content.ndim == 0:
        content = content.item()
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    if is_dataclass(content):
        content = vars(content)
    if isinstance(content, Mapping):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite(value) for value in content]
    return content


def json_text(content: Any, *, ascii_only: bool = True) -> str:
    """Indented JSON document with a line end."""
    return json.dumps(finite(content), indent=2, ensure_ascii=ascii_only, allow_nan=False) + "\n"


def read_json(path: Path, expected: str) -> Any:
    """Read a UTF-8 JSON file; `InputError`, with the `expected` content, if it is invalid or contains NaN."""
    return parsed_json(read_text(path, expected), str(path), expected)


def parsed_json(text: str | bytes, source: str, expected: str) -> Any:
    """Parse a JSON text; `source` starts the message of the `InputError`, see `read_json`."""

    def refused(word: str) -> NoReturn:
        raise InputError(f"{source}: found {word[:40]}, expected finite numbers; write the file again")

    def number(text: str) -> float:
        value = float(text)
        return value if math.isfinite(value) else refused(text)

    try:
        text = text if isinstance(text, str) else text.decode()
        content = json.loads(text, parse_constant=refused, parse_float=number)
        if HALF.search(text):  # a pair of surrogates is a whole character
            json.dumps(content, ensure_ascii=False).encode()
    except RecursionError as error:
        raise InputError(f"{source}: nested too deeply, expected {expected}") from error
    except json.JSONDecodeError as error:
        raise InputError(f"{source}: not JSON ({error}), expected {expected}") from error
    except InputError:
        raise
    except UnicodeEncodeError as error:
        raise InputError(f"{source}: found half a character of UTF-16, expected {expected}") from error
    except ValueError as error:  # an integer with too many digits for Python
        raise InputError(f"{source}: {str(error).split(';')[0]}, expected {expected}") from error
    return content


def words_of(name: str) -> dict[str, Any]:
    """Lists of words in a file of the package, `data/NAME.toml`."""
    return tomllib.loads((resources.files("shipfp_rs") / "data" / f"{name}.toml").read_text(encoding="utf-8"))
