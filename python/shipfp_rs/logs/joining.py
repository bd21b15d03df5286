"""Joins files of one recording, merges loggers with a common clock, and finds the rate of rows behind a coarse clock."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Blocks, Channel, Samples, first_of, with_nan
from shipfp_rs.logs.faults.clock import Segment, laid_out
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.log import Log
from shipfp_rs.support.arrays import Array, even_parts, runs
from shipfp_rs.support.sentences import Sentence

Rows = npt.NDArray[np.int64]

UNEVEN_TICKS = 0.01
"""Ticks (clock steps) count as equal if all are multiples of the shortest tick, within this fraction of the shortest."""
USUAL = 0.9
"""Ticks with fewer rows than usual lack rows only if at least this fraction of the ticks has the usual number."""
WITHIN = 1.05
"""Largest deviation [rows] of evenly spaced rows from a line through the first rows of their ticks."""
EARLY = 0.25
"""Fraction of a tick by which the time stamps of rows may be early or late."""


@dataclass(frozen=True)
class CoarseClock:
    """Evenly spaced rows under a coarse clock."""

    rate_hz: float
    """Rate of the rows [Hz]: the number with the fewest digits that is consistent with the ticks."""
    resolution_s: float
    """Length of a tick [s]."""
    times: Array
    """Time of every row [s], to within one row; the time jumps where rows are missing or the clock was set."""
    jumps: bool
    """Whether rows are missing or the clock was set."""
    masked: Rows
    """Rows [first, stop) with unknown times, since other rows of their tick are missing; shape (K, 2)."""


def find_coarse(times: Array) -> CoarseClock | None:
    """Return the clock of evenly spaced rows with coarse, and so repeated, times; None if the rows are not evenly spaced."""
    steps = np.diff(times)
    rises = np.flatnonzero(steps != 0.0) + 1
    if len(rises) < 3 or not (steps > 0.0).any():
        return None
    tick = float(steps[steps > 0.0].min())
    passed = steps[rises - 1] / tick
    alike = np.abs(passed - np.rint(passed)).max() < UNEVEN_TICKS
    if not alike:  # missing rows can't be found among ticks of different lengths
        return _through(times, rises, tick, [])
    slips, early = _slips(np.rint(passed), np.diff(rises))
    # If some time stamps are early, a tick with fewer rows need not lack any: first try a single line through all rows.
    return (_through(times, rises, tick, []) if early else None) or _through(times, rises, tick, slips)


def _through(times: Array, rises: Rows, tick: float, slips: Sequence[_Slip]) -> CoarseClock | None:
    """Fit evenly spaced rows to all changes of the clock except at slips; None if the rows are not evenly spaced."""
    ends = [0, *(k for slip in slips for k in (slip.before, slip.behind)), len(rises) - 1]
    spans = rises[np.reshape(ends, (-1, 2))]
    count = int(np.diff(spans).sum())
    period = float(np.diff(times[spans]).sum()) / count if count else 0.0
    if not period > 0.0:
        return None
    known = 1.5 / count  # times are accurate to one row; take the rate with the fewest digits
    rate = next(
        rounded
        for digits in range(1, 13)
        if abs((rounded := float(f"{1.0 / period:.{digits}g}")) * period - 1.0) <= known
    )
    # The first row of a tick is less than one sample interval after the clock's change; a tenth of them may be early.
    behind = times[rises] - rises / rate
    levels = [
        float(np.quantile(behind[first : stop + 1], 0.9, method="higher"))
        for first, stop in np.reshape(ends, (-1, 2))
    ]
    breaks = [int(rises[slip.at]) for slip in slips]
    row = np.arange(len(times))
    found = np.asarray(levels)[np.searchsorted(breaks, row, side="right")] + row / rate
    masked = [_rows(slip, rises, len(times)) for slip in slips if slip.hides]
    off = times - found
    for slip in slips:
        off[slice(*_rows(slip, rises, len(times)))] = np.nan
    if np.isnan(off).all() or not np.nanmax(off) - np.nanmin(off) <= 1.02 * tick + 2.0 / rate:
        return None
    return CoarseClock(rate, tick, found, bool(slips), np.reshape(masked, (-1, 2)).astype(np.int64))


class _Slip(NamedTuple):
    """A slip (missing rows, or a clock that was set): indices of the last clock change before and the first after it."""

    before: int
    behind: int
    at: int
    """Index of the clock change at which the rows after the slip begin."""
    hides: bool
    """Whether the times of the rows between `before` and `behind` are unknown."""


def _rows(slip: _Slip, rises: Rows, count: int) -> tuple[int, int]:
    """Rows [first, stop) of a slip; near an end of the file, where the tick is incomplete, all rows up to that end."""
    first = 0 if slip.before == 0 else int(rises[slip.before])
    return first, count if slip.behind == len(rises) - 1 else int(rises[slip.behind])


def _rows_a_tick(counts: Rows) -> float:
    """Number of rows in a complete tick: the median number if all other ticks lack rows, else the mean number."""
    if not len(counts):
        return np.nan
    usual = float(np.median(counts))
    near = counts[np.abs(counts - usual) <= 2.0]
    mean = float(near.mean()) if len(near) else usual
    fewer = float((usual - near).sum())
    if fewer >= 2.0:  # with a fractional number of rows per tick, shorter ticks recur at even intervals
        walk, slopes = np.cumsum(near - mean)[:, None], np.linspace(-1.0, 1.0, 41) / len(near)
        if np.ptp(walk + np.arange(len(near))[:, None] * slopes, axis=0).min() <= WITHIN:
            return mean
    return mean if fewer < 0.0 or np.mean(counts == usual) < USUAL else usual


def _slips(passed: Array, counts: Rows) -> tuple[list[_Slip], bool]:
    """Find the slips by the ticks and rows between changes of the clock; also return whether some time stamps are early."""
    steps = passed[1:]
    usual = _rows_a_tick(counts[steps == 1.0])
    lacking = usual * steps - counts
    # A tick of the clock with a few rows more than usual shows by how many rows time stamps are early or late.
    more = -lacking[(steps == 1.0) & (lacking >= -EARLY * usual)].min(initial=0.0)
    least = 0.5 if usual == round(usual) else 2.0 * WITHIN
    early = bool(more > least)
    least += 2.0 * more if early else 0.0
    odd = np.abs(lacking) > least
    odd[0] |= passed[0] != 1.0  # the tick before the first change is not complete
    slips: list[_Slip] = []
    for first, stop in runs(odd).tolist():
        by, net = steps[first:stop], float(lacking[first:stop].sum())
        if -max(1.5, least) <= net <= least and (by > 0.0).all() and (first or passed[0] == 1.0):
            continue  # time stamps are early or late
        alone = stop - first == 1 and (by[0] != 1.0 or net < 0.0)
        amid = stop - first == 2 and by[0] != 1.0 and by[1] == 1.0
        at_end = first == 0 or stop == len(steps)
        at = first + 1 if amid and not at_end else stop
        slips.append(_Slip(first, stop, at, at_end or not (alone or amid)))
    return slips, early


RATES_AGREE = 1e-4
"""Largest relative difference between the estimated rates of two pieces."""
LONGEST_GAP = 100.0
"""Largest number of missing samples between two pieces of a recording, per recorded sample."""
OFF_GRID = 0.25
"""Largest offset between the sample times of overlapping pieces [samples]; rounded times cause such offsets."""
COMPARED = 1 << 16
"""Number of samples of an overlap that are compared at once."""


def open_pattern(path: Path, **options: Any) -> Log:
    """Open all files of a pattern such as run_*.csv as one log; see `join`."""
    parts = {file: re.split(r"(\d+)", file.name) for file in path.parent.glob(path.name)}
    # run_2 comes before run_10
    found = sorted(parts, key=lambda file: [(int(p), "") if p.isdigit() else (-1, p) for p in parts[file]])
    if not found:
        raise InputError(f"{path}: no file of this pattern")
    return join([Log.open(file, **options) for file in found], name=str(path))


def join(logs: Sequence[Log], name: str = "") -> Log:
    """Join pieces of one recording.

    Pieces are placed by their own times if all have a date, or if time continues from piece to piece; missing stretches
    are NaN. Samples that are in two pieces, such as the last seconds repeated at the start of the next file, are used
    once. Pieces that all start at the same time are joined in the given order, with a note.

    Parameters
    ----------
    logs
        Pieces with the same channels.
    name
        Name of the joined log; by default that of the first piece.

    Raises
    ------
    InputError
        If a piece lacks a channel, has another unit or rate, or differs from the previous one where they overlap.
    """
    if len(logs) == 1:
        return logs[0]
    for log in logs[1:]:
        _require_same(logs[0], log)
    offsets, told = _offsets(logs)
    begins = [offset + _span(log.channels.values())[0] for log, offset in zip(logs, offsets, strict=True)]
    order = sorted(range(len(logs)), key=begins.__getitem__)
    logs, offsets = [logs[k] for k in order], [offsets[k] for k in order]
    first = logs[0]
    placed = {own.name: _Placed.first(own, logs, offsets[0]) for own in first.channels.values()}
    for log, offset in zip(logs, offsets, strict=True):
        _place(placed, log, offset)
    faults = _faults_of_pieces(placed)
    for label, own in placed.items():
        if own.holes:
            faults.append(
                Fault("time_gap", label, Sentence("masked: between two files"), np.array(own.holes))
            )
        if own.twice:
            again = Sentence("copies left out")
            faults.append(Fault("repeated", label, again, np.array(own.twice), excluded=False))
    twice_s = max(sum(stop - start for start, stop in own.twice) / own.rate_hz for own in placed.values())
    told += f"; {twice_s:g} s that two of them hold alike count once" if twice_s else ""
    notes = (
        f"{len(logs)} files as one: {', '.join(Path(log.name).name for log in logs)}{told}",
        *first.notes,
    )
    channels = [
        replace(own, rate_hz=p.rate_hz, start_s=p.start_s, samples=p.end)
        for own, p in zip(first.channels.values(), placed.values(), strict=True)
    ]
    start_utc = None if first.start_utc is None else first.start_utc - timedelta(seconds=offsets[0])
    return Log(name or first.name, channels, _blocks_of(placed), start_utc, tuple(faults), notes)


@dataclass
class _Placed:
    """A joined channel so far: its pieces with the index of their first sample, its end, gaps and overlaps."""

    rate_hz: float
    start_s: float
    end: int = 0
    pieces: list[tuple[int, Log]] = field(default_factory=list)
    holes: list[tuple[int, int]] = field(default_factory=list)
    twice: list[tuple[int, int]] = field(default_factory=list)

    @classmethod
    def first(cls, own: Channel, logs: Sequence[Log], offset: float) -> _Placed:
        """Start a channel with the first piece."""
        return cls(float(np.median([log.channels[own.name].rate_hz for log in logs])), own.start_s + offset)

    def add(self, log: Log, at: int, samples: int) -> None:
        """Add a piece that begins at sample `at` of the joined channel; overlapping samples are used once."""
        if at - self.end > LONGEST_GAP * max(samples, self.end):
            late = (at - self.end) / self.rate_hz
            raise InputError(
                f"{log.name}: begins {late:.4g} s after the end of the previous piece; open it alone"
            )
        if at > self.end:
            self.holes.append((self.end, at))
        if min(self.end, at + samples) > at:
            self.twice.append((at, min(self.end, at + samples)))
        self.pieces.append((at, log))
        self.end = max(self.end, at + samples)


def _faults_of_pieces(placed: dict[str, _Placed]) -> list[Fault]:
    """Faults of the pieces, with spans in samples of the joined channel; faults of the clock refer to the first channel."""
    anywhere = next(iter(placed.values()))
    found: list[Fault] = []
    for number, (_, log) in enumerate(anywhere.pieces):
        for fault in log.faults:
            at = placed.get(fault.of or fault.channel, anywhere).pieces[number][0]
            found.append(replace(fault, spans=fault.spans + at))
    return found


def _place(placed: dict[str, _Placed], log: Log, offset: float) -> None:
    """Place a piece by its times; where it overlaps the previous one, both must have the same samples."""
    at: dict[str, int] = {}
    odd = ""
    for label, own in placed.items():
        place = (log.channels[label].start_s + offset - own.start_s) * own.rate_hz
        at[label] = round(place)
        if at[label] < own.end and not odd:
            odd = _difference(placed, log, label, place)
    if odd and any(own.end - at[label] > 1 for label, own in placed.items()):
        label, own = max(placed.items(), key=lambda item: (item[1].end - at[item[0]]) / item[1].rate_hz)
        raise InputError(
            f"{log.name}: begins {(own.end - at[label]) / own.rate_hz:g} s before the end of the previous piece, and {odd}; "
            "expected the same samples in both: cut one of them where they overlap, or open each alone"
        )
    for label, own in placed.items():
        # A gap or overlap of one sample is an error of the clock.
        near = at[label] - own.end == 1 or (odd and abs(at[label] - own.end) <= 1)
        own.add(log, own.end if near else at[label], log.channels[label].samples)


def _difference(placed: dict[str, _Placed], log: Log, label: str, place: float) -> str:
    """Describe the difference of a channel between overlapping pieces; empty if there is none."""
    own, at = placed[label], round(place)
    last = Path(max(own.pieces, key=lambda each: each[0] + each[1].channels[label].samples)[1].name).name
    if at < 0 or abs(place - at) > OFF_GRID:
        beside = f"{place - at:.2g} of a sample beside" if at >= 0 else f"{-at} samples before"
        return f"channel {label!r} lies {beside} those of {last}"
    row, stop = 0, min(own.end - at, log.channels[label].samples)
    both = (_blocks_of(placed)(label, at, COMPARED), log.raw_blocks(label, 0, COMPARED))
    parts = (even_parts(map(with_nan, first_of(blocks, stop)), COMPARED) for blocks in both)
    for before, now in (map(np.concatenate, pair) for pair in zip(*parts, strict=True)):
        other = np.flatnonzero(~((before == now) | ((before != before) & (now != now))))
        if len(other):
            k = int(other[0])
            late_s = (row + k) / own.rate_hz
            return (
                f"{late_s:.9g} s after it begins channel {label!r} is {now[k]!s}, but {before[k]!s} in {last}"
            )
        row += len(now)
    return ""


def _require_same(first: Log, other: Log) -> None:
    if first.channels.keys() != other.channels.keys():
        odd = sorted(first.channels.keys() ^ other.channels.keys())
        raise InputError(
            f"{other.name}: channels {', '.join(odd)} are in only one of this file and {first.name}; expected the same"
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
    """Offset of each piece's times [s], and a note on the assumption made."""
    stamps = [log.start_utc for log in logs if log.start_utc is not None]
    if len(stamps) == len(logs):
        zero = min(stamps)
        return [(stamp - zero).total_seconds() for stamp in stamps], ""
    spans = [_span(log.channels.values()) for log in logs]
    step = max(1.0 / min(c.rate_hz for c in log.channels.values()) for log in logs)
    ordered = sorted(spans)
    if all(after[0] >= before[1] - 1.5 * step for before, after in pairwise(ordered)):
        return [0.0] * len(logs), ""
    if max(begin for begin, _ in spans) - min(begin for begin, _ in spans) > step:
        return [0.0] * len(logs), ""  # overlapping; compared when placed
    offsets, end = [], spans[0][0]
    for begin, stop in spans:
        offsets.append(end - begin)
        end += stop - begin
    return offsets, "; each counts from its own beginning: taken as back to back in this order"


def _span(channels: Collection[Channel]) -> tuple[float, float]:
    """First start and last end of channels [s]."""
    return min(one.start_s for one in channels), max(one.stop_s for one in channels)


def _blocks_of(placed: dict[str, _Placed]) -> Blocks:
    return laid_out(
        lambda name: (
            (Segment(0, log.channels[name].samples, start), log.raw_blocks)
            for start, log in placed[name].pieces
        )
    )


def merge(logs: Sequence[Log], name: str = "") -> Log:
    """Merge the channels of loggers with a common clock, by the time stamps of the files.

    Parameters
    ----------
    logs
        Logs to merge. Either all of them have a date, or none; without dates, all times are assumed to come from one
        clock. A channel name that occurs in several logs gets the file's name as a prefix.
    name
        Name of the merged log; by default that of the first log.

    Raises
    ------
    InputError
        If only some logs have a date, or the recordings do not overlap in time.
    """
    if len(logs) == 0:
        raise InputError("merge: no log, expected two or more")
    dated = [log for log in logs if log.start_utc is not None]
    if dated and len(dated) < len(logs):
        bare = next(log for log in logs if log.start_utc is None)
        raise InputError(
            f"{bare.name}: has no date, but {dated[0].name} has one; align them by a common channel ([align] common)"
        )
    zero = min((log.start_utc for log in logs if log.start_utc), default=None)
    counts = Counter(label for log in logs for label in log.channels)
    channels: list[Channel] = []
    source: dict[str, tuple[Log, str]] = {}
    spans: list[tuple[float, float]] = []
    for log in logs:
        later = (log.start_utc - zero).total_seconds() if zero and log.start_utc else 0.0
        for channel in log.channels.values():
            full = channel.name if counts[channel.name] == 1 else f"{Path(log.name).stem}/{channel.name}"
            channels.append(replace(channel, name=full, start_s=channel.start_s + later))
            source[full] = (log, channel.name)
        spans.append(_span(channels[-len(log.channels) :]))
    if max(begin for begin, _ in spans) >= min(end for _, end in spans):
        raise InputError(
            f"{logs[0].name}: the logs do not overlap in time ({'; '.join(f'{a:g} to {b:g} s' for a, b in spans)}); do they "
            "share a clock? If not, align them by a common channel ([align] common)"
        )

    def blocks(channel: str, first: int, size: int) -> Iterator[Samples]:
        log, own = source[channel]
        return log.raw_blocks(own, first, size)

    by = "time stamps" if zero else "times"
    notes = (
        f"{', '.join(Path(log.name).name for log in logs)} merged by their {by}",
        *(n for log in logs for n in log.notes),
    )
    named = [{own: full for full, (of, own) in source.items() if of is log} for log in logs]
    faults = tuple(fault for log, own in zip(logs, named, strict=True) for fault in log.faults_under(own))
    return Log(name or logs[0].name, channels, blocks, zero, faults, notes)
