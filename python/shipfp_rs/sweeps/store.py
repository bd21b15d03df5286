"""A sweep's folder: parts as they come, a manifest that says which are done, and the table made of them."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from shipfp_rs.errors import InputError
from shipfp_rs.support.files import local, replacing, write_text_atomically
from shipfp_rs.support.json_files import read_json

MANIFEST, RESULTS, SUMMARY, PARTS, LOCK = "manifest.json", "results.parquet", "summary.json", "parts", ".lock"
FORMAT = 1
ROWS_PER_GROUP = 16_384
"""Rows written at once, whatever the parts' size: the same bytes come of any parts, from flat memory."""
PARTS_PER_FOLDER = 1000


@dataclass
class Store:
    """The folder of one sweep. Part k holds draws k part_draws up to the next part's; only the manifest makes it count.

    A part is written under another name, renamed, and then entered in the manifest, which is replaced in one rename
    too: whatever is killed when, a part is done as a whole or to do as a whole.
    """

    folder: Path
    record: Mapping[str, Any]
    schema: pa.Schema
    draws: int
    part_draws: int
    finished: bool = False
    below: int = 0
    """Every part before this one is done."""
    beyond: set[int] = field(default_factory=set)
    """Parts that are done after it: a few, since parts are begun in order."""

    @property
    def parts(self) -> int:
        """Number of parts in all."""
        return -(-self.draws // self.part_draws)

    def draws_of(self, part: int) -> range:
        """Return the draws of a part."""
        return range(part * self.part_draws, min((part + 1) * self.part_draws, self.draws))

    def to_do(self) -> Iterator[int]:
        """Give the parts that are not done, in order."""
        return (part for part in range(self.below, self.parts) if part not in self.beyond)

    @property
    def rows(self) -> int:
        """Number of draws that are in the folder."""
        if self.finished:
            return self.draws
        return min(self.below * self.part_draws, self.draws) + sum(len(self.draws_of(k)) for k in self.beyond)

    def add(self, part: int, rows: pa.RecordBatch) -> None:
        """Write the rows of a part; from its return on the part is done."""
        path = self._path(part)
        with replacing(path) as temporary:
            # It lives as long as the sweep runs, and the driver writes every one: plain takes less than half the time.
            pq.write_table(
                pa.Table.from_batches([rows]),
                temporary,
                compression="none",
                use_dictionary=False,
                write_statistics=False,
                write_page_checksum=True,
            )
        self._enter(part)
        self._write_manifest()

    def finish(self) -> Path:
        """Make `results.parquet` of all parts, in the order of their draws, then remove them."""
        path = self.folder / RESULTS
        if not self.finished:
            schema = self.schema.with_metadata(
                {"shipfp_sweep": json.dumps(dict(self.record), sort_keys=True)}
            )
            with (
                replacing(path) as temporary,
                pq.ParquetWriter(local(temporary), schema, compression="zstd") as writer,
            ):
                for table in self._groups():
                    writer.write_table(table.cast(schema), row_group_size=ROWS_PER_GROUP)
            self.finished = True
            self._write_manifest()
        shutil.rmtree(self.folder / PARTS, ignore_errors=True)
        return path

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Give the rows that there are, in the order of their draws."""
        if self.finished:
            with pq.ParquetFile(local(self.folder) / RESULTS) as file:
                yield from file.iter_batches(batch_size=ROWS_PER_GROUP)
            return
        for part in (*range(self.below), *sorted(self.beyond)):
            yield from self._read(part).to_batches()

    def _groups(self) -> Iterator[pa.Table]:
        waiting, rows = [], 0
        for batch in self.batches():
            waiting.append(batch)
            rows += len(batch)
            while rows >= ROWS_PER_GROUP:
                table = pa.Table.from_batches(waiting).combine_chunks()
                yield table.slice(0, ROWS_PER_GROUP).combine_chunks()
                waiting, rows = table.slice(ROWS_PER_GROUP).to_batches(), rows - ROWS_PER_GROUP
        if rows:
            yield pa.Table.from_batches(waiting).combine_chunks()

    def _path(self, part: int) -> Path:
        return local(self.folder) / PARTS / f"{part // PARTS_PER_FOLDER:06d}" / f"{part:09d}.parquet"

    def _write_manifest(self) -> None:
        content = {
            "format": FORMAT,
            "draws": self.draws,
            "part_draws": self.part_draws,
            "below": self.below,
            "beyond": sorted(self.beyond),
            "finished": self.finished,
            "sweep": self.record,
        }
        write_text_atomically(self.folder / MANIFEST, json.dumps(content, indent=1) + "\n")

    def _take_over(self, content: Mapping[str, Any]) -> None:
        """Go on where an earlier run stopped."""
        self.part_draws, self.finished = int(content["part_draws"]), bool(content["finished"])
        self.below, self.beyond = self.parts, set()
        if not self.finished:
            self.below = 0
            for part in (*range(content["below"]), *content["beyond"]):
                if self._is_whole(part):
                    self._enter(part)

    def _enter(self, part: int) -> None:
        self.beyond.add(part)
        while self.below in self.beyond:
            self.beyond.remove(self.below)
            self.below += 1

    def _is_whole(self, part: int) -> bool:
        """Whether a part is there as it was written, and under its own name."""
        try:
            table = self._read(part)
            return bool(table.schema.equals(self.schema)) and table["index"].to_pylist() == [
                *self.draws_of(part)
            ]
        except (OSError, pa.ArrowException):
            return False

    def _read(self, part: int) -> pa.Table:
        with pq.ParquetFile(self._path(part), page_checksum_verification=True) as file:
            return file.read()


@contextlib.contextmanager
def opened(
    folder: Path, record: Mapping[str, Any], schema: pa.Schema, draws: int, part_draws: int
) -> Iterator[Store]:
    """Open a sweep's folder to run it or go on with it; nobody else can until this is left.

    Raises
    ------
    InputError
        Where the folder holds something else, was made by another SWEEP.toml, or is being worked in.
    """
    store = Store(folder, record, schema, draws, part_draws)
    content = read_manifest(folder)
    if content is None:
        _require_empty(folder)
    else:
        _require_same(folder, content["sweep"], record)
    lock = FileLock(folder / LOCK, blocking=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = lock.acquire()
    except Timeout as error:
        raise InputError(
            f"{folder}: a sweep is running in this folder; wait for it, or choose another"
        ) from error
    except OSError as error:
        raise InputError(
            f"{folder}: can't be written, {error.strerror or error}; choose another folder"
        ) from error
    with held:
        if content is not None:
            # Read again: whoever held the folder until now may have added to it.
            store._take_over(read_manifest(folder) or content)
            _remove_leftovers(folder)
        try:
            store._write_manifest()
        except InputError:
            if content is None:
                _remove_empty(folder)
            raise
        yield store


def _remove_empty(folder: Path) -> None:
    """Remove a folder in which nothing could be written, unless others stand in it."""
    with contextlib.suppress(OSError):
        (folder / LOCK).unlink(missing_ok=True)
        folder.rmdir()


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return the manifest of a sweep's folder; None where there is none.

    Raises
    ------
    InputError
        Where it can't be read.
    """
    path = folder / MANIFEST
    if not os.path.lexists(path):
        return None
    content = read_json(path, "a sweep's manifest")
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(f"{path}: not a manifest of format {FORMAT}; choose another folder")
    if not _is_manifest(content):
        raise InputError(f"{path}: was changed by another program; choose another folder")
    return content


def _is_manifest(content: Mapping[str, Any]) -> bool:
    """Whether it holds what `Store` writes, with numbers of parts that there can be."""
    parts = [content.get("below"), *(beyond if isinstance(beyond := content.get("beyond"), list) else [None])]
    sizes = (content.get("draws"), content.get("part_draws"))
    return (
        all(type(size) is int and size > 0 for size in sizes)
        and all(type(part) is int and 0 <= part <= content["draws"] for part in parts)
        and isinstance(content.get("finished"), bool)
        and isinstance(content.get("sweep"), dict)
    )


def _remove_leftovers(folder: Path) -> None:
    """Remove what a killed run had not yet renamed."""
    for pattern in (f".{MANIFEST}.*", f".{RESULTS}.*", f".{SUMMARY}.*", f"{PARTS}/*/.*"):
        for path in folder.glob(pattern):
            path.unlink(missing_ok=True)


def _require_empty(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file, expected a folder or a new name")
    if folder.exists() and {entry.name for entry in folder.iterdir()} - {LOCK}:
        raise InputError(f"{folder}: the folder is not empty and not a sweep's; choose another folder")


def _require_same(folder: Path, then: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    before, after = dict(_flat(then)), dict(_flat(now))
    for key in sorted(before.keys() | after.keys()):
        old, new = before.get(key, "nothing"), after.get(key, "nothing")
        if old != new:
            raise InputError(
                f"{folder}: begun with {key} = {old}, found {new} now; choose another folder, or restore it"
            )


def _flat(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
