"""Logs of a CAN bus (.blf, .asc, .trc, candump), read by python-can; cantools reads the DBC."""

from __future__ import annotations

import io
import re
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.can_signals import Frames, log_of_frames
from shipfp_rs.logs.readers.child_process import in_child
from shipfp_rs.logs.readers.long_table import seconds_since_1970

CONSOLE = re.compile(
    r"\s*\((?P<time>[^)]+)\)\s+(?P<bus>\S+)(?:\s+[RT]X\b[ \-BE]*)?\s+(?P<id>[0-9A-Fa-f]{3,8})"
    r"\s+\[\d+\]\s+(?P<data>(?:[0-9A-Fa-f]{2}\s+)+)"
)
"""Pattern of a frame as candump prints it on a console."""
BACK = 0.1
"""If more than this fraction of lines has an earlier time than the line before, all times are differences (candump
-td).
"""
STAMP = re.compile(r"\s*(\d+\.\d+)(?=\s)")
"""Pattern of the time stamp in a line of Vector ASC."""


@register_reader(".blf", ".trc", takes=("names",))
@in_child("can", extra="can")
def open_can(path: Path, rate_hz: float | None, names: str | None = None) -> Log:
    """Open a CAN log; each signal of the DBC, or of J1939's engine messages, becomes a channel."""
    times, identifiers, extended, payloads, buses = [], [], [], [], []
    for message in _reader(path):
        if message.is_error_frame or message.is_remote_frame:
            continue
        times.append(message.timestamp)
        identifiers.append(message.arbitration_id)
        extended.append(message.is_extended_id)
        payloads.append(bytes(message.data))
        buses.append(str(message.channel))
    width = max(8, max(map(len, payloads), default=0))
    data = np.frombuffer(b"".join(part.ljust(width, b"\0") for part in payloads), dtype=np.uint8)
    lengths = [len(part) for part in payloads]
    frames = Frames.of(times, identifiers, extended, data.reshape(-1, width), lengths, buses)
    return log_of_frames(path, frames, names)


def _reader(path: Path) -> Any:
    import can

    with path.open("rb") as file:
        begin = file.read(200)
    if begin.startswith(b"LOGG"):
        return can.BLFReader(path)
    if begin.lstrip().startswith(b";$FILEVERSION") or path.suffix.lower() == ".trc":
        return can.TRCReader(path)
    text = path.read_text(encoding="utf-8", errors="replace")
    if begin.lstrip()[:4].lower() == b"date":
        return can.ASCReader(io.StringIO(_absolute(text)), relative_timestamp=False)
    if begin.lstrip().startswith(b"("):
        return can.CanutilsLogReader(io.StringIO(_logged(path, text)))
    raise InputError(
        f"{path}: not a CAN log of a supported format: expected BLF, Vector ASC, PEAK TRC or candump"
    )


def _absolute(text: str) -> str:
    """Return the text of a Vector ASC file with times since the start; times relative to the line before are accumulated."""
    lines = text.splitlines()
    if not any(re.match(r"base\s+\w+\s+timestamps\s+relative", line.strip()) for line in lines[:5]):
        return text
    stamps = [STAMP.match(line) for line in lines]
    times = accumulate(float(stamp[1]) if stamp else 0.0 for stamp in stamps)
    return "\n".join(
        f"{time:.6f}{line[stamp.end() :]}" if stamp else line
        for line, stamp, time in zip(lines, stamps, times, strict=True)
    )


def _logged(path: Path, text: str) -> str:
    """Return the text of a candump log; console output is converted to candump's log format."""
    lines = text.splitlines()
    shown = [CONSOLE.match(f"{line} ") for line in lines]
    if not any(shown[:20]):
        return text
    stamps = [each["time"] for each in shown if each]
    try:
        times = [float(t) if re.fullmatch(r"[\d.]+", t) else seconds_since_1970(t) for t in stamps]
    except ValueError as error:
        raise InputError(f"{path}: {error}, expected seconds or a date with a time (candump -tA)") from None
    if np.count_nonzero(np.diff(times) < 0.0) > BACK * len(times):
        times = list(accumulate(times))
    frames = [each for each in shown if each]
    return "\n".join(
        f"({time:.6f}) {each['bus']} {each['id']}#{'#0' * (len(each['data'].split()) > 8)}{''.join(each['data'].split())}"
        for time, each in zip(times, frames, strict=True)
    )
