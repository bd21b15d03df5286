"""Several files as one log: pieces that a logger cut one recording into, or loggers that share one clock."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Blocks, Channel, Samples
from shipfp_rs.logs.faults.clock import FILL
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.log import Log, register_joiner
from shipfp_rs.support.sentences import Sentence

RATES_AGREE = 1e-4
"""Two pieces have the same rate where their rates, each estimated from its own times, differ by less, relative."""
LONGEST_GAP = 100.0
"""With more missing samples per recorded one two pieces are taken for two recordings."""


@register_joiner("pattern")
def open_pattern(path: Path, **options: Any) -> Log:
    """Open all files of a pattern such as run_*.csv as one log; see `join`."""
    found = sorted(path.parent.glob(path.name), key=_natural)
    if not found:
        raise InputError(f"{path}: no file of this pattern")
    return join([Log.open(file, **options) for file in found], name=str(path))


def _natural(path: Path) -> list[tuple[int, str]]:
    """Order of names in which run_2 comes before run_10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def join(logs: Sequence[Log], name: str = "") -> Log:
    """Join pieces of one recording, one after the other.

    They stand at their own times where every piece tells when it began, or where the time goes on from piece to piece;
    missing stretches are NaN. Pieces that all begin at the same time count for themselves: they follow one another in
    the order given, which is told.

    Parameters
    ----------
    logs
        Pieces with the same channels.
    name
        Of the log; the first piece's by default.

    Raises
    ------
    InputError
        Where a piece lacks a channel, has another unit or rate, or begins before the one before it has ended.
    """
    if len(logs) == 1:
        return logs[0]
    first = logs[0]
    for log in logs[1:]:
        _require_same(first, log)
    offsets, told = _offsets(logs)
    order = sorted(range(len(logs)), key=offsets.__getitem__)
    logs, offsets = [logs[k] for k in order], [offsets[k] for k in order]
    first = logs[0]
    channels: list[Channel] = []
    pieces: dict[str, list[tuple[int, Log]]] = {}
    gaps: list[Fault] = []
    for own in first.channels.values():
        rate = float(np.median([log.channels[own.name].rate_hz for log in logs]))
        start_s = own.start_s + offsets[0]
        placed: list[tuple[int, Log]] = []
        end = 0
        holes: list[tuple[int, int]] = []
        for log, offset in zip(logs, offsets, strict=True):
            piece = log.channels[own.name]
            at = round((piece.start_s + offset - start_s) * rate)
            if abs(at - end) <= 1:
                at = end  # clocks are not exact to a sample
            if at < end:
                raise InputError(
                    f"{log.name}: channel {own.name!r} begins {(end - at) / rate:g} s before the piece before it has ended; "
                    "are these pieces of one recording?"
                )
            if at - end > LONGEST_GAP * max(piece.samples, end):
                raise InputError(
                    f"{log.name}: begins {(at - end) / rate:.4g} s after the piece before it; open it alone"
                )
            if at > end:
                holes.append((end, at))
            placed.append((at, log))
            end = at + piece.samples
        channels.append(replace(own, rate_hz=rate, start_s=start_s, samples=end))
        pieces[own.name] = placed
        if holes:
            gaps.append(Fault("time_gap", own.name, Sentence("masked: between two files"), np.array(holes)))
    notes = (
        f"{len(logs)} files as one: {', '.join(Path(log.name).name for log in logs)}{told}",
        *first.notes,
    )
    start_utc = None if first.start_utc is None else first.start_utc - timedelta(seconds=offsets[0])
    return Log(name or first.name, channels, _blocks_of(pieces), start_utc, tuple(gaps), notes)


def _require_same(first: Log, other: Log) -> None:
    if first.channels.keys() != other.channels.keys():
        odd = sorted(first.channels.keys() ^ other.channels.keys())
        raise InputError(
            f"{other.name}: channels {', '.join(odd)} are not in both it and {first.name}; expected the same ones"
        )
    for one, two in zip(
        first.channels.values(), (other.channels[name] for name in first.channels), strict=True
    ):
        if one.unit != two.unit or abs(one.rate_hz / two.rate_hz - 1.0) > RATES_AGREE:
            raise InputError(
                f"{other.name}: channel {one.name!r} is in {two.unit!r} at {two.rate_hz:g} Hz, in {first.name} in "
                f"{one.unit!r} at {one.rate_hz:g} Hz; expected pieces of one recording"
            )


def _offsets(logs: Sequence[Log]) -> tuple[list[float], str]:
    """Seconds to add to the times of each piece, and a note on what was assumed."""
    stamps = [log.start_utc for log in logs if log.start_utc is not None]
    if len(stamps) == len(logs):
        zero = min(stamps)
        return [(stamp - zero).total_seconds() for stamp in stamps], ""
    spans = [
        (min(c.start_s for c in log.channels.values()), max(c.stop_s for c in log.channels.values()))
        for log in logs
    ]
    step = max(1.0 / min(c.rate_hz for c in log.channels.values()) for log in logs)
    ordered = sorted(spans)
    if all(after[0] >= before[1] - 1.5 * step for before, after in pairwise(ordered)):
        return [0.0] * len(logs), ""
    if max(begin for begin, _ in spans) - min(begin for begin, _ in spans) > step:
        raise InputError(
            f"{logs[0].name}: the times of its {len(logs)} files overlap; expected pieces of one recording, or stamps"
        )
    offsets, end = [], spans[0][0]
    for begin, stop in spans:
        offsets.append(end - begin)
        end += stop - begin
    return offsets, "; each counts from its own beginning: taken as back to back in this order"


def _blocks_of(pieces: dict[str, list[tuple[int, Log]]]) -> Blocks:
    def read(channel: str, first: int, size: int) -> Iterator[Samples]:
        at = first
        for start, log in pieces[channel]:
            while at < start:
                yield np.full(min(start - at, size, FILL), np.nan)
                at += min(start - at, size, FILL)
            if at < start + log.channels[channel].samples:
                for block in log.raw_blocks(channel, at - start, size):
                    yield block
                    at += len(block)

    return read


@register_joiner("merge")
def merge(logs: Sequence[Log], name: str = "") -> Log:
    """Merge logs of loggers that share one clock: their channels side by side, by the time stamps of the files.

    Parameters
    ----------
    logs
        Either all logs have a date, or none has; without dates their times are taken for those of one clock.
        A channel name that several logs have gets the file's name in front.
    name
        Of the log; the first one's by default.

    Raises
    ------
    InputError
        Where some logs have a date and others do not, or the recordings do not overlap in time.
    """
    if len(logs) == 0:
        raise InputError("merge: no log, expected two or more")
    dated = [log for log in logs if log.start_utc is not None]
    if dated and len(dated) < len(logs):
        bare = next(log for log in logs if log.start_utc is None)
        raise InputError(
            f"{bare.name}: tells no date where {dated[0].name} does; align them by a common channel ([align] common)"
        )
    zero = min((log.start_utc for log in logs if log.start_utc), default=None)
    counts: dict[str, int] = {}
    for log in logs:
        for label in log.channels:
            counts[label] = counts.get(label, 0) + 1
    channels: list[Channel] = []
    source: dict[str, tuple[Log, str]] = {}
    spans: list[tuple[float, float]] = []
    for log in logs:
        later = (log.start_utc - zero).total_seconds() if zero and log.start_utc else 0.0
        for channel in log.channels.values():
            full = channel.name if counts[channel.name] == 1 else f"{Path(log.name).stem}/{channel.name}"
            channels.append(replace(channel, name=full, start_s=channel.start_s + later))
            source[full] = (log, channel.name)
        own = channels[-len(log.channels) :]
        spans.append((min(c.start_s for c in own), max(c.stop_s for c in own)))
    if max(begin for begin, _ in spans) >= min(end for _, end in spans):
        raise InputError(
            f"{logs[0].name}: the logs do not overlap in time ({'; '.join(f'{a:g} to {b:g} s' for a, b in spans)}); do they "
            "share a clock? Else align them by a common channel ([align] common)"
        )

    def blocks(channel: str, first: int, size: int) -> Iterator[Samples]:
        log, own = source[channel]
        return log.raw_blocks(own, first, size)

    by = "time stamps" if zero else "times"
    notes = (
        f"{', '.join(Path(log.name).name for log in logs)} merged by their {by}",
        *(n for log in logs for n in log.notes),
    )
    faults = tuple(fault for log in logs for fault in log.faults)
    return Log(name or logs[0].name, channels, blocks, zero, faults, notes)
