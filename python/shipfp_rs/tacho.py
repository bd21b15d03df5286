"""Pulse trains to shaft speed: crossing times, repair, reflector angles, speed per interval, uniform grids."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import IntFlag
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from shipfp_rs._core import PulseCrossings, pulse_levels
from shipfp_rs.errors import InputError

__all__ = [
    "IntervalSpeed",
    "PulseFlag",
    "PulseTimes",
    "ReflectorAngles",
    "interval_gain",
    "pulse_times",
    "reflector_angles",
    "resample",
    "speed_from_pulses",
]

Array = npt.NDArray[np.float64]

_HYSTERESIS = 0.4
"""Distance between the two thresholds, as a part of the distance between the train's levels."""
_MEDIAN_WINDOW = 11
"""Periods in the running median against which missed and extra pulses show."""
_EXTRA_BELOW = 0.6
"""A period shorter than this part of the median ends at an extra pulse: two halves of one that was cut in the middle
both count, a shaft does not speed up so much within a few pulses."""
_MISSED_FROM = 1.6
_MOST_MISSED = 4
"""More missed pulses in a row are a stopped shaft or a dead pick-up, and are left out rather than filled in."""
_STEADY = 0.02
"""Reflectors are measured where the speed changes by less than this part of itself in a turn."""
_LEAST_TURNS = 20
_WORST_ANGLE = 0.002
"""Standard deviation of a spacing, as a part of the even spacing, from which on the estimate is no use."""


class PulseFlag(IntFlag):
    """What was repaired in an interval."""

    GOOD = 0
    EXTRA = 1
    """Extra crossings within it were removed."""
    MISSED = 2
    """Its crossings were missed; it is an equal share of a longer one."""


@dataclass(frozen=True)
class PulseTimes:
    """Rising crossings of a pulse train.

    Parameters
    ----------
    times_s
        Times of the crossings from the first sample on [s], shape (N,).
    gaps_s
        Stretches without samples, from the first missing one to the next present [s], shape (G, 2).
    low, middle, high
        Levels used, in the unit of the samples: armed at `low`, fired at `high`, timed at `middle`.
    rate_hz
        Sample rate of the train [Hz].
    """

    times_s: Array
    gaps_s: Array
    low: float
    middle: float
    high: float
    rate_hz: float

    @property
    def time_std_s(self) -> float:
        """Standard deviation of a crossing whose edge rises within one sample, Ts / sqrt(12) [s].

        Such an edge lies anywhere between its two samples with equal chance. Edges that last several samples are
        known better.
        """
        return float(1.0 / (self.rate_hz * np.sqrt(12.0)))


@dataclass(frozen=True)
class IntervalSpeed:
    """Mean speed between successive pulses.

    Parameters
    ----------
    time_s
        Middles of the intervals [s], shape (N,).
    speed_rps
        Mean speed over each interval [rev/s], shape (N,).
    std_rps
        Its standard deviation from the timing and the reflectors' angles [rev/s], shape (N,).
    duration_s
        Lengths of the intervals [s], shape (N,).
    flags
        `PulseFlag` of each interval, shape (N,).
    pulses_per_rev
        Pulses in a turn.
    """

    time_s: Array
    speed_rps: Array
    std_rps: Array
    duration_s: Array
    flags: npt.NDArray[np.uint8]
    pulses_per_rev: int

    @property
    def bandwidth_hz(self) -> float:
        """Highest frequency that the intervals can show: half the pulses per second [Hz]."""
        return float(0.5 / np.median(self.duration_s)) if len(self.duration_s) else 0.0


@dataclass(frozen=True)
class ReflectorAngles:
    """Angles between the reflectors (or teeth) of a pulse wheel.

    Parameters
    ----------
    fractions
        Angle from each pulse to the next as a part of a turn, shape (P,), in order, summing to 1.
    std
        Standard deviations of `fractions`, shape (P,).
    ok
        Whether the data could tell; the angles are even where they could not.
    reason
        Why not, else empty.
    """

    fractions: Array
    std: Array
    ok: bool
    reason: str = ""


def pulse_times(
    samples: npt.ArrayLike | Iterable[npt.ArrayLike],
    rate_hz: float,
    *,
    threshold: float | None = None,
    hysteresis: float | None = None,
    chunk: int = 1 << 20,
) -> PulseTimes:
    """Times at which a pulse train rises through a level, interpolated between samples.

    A crossing counts when the train was low before and gets high after, so that saw-tooth edges and noise at the level
    make no second one.

    Parameters
    ----------
    samples
        The train: an array, shape (N,), or an iterable of such arrays that follow one another (a log read piece by
        piece). NaN marks a missing sample.
    rate_hz
        Sample rate [Hz].
    threshold
        Level of the crossings in the unit of the samples (the thesis uses 2 V, section 6.4); by default midway between the
        train's levels.
    hysteresis
        Distance between the levels that arm and fire, around the threshold; by default 0.4 of the distance between the
        train's levels.
    chunk
        Samples handled at a time where an array has to be converted.

    Returns
    -------
    PulseTimes

    Raises
    ------
    InputError
        If the train has no two levels, or the threshold lies outside of them.

    Examples
    --------
    >>> import numpy as np
    >>> train = np.where(np.arange(1000) % 100 < 30, 5.0, 0.0)
    >>> pulse_times(train, 1000.0).times_s[:3]
    array([0.0995, 0.1995, 0.2995])
    """
    _require_positive("rate_hz", rate_hz)
    pieces = _pieces(samples, chunk)
    first = next(pieces, None)
    if first is None:
        raise InputError("samples: found none, expected a pulse train")
    states = None
    if threshold is None or hysteresis is None:
        whole = (
            isinstance(samples, np.ndarray) and samples.dtype == first.dtype and samples.flags.c_contiguous
        )
        states = pulse_levels(samples if whole else first)  # type: ignore[arg-type]
    low, middle, high = _levels(states, threshold, hysteresis)
    detector = PulseCrossings(low, high, middle)
    times = [detector.feed(first), *(detector.feed(piece) for piece in pieces)]
    return PulseTimes(
        np.concatenate(times) / rate_hz,
        detector.gaps / rate_hz,
        low=low,
        middle=middle,
        high=high,
        rate_hz=rate_hz,
    )


def reflector_angles(
    times_s: npt.ArrayLike, pulses_per_rev: int, *, gaps: npt.ArrayLike | None = None
) -> ReflectorAngles:
    """Angles between the reflectors of a shaft, from the pulses themselves.

    Each period is divided by the centred mean over one turn, which no reflector can bend: whatever their angles, a turn
    of them is a turn. The means of that ratio over all steady turns are the angles. Motion of the shaft at whole orders
    of its rotation can't be told from angles. Only the longest stretch without a break is used, since the
    count of reflectors is lost in a break; single missed pulses do not shift it.

    Parameters
    ----------
    times_s
        Crossing times [s], shape (N,), ascending.
    pulses_per_rev
        Pulses in a turn, P.
    gaps
        Stretches without samples [s], shape (G, 2), as in `PulseTimes.gaps_s`.

    Returns
    -------
    ReflectorAngles
        The first fraction is that of the first interval of the longest stretch. With `ok` false, and a reason,
        where the data can't tell: too few turns, a speed that changes too much, too much scatter.

    Notes
    -----
    Diamond et al. (2016), https://hdl.handle.net/2263/56372, fit the same model, periods against a smooth speed and a turn
    that sums to one, by Bayesian regression.
    """
    times, gap_times = _checked(times_s, pulses_per_rev, gaps)
    even = np.full(pulses_per_rev, 1.0 / pulses_per_rev)
    if pulses_per_rev == 1:
        return ReflectorAngles(even, np.zeros(1), ok=True)

    def refused(reason: str) -> ReflectorAngles:
        return ReflectorAngles(even, np.full(pulses_per_rev, np.nan), ok=False, reason=reason)

    tracks = _tracks(times, gap_times)
    if not tracks:
        return refused("no two pulses in a row")
    track = max(tracks, key=lambda track: track.count.sum())
    ratio, steady, phase = _period_ratios(track, pulses_per_rev)
    turns = int(min(np.bincount(phase[steady], minlength=pulses_per_rev)))
    if turns < _LEAST_TURNS:
        return refused(
            f"{turns} turns without a break where the speed changes by less than {_STEADY:.0%} a turn, "
            f"at least {_LEAST_TURNS} are needed"
        )
    mean, std = np.empty(pulses_per_rev), np.empty(pulses_per_rev)
    for k in range(pulses_per_rev):
        # Means of ten stretches in time: their scatter allows for errors that last, such as a count that slipped.
        parts = [part.mean() for part in np.array_split(ratio[steady & (phase == k)], 10)]
        mean[k], std[k] = np.mean(parts), np.std(parts, ddof=1) / np.sqrt(len(parts))
    fractions, std = mean / mean.sum(), std / mean.sum()
    worst = float(std.max() * pulses_per_rev)
    if worst > _WORST_ANGLE:
        return refused(f"the spacings scatter by {worst:.2%} of the even one, more than {_WORST_ANGLE:.1%}")
    return ReflectorAngles(fractions, std, ok=True)


def speed_from_pulses(
    times_s: npt.ArrayLike,
    pulses_per_rev: int,
    *,
    gaps: npt.ArrayLike | None = None,
    angles: ReflectorAngles | None = None,
    time_std_s: float = 0.0,
) -> IntervalSpeed:
    """Mean speed over each interval between pulses, assigned to its middle; missed and extra pulses repaired.

    Against a running median of the periods, one that is too short ends at an extra pulse, which is removed, and one
    near a multiple has missed pulses, which are put in. Both are flagged. Intervals over a gap, and such as miss more
    than four pulses, are left out.

    Parameters
    ----------
    times_s
        Crossing times [s], shape (N,), ascending.
    pulses_per_rev
        Pulses in a turn, P.
    gaps
        Stretches without samples [s], shape (G, 2), as in `PulseTimes.gaps_s`.
    angles
        Angles of the reflectors; even by default. Which of them comes first is found from the periods, for
        each stretch between breaks anew.
    time_std_s
        Standard deviation of a crossing time [s], for instance `PulseTimes.time_std_s`.

    Returns
    -------
    IntervalSpeed

    Raises
    ------
    InputError
        If the times do not ascend, or `angles` is not ok.

    Examples
    --------
    >>> import numpy as np
    >>> speed_from_pulses(np.arange(9) * 0.05, 4).speed_rps[0]
    np.float64(5.0)
    """
    times, gap_times = _checked(times_s, pulses_per_rev, gaps)
    fractions = np.full(pulses_per_rev, 1.0 / pulses_per_rev)
    relative = np.zeros(pulses_per_rev)
    if angles is not None:
        if not angles.ok:
            raise InputError(f"angles: not known ({angles.reason}); leave them out for even spacing")
        if len(angles.fractions) != pulses_per_rev:
            raise InputError(
                f"angles: found {len(angles.fractions)}, expected pulses_per_rev = {pulses_per_rev}"
            )
        fractions, relative = angles.fractions, angles.std / angles.fractions
    parts = [_track_speed(track, fractions, relative, time_std_s) for track in _tracks(times, gap_times)]
    middle, speed, std, duration, flags = (
        np.concatenate(part) if parts else np.empty(0)
        for part in (zip(*parts, strict=True) if parts else [()] * 5)
    )
    return IntervalSpeed(middle, speed, std, duration, flags.astype(np.uint8), pulses_per_rev)


def resample(
    interval_speed: IntervalSpeed, rate_hz: float, start_s: float, stop_s: float
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Speed on a uniform grid from `start_s` up to, not including, `stop_s`.

    Straight lines between the middles of the intervals; nothing is bridged where intervals were left out. The grid
    holds what lies below `IntervalSpeed.bandwidth_hz`, multiplied by `interval_gain`.

    Parameters
    ----------
    interval_speed
        Speeds of the intervals.
    rate_hz
        Rate of the grid [Hz].
    start_s, stop_s
        Its ends [s].

    Returns
    -------
    speed_rps
        Speed [rev/s], NaN where masked, shape (round((stop_s - start_s) rate_hz),).
    masked
        True where no interval covers the time.
    """
    _require_positive("rate_hz", rate_hz)
    count = round((stop_s - start_s) * rate_hz)
    if not count > 0:
        raise InputError(f"stop_s: found {stop_s} with start_s = {start_s}, expected later")
    grid = start_s + np.arange(count) / rate_hz
    half = 0.5 * interval_speed.duration_s
    first, last = interval_speed.time_s - half, interval_speed.time_s + half
    if not first.size:
        return np.full(count, np.nan), np.ones(count, dtype=np.bool_)
    breaks = np.flatnonzero(first[1:] - last[:-1] > 1e-3 * half[1:])
    begins, ends = np.append(0, breaks + 1), np.append(breaks, len(first) - 1)
    # Towards a break the speed of the last interval holds up to its end.
    nodes = np.concatenate([interval_speed.time_s, first[begins], last[ends]])
    values = np.concatenate(
        [interval_speed.speed_rps, interval_speed.speed_rps[begins], interval_speed.speed_rps[ends]]
    )
    order = np.argsort(nodes, kind="stable")
    speed = np.interp(grid, nodes[order], values[order])
    stretch = np.searchsorted(first[begins], grid, side="right") - 1
    masked = (stretch < 0) | (grid > last[ends][stretch])
    speed[masked] = np.nan
    return speed, masked


def interval_gain(frequency_hz: npt.ArrayLike, pulses_per_rev: int, speed_rps: float) -> Array:
    """Gain of the mean over one interval, sinc(f / (P n)), by which speed ripple at `frequency_hz` is reduced.

    Parameters
    ----------
    frequency_hz
        Frequency of the ripple [Hz], any shape.
    pulses_per_rev
        Pulses in a turn, P.
    speed_rps
        Mean speed n [rev/s].

    Returns
    -------
    gain
        Same shape.
    """
    return np.asarray(np.sinc(np.asarray(frequency_hz, dtype=np.float64) / (pulses_per_rev * speed_rps)))


@dataclass(frozen=True)
class _Track:
    """Pulses between two breaks: interval k runs from edge k to k + 1 over `count[k]` true intervals."""

    edges_s: Array
    count: npt.NDArray[np.int64]
    flags: npt.NDArray[np.uint8]
    usable: npt.NDArray[np.bool_]


def _require_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name}: found {value}, expected a positive number")


def _pieces(samples: Any, chunk: int) -> Iterator[Any]:
    """Cut the samples into arrays that the kernel takes; views where the type fits."""
    _require_positive("chunk", chunk)
    pieces = samples
    if isinstance(samples, np.ndarray):
        ends = range(chunk, len(samples) + chunk, chunk) if samples.ndim == 1 else ()
        pieces = [samples[end - chunk : end] for end in ends] or [samples]
    for piece in pieces:
        array = np.asarray(piece)
        if array.ndim != 1:
            raise InputError(
                f"samples: found an array of shape {array.shape}, expected one axis (or an iterable of such)"
            )
        fits = array.dtype in (np.float32, np.float64, np.int16)
        yield np.require(array, dtype=None if fits else np.float64, requirements=["C", "A"])


def _levels(
    states: tuple[float, float] | None, threshold: float | None, hysteresis: float | None
) -> tuple[float, float, float]:
    """Arming, timing and firing level."""
    if states is None:
        assert threshold is not None
        assert hysteresis is not None
        _require_positive("hysteresis", hysteresis)
        return threshold - hysteresis / 2, threshold, threshold + hysteresis / 2
    bottom, top = states
    if not bottom < top:
        raise InputError(f"samples: constant at {bottom:g}, expected a train of pulses between two levels")
    middle = (bottom + top) / 2 if threshold is None else threshold
    if not bottom < middle < top:
        raise InputError(
            f"threshold: found {middle:g}, expected between the train's levels {bottom:g} and {top:g}"
        )
    if hysteresis is None:
        hysteresis = _HYSTERESIS * (top - bottom)
    _require_positive("hysteresis", hysteresis)
    # A threshold near one of the levels leaves room for half the way to it only.
    low = middle - min(hysteresis, middle - bottom) / 2
    high = middle + min(hysteresis, top - middle) / 2
    return low, middle, high


def _checked(times_s: npt.ArrayLike, pulses_per_rev: int, gaps: npt.ArrayLike | None) -> tuple[Array, Array]:
    times = np.asarray(times_s, dtype=np.float64)
    if times.ndim != 1:
        raise InputError(f"times_s: found shape {times.shape}, expected one axis")
    if pulses_per_rev < 1:
        raise InputError(f"pulses_per_rev: found {pulses_per_rev}, expected 1 or more")
    bad = np.flatnonzero(~(np.diff(times) > 0))
    if bad.size:
        k = int(bad[0])
        raise InputError(
            f"times_s: {times[k + 1]} follows {times[k]} at index {k + 1}, expected ascending times"
        )
    gap_times = np.empty((0, 2)) if gaps is None else np.asarray(gaps, dtype=np.float64)
    if gap_times.ndim != 2 or gap_times.shape[1] != 2:
        raise InputError(f"gaps: found shape {gap_times.shape}, expected (G, 2)")
    return times, gap_times


def _running_median(periods: Array) -> Array:
    return np.asarray(median_filter(periods, size=_MEDIAN_WINDOW, mode="nearest"))


def _without_extra(times: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Remove extra crossings; also tell which intervals between the remaining ones contain a removed one."""
    median = _running_median(np.diff(times))
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
        elif len(kept) > 1 and abs(time - kept[-2] - usual) < abs(kept[-1] - kept[-2] - usual):
            # The one before it was the extra pulse.
            kept[-1], merged[-1] = time, True
        else:
            pending = True
    return np.array(kept), np.array(merged[1:])


def _tracks(times: Array, gaps: Array) -> list[_Track]:
    """Cut the pulses at breaks, count what each interval holds, and flag the repairs."""
    if len(times) < 2:
        return []
    times, merged = _without_extra(times)
    if len(times) < 2:
        return []
    periods = np.diff(times)
    ratio = periods / _running_median(periods)
    count = np.where(ratio < _MISSED_FROM, 1, np.rint(ratio)).astype(np.int64)
    over_gap = np.searchsorted(gaps[:, 0], times[1:]) > np.searchsorted(gaps[:, 1], times[:-1], side="right")
    # Over a gap the count of pulses is only kept where it is beyond doubt.
    broken = (count > 1 + _MOST_MISSED) | (over_gap & (np.abs(ratio - count) > 0.3))
    flags = np.where(count > 1, PulseFlag.MISSED, 0) | np.where(merged, PulseFlag.EXTRA, 0)
    cuts = np.flatnonzero(broken)
    tracks = []
    for first, last in zip(np.append(0, cuts + 1), np.append(cuts, len(periods)), strict=True):
        if last > first:
            span = slice(first, last)
            tracks.append(
                _Track(times[first : last + 1], count[span], flags[span].astype(np.uint8), ~over_gap[span])
            )
    return tracks


def _period_ratios(
    track: _Track, pulses_per_rev: int
) -> tuple[Array, npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """Periods over the centred mean of one turn times P, which of them are steady, and their place in the turn."""
    good = (track.flags == PulseFlag.GOOD) & track.usable
    periods = np.repeat(np.where(good, np.diff(track.edges_s), np.nan), track.count)
    phase = np.arange(len(periods)) % pulses_per_rev
    ratio = np.full(len(periods), np.nan)
    steady = np.zeros(len(periods), dtype=np.bool_)
    half, odd = divmod(pulses_per_rev, 2)
    # An even number of periods is centred by two halves at the ends, which belong to the same reflector.
    weights = np.ones(pulses_per_rev) if odd else np.r_[0.5, np.ones(pulses_per_rev - 1), 0.5]
    if len(periods) < 3 * pulses_per_rev + 1:
        return ratio, steady, phase
    turn = np.full(len(periods), np.nan)
    turn[half : len(periods) - half] = np.convolve(periods, weights, mode="valid")
    ratio = periods / turn
    lag = pulses_per_rev
    change = np.full(len(periods), np.nan)
    change[lag:-lag] = (turn[2 * lag :] - turn[: -2 * lag]) / (2 * turn[lag:-lag])
    steady = np.abs(change) < _STEADY
    return ratio, steady, phase


def _rotation(track: _Track, fractions: Array) -> int:
    """By how many places the track's first interval lies behind the first of `fractions`."""
    ratio, steady, phase = _period_ratios(track, len(fractions))
    if not steady.any():
        return 0
    seen = np.bincount(phase[steady], minlength=len(fractions))
    mean = np.bincount(phase[steady], ratio[steady], minlength=len(fractions)) / np.maximum(seen, 1)
    misfit = [np.sum(seen * (mean - np.roll(fractions, -k)) ** 2) for k in range(len(fractions))]
    return int(np.argmin(misfit))


def _track_speed(
    track: _Track, fractions: Array, relative_std: Array, time_std_s: float
) -> tuple[Array, Array, Array, Array, npt.NDArray[np.uint8]]:
    """Middle, speed, its standard deviation, length and flags of the usable intervals, missed pulses put in."""
    total = int(track.count.sum())
    place = (np.arange(total) + _rotation(track, fractions)) % len(fractions)
    begins = np.cumsum(track.count) - track.count
    angle = np.add.reduceat(fractions[place], begins)
    long = np.diff(track.edges_s)
    speed = np.repeat(angle / long, track.count)
    duration = fractions[place] / speed
    middle = track.edges_s[0] + np.cumsum(duration) - duration / 2
    timing = np.repeat(np.sqrt(2.0) * time_std_s / long, track.count)
    std = speed * np.hypot(timing, relative_std[place])
    usable = np.repeat(track.usable, track.count)
    flags = np.repeat(track.flags, track.count)
    return middle[usable], speed[usable], std[usable], duration[usable], flags[usable]
