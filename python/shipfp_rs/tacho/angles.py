"""Angles between the reflectors of a shaft, estimated from the pulses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.tacho.tracks import PulseFlag, Track, checked_times, cut_tracks

_STEADY = 0.02
"""Largest relative change of speed within a turn from which the reflectors are measured."""
_LEAST_TURNS = 20
_WORST_ANGLE = 0.002
"""Largest standard deviation of an angle between reflectors, relative to the even angle, at which the estimate is
used.
"""


@dataclass(frozen=True)
class ReflectorAngles:
    """Angles between the reflectors (or teeth) of a pulse wheel.

    Parameters
    ----------
    fractions
        Angle from each pulse to the next as a fraction of a turn, shape (P,), in order; they sum to 1.
    std
        Standard deviations of `fractions`, shape (P,).
    ok
        Whether the pulses determine the angles; if not, `fractions` are equal.
    reason
        Reason if `ok` is false, else empty.
    """

    fractions: Array
    std: Array
    ok: bool
    reason: str = ""


@checked
def reflector_angles(
    times_s: npt.ArrayLike, pulses_per_rev: int, *, gaps: npt.ArrayLike | None = None
) -> ReflectorAngles:
    """Estimate the angles between the reflectors of a shaft from the pulses.

    Each period is divided by the duration of the turn centred on it, which does not depend on the reflectors' angles.
    The mean of this ratio over all steady turns is the angle. Speed variations at whole orders of the rotation can't
    be distinguished from uneven angles. Only the longest stretch without a break is used, since the count of
    reflectors is lost in a break. Single missed pulses do not shift the count.

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
        The first fraction belongs to the first interval of the longest stretch. `ok` is false, with a reason, if there
        are too few turns, the speed changes too much or the scatter is too large.

    Notes
    -----
    Diamond et al. (2016), https://hdl.handle.net/2263/56372, fit the same model by Bayesian regression.
    """
    times, gap_times = checked_times(times_s, pulses_per_rev, gaps)
    even = np.full(pulses_per_rev, 1.0 / pulses_per_rev)
    if pulses_per_rev == 1:
        return ReflectorAngles(even, np.zeros(1), ok=True)

    def refused(reason: str) -> ReflectorAngles:
        return ReflectorAngles(even, np.full(pulses_per_rev, np.nan), ok=False, reason=reason)

    tracks = cut_tracks(times, gap_times, pulses_per_rev)
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
        # The scatter of the means of ten parts of the record also includes slow errors, such as a slipped count.
        parts = [part.mean() for part in np.array_split(ratio[steady & (phase == k)], 10)]
        mean[k], std[k] = np.mean(parts), np.std(parts, ddof=1) / np.sqrt(len(parts))
    fractions, std = mean / mean.sum(), std / mean.sum()
    worst = float(std.max() * pulses_per_rev)
    if worst > _WORST_ANGLE:
        return refused(f"the spacings scatter by {worst:.2%} of the even one, more than {_WORST_ANGLE:.1%}")
    return ReflectorAngles(fractions, std, ok=True)


def _period_ratios(
    track: Track, pulses_per_rev: int
) -> tuple[Array, npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """Ratio of each period to the turn centred on it, whether the speed is steady, and the period's index in the turn."""
    good = (track.flags == PulseFlag.GOOD) & track.usable
    periods = np.repeat(np.where(good, np.diff(track.edges_s), np.nan), track.count)
    phase = np.arange(len(periods)) % pulses_per_rev
    ratio = np.full(len(periods), np.nan)
    steady = np.zeros(len(periods), dtype=np.bool_)
    half, odd = divmod(pulses_per_rev, 2)
    # With an even number of periods, a turn centred on a period begins and ends with half a period.
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


def align_angles(track: Track, angles: ReflectorAngles) -> tuple[Array, Array]:
    """Fractions and their relative standard deviations, rotated to start at the track's first interval."""
    count = len(angles.fractions)
    if count == 1:
        return angles.fractions, angles.std / angles.fractions
    ratio, steady, phase = _period_ratios(track, count)
    seen = np.bincount(phase[steady], minlength=count)
    if (
        seen.min() < _LEAST_TURNS
    ):  # The track is too short to identify its first interval, so equal fractions are returned.
        return np.full(count, 1.0 / count), np.full(count, np.std(angles.fractions) * count)
    mean = np.bincount(phase[steady], ratio[steady], minlength=count) / np.maximum(seen, 1)
    turned = [np.roll(angles.fractions, -k) for k in range(count)]
    best = int(np.argmin([np.sum((mean - fractions) ** 2) for fractions in turned]))
    return turned[best], np.roll(angles.std, -best) / turned[best]
