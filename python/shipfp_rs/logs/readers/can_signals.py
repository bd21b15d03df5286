"""Signals in frames of a CAN bus, defined by a DBC or by the engine messages of SAE J1939, decoded as whole arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers.long_table import Series, log_of_series
from shipfp_rs.logs.readers.time_cells import EPOCH
from shipfp_rs.support.files import words_of

SPECIAL = 0xFB
"""A J1939 number whose highest byte is at least this is a code, not a value: parameter specific, reserved, error, not
available.
"""
ECHO_S = 5e-3
"""Longest time between a frame and its echo on another interface."""
EPOCH_S = 9.4e8
"""Time stamps above this are seconds since 1970."""


@dataclass(frozen=True)
class Frames:
    """Frames of a bus in order of time; payloads are padded with zeros."""

    time_s: npt.NDArray[np.float64]
    identifier: npt.NDArray[np.uint32]
    extended: npt.NDArray[np.bool_]
    data: npt.NDArray[np.uint8]
    length: npt.NDArray[np.int64]
    bus: npt.NDArray[np.str_]
    """Interface or channel of the bus."""

    @classmethod
    def of(cls, *columns: Any) -> Frames:
        """Make frames from columns of any type, in the order of the fields."""
        kinds = (np.float64, np.uint32, np.bool_, np.uint8, np.int64, np.str_)
        return cls(*(np.asarray(column, dtype=kind) for column, kind in zip(columns, kinds, strict=True)))

    def take(self, rows: npt.NDArray[np.intp]) -> Frames:
        """Frames of some rows."""
        return Frames(*(getattr(self, each.name)[rows] for each in fields(self)))


@dataclass(frozen=True)
class Signal:
    """Signal in a payload: value = scale * raw + offset."""

    name: str
    unit: str
    start: int
    length: int
    scale: float = 1.0
    offset: float = 0.0
    little: bool = True
    signed: bool = False
    is_float: bool = False
    selector: Signal | None = None
    selected: tuple[int, ...] = ()
    """For a multiplexed signal: `selector` is the multiplexer, `selected` has its values for which the signal is
    present.
    """

    @property
    def first_bit(self) -> int:
        """First bit, counted from the lowest bit of the first byte, or from its highest if `little` is false."""
        return self.start if self.little else 8 * (self.start // 8) + 7 - self.start % 8

    def raw(self, data: npt.NDArray[np.uint8]) -> npt.NDArray[Any]:
        """Recorded integers (or floats) of payloads, shape (N, bytes)."""
        end = self.first_bit + self.length
        part = data[:, self.first_bit // 8 : (end - 1) // 8 + 1]
        part, shift = (part, self.start % 8) if self.little else (part[:, ::-1], -end % 8)
        value = np.zeros(len(data), dtype=np.uint64)
        for k in range(min(part.shape[1], 8)):
            value |= part[:, k].astype(np.uint64) << np.uint64(8 * k)
        value >>= np.uint64(shift)
        if part.shape[1] == 9:
            value |= part[:, 8].astype(np.uint64) << np.uint64(64 - shift)
        if self.length < 64:
            value &= np.uint64((1 << self.length) - 1)
        if self.is_float:
            return value.astype(f"u{self.length // 8}").view(f"f{self.length // 8}")
        if self.signed:
            lift = np.int64(64 - self.length)
            return (value.view(np.int64) << lift) >> lift
        return value

    def values(self, data: npt.NDArray[np.uint8], *, j1939: bool) -> npt.NDArray[np.float64]:
        """Values in payloads; NaN for J1939's codes without a value."""
        raw = self.raw(data)
        value = raw.astype(np.float64) * self.scale + self.offset
        if j1939 and self.length > 1 and not self.signed and not self.is_float:
            none = (1 << self.length) - 2 if self.length < 8 else SPECIAL << (self.length - 8)
            value[raw >= np.uint64(none)] = np.nan
        return np.asarray(value)


@dataclass(frozen=True)
class Message:
    """Message of the bus; its frames are found by identifier, or by parameter group (J1939) from any sender."""

    name: str
    identifier: int
    extended: bool
    j1939: bool
    signals: tuple[Signal, ...]

    @property
    def key(self) -> tuple[str, int]:
        """Key by which the frames of the message are selected."""
        if self.j1939:
            return "pgn", int(parameter_group(np.array([self.identifier], dtype=np.uint32))[0])
        return ("extended" if self.extended else "standard"), self.identifier


def parameter_group(identifier: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint32]:
    """Parameter group (J1939) of 29-bit identifiers; for PDU formats below 240, the PDU-specific byte is an address."""
    pgn = (identifier >> 8) & 0x3FFFF
    return np.where(((identifier >> 16) & 0xFF) < 240, pgn & 0x3FF00, pgn)


def _requests(signals: Sequence[Signal]) -> Iterator[Signal]:
    """Signals of TSC1 by override mode: speed control (1), torque control (2), or limits of both (3)."""
    mode = Signal("EngOverrideCtrlMode", "", 0, 2)
    for signal in signals:
        asked = {(8, 16): 1, (24, 8): 2}.get((signal.start, signal.length))
        if asked is None or signal.selector is not None:
            yield signal
        else:
            yield replace(signal, selector=mode, selected=(asked,))
            yield replace(signal, name=f"{signal.name}Limit", selector=mode, selected=(3,))


BUS_SIGNALS = words_of("bus_signals")


def _of_j1939() -> Iterator[Message]:
    for each in BUS_SIGNALS["j1939"]:
        signals = [Signal(*row) for row in each["signals"]]
        signals = [*_requests(signals)] if each["name"] == "TSC1" else signals
        yield Message(each["name"], each["identifier"], True, True, tuple(signals))


J1939 = tuple(_of_j1939())
"""Set point, speed, torque, load, fuel and boost of an engine by SAE J1939-71; TSC1 is the first."""


def messages_of(path: Path, names: str | None) -> tuple[Message, ...]:
    """Messages of a DBC (or ARXML, KCD, SYM), or J1939's engine messages without one."""
    if names is None:
        return J1939
    try:
        import cantools
    except ImportError as error:
        raise InputError(
            f"{path}: reading {names} needs the optional package cantools; pip install 'shipfp_rs[can]'"
        ) from error
    if not Path(names).is_file():
        raise InputError(f"{names}: no such file, expected the DBC of {path}")
    try:
        base: Any = cantools.database.load_file(names, strict=False)
        definitions = list(base.messages)
    except Exception as error:  # each file format raises different errors
        raise InputError(f"{names}: can't be read as a DBC: {' '.join(str(error).split())[:300]}") from error
    kind = getattr(getattr(base, "dbc", None), "attributes", None) or {}
    all_j1939 = "J1939" in str(getattr(kind.get("ProtocolType"), "value", ""))
    found = []
    for each in definitions:
        j1939 = bool(each.is_extended_frame and (all_j1939 or each.protocol == "j1939"))
        message = Message(
            each.name, each.frame_id, bool(each.is_extended_frame), j1939, tuple(_signals(each))
        )
        if message.key == J1939[0].key:
            message = replace(message, signals=tuple(_requests(message.signals)))
        found.append(message)
    return tuple(found)


def _signals(message: Any) -> Iterator[Signal]:
    by_name = {signal.name: signal for signal in message.signals}
    for signal in message.signals:
        own = _signal(signal)
        if signal.multiplexer_signal and signal.multiplexer_ids:
            selector = _signal(by_name[signal.multiplexer_signal])
            own = replace(own, selector=selector, selected=tuple(signal.multiplexer_ids))
        yield own


def _signal(signal: Any) -> Signal:
    place = (signal.start, signal.length, float(signal.scale), float(signal.offset))
    kind = (signal.byte_order == "little_endian", bool(signal.is_signed), bool(signal.is_float))
    return Signal(signal.name, signal.unit or "", *place, *kind)


def log_of_frames(path: Path, frames: Frames, names: str | None, zero: datetime | None = None) -> Log:
    """Log with a channel for each signal of a bus, on an even grid at the rate of its message; the resolution is one bit."""
    messages = messages_of(path, names)
    if not len(frames.time_s):
        raise InputError(f"{path}: no frames in it")
    frames = frames.take(np.argsort(frames.time_s, kind="stable"))
    first = float(frames.time_s[0])
    if zero is None and first > EPOCH_S:
        zero = EPOCH + timedelta(microseconds=round(first * 1e6))
    time = frames.time_s - first if first > EPOCH_S else frames.time_s
    found = list(_found(messages, frames))
    if not found:
        raise InputError(f"{path}: {_nothing(frames, names)}")
    series: dict[str, Series] = {}
    for key, rows in found:
        for signal, own in _rows_of(key.message, frames, rows):
            name = _name(key, signal, [other for other, _ in found])
            samples = signal.values(frames.data[own], j1939=key.message.j1939)
            if len(own) > 1 and np.isfinite(samples).any():
                series.setdefault(name, Series(signal.unit, abs(signal.scale), time[own], samples))
    none = f"{', '.join(key.message.name for key, _ in found)} have only the value 'not available'"
    by = (
        f"DBC {Path(names).name}"
        if names
        else "the engine messages of SAE J1939; give a DBC for others (--names)"
    )
    return log_of_series(path, series, [f"signals by {by}"], zero, none=none)


@dataclass(frozen=True)
class Key:
    """Key of a message: bus, message, source address, and destination if the parameter group has one, else -1."""

    bus: str
    message: Message
    source: int = -1
    destination: int = -1


def _name(key: Key, signal: Signal, others: Sequence[Key]) -> str:
    """Name of a signal, prefixed with the parts of its key that distinguish it from signals of the same name."""
    alike = [other for other in others if any(own.name == signal.name for own in other.message.signals)]
    own = [other for other in alike if other.message.key == key.message.key]
    parts = [key.message.name if len({other.message.key for other in alike}) > 1 or len(own) > 1 else ""]
    parts += [f"@{key.source}" if len({other.source for other in own}) > 1 else ""]
    parts += [f">{key.destination}" if len({other.destination for other in own}) > 1 else ""]
    if not any(parts[1:]) and len({other.message.key for other in alike}) == 1:
        parts = []
    buses = f"{key.bus}." if len({other.bus for other in alike}) > 1 else ""
    return f"{buses}{''.join(parts)}.{signal.name}" if any(parts) else f"{buses}{signal.name}"


def _found(messages: Sequence[Message], frames: Frames) -> list[tuple[Key, npt.NDArray[np.intp]]]:
    """Each message by bus, source and destination, with indices of its frames; echoes on other interfaces are left out."""
    found: list[tuple[Key, npt.NDArray[np.intp]]] = []
    groups = parameter_group(frames.identifier)
    for (kind, number), message in {message.key: message for message in messages}.items():
        if kind == "pgn":
            own = np.flatnonzero(frames.extended & (groups == number))
            keys = np.where(number >> 8 & 0xFF < 240, frames.identifier & 0xFFFF, frames.identifier & 0xFF)
        else:
            own = np.flatnonzero((frames.extended == (kind == "extended")) & (frames.identifier == number))
            keys = np.zeros(len(groups), np.uint32)
        for key in np.unique(keys[own]).tolist():
            heard: list[npt.NDArray[np.intp]] = []
            for bus in np.unique(frames.bus[own]).tolist():
                rows = own[(keys[own] == key) & (frames.bus[own] == bus)]
                if not len(rows) or any(_is_echo(frames.take(rows), frames.take(other)) for other in heard):
                    continue
                heard.append(rows)
                address = (key & 0xFF, key >> 8) if kind == "pgn" else ()
                found.append((Key(bus, message, *address), rows))
    return found


def _is_echo(frames: Frames, others: Frames) -> bool:
    """Whether nearly all frames have an equal frame on another bus at nearly the same time."""
    after = np.clip(np.searchsorted(others.time_s, frames.time_s), 1, len(others.time_s) - 1)
    before = frames.time_s - others.time_s[after - 1] < others.time_s[after] - frames.time_s
    nearest = others.take(after - before)
    same = (nearest.data == frames.data).all(axis=1) & (np.abs(nearest.time_s - frames.time_s) < ECHO_S)
    return bool(np.mean(same) > 0.95)


def _rows_of(
    message: Message, frames: Frames, rows: npt.NDArray[np.intp]
) -> Iterator[tuple[Signal, npt.NDArray[np.intp]]]:
    """Signals of a message, each with the indices of the frames that are long enough and have its multiplexer value."""
    for signal in message.signals:
        own = rows[frames.length[rows] * 8 >= signal.first_bit + signal.length]
        if signal.selector is not None and len(own):
            told = signal.selector.raw(frames.data[own])
            own = own[np.isin(told, np.array(signal.selected, dtype=told.dtype))]
        yield signal, own


def _nothing(frames: Frames, names: str | None) -> str:
    seen = np.unique(frames.identifier)
    shown = ", ".join(f"0x{identifier:X}" for identifier in seen[:6].tolist())
    shown += " ..." if len(seen) > 6 else ""
    if names is None:
        return (
            f"none of its {len(seen)} messages ({shown}) is known without a DBC; give one (--names FILE.dbc)"
        )
    return f"none of its {len(seen)} messages ({shown}) stands in {Path(names).name}; give the DBC of this bus (--names)"
