"""Speed over each interval between pulses, and on a uniform grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from shipfp_rs._core import interval_speeds, slope_at_even_times
from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.checks import at_most
from shipfp_rs.tacho.angles import ReflectorAngles, align_angles
from shipfp_rs.tacho.crossings import PulseTimes
from shipfp_rs.tacho.tracks import Track, checked_times, cut_tracks, require_positive

_TYPICAL = 21


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
    angle_rev
        Angle turned in each interval [rev], shape (N,); None: speed times length. It differs from that where pulses
        are timed so coarsely that the mean of 1 / T is above 1 / mean of T, which the speed is freed of.
    ends_std_rps
        What `std_rps` would be if the errors of an interval's two ends had nothing to do with each other [rev/s], shape
        (N,): tells how well the ends are known by themselves. None: that they have not.
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
        """Median speed [rev/s], of about twenty pulses at a time: of a single one it may be coarse."""
        size = min(_TYPICAL, max(len(self.duration_s), 1))
        turned, lasted = (
            np.convolve(column, np.ones(size), mode="valid") for column in (self.turned_rev, self.duration_s)
        )
        return float(np.median(turned / lasted))

    def times_as_fast_as(self, other: IntervalSpeed) -> float:
        """Return the median ratio of the two speeds at the same times, of about twenty pulses at a time.

        Where a set point steps between levels the median of each speed alone may be either level's. It is not a number
        where the two share no time.
        """
        size = min(_TYPICAL, max(len(self.duration_s), 1))
        first, last = 0.5 * self.duration_s[: 1 - size or None], 0.5 * self.duration_s[size - 1 :]
        begin, end = self.time_s[: 1 - size or None] - first, self.time_s[size - 1 :] + last
        own, others = self._mean_over(begin, end), other._mean_over(begin, end)
        known = np.isfinite(own) & np.isfinite(others) & (others > 0.0)
        return float(np.median(own[known] / others[known])) if known.any() else float("nan")

    def _mean_over(self, begin: Array, end: Array) -> Array:
        """Mean speed between two times [rev/s], gaps left out; not a number where there is no interval."""
        if not len(self.time_s):
            return np.full(len(begin), np.nan)
        ends = self.time_s + 0.5 * self.duration_s
        turned, lasted = (
            np.interp(end, ends, column) - np.interp(begin, ends, column)
            for column in (np.cumsum(self.turned_rev), np.cumsum(self.duration_s))
        )
        return np.asarray(np.divide(turned, lasted, out=np.full(len(begin), np.nan), where=lasted > 0.0))

    def part(self, which: slice) -> IntervalSpeed:
        """Return some of the intervals."""
        return replace(
            self,
            time_s=self.time_s[which],
            speed_rps=self.speed_rps[which],
            std_rps=self.std_rps[which],
            duration_s=self.duration_s[which],
            flags=self.flags[which],
            angle_rev=None if self.angle_rev is None else self.angle_rev[which],
            ends_std_rps=None if self.ends_std_rps is None else self.ends_std_rps[which],
        )

    @property
    def bandwidth_hz(self) -> float:
        """Highest frequency that the intervals can show: half the pulses per second [Hz]."""
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
    """Mean speed over each interval between pulses, assigned to its middle; missed and extra pulses repaired.

    Against a running median of the periods, one that is too short ends at an extra pulse, which is removed, and one
    near a multiple has missed pulses, which are put in. Both are flagged. Next to breaks, and where a shaft nearly
    stops, the trend of the speeds before and behind decides, so that a shaft may slow down to rest or run up from it;
    what only one side tells has a deviation that allows for the other reading. Intervals over a gap, and such as miss
    more than four pulses, are left out.

    Of pulses from `pulse_times` the standard deviations hold from three samples a pulse up, as well as the noise is
    known, some 4 % of itself. Where a steady speed has a whole number of samples between pulses, or nearly so, the
    errors are alike and cancel: a twentieth of their variance is stated at least, which is too much there.

    Parameters
    ----------
    times_s
        Crossing times [s], shape (N,), ascending; or the pulses, with their gaps and standard deviations.
    pulses_per_rev
        Pulses in a turn, P.
    gaps
        Stretches without samples [s], shape (G, 2), as in `PulseTimes.gaps_s`; None: those of the pulses.
    angles
        Angles of the reflectors; even by default. Which of them comes first is found from the periods, for
        each stretch between breaks anew.
    time_std_s
        Standard deviation of a crossing time [s], or of each, shape (N,), for instance `PulseTimes.time_std_s`.
        None: those of the pulses, which also tell apart what sampling does, in step with the pulses where these have
        few samples, from noise; 0 of plain times.

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
    parts = [_track_speed(track, angles, timing) for track in cut_tracks(times, gap_times)]
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

    The slope of a cubic spline through the angle turned up to each pulse; nothing is bridged where intervals were
    left out. It follows the speed itself, not its mean over the intervals: a swing at a tenth of the pulse rate
    keeps its size to 0.03 %, one at a fifth to 0.5 %. Straight lines between the means would take 5 and 18 % off.
    There is no delay: read when its last pulse comes, an interval would lag by half its length, 1 / (2 P n).

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
    require_positive("rate_hz", rate_hz)
    if not stop_s > start_s:
        raise InputError(f"stop_s: found {stop_s} with start_s = {start_s}, expected later")
    count = at_most("stop_s", (stop_s - start_s) * rate_hz)
    speed = np.full(count, np.nan)
    for _, edges, turned in unbroken(interval_speed):
        spline = CubicSpline(edges, turned, bc_type="natural")
        first, slopes = slope_at_even_times(edges, spline.c, start_s, rate_hz, count)
        speed[first : first + len(slopes)] = slopes
    masked = np.isnan(speed)
    return speed, masked


def unbroken(interval_speed: IntervalSpeed) -> list[tuple[slice, Array, Array]]:
    """Stretches of intervals without a break: which ones, their edges [s], and the angle turned up to each [rev]."""
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
class _Timing:
    """Standard deviations of crossing times [s]: each a number, or an array of one for each time."""

    times_s: npt.ArrayLike
    noise_s: Array
    grid_s: Array
    sample_s: float
    """Time between samples; 0: it is not known what sampling did."""

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
                "time_std_s: found a negative or infinite one, expected finite numbers from 0 on"
            )
        return cls(times, std, none, 0.0)

    def of_edges(self, edges_s: Array) -> tuple[Array, Array]:
        """Return those of some of the edges: from noise and from sampling, one for all or one for each."""
        noise, grid = np.atleast_1d(self.noise_s), np.atleast_1d(self.grid_s)
        times = np.asarray(self.times_s)
        if max(len(noise), len(grid)) > 1 and len(edges_s) < len(times):
            place = np.searchsorted(times, edges_s)
            noise, grid = (std[place] if len(std) > 1 else std for std in (noise, grid))
        return np.ascontiguousarray(noise), np.ascontiguousarray(grid)


def _track_speed(
    track: Track, angles: ReflectorAngles, timing: _Timing
) -> tuple[Array, Array, Array, Array, npt.NDArray[np.uint8], Array, Array]:
    """Columns of the usable intervals, missed pulses put in: middle, speed, deviation, length, flags, angle, ends'."""
    fractions, relative_std = align_angles(track, angles)
    noise, grid = timing.of_edges(track.edges_s)
    columns = interval_speeds(
        np.ascontiguousarray(track.edges_s),
        track.count,
        fractions,
        relative_std,
        noise,
        grid,
        timing.sample_s,
    )
    flags = track.flags
    if track.doubt is not None and track.doubt.any():
        doubt = np.repeat(track.doubt, track.count) * columns[1]
        columns[2], columns[5] = np.hypot(columns[2], doubt), np.hypot(columns[5], doubt)
    if len(track.count) > 1 and (track.count > 1).any():
        # The mean over missed pulses is as good as any; that all of them have it is not.
        mean = columns[1, np.cumsum(track.count) - 1]
        columns[2] = np.hypot(
            columns[2], np.repeat(np.abs(np.gradient(mean)) * (track.count > 1), track.count)
        )
    if not track.usable.all() or columns.shape[1] > len(flags):
        usable = np.repeat(track.usable, track.count)
        columns, flags = columns[:, usable], np.repeat(flags, track.count)[usable]
    middle, speed, std, duration, angle, ends = columns
    return middle, speed, std, duration, flags, angle, ends
