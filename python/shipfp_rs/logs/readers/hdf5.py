"""HDF5 files (.h5, .hdf5) and MATLAB files of version 7.3, which are HDF5, read by h5py."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel, Samples
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.child_process import in_child
from shipfp_rs.logs.readers.columns import (
    Found,
    Row,
    axis_of,
    blocks_of_rows,
    column_names,
    is_table,
    log_of_found,
    named_time,
    tell_left_out,
    tell_no_time,
    time_of,
    times_among,
)
from shipfp_rs.logs.readers.time_cells import TimePlan, split_bracketed, stated_rate
from shipfp_rs.logs.time_axis import TimeAxis

START_NAMES = ("start_utc", "start_time", "wf_start_time")
OWN = "expected all data in this file; write it as one file"
SINCE = re.compile(r"\s*([a-zµ]+)\s+since\s+(.+)")
"""Pattern of a time unit in the Climate and Forecast conventions."""


@register_reader(".h5", ".hdf5")
@in_child("h5py", extra="hdf5")
def open_hdf5(path: Path, rate_hz: float | None) -> Log:
    """Open an HDF5 file; each one-dimensional dataset, and each field of one, is a channel named by its path."""
    import h5py

    if not h5py.is_hdf5(path):
        raise InputError(f"{path}: not an HDF5 file, or its first block is damaged")
    file = h5py.File(path, "r")
    # Links into other files are not followed: a log must not give access to other files on the disk.
    own = h5py.HardLink | h5py.SoftLink
    leads_out = file.visititems_links(lambda name, link: None if isinstance(link, own) else name)
    if leads_out is not None:
        raise InputError(f"{path}: {leads_out!r} leads into another file, {OWN}")
    rows, datasets, skipped = _find_rows(file)
    scalars = [(posixpath.basename(key), datasets[key][()]) for key, row in rows.items() if row.length == 1]
    times = times_among(rows)
    clock = cache(lambda key: _clock(path, datasets[key].attrs, rows[key], rows))
    timeless: list[Row] = []
    channels: dict[str, Row] = {}
    found: dict[str, Found] = {}
    for key, row in rows.items():
        if key in times or (row.length == 1 and len(rows) > 1):
            continue
        facts = _attributes(datasets[key])
        name, unit = split_bracketed(key)
        unit = _text(facts.get("unit", facts.get("units", unit)))
        start_s = float(np.asarray(facts.get("start_s", 0.0)).reshape(-1)[0])
        stamp = next((facts[each] for each in START_NAMES if each in facts), None)
        start_utc = None if stamp is None else _instant(path, stamp)
        rate = rate_hz or stated_rate(facts.items())
        rate = rate or (None if named_time(row, rows) else stated_rate(scalars))
        if rate is not None:
            found[name] = Found(Channel(name, unit, rate, row.length, start_s), start_utc=start_utc)
        elif time := time_of(row, rows)[0]:
            axis, plan = clock(time)
            found[name] = Found.on(axis, name, unit, plan, start_utc=start_utc)
        else:
            timeless.append(row)
            continue
        channels[name] = row
    tell_no_time(path, timeless, all_of_them=not found)
    tell_left_out(path, "no numbers along one axis", skipped, all_of_them=not found)
    return log_of_found(path, [*found.values()], blocks_of_rows(path, channels))


def _read(dataset: Any, field: str | None, column: int, start: int, stop: int) -> Samples:
    """Numbers along the longest axis of a dataset, of one field, or of one column of a table."""
    _require_own(dataset)
    axis = int(np.argmax(dataset.shape))
    place = tuple(slice(start, stop) if k == axis else column for k in range(dataset.ndim))
    try:
        samples: Samples = (dataset.fields(field) if field else dataset)[place]
    except OSError as error:
        missing = _missing_filter(dataset)
        if missing is None:
            raise
        raise InputError(
            f"{dataset.file.filename}: dataset {dataset.name!r} is compressed with filter {missing}, "
            "which h5py lacks; pack it again with h5repack -f GZIP=4"
        ) from error
    return samples.astype(bool) if _text(dataset.attrs.get("MATLAB_class", "")) == "logical" else samples


def _find_rows(file: Any) -> tuple[dict[str, Row], dict[str, Any], list[str]]:
    """Vectors of numbers in a file by path, the dataset of each, and the names of the datasets left out."""
    import h5py

    rows: dict[str, Row] = {}
    datasets: dict[str, Any] = {}
    skipped: list[str] = []

    def add(key: str, item: Any, length: int, field: str | None = None, column: int = 0) -> None:
        rows[key] = Row(key, "", length, partial(_read, item, field, column))
        datasets[key] = item

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset):
            return
        _require_own(item)
        if name.startswith("#"):
            return
        matlab = _text(item.attrs.get("MATLAB_class", ""))
        one_axis = item.ndim > 0 and item.size == max(item.shape) > 0 and "MATLAB_empty" not in item.attrs
        names = item.dtype.names or (None,)
        for field in names:
            kind = item.dtype[field] if field else item.dtype
            key = f"{name}/{field}" if field else name
            number = kind.kind in "biuf" and kind.itemsize <= 8 and matlab not in ("char", "cell")
            if number and (one_axis or (item.ndim == 0 and item.size == 1)):
                add(key, item, item.size, field)
            elif number and field is None and item.ndim == 2:
                if not is_table(item.shape):
                    skipped.append(key)
                    return
                above = posixpath.dirname(name)
                names_of = column_names(min(item.shape), _words(item), posixpath.basename(name))
                for k, column in enumerate(names_of):
                    add(posixpath.join(above, column), item, max(item.shape), column=k)
            else:
                skipped.append(key)

    file.visititems(visit)
    return rows, datasets, skipped


def _require_own(dataset: Any) -> None:
    """Raise `InputError` for a dataset whose samples are in another file."""
    if dataset.external or (
        dataset.is_virtual and any(source.file_name != "." for source in dataset.virtual_sources())
    ):
        raise InputError(f"{dataset.file.filename}: {dataset.name!r} has its samples in another file, {OWN}")


def _words(dataset: Any) -> dict[str, list[str]]:
    """Lists of texts that may name a dataset's columns: attributes of the dataset and text arrays in its group."""
    import h5py

    found: dict[str, list[str]] = {}
    for name, value in dataset.attrs.items():
        if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "OSU":
            found[name] = [_text(word) for word in value]
    for name, item in dataset.parent.items():
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "OS":
            continue
        content = item[()]
        if h5py.check_ref_dtype(item.dtype) is h5py.Reference:
            cells = [dataset.file[ref] for ref in np.ravel(content) if ref]
            if all(_text(cell.attrs.get("MATLAB_class", "")) == "char" for cell in cells):
                found[name] = ["".join(chr(code) for code in np.ravel(cell[()])) for cell in cells]
        elif isinstance(content, np.ndarray) and content.ndim == 1:
            found[name] = [_text(word) for word in content]
    return found


def _missing_filter(dataset: Any) -> str | None:
    """Name of the dataset's compression filter if h5py lacks this filter, else None."""
    import h5py

    created = dataset.id.get_create_plist()
    for index in range(created.get_nfilters()):
        code, _, _, name = created.get_filter(index)
        if not h5py.h5z.filter_avail(code):
            return f"{code} ({_text(name) or 'without a name'})"
    return None


def _attributes(dataset: Any) -> dict[str, Any]:
    """Attributes of a dataset or, where absent, of the nearest group above it; names in lower case."""
    facts: dict[str, Any] = {}
    wanted = {"unit", "units", "start_s", *START_NAMES}
    item = dataset
    while True:
        for name in item.attrs:
            key = name.lower()
            if key not in facts and (key in wanted or stated_rate([(name, 1.0)])):
                facts[key] = item.attrs[name]
        if item.name == "/":
            return facts
        item = item.parent


def _clock(path: Path, facts: Any, row: Row, rows: Mapping[str, Row]) -> tuple[TimeAxis, TimePlan]:
    """Grid and interpretation of a dataset of times; if its unit has a date, the date is time zero."""
    unit = _text(facts.get("units", facts.get("unit", "")))
    since = SINCE.fullmatch(unit)
    plain = replace(row, unit=since[1] if since else unit)
    axis, plan = axis_of(path, row.name, plain, rows, trusted=True)
    return axis, replace(plan, zero=_instant(path, since[2])) if since else plan


def _instant(path: Path, value: Any) -> datetime:
    """Parse an instant in ISO 8601; without a zone, it is UTC."""
    text = _text(value)
    try:
        instant = datetime.fromisoformat(text.strip().removesuffix("UTC").strip())
    except ValueError as error:
        raise InputError(
            f"{path}: start {text!r}, expected a date and time like 2026-05-01T10:00:00Z"
        ) from error
    return instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant.astimezone(UTC)


def _text(value: Any) -> str:
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    if not isinstance(value, bytes):
        return str(value)
    try:
        return value.decode()
    except UnicodeDecodeError:  # older loggers write the degree sign in Latin-1
        return value.decode("latin-1")
