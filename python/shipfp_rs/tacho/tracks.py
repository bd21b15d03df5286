"""Repair of missed and extra pulses: makes tracks of counted intervals from crossing times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntFlag
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs._core import pulses_are_even
from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import Array, runs
from shipfp_rs.support.spikes import running_median

MOST_PULSES = 100_000
"""Largest number of pulses per turn: an encoder with 25,000 lines, of which both edges of both channels are counted."""
_MEDIAN_WINDOW = 21
"""Number of periods in the running median by which missed and extra pulses are detected."""
_EXTRA_BELOW = 0.6
"""A period shorter than this fraction of the median ends at an extra pulse. An extra pulse in the middle of a period
makes both parts that short, and a shaft can't accelerate so much within a few pulses.
"""
_CLEARLY_BETTER = 0.05
"""Of two crossings close together, the first is the pulse and the second a saw-tooth on its edge (thesis, Fig. 6.15),
unless the second fits the period better by this fraction of a period. Uneven reflectors and changing speed cause
smaller differences.
"""
MISSED_FROM = 1.6
_MOST_MISSED = 4
"""Largest number of successive missed pulses that are inserted; more indicate a stopped shaft or a dead pick-up."""
_END_ZONE = _MEDIAN_WINDOW // 2
"""Number of intervals at each end of a track where the running median has a shorter window and can't follow a trend."""
_TREND = 4
"""Number of intervals that define the trend of the speed, a straight line over time, as under constant torque."""
_PART_OF_A_PULSE = 0.1
_SAME_NEXT_TURN = 0.25
"""Largest relative difference between periods one turn apart in irregular rotation, such as cranking of an engine."""
_GENTLE, _SHARP, _OFTEN = 1.9, 2.2, 0.25
"""Largest ratio of successive periods in irregular rotation; a missed or extra pulse halves or doubles a period.
`_SHARP` applies where more than the fraction `_OFTEN` of a turn's periods deviate, which single pulses can't cause.
"""


class PulseFlag(IntFlag):
    """Repair made in an interval."""

    GOOD = 0
    EXTRA = 1
    """Extra crossings in the interval were removed."""
    MISSED = 2
    """Pulses were missed; the interval is an equal part of a longer measured interval."""


@dataclass(frozen=True)
class Track:
    """Pulses between two breaks: interval k runs from edge k to k + 1 over `count[k]` true intervals."""

    edges_s: Array
    count: npt.NDArray[np.int64]
    flags: npt.NDArray[np.uint8]
    usable: npt.NDArray[np.bool_]
    doubt: Array | None = None
    """Relative standard deviation of each interval's speed due to an uncertain pulse count; None if the count is
    certain.
    """


def require_positive(name: str, value: float) -> None:
    """Raise `InputError` unless a value is positive and finite."""
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name}: found {value}, expected a positive number")


def checked_times(
    times_s: npt.ArrayLike, pulses_per_rev: int, gaps: npt.ArrayLike | None
) -> tuple[Array, Array]:
    """Check times and gaps, and return them as arrays."""
    times = np.asarray(times_s, dtype=np.float64, order="C")
    if times.ndim != 1:
        raise InputError(f"times_s: found shape {times.shape}, expected one axis")
    if not 1 <= pulses_per_rev <= MOST_PULSES:
        raise InputError(f"pulses_per_rev: found {pulses_per_rev}, expected 1 to {MOST_PULSES}")
    ascending = times[1:] > times[:-1]
    if not ascending.all():
        k = int(np.argmin(ascending))
        raise InputError(
            f"times_s: {times[k + 1]} follows {times[k]} at index {k + 1}, expected ascending times"
        )
    gap_times = np.empty((0, 2)) if gaps is None else np.asarray(gaps, dtype=np.float64)
    if gap_times.ndim != 2 or gap_times.shape[1] != 2:
        raise InputError(f"gaps: found shape {gap_times.shape}, expected (G, 2)")
    return times, gap_times


def _usual(periods: Array, pulses_per_rev: int) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Expected periods, and which of them deviate from the running median because the rotation is irregular in each turn."""
    median = running_median(periods, _MEDIAN_WINDOW)
    lag = pulses_per_rev
    odd = np.abs(np.log(periods / median)) > _SAME_NEXT_TURN
    if lag < 3 or len(periods) <= lag or not odd.any():
        return median, np.zeros(len(periods), dtype=np.bool_)

    # Such a period, and both its neighbours, resemble those of the same teeth a turn before or after.
    fits = np.abs(np.log(periods[lag:] / periods[:-lag])) < _SAME_NEXT_TURN
    same = fits & np.append(True, fits[:-1]) & np.append(fits[1:], True)  # with both neighbours
    apart = np.zeros(lag, dtype=np.bool_)
    often = np.convolve(odd, np.full(lag, 1.0 / lag), mode="same")[1:] > _OFTEN
    gentle = np.abs(np.diff(np.log(periods))) < np.log(np.where(often, _SHARP, _GENTLE))
    irregular = (np.append(apart, same) | np.append(same, apart)) & odd
    irregular &= np.append(True, gentle) & np.append(gentle, True)
    return np.where(irregular, periods, median), irregular


def _without_extra(times: Array, pulses_per_rev: int) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Remove extra crossings; also return which remaining intervals contained one."""
    median, _ = _usual(np.diff(times), pulses_per_rev)
    if not (np.diff(times) < _EXTRA_BELOW * median).any():
        return times, np.zeros(len(times) - 1, dtype=np.bool_)
    kept = [times[0]]
    merged = [False]
    pending = False
    for time, usual in zip(times[1:], median, strict=True):
        if time - kept[-1] >= _EXTRA_BELOW * usual:
            kept.append(time)
            merged.append(pending)
            pending = False
        elif (
            len(kept) > 1
            and abs(time - kept[-2] - usual) < abs(kept[-1] - kept[-2] - usual) - _CLEARLY_BETTER * usual
        ):
            # The earlier of the two crossings was extra.
            kept[-1], merged[-1] = time, True
        else:
            pending = True
    return np.array(kept), np.array(merged[1:])


def cut_tracks(times: Array, gaps: Array, pulses_per_rev: int) -> list[Track]:
    """Cut the pulses at breaks, count the true intervals in each, and flag the repairs."""
    if len(times) < 2:
        return []
    if not len(gaps) and pulses_are_even(times, _EXTRA_BELOW, MISSED_FROM):
        # Shortcut with the same result, since all periods are near the median.
        size = len(times) - 1
        one, good = np.ones(size, dtype=np.int64), np.zeros(size, dtype=np.uint8)
        return [Track(times, one, good, np.ones(size, dtype=np.bool_))]
    times, merged = _without_extra(times, pulses_per_rev)
    if len(times) < 2:
        return []
    periods = np.diff(times)
    usual, irregular = _usual(periods, pulses_per_rev)
    ratio = periods / usual
    count = np.where(ratio < MISSED_FROM, 1, np.rint(ratio)).astype(np.int64)
    over_gap = np.searchsorted(gaps[:, 0], times[1:]) > np.searchsorted(gaps[:, 1], times[:-1], side="right")
    # Counting continues across a gap only where the number of pulses in it is certain.
    broken = (count > 1 + _MOST_MISSED) | (over_gap & (np.abs(ratio - count) > 0.3))
    flags = np.where(count > 1, PulseFlag.MISSED, 0) | np.where(merged, PulseFlag.EXTRA, 0)
    cuts = np.flatnonzero(broken)
    tracks = []
    for first, last in zip(np.append(0, cuts + 1), np.append(cuts, len(periods)), strict=True):
        if last > first:
            span = slice(first, last)
            track = Track(times[first : last + 1], count[span], flags[span].astype(np.uint8), ~over_gap[span])
            tracks.append(_judged_by_trend(track, ratio[span], irregular[span]))
    return tracks


def _judged_by_trend(track: Track, ratio: Array, irregular: npt.NDArray[np.bool_]) -> Track:
    """Count intervals again where the running median fails: at both ends, and where the shaft nearly stops."""
    if len(track.count) <= _TREND:
        return replace(track, doubt=1.0 - 1.0 / track.count)
    whole = _near_rest(track, ratio)
    reach = _END_ZONE + _TREND
    for end in (irregular[-reach:], irregular[:reach]):
        size = len(whole.count)
        # Irregular rotation has no trend to compare with.
        zone = 0 if end.any() else min(_END_ZONE, size // 2)
        whole = _turned(_outwards(whole, size - zone, size))
    return whole


def _near_rest(track: Track, ratio: Array) -> Track:
    """Count rows of long intervals again, from both sides up to the longest one, as for a shaft that reverses."""
    rows = runs(track.count > 1)
    # Only rows with a period that is not a multiple of the median: missed pulses would cause a multiple.
    strange = np.append(0, np.cumsum(np.abs(ratio - track.count) > _PART_OF_A_PULSE))
    rows = rows[np.diff(strange[rows])[:, 0] > 0]
    parts, done = [], 0
    for first, last in rows.tolist():
        begin, end = first - _TREND, last + _TREND
        if done <= begin and end <= len(track.count):
            slowest = int(np.argmax(np.diff(track.edges_s[first : last + 1])))
            part = _outwards(_part(track, begin, end), _TREND, _TREND + slowest + 1, alone=False)
            part = _turned(_outwards(_turned(part), _TREND, _TREND + last - first - slowest - 1, alone=False))
            parts += [_part(track, done, begin), part]
            done = end
    return _joined([*parts, _part(track, done, len(track.count))]) if parts else track


def _part(track: Track, first: int, last: int) -> Track:
    return Track(track.edges_s[first : last + 1], *(column[first:last] for column in _columns(track)))


def _joined(parts: list[Track]) -> Track:
    """Join successive tracks."""
    edges = [part.edges_s[:-1] for part in parts]
    columns = zip(*(_columns(part) for part in parts), strict=True)
    return Track(
        np.concatenate([*edges, parts[-1].edges_s[-1:]]), *(np.concatenate(column) for column in columns)
    )


def _turned(track: Track) -> Track:
    """Reverse a track in time."""
    return Track(*(column[::-1].copy() for column in (-track.edges_s, *_columns(track))))


def _columns(track: Track) -> tuple[npt.NDArray[Any], ...]:
    doubt = np.zeros(len(track.count)) if track.doubt is None else track.doubt
    return track.count, track.flags, track.usable, doubt


def _outwards(track: Track, start: int, stop: int, *, alone: bool = True) -> Track:
    """Number of pulses in each interval from `start` to `stop`, as predicted by the speeds of the intervals before it."""
    if not _TREND <= start < stop or not track.usable[start - _TREND : stop].all():
        return track
    edges = track.edges_s[start - _TREND : stop + 1].tolist()
    median_count, merged = track.count[start:stop].tolist(), track.flags[start:stop].tolist()
    before = zip(edges, edges[1:], track.count[start - _TREND : start].tolist(), strict=False)
    known = [((one + two) / 2, count / (two - one)) for one, two, count in before]
    edges, kept, rows, place, most = edges[_TREND:], [], [], 0, 1 + _MOST_MISSED
    while place < stop - start:
        end = place + 1
        seen = _pulses_by_trend(known, edges[place], edges[end])
        while seen < _EXTRA_BELOW and end < stop - start:
            longer = _pulses_by_trend(known, edges[place], edges[end + 1])
            if abs(longer - 1.0) >= abs(seen - 1.0):
                break
            seen, end = longer, end + 1
        count = round(min(seen, most + 1)) if seen >= MISSED_FROM else 1
        extra = end > place + 1 or any(flag & PulseFlag.EXTRA for flag in merged[place:end])
        flag = (PulseFlag.MISSED if count > 1 else 0) | (PulseFlag.EXTRA if extra else 0)
        unsure = flag or any(count != other for other in median_count[place:end])
        kept.append(edges[place])
        rows.append((count, int(flag), count <= most, abs(seen / count - 1.0) if unsure else 0.0))
        known.append(((edges[place] + edges[end]) / 2, count / (edges[end] - edges[place])))
        place = end
    # If no intervals follow after `stop` (`alone`), long last ones may be missed pulses or a stopping shaft.
    for back in reversed(range(len(rows))) if alone else ():
        if rows[back][0] == 1:
            break
        rows[back] = (*rows[back][:3], max(rows[back][3], 1.0 - 1.0 / rows[back][0]))
    counts, flags, usable, doubts = map(np.array, zip(*rows, strict=True))
    made = Track(np.array([*kept, edges[-1]]), counts, flags.astype(np.uint8), usable, doubts)
    return _joined([_part(track, 0, start), made, _part(track, stop, len(track.count))])


def _pulses_by_trend(known: list[tuple[float, float]], first_s: float, last_s: float) -> float:
    """Number of pulses between two times by the trend of the speed; zero or negative if the shaft stops before."""
    latest = known[-_TREND:]
    time = sum(at for at, _ in latest) / _TREND
    speed = sum(value for _, value in latest) / _TREND
    spread = sum((at - time) ** 2 for at, _ in latest)
    slope = sum((at - time) * (value - speed) for at, value in latest) / spread if spread > 0.0 else 0.0
    return (speed + slope * ((first_s + last_s) / 2 - time)) * (last_s - first_s)
