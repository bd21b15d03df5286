"""Descriptions read, and files and folders written so that each appears whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from shipfp_rs.errors import InputError

MOST_BYTES = 64 * 2**20
"""Most bytes of a description or a result; a longer file is another kind of file, given by mistake."""
LONGEST_NAME = 255
"""Longest file name in bytes."""
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
"""Errors of the system, often without a file name, when a file can't be written to its end."""


def read_text(path: Path, expected: str) -> str:
    """Return the text of a description, UTF-8; of a pipe or a device nothing is read, since it may never end.

    Parameters
    ----------
    path
        File to read.
    expected
        What it should be, as a message calls it: "a TOML file".

    Raises
    ------
    InputError
        Where it is no file or can't be read; one line.
    """
    try:
        kind = path.stat().st_mode
        content = None
        if stat.S_ISREG(kind) or stat.S_ISDIR(kind):
            with path.open("rb") as file:
                content = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise InputError(
            f"{path}: {getattr(error, 'strerror', None) or error}; expected {expected}"
        ) from error
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
    """Return a path to write; refuse one whose name says that it is of another kind, such as a log."""
    path = Path(path)
    if path.suffix and path.suffix.lower() not in suffixes:
        raise InputError(
            f"{path}: expected a name ending in {' or '.join(suffixes)}, which is what is written"
        )
    return path


def local(path: Path) -> Path:
    """Return the absolute path, since Arrow takes a relative name with a colon, "log 12:30", for a network address."""
    return path.absolute()


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary name beside `path`; left without an error it becomes `path`, else it is removed.

    Through a link the file that it leads to is replaced, and the link stays. A device or a pipe is written into, as any
    other program would: it is never replaced by a file.

    Raises
    ------
    InputError
        Where there can be no such file.
    """
    try:
        target = path.resolve()
        special = target.exists() and not target.is_file()
    except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle, in older Pythons
        raise _cannot(path, error) from error
    if special:
        _require_stream(path, target)
        with tempfile.TemporaryDirectory() as folder:
            temporary = Path(folder) / path.name
            yield temporary
            _write_into(path, target, temporary)
        return
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot(path, error) from error
    temporary = _beside(target)
    try:
        _made(path, lambda: temporary.touch(0o600, exist_ok=False))
        yield temporary
        # It was private; a result should be as readable as any other file the user makes.
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    except OSError as error:
        raise _of_writing(path, temporary, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _beside(target: Path) -> Path:
    """A name of a temporary file or folder, known before there is one: Ctrl-C while it is made leaves none."""
    return target.with_name(f"{f'.{target.name}'[:100]}.{secrets.token_hex(4)}")


def _made(path: Path, make: Callable[[], object]) -> None:
    try:
        make()
    except OSError as error:
        raise _cannot(path, error) from error


def _cannot(path: Path, error: Exception) -> InputError:
    reason = getattr(error, "strerror", None) or error
    return InputError(f"{path}: can't be written, {reason}; choose another folder")


def _of_writing(path: Path, temporary: Path, error: OSError) -> Exception:
    """Name what the user named where an error is that of writing it; any other error stays as it is."""
    about_it = str(error.filename or "").startswith(str(temporary)) or error.filename2 is not None
    return _cannot(path, error) if about_it or error.errno in NO_ROOM else error


def _require_stream(path: Path, target: Path) -> None:
    """Refuse folders, disks and sockets as files to write."""
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
    """Write UTF-8 text under a temporary name, then rename; return the path."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


@contextlib.contextmanager
def replacing_folder(
    path: Path, *, marker: str, others: Collection[str] = (), force: bool = False
) -> Iterator[Path]:
    """Give a temporary folder beside `path`; its files are moved to `path` on leaving without an error.

    A new folder appears in one rename. In a folder that exists each file is replaced in one rename, and no
    other file is touched.

    Parameters
    ----------
    path
        The folder.
    marker, others
        Names of the files that are about to be written; a folder that holds `marker`, and nothing but these,
        is a previous result and may be replaced.
    force
        Write into a folder that holds other files, too.

    Raises
    ------
    InputError
        Where `path` can't be made, is a file, or holds other files.
    """
    try:
        _check_replaceable(path, {marker, *others}, marker, force)
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot(path, error) from error
    temporary = _beside(path)
    try:
        _made(path, lambda: temporary.mkdir(0o700))
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
            raise InputError(f"{path}: is a link that leads nowhere, expected a folder or a new name")
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
