"""Time series of ISO 19848 (JSON, XML or CSV), with names from their data channel list if there is one."""

from __future__ import annotations

import csv
import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.long_table import Series, log_since_1970, seconds_since_1970

Values = Iterator[tuple[str, str, str, str]]
"""Data channel, time stamp, value and quality, as written in the file."""
GOOD = frozenset(("", "0", "192", "good", "ok", "valid", "true"))
"""Quality codes of good values, in ISO 19848 and in OPC."""


@register_reader(".json", ".xml", takes=("names",))
def open_iso19848(path: Path, rate_hz: float | None, names: str | None = None) -> Log:
    """Open a time series package; values of bad quality become gaps, and values that are words are omitted."""
    begin = path.read_text(encoding="utf-8-sig", errors="replace")
    text = begin.lstrip()
    if '"DataChannelList"' in text[:2000] and '"TimeSeriesData"' not in text:
        raise InputError(f"{path}: a data channel list, expected time series; give it with --names")
    of = {"{": _of_json, "<": _of_xml}.get(text[:1], _of_csv)
    listed = _listed(path, names)
    found: dict[str, Series] = {}
    bad = words = 0
    for channel, stamp, value, quality in of(path, text):
        name, unit = listed.get(channel, (channel, ""))
        series = found.setdefault(name, Series(unit))
        try:
            time = seconds_since_1970(stamp)
        except ValueError:
            raise InputError(
                f"{path}: channel {channel!r}: time stamp {stamp!r}, expected one like 2026-05-01T10:00:00Z"
            ) from None
        good = quality.strip().lower() in GOOD
        try:
            number = float(value) if good else float("nan")
        except ValueError:
            words += 1
            continue
        bad += not good
        series.times.append(time)
        series.values.append(number)
    notes = [f"{bad} values of bad quality are gaps"] if bad else []
    notes += [f"{words} values are words and left out"] if words else []
    notes += [] if listed else ["no data channel list; give it with --names to have names and units"]
    return log_since_1970(path, found, notes)


def _row(channels: Sequence[str], stamp: str, values: Sequence[str], qualities: Sequence[str]) -> Values:
    """Yield the values of one time stamp; a missing quality is empty."""
    for channel, value, quality in zip(channels, values, chain(qualities, repeat("")), strict=False):
        yield channel, stamp, value, quality


def _items(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [] if value is None else [value]


def _of_json(path: Path, text: str) -> Values:
    try:
        series = _items(json.loads(text)["Package"]["TimeSeriesData"])
    except (ValueError, KeyError, TypeError) as error:
        reason = f"no Package.TimeSeriesData ({error})"
        raise InputError(
            f"{path}: {reason}; expected time series of ISO 19848, or lines of canboat"
        ) from error
    for part in series:
        for table in _items(part.get("TabularData")):
            channels = [str(channel) for channel in _items(table.get("DataChannelID"))]
            for row in _items(table.get("DataSet")):
                values = [str(value) for value in _items(row.get("Value"))]
                if len(values) != len(channels):
                    raise InputError(
                        f"{path}: {len(values)} values at {row.get('TimeStamp')}, expected {len(channels)}, one a channel"
                    )
                qualities = [str(quality) for quality in _items(row.get("Quality"))]
                yield from _row(channels, str(row["TimeStamp"]), values, qualities)
        for row in _items((part.get("EventData") or {}).get("DataSet")):
            quality = str(row.get("Quality", ""))
            yield str(row["DataChannelID"]), str(row["TimeStamp"]), str(row["Value"]), quality


def _local(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _texts(element: ElementTree.Element, name: str) -> list[str]:
    return [(child.text or "").strip() for child in element if _local(child) == name]


def _of_xml(path: Path, text: str) -> Values:
    if re.search(r"<!(?:DOCTYPE|ENTITY)", text):
        raise InputError(
            f"{path}: declares XML entities, which are not allowed; expected a time series of ISO 19848"
        )
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: no XML: {error}") from error
    tables = [item for item in root.iter() if _local(item) == "TabularData"]
    events = [item for item in root.iter() if _local(item) == "EventData"]
    if not tables and not events:
        raise InputError(f"{path}: neither TabularData nor EventData, expected time series of ISO 19848")
    for table in (*tables, *events):
        channels = _texts(table, "DataChannelID")
        for row in table:
            if _local(row) == "DataSet":
                stamp = row.get("timeStamp") or next(iter(_texts(row, "TimeStamp")), "")
                named = channels or _texts(row, "DataChannelID")[:1]  # each event has the name of its channel
                yield from _row(named, stamp, _texts(row, "Value"), _texts(row, "Quality"))


def _of_csv(path: Path, text: str) -> Values:
    """Yield the values of the rows below the row with the data channels' names."""
    delimiter = ";" if text.count(";") > text.count(",") else ","
    channels: list[str] = []
    quality_of: dict[int, int] = {}
    for row in csv.reader(text.splitlines(), delimiter=delimiter):
        cells = [cell.strip() for cell in row]
        if cells and re.sub(r"[\s_]", "", cells[0]).lower() in ("timestamp", "datachannelid"):
            channels = cells
            quality_of = {
                k - 1: k for k, cell in enumerate(cells) if k and cell.lower().startswith("quality")
            }
        elif channels and cells and re.match(r"\d{4}-\d\d-\d\dT", cells[0]):
            for k, (channel, value) in enumerate(zip(channels[1:], cells[1:], strict=False), 1):
                if k not in quality_of.values() and value:
                    place = quality_of.get(k, len(cells))
                    yield channel, cells[0], value, "".join(cells[place : place + 1])
    if not channels:
        raise InputError(
            f"{path}: no row that begins with TimeStamp and names the channels; expected CSV of ISO 19848"
        )


def _listed(path: Path, names: str | None) -> dict[str, tuple[str, str]]:
    """Name and unit of each short and local identifier in a data channel list (JSON or XML)."""
    if names is None:
        return {}
    try:
        text = Path(names).read_text(encoding="utf-8-sig").lstrip()
        entries = list(_listed_json(text) if text.startswith("{") else _listed_xml(text))
    except (OSError, ValueError, KeyError, TypeError, ElementTree.ParseError) as error:
        raise InputError(
            f"{names}: can't be read as a data channel list: {error}; expected that of {path}"
        ) from error
    found: dict[str, tuple[str, str]] = {}
    seen: dict[str, int] = {}
    for short, local, name, unit in entries:
        seen[name] = seen.get(name, 0) + 1
        label = name.strip() or local or short
        told = (label if seen[name] == 1 else f"{label} ({short})", unit)
        found |= {key: told for key in (short, local) if key}
    return found


def _listed_json(text: str) -> Iterator[tuple[str, str, str, str]]:
    for channel in _items(json.loads(text)["Package"]["DataChannelList"]["DataChannel"]):
        identity, about = channel["DataChannelID"], channel.get("Property", {})
        unit = (about.get("Unit") or {}).get("UnitSymbol", "")
        told = (identity.get("ShortID", ""), identity.get("LocalID", ""), about.get("Name") or "", unit)
        short, local, name, unit = map(str, told)
        yield short, local, name, unit


def _listed_xml(text: str) -> Iterator[tuple[str, str, str, str]]:
    if re.search(r"<!(?:DOCTYPE|ENTITY)", text):
        raise ValueError("it declares entities")
    for channel in ElementTree.fromstring(text).iter():
        if _local(channel) != "DataChannel":
            continue
        told = {_local(item): (item.text or "").strip() for item in channel.iter()}
        short, local, name, unit = (told.get(key, "") for key in ("ShortID", "LocalID", "Name", "UnitSymbol"))
        yield short, local, name, unit
