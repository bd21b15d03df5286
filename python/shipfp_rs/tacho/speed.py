"""Mean speed between the pulses of a train, and speed on a uniform grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from shipfp_rs._core import interval_speeds
from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import at_most, checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.tacho.angles import ReflectorAngles, align_angles
from shipfp_rs.tacho.crossings import PulseTimes
from shipfp_rs.tacho.tracks import PulseFlag, Track, checked_times, cut_tracks, require_positive

_TYPICAL = 21


@dataclass(frozen=True)
class IntervalSpeed:
    """Mean speed between successive pulses.

    Parameters
    ----------
    time_s
        Midpoints of the intervals [s], shape (N,).
    speed_rps
        Mean speed over each interval [rev/s], shape (N,).
    std_rps
        Standard deviation of the speed from timing and reflector angles [rev/s], shape (N,).
    duration_s
        Lengths of the intervals [s], shape (N,).
    flags
        `PulseFlag` of each interval, shape (N,).
    pulses_per_rev
        Pulses in a turn.
    angle_rev
        Angle turned in each interval [rev], shape (N,); by default speed times duration. The two differ for coarsely
        timed pulses, whose speed is corrected for the bias of 1 / T.
    ends_std_rps
        Value of `std_rps` under the assumption that the errors of an interval's two ends are independent [rev/s],
        shape (N,). The uncertainty of each end is calculated from it. None if the errors are independent.
    """

    time_s: Array
    speed_rps: Array
    std_rps: Array
    duration_s: Array
    flags: npt.NDArray[np.uint8]
    pulses_per_rev: int
    angle_rev: Array | None = None
    ends_std_rps: Array | None = None

    @property
    def turned_rev(self) -> Array:
        """Angle turned in each interval [rev], shape (N,)."""
        return self.speed_rps * self.duration_s if self.angle_rev is None else self.angle_rev

    def typical_rps(self) -> float:
        """Median of mean speeds over about twenty pulses [rev/s]; single intervals may be coarsely timed."""
        size = min(_TYPICAL, max(len(self.duration_s), 1))
        turned, lasted = (
            np.convolve(column, np.ones(size), mode="valid") for column in (self.turned_rev, self.duration_s)
        )
        return float(np.median(turned / lasted))

    def times_as_fast_as(self, other: IntervalSpeed) -> float:
        """Median ratio of this speed to another one at the same times, both averaged over about twenty pulses.

        NaN if the two speeds have no common time. A ratio of medians would fail for a speed that steps between levels,
        since each median may be at either level.
        """
        size = min(_TYPICAL, max(len(self.duration_s), 1))
        first, last = 0.5 * self.duration_s[: 1 - size or None], 0.5 * self.duration_s[size - 1 :]
        begin, end = self.time_s[: 1 - size or None] - first, self.time_s[size - 1 :] + last
        own, others = self._mean_over(begin, end), other._mean_over(begin, end)
        known = np.isfinite(own) & np.isfinite(others) & (others > 0.0)
        return float(np.median(own[known] / others[known])) if known.any() else float("nan")

    def _mean_over(self, begin: Array, end: Array) -> Array:
        """Mean speed between two times [rev/s], gaps excluded; NaN if there are no intervals."""
        if not len(self.time_s):
            return np.full(len(begin), np.nan)
        ends = self.time_s + 0.5 * self.duration_s
        turned, lasted = (
            np.interp(end, ends, column) - np.interp(begin, ends, column)
            for column in (np.cumsum(self.turned_rev), np.cumsum(self.duration_s))
        )
        return np.asarray(np.divide(turned, lasted, out=np.full(len(begin), np.nan), where=lasted > 0.0))

    def part(self, which: slice) -> IntervalSpeed:
        """Select intervals."""
        arrays = {name: own for name, own in vars(self).items() if isinstance(own, np.ndarray)}
        columns: dict[str, Any] = {name: own[which] for name, own in arrays.items()}
        return replace(self, **columns)

    @property
    def bandwidth_hz(self) -> float:
        """Highest frequency that the intervals resolve: half the pulse rate [Hz]."""
        return float(0.5 / np.median(self.duration_s)) if len(self.duration_s) else 0.0


@checked
def speed_from_pulses(
    times_s: npt.ArrayLike | PulseTimes,
    pulses_per_rev: int,
    *,
    gaps: npt.ArrayLike | None = None,
    angles: ReflectorAngles | None = None,
    time_std_s: npt.ArrayLike | None = None,
) -> IntervalSpeed:
    """Mean speed over each interval between pulses, with missed and extra pulses repaired.

    Periods are compared with their running median. A period that is too short ends at an extra pulse, which is
    removed. A period near a multiple of the median has missed pulses, which are inserted. Intervals with extra or
    missed pulses are flagged. Next to breaks, and where a shaft nearly stops, periods are compared with the trend of
    the neighbouring speeds instead, since the shaft may be stopping or starting there. A trend on one side alone can't
    distinguish missed pulses from a stopping shaft; the standard deviation then covers both. Intervals over a gap, and
    intervals with more than four missed pulses, are omitted.

    Standard deviations for pulses of `pulse_times` are valid from three samples per pulse upwards, and accurate to
    about 4 %, like the noise estimate. At a steady speed with a nearly whole number of samples between pulses, the
    errors are equal and cancel; the standard deviation is then too large, since at least a twentieth of the variance
    is kept.

    Parameters
    ----------
    times_s
        Ascending crossing times [s], shape (N,); or a `PulseTimes`, whose gaps and standard deviations are used.
    pulses_per_rev
        Pulses in a turn, P.
    gaps
        Stretches without samples [s], shape (G, 2), as in `PulseTimes.gaps_s`; by default those of the `PulseTimes`.
    angles
        Angles of the reflectors; even by default. The first reflector of each stretch between breaks is identified from
        the periods.
    time_std_s
        Standard deviation of the crossing times [s], one number or shape (N,), such as `PulseTimes.time_std_s`. By
        default, 0 for plain times; for `PulseTimes`, its standard deviations of sampling and of noise separately, since
        sampling errors are correlated if a pulse has few samples.

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
    timing = _Timing.of(times_s, time_std_s)
    if isinstance(times_s, PulseTimes):
        gaps = times_s.gaps_s if gaps is None else gaps
    times, gap_times = checked_times(timing.times_s, pulses_per_rev, gaps)
    timing = replace(timing, times_s=times)
    if angles is None:
        angles = ReflectorAngles(
            np.full(pulses_per_rev, 1.0 / pulses_per_rev), np.zeros(pulses_per_rev), ok=True
        )
    if not angles.ok:
        raise InputError(f"angles: not known ({angles.reason}); leave them out for even spacing")
    if len(angles.fractions) != pulses_per_rev:
        raise InputError(f"angles: found {len(angles.fractions)}, expected pulses_per_rev = {pulses_per_rev}")
    parts = [_track_speed(track, angles, timing) for track in cut_tracks(times, gap_times, pulses_per_rev)]
    middle, speed, std, duration, flags, angle, ends = (
        (part[0] if len(part) == 1 else np.concatenate(part)) if parts else np.empty(0)
        for part in (zip(*parts, strict=True) if parts else [()] * 7)
    )
    return IntervalSpeed(middle, speed, std, duration, flags.astype(np.uint8), pulses_per_rev, angle, ends)


@checked
def resample(
    interval_speed: IntervalSpeed, rate_hz: float, start_s: float, stop_s: float
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Speed on a uniform grid from `start_s` up to, not including, `stop_s`.

    The speed is the slope of a cubic spline through the angle at each pulse. The speed is masked in omitted
    intervals. The spline follows the speed itself, not its mean over the intervals: the amplitude at a tenth
    of the pulse rate is kept to 0.03 %, at a fifth to 0.5 %. Straight lines between the means would reduce
    these amplitudes by 5 and 18 %. There is no delay; assigning each mean to the last pulse of its interval
    would delay the speed by 1 / (2 P n).

    Parameters
    ----------
    interval_speed
        Speeds of the intervals.
    rate_hz
        Rate of the grid [Hz].
    start_s, stop_s
        Ends of the grid [s].

    Returns
    -------
    speed_rps
        Speed [rev/s], NaN where masked, shape (round((stop_s - start_s) rate_hz),).
    masked
        True where no interval covers the time.
    """
    require_positive("rate_hz", rate_hz)
    if not stop_s > start_s:
        raise InputError(f"stop_s: found {stop_s} with start_s = {start_s}, expected later")
    count = at_most("stop_s", (stop_s - start_s) * rate_hz)
    speed, time = np.full(count, np.nan), start_s + np.arange(count) / rate_hz
    for _, edges, turned in unbroken(interval_speed):
        spline = CubicSpline(edges, turned, bc_type="natural")
        covered = slice(*np.searchsorted(time, edges[[0, -1]]))
        speed[covered] = spline(time[covered], 1)
    masked = np.isnan(speed)
    return speed, masked


def unbroken(interval_speed: IntervalSpeed) -> list[tuple[slice, Array, Array]]:
    """Stretches of intervals without a break: their slices, edges [s], and angle at each edge [rev]."""
    half = 0.5 * interval_speed.duration_s
    first, last = interval_speed.time_s - half, interval_speed.time_s + half
    if not first.size:
        return []
    breaks = np.flatnonzero(first[1:] - last[:-1] > 1e-3 * half[1:])
    stretches = []
    for begin, end in zip(np.append(0, breaks + 1), np.append(breaks + 1, len(first)), strict=True):
        stretch = slice(int(begin), int(end))
        turned = np.cumsum(interval_speed.turned_rev[stretch])
        stretches.append((stretch, np.append(first[stretch], last[end - 1]), np.append(0.0, turned)))
    return stretches


@checked
def interval_gain(frequency_hz: npt.ArrayLike, pulses_per_rev: int, speed_rps: float) -> Array:
    """Gain sinc(f / (P n)) by which averaging over one interval reduces speed ripple at `frequency_hz`.

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
class _Timing:
    """Crossing times [s] and their standard deviations due to noise and sampling, one value for all or one per time."""

    times_s: npt.ArrayLike
    noise_s: Array
    grid_s: Array
    sample_s: float
    """Time between samples [s]; 0 if unknown."""

    @classmethod
    def of(cls, times_s: npt.ArrayLike | PulseTimes, time_std_s: npt.ArrayLike | None) -> _Timing:
        none = np.zeros(())
        if isinstance(times_s, PulseTimes) and time_std_s is None:
            noise = none if times_s.noise_std_s is None else times_s.noise_std_s
            grid = times_s.time_std_s if times_s.grid_std_s is None else times_s.grid_std_s
            return cls(times_s.times_s, noise, grid, 1.0 / times_s.rate_hz)
        times = times_s.times_s if isinstance(times_s, PulseTimes) else times_s
        std = none if time_std_s is None else np.asarray(time_std_s, dtype=np.float64)
        if std.ndim and std.shape != np.shape(times):
            raise InputError(f"time_std_s: found shape {std.shape}, expected one number or {np.shape(times)}")
        if not (np.isfinite(std).all() and (std >= 0.0).all()):
            raise InputError(
                "time_std_s: found a negative number or one that is not finite, expected finite numbers from 0 on"
            )
        return cls(times, std, none, 0.0)

    def of_edges(self, edges_s: Array) -> tuple[Array, Array]:
        """Standard deviations of the given edges due to noise and to sampling, each a single value or one per edge."""
        noise, grid = np.atleast_1d(self.noise_s), np.atleast_1d(self.grid_s)
        times = np.asarray(self.times_s)
        if max(len(noise), len(grid)) > 1 and len(edges_s) < len(times):
            place = np.searchsorted(times, edges_s)
            noise, grid = (std[place] if len(std) > 1 else std for std in (noise, grid))
        return np.ascontiguousarray(noise), np.ascontiguousarray(grid)


def _track_speed(
    track: Track, angles: ReflectorAngles, timing: _Timing
) -> tuple[Array, Array, Array, Array, npt.NDArray[np.uint8], Array, Array]:
    """Usable intervals after repair: midpoint, speed, std, duration, flags, angle, std for independent ends."""
    fractions, relative_std = align_angles(track, angles)
    noise, grid = timing.of_edges(track.edges_s)
    edges = np.ascontiguousarray(track.edges_s)
    columns = interval_speeds(edges, track.count, fractions, relative_std, noise, grid, timing.sample_s)
    flags = track.flags
    if track.doubt is not None and track.doubt.any():
        doubt = np.repeat(track.doubt, track.count) * columns[1]
        columns[2], columns[5] = np.hypot(columns[2], doubt), np.hypot(columns[5], doubt)
    if len(track.count) > 1 and (track.count > 1).any():
        # The mean speed over missed pulses is accurate, but the true speeds of the inserted intervals deviate from it.
        mean = columns[1, np.cumsum(track.count) - 1]
        columns[2] = np.hypot(
            columns[2], np.repeat(np.abs(np.gradient(mean)) * (track.count > 1), track.count)
        )
    if not track.usable.all() or columns.shape[1] > len(flags):
        usable = np.repeat(track.usable, track.count)
        columns, flags = columns[:, usable], np.repeat(flags, track.count)[usable]
    middle, speed, std, duration, angle, ends = columns
    return middle, speed, std, duration, flags, angle, ends


@dataclass(frozen=True)
class Train:
    """Pulse train of one shaft.

    Parameters
    ----------
    name
        Label.
    speed
        Interval speeds of the train's shaft, with standard deviations (`speed_from_pulses(..., time_std_s=...)`).
    ratio
        Turns of the train's shaft per turn of the shaft whose speed is wanted: 1 for a train on that shaft, the gear
        ratio for a train on the engine's shaft; None if it is to be estimated.
    """

    name: str
    speed: IntervalSpeed
    ratio: float | None = 1.0


@dataclass(frozen=True)
class Passages:
    """Recorded pulses of a train: times, turns of its own shaft, standard deviations of the turns, stretch of each."""

    time_s: Array
    turned: Array
    std: Array
    stretch: npt.NDArray[np.intp]
    pitch: float
    """Angle between pulses [rev]."""
    slips_s: Array

    def cut(self, places: npt.NDArray[np.intp]) -> Passages:
        """Start a new stretch at each of the given indices, where the count of pulses slipped."""
        later = np.zeros(len(self.time_s), dtype=np.intp)
        later[places] = 1
        return replace(
            self,
            stretch=self.stretch + np.cumsum(later),
            slips_s=np.sort(np.append(self.slips_s, self.time_s[places])),
        )


def passages_of(train: Train) -> Passages:
    """Recorded pulses of a train, without inserted ones."""
    speed = train.speed
    if not (speed.std_rps > 0.0).all():
        raise InputError(
            f"train {train.name!r}: the speeds have no standard deviation; give time_std_s to speed_from_pulses"
        )
    if train.ratio is not None:
        require_positive(f"train {train.name!r}, ratio", train.ratio)
    ends_std_rps = speed.std_rps if speed.ends_std_rps is None else speed.ends_std_rps
    columns: list[tuple[Array, Array, Array, npt.NDArray[np.intp]]] = []
    for k, (stretch, edges, turned) in enumerate(unbroken(speed)):
        put_in = (speed.flags[stretch] & PulseFlag.MISSED) > 0
        true = ~np.concatenate([[False], put_in[1:] & put_in[:-1], [False]])
        # The variance of an interval is the sum of the variances of its two ends.
        variance = 0.5 * (ends_std_rps * speed.duration_s)[stretch] ** 2
        std = np.sqrt(0.5 * (np.append(variance, variance[-1]) + np.append(variance[0], variance)))
        columns.append((edges[true], turned[true], std[true], np.full(np.count_nonzero(true), k)))
    if not columns or sum(len(column[0]) for column in columns) < 8:
        raise InputError(f"train {train.name!r}: too few pulses, expected 8 or more")
    time, angle, deviation, stretches = (np.concatenate(column) for column in zip(*columns, strict=True))
    return Passages(time, angle, deviation, stretches, 1.0 / speed.pulses_per_rev, np.empty(0))
