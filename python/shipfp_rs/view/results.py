"""Finished runs and sweeps of a folder, and their signals at any zoom."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import stat
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel, Samples
from shipfp_rs.logs.log import Log, Pieces
from shipfp_rs.support.files import MOST_BYTES, read_json
from shipfp_rs.support.toml import MOST_CHARACTERS
from shipfp_rs.view.pyramid import FACTOR, Extremes, Stored, coarser, extremes, level_counts

Array = npt.NDArray[np.float64]

TILE = 1024
"""Blocks in a tile."""
FINER = 3
"""Number of levels finer than the stored ones, with 1, 4 and 16 samples per block."""
PIECE = 1 << 18
"""Samples read at once."""
KEPT = 8
"""Number of pieces of a channel that are kept in memory; in single precision they take 8 MB."""
HEAD = np.dtype([("offset", "<f8"), ("count", "<u4"), ("columns", "<u4")])
"""Header of a tile's float32 values: offset to add, number of rows, one column (samples) or two (extremes)."""


@dataclass(frozen=True)
class Series:
    """Channel or signal that can be drawn at any zoom."""

    channel: Channel
    """Name, unit, rate, samples, start."""
    read: Callable[[int, int], Samples]
    """Function (first, stop) that returns samples."""
    levels: tuple[Array, ...]
    """Extremes of every 64, 256, ... samples, each of shape (K, 2)."""
    gaps: npt.NDArray[np.int64]
    gap_count: int
    """First stretches without samples, shape (G, 2), and the number of all such stretches."""
    layer: str = "raw"
    """"raw" or "processed"."""
    ahead: Callable[[int, int], None] | None = None
    """Function (first, stop) that starts to read samples; None if all samples are in memory."""

    @classmethod
    def of_channel(cls, stored: Stored, log: Callable[[], Log]) -> Series:
        """Series of a stored channel; its log is opened when samples are needed."""
        channel, pieces = stored.channel, _Pieces(log, stored.channel, PIECE, KEPT)
        return cls(
            channel, pieces.read, stored.levels, stored.gaps, stored.gap_count, ahead=pieces.begin_to_read
        )

    @classmethod
    def of_array(cls, channel: Channel, samples: Array, layer: str) -> Series:
        """Signal in memory."""
        blocks = Extremes()
        levels = [np.concatenate([blocks.feed(samples), blocks.finish()])]
        for _ in level_counts(len(samples))[1:]:
            levels.append(coarser(levels[-1]))
        held = samples.astype(np.float32)
        return cls(
            channel, lambda first, stop: held[first:stop], tuple(levels), blocks.gaps, blocks.gap_count, layer
        )

    @property
    def depth(self) -> int:
        """Number of levels, starting with single samples."""
        return FINER + len(self.levels)

    def blocks(self, level: int, first: int, stop: int) -> Array:
        """Blocks of a level, shape (K, 2): minimum and maximum; samples at level 0, shape (K, 1)."""
        if level >= FINER:
            return self.levels[level - FINER][first:stop]
        size = FACTOR**level
        start, end = first * size, min(stop * size, self.channel.samples)
        if start >= end:
            return np.empty((0, 1 if level == 0 else 2))
        samples = self.read(start, end)
        if level == 0:
            return samples.astype(np.float64)[:, None]
        return extremes(samples, size)

    def tile(self, level: int, index: int) -> bytes:
        """A tile of samples, packed for the page; `InputError` if the level or the index does not exist."""
        if not 0 <= level < self.depth or not 0 <= index * TILE * FACTOR**level < max(
            self.channel.samples, 1
        ):
            raise InputError(f"{self.channel.name}: no tile {index} of level {level}")
        if (
            self.ahead is not None and level == FINER
        ):  # reads ahead, since zooming in further needs the samples
            size = TILE * FACTOR**level
            self.ahead(index * size, min((index + 1) * size, self.channel.samples))
        return packed(self.blocks(level, index * TILE, (index + 1) * TILE))


class _Pieces(Pieces):
    """Samples of a channel, in pieces that can be read ahead; the log is opened when samples are needed."""

    def begin_to_read(self, first: int, stop: int) -> None:
        """Start to read the pieces with these samples."""
        if any(index not in self._held for index in range(first // PIECE, -(-stop // PIECE))):
            threading.Thread(target=self._read_quietly, args=(first, stop), daemon=True).start()

    def _read_quietly(self, first: int, stop: int) -> None:
        with contextlib.suppress(
            InputError, OSError
        ):  # the same error is raised again when the samples are needed
            self.read(first, stop)


def packed(blocks: Array) -> bytes:
    """Blocks in single precision relative to an offset, which preserves small changes of large values."""
    offset, most = 0.0, float(np.finfo(np.float32).max)
    finite = blocks[np.isfinite(blocks)]
    if finite.size and not np.array_equal(
        np.clip(finite, -most, most).astype(np.float32).astype(np.float64), finite
    ):
        offset = 0.5 * float(finite.min()) + 0.5 * float(finite.max())
    # Values are limited to the range of single precision; infinite samples count as missing, as in coarser levels.
    single = np.where(np.isfinite(blocks), np.clip(blocks - offset, -most, most), np.nan)
    head = np.array([(offset, len(blocks), blocks.shape[1])], dtype=HEAD)
    return head.tobytes() + single.astype("<f4").tobytes()


DEPTH = 3
"""Depth of the search below the folder."""
MOST = 500
MOST_FOLDERS = 10_000
"""Largest number of searched folders, so that the page loads even for a whole disk."""
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
            with contextlib.suppress(OSError):  # the folder is unreadable, or was removed meanwhile
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
    verdict = found.get("verdict")
    told = [found.get("usable"), *(verdict if isinstance(verdict, list) else [verdict])]
    first = next(iter(doubt_first([str(line) for line in told if line])), "")
    return {
        "kind": "run",
        "about": f"{_short(found.get('vessel')) or 'drive train not named'}, {_text(found.get('structure'))}",
        "verdict": _short(first),
        "changed": (folder / "fingerprint.json").stat().st_mtime,
    }


DOUBT = "Set point and speed differ"
"""Start of the verdict's line that puts all other lines in doubt: with an integral governor, one calibration is wrong."""


def doubt_first(verdict: Sequence[str]) -> list[str]:
    """Lines of a verdict, with a doubt about the measurement first."""
    return sorted(verdict, key=lambda line: not line.startswith(DOUBT))


def _text(structure: Any) -> str:
    return _short(structure.get("name")) if isinstance(structure, dict) else ""


def _short(value: Any) -> str:
    """Shortened text of a file's name or verdict, which may be of any type."""
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
