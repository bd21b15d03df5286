"""Folder of a sweep: a file of each completed part, a manifest of the settings, and the final table."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from filelock import FileLock, Timeout
from pydantic import Field

from shipfp_rs.errors import InputError
from shipfp_rs.support.files import local, read_json, replacing, write_text_atomically
from shipfp_rs.support.toml import Section, validated

MANIFEST, RESULTS, SUMMARY, PARTS, LOCK = "manifest.json", "results.parquet", "summary.json", "parts", ".lock"
ROWS_PER_GROUP = 16_384
"""Rows per row group of the final table. It is fixed: memory is constant, and the bytes do not depend on the parts' size."""
PARTS_PER_FOLDER = 1000


class Manifest(Section):
    """Settings with which a folder was started."""

    format: Literal[1] = 1
    part_draws: Annotated[int, Field(ge=1)]
    share: str | None = None
    """Share of the sweep that the folder computes, as "3/20"; None: the whole sweep."""
    sweep: dict[str, Any]


@dataclass
class Store:
    """Folder of one sweep, or of a share of it. Part k is `draws[k * part_draws : (k + 1) * part_draws]`.

    A part is written under a temporary name and renamed; after a kill it is either complete or missing.
    """

    folder: Path
    record: Mapping[str, Any]
    schema: pa.Schema
    draws: range
    part_draws: int
    done: set[int] = field(init=False)
    """Parts in the folder."""

    def __post_init__(self) -> None:
        parts = range(0 if self.finished else -(-len(self.draws) // self.part_draws))
        self.done = {part for part in parts if self._is_whole(part)}

    @property
    def finished(self) -> bool:
        """Whether the final table exists."""
        return (self.folder / RESULTS).exists()

    def draws_of(self, part: int) -> range:
        """Draws of a part."""
        return self.draws[part * self.part_draws : (part + 1) * self.part_draws]

    def to_do(self) -> Iterator[int]:
        """Yield the missing parts, in order."""
        return (part for part in range(-(-len(self.draws) // self.part_draws)) if part not in self.done)

    @property
    def rows(self) -> int:
        """Number of draws in the folder."""
        return len(self.draws) if self.finished else sum(len(self.draws_of(part)) for part in self.done)

    def add(self, part: int, rows: pa.RecordBatch) -> None:
        """Write the rows of a part."""
        path = self._path(part)
        with replacing(path) as temporary:
            # Not compressed: a part exists only while the sweep runs, and compression would double the time to write it.
            pq.write_table(
                pa.Table.from_batches([rows]),
                temporary,
                compression="none",
                use_dictionary=False,
                write_statistics=False,
                write_page_checksum=True,
            )
        self.done.add(part)

    def finish(self, batches: Iterable[pa.RecordBatch] | None = None) -> None:
        """Write all parts, or the given rows, to `results.parquet`, ordered by draw; then remove the parts."""
        schema = self.schema.with_metadata({"shipfp_sweep": json.dumps(dict(self.record), sort_keys=True)})
        with (
            replacing(self.folder / RESULTS) as temporary,
            pq.ParquetWriter(local(temporary), schema, compression="zstd") as writer,
        ):
            for table in self._groups(self.batches() if batches is None else batches):
                writer.write_table(table.cast(schema), row_group_size=ROWS_PER_GROUP)
        shutil.rmtree(self.folder / PARTS, ignore_errors=True)

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the available rows, ordered by draw."""
        if self.finished:
            with pq.ParquetFile(local(self.folder) / RESULTS) as file:
                yield from file.iter_batches(batch_size=ROWS_PER_GROUP)
            return
        for part in sorted(self.done):
            yield from self._read(part).to_batches()

    def _groups(self, batches: Iterable[pa.RecordBatch]) -> Iterator[pa.Table]:
        table = self.schema.empty_table()
        for batch in batches:
            table = pa.concat_tables([table, pa.Table.from_batches([batch])])
            while len(table) >= ROWS_PER_GROUP:
                yield table.slice(0, ROWS_PER_GROUP).combine_chunks()
                table = table.slice(ROWS_PER_GROUP)
        if len(table):
            yield table.combine_chunks()

    def _path(self, part: int) -> Path:
        return local(self.folder) / PARTS / f"{part // PARTS_PER_FOLDER:06d}" / f"{part:09d}.parquet"

    def _is_whole(self, part: int) -> bool:
        """Whether a part is complete and has its final name."""
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
    folder: Path,
    record: Mapping[str, Any],
    schema: pa.Schema,
    draws: range,
    part_draws: int,
    share: str | None = None,
) -> Iterator[Store]:
    """Open a sweep's folder to start or resume the sweep, locked against other processes.

    Raises
    ------
    InputError
        If the folder contains other files, belongs to another SWEEP.toml, or is in use.
    """
    _manifest_of(folder, record, share)  # before anything is written
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
        # Read the manifest again, since the previous holder of the lock may have started a sweep.
        manifest = _manifest_of(folder, record, share)
        if manifest is None:
            manifest = Manifest(part_draws=part_draws, share=share, sweep=dict(record))
            try:
                write_text_atomically(folder / MANIFEST, manifest.model_dump_json(indent=1) + "\n")
            except InputError:
                with contextlib.suppress(OSError):  # not empty
                    (folder / LOCK).unlink(missing_ok=True)
                    folder.rmdir()
                raise
        _remove_leftovers(folder)
        yield Store(folder, record, schema, draws, manifest.part_draws)


def _manifest_of(folder: Path, record: Mapping[str, Any], share: str | None) -> Manifest | None:
    """Manifest of a sweep's folder; None without one; `InputError` for other folders."""
    path = folder / MANIFEST
    if not os.path.lexists(path):
        _require_empty(folder)
        return None
    manifest = validated(read_json(path, "a sweep's manifest"), Manifest, str(path))
    _require_same(folder, manifest.sweep, record)
    _require_same(folder, {"part": manifest.share or "the whole"}, {"part": share or "the whole"})
    return manifest


def share_of(share: str, draws: int) -> range:
    """Draws of a share of a sweep, as "3/20".

    Raises
    ------
    InputError
        If `share` has another form, or there are more shares than draws.
    """
    number, slash, count = share.partition("/")
    if not (slash and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise InputError(f"part: found {share!r}, expected a number and how many there are, such as 3/20")
    if int(count) > draws:
        raise InputError(f"part: found {share!r} of a sweep of {draws} draws, expected at most {draws} parts")
    return range((int(number) - 1) * draws // int(count), int(number) * draws // int(count))


def joined(folders: Sequence[Path], whole: Store) -> Iterator[pa.RecordBatch]:
    """Return the rows of a whole sweep, ordered by draw, from the folders of its shares.

    Raises
    ------
    InputError
        If a folder belongs to another sweep, or a share is missing, unfinished or given twice.
    """
    found: dict[str, Path] = {}
    for folder in folders:
        path = folder / MANIFEST
        manifest = validated(read_json(path, "a sweep's manifest"), Manifest, str(path))
        _require_same(folder, manifest.sweep, whole.record)
        if manifest.share is None:
            raise InputError(f"{folder}: has the whole sweep, expected one of its parts")
        if (other := found.setdefault(manifest.share, folder)) is not folder:
            raise InputError(f"{folder}: has part {manifest.share}, as {other} has; give each part once")
    if not found:
        raise InputError("merge: found no folder, expected those of all parts")
    first, *others = {share.partition("/")[2]: share for share in found}.values()
    if others:
        raise InputError(f"parts {first} and {others[0]} divide the sweep differently, expected one division")
    count = int(first.partition("/")[2])
    shares = [f"{number}/{count}" for number in range(1, count + 1)]
    if missing := [share for share in shares if share not in found]:
        raise InputError(f"found no folder of part {', '.join(missing)}; expected all {count} parts")
    stores = [
        Store(found[share], whole.record, whole.schema, share_of(share, len(whole.draws)), 1)
        for share in shares
    ]
    for share, store in zip(shares, stores, strict=True):
        try:
            rows = pq.read_table(local(store.folder) / RESULTS, columns=["index"])["index"]
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"{store.folder}: part {share} is not finished; repeat its command") from error
        if not np.array_equal(rows.to_numpy(), store.draws):
            raise InputError(f"{store.folder / RESULTS}: not the draws of part {share}; compute it again")
    return (batch for store in stores for batch in store.batches())


def _remove_leftovers(folder: Path) -> None:
    """Remove temporary files of a killed run, and parts that the final table contains."""
    if (folder / RESULTS).exists():
        shutil.rmtree(folder / PARTS, ignore_errors=True)
    for pattern in (f".{MANIFEST}.*", f".{RESULTS}.*", f".{SUMMARY}.*", f"{PARTS}/*/.*"):
        for path in folder.glob(pattern):
            path.unlink(missing_ok=True)


def _require_empty(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file, expected a folder or a new name")
    if folder.exists() and {entry.name for entry in folder.iterdir()} - {LOCK}:
        raise InputError(f"{folder}: the folder is not empty and has no sweep; choose another folder")


def _require_same(folder: Path, then: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    before, after = dict(_flat(then)), dict(_flat(now))
    for key in sorted(before.keys() | after.keys()):
        old, new = before.get(key, "nothing"), after.get(key, "nothing")
        if old != new:
            raise InputError(
                f"{folder}: started with {key} = {old}, found {new}; choose another folder, or restore the value"
            )


def _flat(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
