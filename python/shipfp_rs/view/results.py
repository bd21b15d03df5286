"""Finished runs and sweeps of a folder: a summary line for each, and their files."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from shipfp_rs.errors import InputError
from shipfp_rs.support.files import MOST_BYTES
from shipfp_rs.support.json_files import read_json
from shipfp_rs.support.toml import MOST_CHARACTERS

DEPTH = 3
"""Depth of the search below the folder."""
MOST = 500
MOST_FOLDERS = 10_000
"""Most folders that are searched, so that a page of a whole disk loads, too."""
RUN_FILES = ("report.html", "fingerprint.json", "TRIAL.toml")
SWEEP_FILES = ("summary.json",)
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".toml": "text/plain; charset=utf-8",
    ".png": "image/png",
}


class Results:
    """Finished runs and sweeps below a root folder; files outside are never served."""

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()
        self._folders: dict[str, Path] = {}

    def listed(self) -> list[dict[str, Any]]:
        """Runs and sweeps, newest first."""
        found = []
        for folder in itertools.islice(_folders(self.root, DEPTH), MOST_FOLDERS):
            with contextlib.suppress(OSError):  # an unreadable folder, or one removed meanwhile
                told = _run(folder) or _sweep(folder)
                if told is None:
                    continue
                name = folder.relative_to(self.root).as_posix()
                key = hashlib.sha256(os.fsencode(name)).hexdigest()[:16]
                files = [file.name for file in sorted(folder.iterdir()) if _handed_out(file)]
                self._folders[key] = folder
                found.append(
                    {"id": key, "name": name if name != "." else folder.name, "files": files, **told}
                )
            if len(found) >= MOST:
                break
        return sorted(found, key=lambda one: -one["changed"])

    def file(self, key: str, name: str) -> tuple[Path, str] | None:
        """Listed file and its media type; None for any other."""
        if key not in self._folders:
            self.listed()
        folder = self._folders.get(key)
        if folder is None:
            return None
        for file in folder.iterdir():
            if file.name == name and _handed_out(file) and file.resolve().is_relative_to(self.root):
                return file, TYPES[file.suffix]
        return None


def _handed_out(file: Path) -> bool:
    if file.name not in RUN_FILES + SWEEP_FILES and file.suffix != ".png":
        return False
    status = file.lstat()
    return stat.S_ISREG(status.st_mode) and status.st_size <= MOST_BYTES


def _folders(root: Path, depth: int) -> Iterator[Path]:
    yield root
    if depth:
        try:
            with os.scandir(root) as entries:
                inner = sorted(entry.path for entry in entries if entry.is_dir(follow_symlinks=False))
        except OSError:
            return
        for path in inner:
            if not (entry := Path(path)).name.startswith("."):
                yield from _folders(entry, depth - 1)


def _json(path: Path) -> dict[str, Any] | None:
    try:
        content = read_json(path, "results")
    except InputError:
        return None
    return content if isinstance(content, dict) else None


def _run(folder: Path) -> dict[str, Any] | None:
    found = _json(folder / "fingerprint.json")
    if found is None:
        return None
    verdict = found.get("usable") or found.get("verdict")
    first = next(iter(verdict), "") if isinstance(verdict, list) else verdict
    return {
        "kind": "run",
        "about": f"{_short(found.get('vessel')) or 'drive train not named'}, {_text(found.get('structure'))}",
        "verdict": _short(first),
        "changed": (folder / "fingerprint.json").stat().st_mtime,
    }


def _text(structure: Any) -> str:
    return _short(structure.get("name")) if isinstance(structure, dict) else ""


def _short(value: Any) -> str:
    """Short text for a name or verdict in a file, of any type."""
    return "" if value is None else str(value)[:MOST_CHARACTERS]


def _sweep(folder: Path) -> dict[str, Any] | None:
    found = _json(folder / "summary.json")
    if found is None or not isinstance(found.get("draws"), dict):
        return None
    draws = found["draws"]
    return {
        "kind": "sweep",
        "about": _short(found.get("name")),
        "verdict": ", ".join(
            f"{_short(draws[key])} {key}" for key in ("total", "done", "failed") if key in draws
        )
        + " draws",
        "changed": (folder / "summary.json").stat().st_mtime,
    }
