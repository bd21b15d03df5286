"""NMEA 2000 logs of canboat: lines of raw messages, or one JSON object per line."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.can_signals import BUS_SIGNALS, Signal
from shipfp_rs.logs.readers.long_table import Series, log_since_1970, seconds_since_1970

FAST = frozenset((127489, 127496, 127497, 127498, 129029))
"""Parameter groups whose messages have several frames."""
GROUPS: dict[int, tuple[int | None, list[Signal]]] = {
    each["group"]: (each.get("instance"), [Signal(*row) for row in each["signals"]])
    for each in BUS_SIGNALS["nmea2000"]
}
"""Index of the instance byte, and fields, of the parameter groups of the drive train and the ship."""
UNITS = {signal.name.lower(): signal for _, signals in GROUPS.values() for signal in signals}
JSON_NAMES = {
    "speed": "Engine Speed",
    "enginespeed": "Engine Speed",
    "boostpressure": "Engine Boost Pressure",
}
"""Alternative names for fields of parameter group 127488."""
PLAIN = re.compile(r"[\d-]{10}[T-][\d:.]+Z?,\d+,(\d+),(\d+),\d+,\d+,")


@register_reader(".jsonl")
def open_nmea2000(path: Path, rate_hz: float | None) -> Log:
    """Open a canboat log; instance and sender are appended to the name of a field that occurs several times."""
    found: dict[tuple[str, int, int], Series] = defaultdict(Series)
    unread = 0
    for number, line in enumerate(path.read_text(encoding="utf-8-sig", errors="replace").splitlines(), 1):
        text = line.strip()
        if not text or text.startswith(("#", '{"version"')):
            continue
        try:
            fields = list(_of_json(text) if text.startswith("{") else _of_plain(text, found))
        except (ValueError, KeyError, TypeError, AttributeError):
            unread += 1
            if unread > 10 and unread > number // 10:
                raise InputError(
                    f"{path}: line {number} holds {text[:60]!r}, expected a line of canboat: "
                    "time,priority,group,sender,receiver,length,bytes"
                ) from None
            continue
        for name, unit, resolution, instance, sender, time, value in fields:
            series = found[name, instance, sender]
            series.unit, series.resolution = unit, resolution
            series.times.append(time)
            series.values.append(value)
    notes = ["fields of NMEA 2000 as canboat names them"]
    if unread:
        notes.append(f"{unread} lines are no messages and left out")
    return log_since_1970(path, _named({key: each for key, each in found.items() if key[0]}), notes)


def _named(found: dict[tuple[str, int, int], Series]) -> dict[str, Series]:
    """Series by name; instance and sender are appended if a name occurs several times."""
    named = {}
    for (name, instance, sender), series in found.items():
        others = [key for key in found if key[0] == name]
        instances = {key[1] for key in others}
        senders = {key[2] for key in others if key[1] == instance}
        full = name + (f" {instance}" if len(instances) > 1 else "")
        named[full + (f" from {sender}" if len(senders) > 1 else "")] = series
    return named


Field = tuple[str, str, float, int, int, float, float]
"""Name, unit, resolution, instance, sender, time, value."""


def _of_plain(text: str, found: dict[Any, Series]) -> Iterator[Field]:
    """Decode a line of raw bytes."""
    stamp, _, group, sender, _, _, *data = text.split(",")
    pgn = int(group)
    if pgn not in GROUPS:
        return
    payload = np.array([int(byte, 16) for byte in data], dtype=np.uint8)
    if pgn in FAST and len(payload) == 8:
        whole = _assembled(found, pgn, int(sender), payload)
        if whole is None:
            return
        payload = whole
    place, signals = GROUPS[pgn]
    instance = int(payload[place]) if place is not None else 0
    time = seconds_since_1970(stamp)
    for signal in signals:
        if signal.start + signal.length > 8 * len(payload):
            continue
        raw = int(signal.raw(payload[None, :])[0])
        top = (1 << (signal.length - 1 if signal.signed else signal.length)) - 1
        # The highest values mean "not available" and "error".
        known = raw < top - 1 if signal.length > 4 else raw < top
        value = raw * signal.scale + signal.offset if known else np.nan
        yield signal.name, signal.unit, signal.scale, instance, int(sender), time, value


def _assembled(found: dict[Any, Series], pgn: int, sender: int, frame: Any) -> Any:
    """Assemble the frames of a multi-frame message; None until it is complete."""
    held = found["", pgn, sender]
    order, count = int(frame[0]) >> 5, int(frame[0]) & 31
    if count == 0:
        held.values = [float(order), float(frame[1]), *frame[2:].astype(float)]
    elif held.values and held.values[0] == order and len(held.values) == 2 + 6 + 7 * (count - 1):
        held.values += frame[1:].astype(float).tolist()
    else:
        held.values = []
    if held.values and len(held.values) - 2 >= held.values[1]:
        return np.array(held.values[2 : 2 + int(held.values[1])], dtype=np.uint8)
    return None


def _of_json(text: str) -> Iterator[Field]:
    """Decode a line of canboat's analyzer."""
    told = json.loads(text)
    fields = told["fields"]
    time = seconds_since_1970(told["timestamp"])
    place = next((fields[key] for key in ("Instance", "instance", "Engine Instance") if key in fields), "")
    instance = _number(place)
    which = int("starboard" in str(place).lower()) if instance is None else int(instance)
    for name, value in fields.items():
        number = _number(value)
        if number is None or "instance" in name.lower() or name == "SID":
            continue
        own = JSON_NAMES.get(re.sub(r"[\s_]", "", name).lower(), name) if told["pgn"] == 127488 else name
        known = UNITS.get(own.lower(), Signal(own, "", 0, 0, 0.0))
        yield known.name, known.unit, known.scale, which, int(told.get("src", 0)), time, number


def _number(value: Any) -> float | None:
    if isinstance(value, dict):
        value = value.get("value")
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
