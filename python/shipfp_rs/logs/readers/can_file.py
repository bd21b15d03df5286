"""Logs of a CAN bus (.blf, .asc, .trc, candump), read by python-can; cantools reads the DBC."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log, register_reader
from shipfp_rs.logs.readers.can_signals import Frames, log_of_frames
from shipfp_rs.logs.readers.child_process import in_child

WIDEST = 64
"""Bytes of the longest CAN FD frame."""


@register_reader(".blf", ".trc", takes=("names",))
@in_child("can", extra="can")
def open_can(path: Path, rate_hz: float | None, names: str | None = None) -> Log:
    """Open a log of frames; each signal of the DBC, or of J1939's engine messages, becomes a channel."""
    times, identifiers, extended, payloads = [], [], [], []
    for message in _reader(path):
        if message.is_error_frame or message.is_remote_frame:
            continue
        times.append(message.timestamp)
        identifiers.append(message.arbitration_id)
        extended.append(message.is_extended_id)
        payloads.append(bytes(message.data))
    width = max(8, max(map(len, payloads), default=0))
    data = np.frombuffer(b"".join(part.ljust(width, b"\0") for part in payloads), dtype=np.uint8)
    frames = Frames(
        np.array(times, dtype=np.float64),
        np.array(identifiers, dtype=np.uint32),
        np.array(extended, dtype=np.bool_),
        data.reshape(-1, width),
        np.array([len(part) for part in payloads], dtype=np.int64),
    )
    return log_of_frames(path, frames, names)


def _reader(path: Path) -> Any:
    import can

    with path.open("rb") as file:
        begin = file.read(200)
    if begin.startswith(b"LOGG"):
        return can.BLFReader(path)
    if begin.lstrip().startswith(b";$FILEVERSION") or path.suffix.lower() == ".trc":
        return can.TRCReader(path)
    if begin.lstrip()[:4].lower() == b"date":
        return can.ASCReader(path, relative_timestamp=False)
    if begin.lstrip().startswith(b"("):
        return can.CanutilsLogReader(path)
    raise InputError(
        f"{path}: not a CAN log of a supported format: expected BLF, Vector ASC, PEAK TRC or candump"
    )
