"""Several pulse trains of one shaft line to one best speed with its variance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.tacho.angle_spline import AngleSpline, fit_angle_spline
from shipfp_rs.tacho.speed import IntervalSpeed, unbroken
from shipfp_rs.tacho.tracks import PulseFlag, require_positive

Array = npt.NDArray[np.float64]

_ROUNDS = 10
"""Of reweighting: a slipped count bends all at first, and is left behind round by round."""
_HUBER = 2.5
"""Standard deviations from which on a pulse's pull grows no more."""
_APART = 6.0
"""Standard deviations beyond which a pulse and the fused angle part."""
_SAME_SPEED = 5.0, 1e-5
"""Standard deviations, and part of the speed, within which two trains tell the same mean speed."""
_UNEXPLAINED = 3.0
"""Scatter from which on a train's timing and reflectors no longer explain it."""
_UNKNOWN = 0.05
"""Relative standard deviation from which on a speed is masked: nothing but the bridge is there."""
_ROBUST = 1.4826
"""Standard deviation over median absolute deviation of Gaussian noise."""


@dataclass(frozen=True)
class Train:
    """A pulse train and how fast its shaft turns.

    Parameters
    ----------
    name
        Label.
    speed
        Interval speeds of its own shaft, with standard deviations (`speed_from_pulses(..., time_std_s=...)`).
    ratio
        Turns of its shaft per turn of the one whose speed is wanted: 1 on that shaft itself, the gear ratio on the
        engine's; None: estimated.
    """

    name: str
    speed: IntervalSpeed
    ratio: float | None = 1.0


@dataclass(frozen=True)
class TrainReport:
    """What a train has to do with the fused speed.

    Parameters
    ----------
    ratio, ratio_std
        Turns of its shaft per turn of the fused one; the standard deviation is 0 where the ratio was given.
    scatter
        Scatter of its pulses about the fused angle over what their timing and reflectors explain [-]; the train weighs
        less by its square where it is above 1.
    difference, difference_std
        Its mean speed relative to the fused one less 1 [-]; near 0 by construction where the ratio was estimated.
    apart_s
        Stretches where its angle parts from the fused one [s], shape (K, 2): slipped counts, wrong pulses.
    """

    ratio: float
    ratio_std: float
    scatter: float
    difference: float
    difference_std: float
    apart_s: Array

    @property
    def agrees(self) -> bool:
        """Whether its mean speed and its angle are those of the fused speed, within what their noise explains."""
        deviations, least = _SAME_SPEED
        same_speed = abs(self.difference) <= max(deviations * self.difference_std, least)
        return same_speed and self.scatter < _UNEXPLAINED and not len(self.apart_s)


@dataclass(frozen=True)
class FusedSpeed:
    """One speed of several trains.

    Parameters
    ----------
    time_s
        Uniform grid [s], shape (N,).
    speed_rps, std_rps
        Speed and its standard deviation [rev/s], shape (N,); NaN where no train tells it.
    bandwidth_hz
        Frequency up to which it follows the shaft: gain 1 to a part in a thousand, without delay [Hz].
    trains
        Name to what each has to do with it.
    """

    time_s: Array
    speed_rps: Array
    std_rps: Array
    bandwidth_hz: float
    trains: dict[str, TrainReport]


@dataclass(frozen=True)
class _Passages:
    """True pulses of a train: times, turns of its own shaft, their standard deviations, stretch of each."""

    time_s: Array
    turned: Array
    std: Array
    stretch: npt.NDArray[np.intp]


def fuse(
    trains: Sequence[Train],
    rate_hz: float,
    start_s: float,
    stop_s: float,
    *,
    bandwidth_hz: float | None = None,
) -> FusedSpeed:
    """One speed from several pulse trains, on a uniform grid from `start_s` up to, not including, `stop_s`.

    Every pulse tells the angle of its shaft at its time. A spline is laid through the angles of all trains, each weighted
    by the inverse of its variance, and each unbroken stretch with an offset of its own; the slope is the speed.
    Angles, unlike speeds between pulses, are not averaged over an interval: there is no boxcar gain and no delay to
    correct, and the errors of successive pulses are independent.

    Parameters
    ----------
    trains
        One or more; at least one ratio is known.
    rate_hz
        Rate of the grid [Hz].
    start_s, stop_s
        Its ends [s].
    bandwidth_hz
        Highest frequency to follow [Hz]; noise grows with its power 3/2. None: an eighth of all pulses per second.

    Raises
    ------
    InputError
        Where the trains are too thin for the bandwidth, or their timing's standard deviation is not known.

    Examples
    --------
    >>> from shipfp_rs.tacho import speed_from_pulses
    >>> four = speed_from_pulses(np.arange(400) / 20.0, 4, time_std_s=1e-4)
    >>> engine = speed_from_pulses(np.arange(300) / 15.0, 1, time_std_s=1e-4)
    >>> fused = fuse([Train("PTM_4", four), Train("PTM_e", engine, ratio=3.0)], 10.0, 2.0, 18.0)
    >>> round(float(fused.speed_rps[0]), 6), fused.trains["PTM_e"].agrees
    (5.0, True)
    """
    require_positive("rate_hz", rate_hz)
    count = round((stop_s - start_s) * rate_hz)
    if not count > 0:
        raise InputError(f"stop_s: found {stop_s} with start_s = {start_s}, expected later")
    if not trains or len({train.name for train in trains}) < len(trains):
        raise InputError(
            f"trains: found {[train.name for train in trains]}, expected one or more of different names"
        )
    if all(train.ratio is None for train in trains):
        raise InputError("trains: no ratio is known, expected that of one train at least")
    passages = {train.name: _passages(train) for train in trains}
    pulses_per_s = sum(1.0 / np.median(np.diff(p.time_s)) for p in passages.values())
    band = pulses_per_s / 8.0 if bandwidth_hz is None else bandwidth_hz
    require_positive("bandwidth_hz", band)
    if band > pulses_per_s / 6.0:
        raise InputError(
            f"bandwidth_hz: found {band:g} with {pulses_per_s:.3g} pulses a second in all trains, expected at most "
            f"{pulses_per_s / 6.0:.3g}"
        )
    ratios = {train.name: (train.ratio, 0.0) for train in trains if train.ratio is not None}
    known = {name: (ratio, std) for name, (ratio, std) in ratios.items() if ratio is not None}
    if len(known) < len(trains):
        fit = _Fit(passages, known, band)
        known |= {t.name: fit.ratio(passages[t.name]) for t in trains if t.ratio is None}
    fit = _Fit(passages, known, band)
    grid = start_s + np.arange(count) / rate_hz
    speed, std = fit.at(grid)
    return FusedSpeed(grid, speed, std, float(band), {name: fit.report(name) for name in passages})


class _Fit:
    """Spline through the passages of the trains whose ratio is known."""

    def __init__(
        self, passages: dict[str, _Passages], ratios: dict[str, tuple[float, float]], bandwidth_hz: float
    ) -> None:
        self.ratios = ratios
        self.passages = {}
        stretches = 0
        for name, (ratio, _) in ratios.items():
            own = passages[name]
            self.passages[name] = replace(
                own, turned=own.turned / ratio, std=own.std / ratio, stretch=own.stretch + stretches
            )
            stretches += int(own.stretch.max()) + 1
        parts = list(self.passages.values())
        self.time, self.angle, self.std, self.stretch = (
            np.concatenate([getattr(part, field) for part in parts])
            for field in ("time_s", "turned", "std", "stretch")
        )
        self.train = np.repeat(np.arange(len(parts)), [len(part.time_s) for part in parts])
        self.scatter = np.ones(len(parts))
        pull = np.ones(len(self.time))
        for _ in range(_ROUNDS):
            spread = self.std * np.maximum(self.scatter, 1.0)[self.train]
            self.fit: AngleSpline = fit_angle_spline(
                self.time, self.angle, pull / spread**2, self.stretch, 0.25 / bandwidth_hz
            )
            self.residual = self.angle + self.fit.offsets[self.stretch] - self.fit.spline(self.time)
            # What the spline took up of the scatter it does not show.
            taken = np.sqrt(len(self.time) / max(len(self.time) - len(self.fit.spline.c), 1))
            score = taken * np.abs(self.residual) / self.std
            self.scatter = np.array([_ROBUST * np.median(score[self.train == k]) for k in range(len(parts))])
            score /= np.maximum(self.scatter, 1.0)[self.train]
            pull = _HUBER / np.maximum(score, _HUBER)

    def at(self, grid: Array) -> tuple[Array, Array]:
        """Speed and standard deviation on a grid, NaN where no pulses lead to it."""
        speed, std = np.full((2, len(grid)), np.nan)
        inside = (grid >= self.time.min()) & (grid <= self.time.max())
        speed[inside] = self.fit.speed(grid[inside])
        std[inside] = np.sqrt(self.fit.speed_variance(grid[inside]))
        with np.errstate(invalid="ignore"):
            lost = ~(std <= _UNKNOWN * np.abs(speed))
        speed[lost] = std[lost] = np.nan
        return speed, std

    def ratio(self, own: _Passages) -> tuple[float, float]:
        """Turns of a train's shaft per turn of the fused one, and the standard deviation."""
        inside = (own.time_s >= self.time.min()) & (own.time_s <= self.time.max())
        if np.count_nonzero(inside) < 3:
            raise InputError("trains: a ratio can't be estimated, the trains have no time in common")
        return _slope(
            self.fit.spline(own.time_s[inside]),
            own.turned[inside],
            own.std[inside],
            own.stretch[inside],
        )

    def report(self, name: str) -> TrainReport:
        k = list(self.passages).index(name)
        own, mine = self.passages[name], self.train == k
        spread = own.std * np.clip(self.scatter[k], 1.0, _UNEXPLAINED)
        slope, slope_std = _slope(self.fit.spline(own.time_s), own.turned, spread, own.stretch)
        apart = np.abs(self.residual[mine]) > _APART * spread
        edges = np.flatnonzero(np.diff(apart, prepend=False, append=False)).reshape(-1, 2)
        ratio, ratio_std = self.ratios[name]
        return TrainReport(
            ratio=ratio,
            ratio_std=ratio_std,
            scatter=float(self.scatter[k]),
            difference=slope - 1.0,
            difference_std=slope_std,
            apart_s=np.column_stack([own.time_s[edges[:, 0]], own.time_s[edges[:, 1] - 1]]),
        )


def _passages(train: Train) -> _Passages:
    """Pulses as they came by, without those that were put in."""
    speed = train.speed
    if not (speed.std_rps > 0.0).all():
        raise InputError(
            f"train {train.name!r}: its speeds have no standard deviation; give speed_from_pulses time_std_s"
        )
    if train.ratio is not None:
        require_positive(f"train {train.name!r}, ratio", train.ratio)
    columns: list[tuple[Array, Array, Array, npt.NDArray[np.intp]]] = []
    for k, (stretch, edges, turned) in enumerate(unbroken(speed)):
        put_in = (speed.flags[stretch] & PulseFlag.MISSED) > 0
        true = ~np.concatenate([[False], put_in[1:] & put_in[:-1], [False]])
        # An interval's variance is that of its two ends.
        variance = 0.5 * (speed.std_rps * speed.duration_s)[stretch] ** 2
        std = np.sqrt(0.5 * (np.append(variance, variance[-1]) + np.append(variance[0], variance)))
        columns.append((edges[true], turned[true], std[true], np.full(np.count_nonzero(true), k)))
    if not columns or sum(len(column[0]) for column in columns) < 8:
        raise InputError(f"train {train.name!r}: too few pulses, expected 8 or more")
    return _Passages(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _slope(turned: Array, own: Array, std: Array, stretch: npt.NDArray[np.intp]) -> tuple[float, float]:
    """Slope of a train's turns over the fused ones, offsets of its stretches apart, and its standard deviation."""
    weight = 1.0 / std**2
    numbers = stretch - stretch.min()
    total = np.maximum(np.bincount(numbers, weight), np.finfo(np.float64).tiny)
    x = turned - (np.bincount(numbers, weight * turned) / total)[numbers]
    y = own - (np.bincount(numbers, weight * own) / total)[numbers]
    power = float(np.sum(weight * x**2))
    return float(np.sum(weight * x * y)) / power, power**-0.5
