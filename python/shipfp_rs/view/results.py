"""Finished runs and sweeps of a folder: found, told in a line, their files handed out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

DEPTH = 3
"""Folders below the one that is looked at."""
MOST = 500
RUN_FILES = ("report.html", "fingerprint.json", "TRIAL.toml")
SWEEP_FILES = ("summary.json",)
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".toml": "text/plain; charset=utf-8",
    ".png": "image/png",
}


class Results:
    """The finished runs and sweeps below a folder.

    Parameters
    ----------
    root
        The folder; nothing outside of it is ever handed out.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()
        self._folders: dict[str, Path] = {}

    def listed(self) -> list[dict[str, Any]]:
        """Return what is there, newest first."""
        found = []
        for folder in _folders(self.root, DEPTH):
            told = _run(folder) or _sweep(folder)
            if told is None:
                continue
            name = folder.relative_to(self.root).as_posix()
            key = hashlib.sha256(name.encode()).hexdigest()[:16]
            self._folders[key] = folder
            files = {file.name: file for file in sorted(folder.iterdir()) if _handed_out(file)}
            found.append(
                {"id": key, "name": name if name != "." else folder.name, "files": list(files), **told}
            )
            if len(found) >= MOST:
                break
        return sorted(found, key=lambda one: -one["changed"])

    def file(self, key: str, name: str) -> tuple[Path, str] | None:
        """Return a listed file and its media type; None for anything else."""
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
    named = file.name in RUN_FILES + SWEEP_FILES or file.suffix == ".png"
    return named and file.is_file() and not file.is_symlink()


def _folders(root: Path, depth: int) -> Iterator[Path]:
    yield root
    if depth:
        try:
            inner = sorted(entry for entry in root.iterdir() if entry.is_dir() and not entry.is_symlink())
        except OSError:
            return
        for entry in inner:
            if not entry.name.startswith("."):
                yield from _folders(entry, depth - 1)


def _json(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def _run(folder: Path) -> dict[str, Any] | None:
    found = _json(folder / "fingerprint.json")
    if found is None:
        return None
    verdict = found.get("usable") or next(iter(found.get("verdict") or [""]), "")
    return {
        "kind": "run",
        "about": f"{found.get('vessel') or 'drive train not named'}, {_text(found.get('structure'))}",
        "verdict": str(verdict),
        "changed": (folder / "fingerprint.json").stat().st_mtime,
    }


def _text(structure: Any) -> str:
    return str(structure.get("name", "")) if isinstance(structure, dict) else ""


def _sweep(folder: Path) -> dict[str, Any] | None:
    found = _json(folder / "summary.json")
    if found is None or not isinstance(found.get("draws"), dict):
        return None
    draws = found["draws"]
    return {
        "kind": "sweep",
        "about": str(found.get("name", "")),
        "verdict": ", ".join(f"{draws[key]} {key}" for key in ("total", "done", "failed") if key in draws)
        + " draws",
        "changed": (folder / "summary.json").stat().st_mtime,
    }
