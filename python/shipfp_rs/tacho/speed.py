"""Speed over each interval between pulses, and on a uniform grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from shipfp_rs._core import slope_at_even_times
from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import checked
from shipfp_rs.tacho.angles import ReflectorAngles, align_angles
from shipfp_rs.tacho.tracks import Track, checked_times, cut_tracks, require_positive

Array = npt.NDArray[np.float64]


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


@checked
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
    times, gap_times = checked_times(times_s, pulses_per_rev, gaps)
    if angles is None:
        angles = ReflectorAngles(
            np.full(pulses_per_rev, 1.0 / pulses_per_rev), np.zeros(pulses_per_rev), ok=True
        )
    if not angles.ok:
        raise InputError(f"angles: not known ({angles.reason}); leave them out for even spacing")
    if len(angles.fractions) != pulses_per_rev:
        raise InputError(f"angles: found {len(angles.fractions)}, expected pulses_per_rev = {pulses_per_rev}")
    parts = [_track_speed(track, angles, time_std_s) for track in cut_tracks(times, gap_times)]
    middle, speed, std, duration, flags = (
        np.concatenate(part) if parts else np.empty(0)
        for part in (zip(*parts, strict=True) if parts else [()] * 5)
    )
    return IntervalSpeed(middle, speed, std, duration, flags.astype(np.uint8), pulses_per_rev)


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
    count = round((stop_s - start_s) * rate_hz)
    if not count > 0:
        raise InputError(f"stop_s: found {stop_s} with start_s = {start_s}, expected later")
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
        turned = np.cumsum((interval_speed.speed_rps * interval_speed.duration_s)[stretch])
        stretches.append((stretch, np.append(first[stretch], last[end - 1]), np.append(0.0, turned)))
    return stretches


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


def _track_speed(
    track: Track, angles: ReflectorAngles, time_std_s: float
) -> tuple[Array, Array, Array, Array, npt.NDArray[np.uint8]]:
    """Middle, speed, its standard deviation, length and flags of the usable intervals, missed pulses put in."""
    fractions, relative_std = align_angles(track, angles)
    place = np.arange(track.count.sum()) % len(fractions)
    begins = np.cumsum(track.count) - track.count
    whole = np.diff(track.edges_s)
    speed = np.repeat(np.add.reduceat(fractions[place], begins) / whole, track.count)
    duration = fractions[place] / speed
    middle = track.edges_s[0] + np.cumsum(duration) - duration / 2
    timing = np.repeat(np.sqrt(2.0) * time_std_s / whole, track.count)
    std = speed * np.hypot(timing, relative_std[place])
    usable = np.repeat(track.usable, track.count)
    flags = np.repeat(track.flags, track.count)
    return middle[usable], speed[usable], std[usable], duration[usable], flags[usable]
