"""Common angle of several trains, and how each train compares with it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.spans import runs
from shipfp_rs.tacho.angle_spline import AnglePieces, fit_angle_pieces
from shipfp_rs.tacho.passages import Passages

_SPACING = 1.0 / 3.0
"""Knot spacing as a fraction of the period at the bandwidth. There the spline's gain is 0.1 % low."""
_ROUNDS = 10
"""Rounds of reweighting. A slipped count bends the whole angle at first; each round reduces its weight."""
_HUBER = 2.5
"""Huber's constant: the residual, in standard deviations, above which the influence of a pulse is constant."""
_APART = 6.0
"""Residual, in standard deviations, above which a pulse is reported as an outlier."""
_NEARBY, _SLIP = 5, 0.4
"""A count has slipped where the medians of this many passages before and after differ by more than this part of a pulse."""
_SAME_SPEED = 5.0, 1e-5
"""Largest difference of two equal mean speeds: in standard deviations, and relative to the speed."""
_UNEXPLAINED = 3.0
"""Largest ratio of a train's scatter to that expected from timing and reflectors."""
_UNKNOWN = 0.05
"""Relative standard deviation above which a speed is masked: the spline only bridges a gap there."""
_ROBUST, _CUT_OFF = 1.4826, 0.978
"""Standard deviation over median absolute deviation of Gaussian noise, and its mean square when cut at `_HUBER`."""


@dataclass(frozen=True)
class TrainReport:
    """Comparison of a train with the fused speed.

    Parameters
    ----------
    ratio, ratio_std
        Turns of its shaft per turn of the fused one; the standard deviation is 0 where the ratio was given.
    scatter
        Scatter of its pulses about the fused angle relative to that expected from timing and reflectors [-]. Above 1,
        the train's weight is divided by its square.
    difference, difference_std
        Relative difference of its mean speed from the fused one [-]; near 0 by construction where the ratio was estimated.
    apart_s
        Stretches where its angle departs from the fused one [s], shape (K, 2): wrong pulses, or a slipped count that
        the other trains could not resolve.
    slips_s
        Times at which its count slipped relative to the other trains [s], shape (K,); the train was cut there.
    """

    ratio: float
    ratio_std: float
    scatter: float
    difference: float
    difference_std: float
    apart_s: Array
    slips_s: Array

    @property
    def agrees(self) -> bool:
        """Whether its mean speed and angle agree with the fused ones within their noise."""
        deviations, least = _SAME_SPEED
        same_speed = abs(self.difference) <= max(deviations * self.difference_std, least)
        return same_speed and self.scatter < _UNEXPLAINED and not len(self.apart_s) and not len(self.slips_s)


class FusedAngle:
    """Spline through the passages of the trains whose ratio is known."""

    def __init__(
        self, passages: dict[str, Passages], ratios: dict[str, tuple[float, float]], bandwidth_hz: float
    ) -> None:
        self.ratios = ratios
        self.passages = {}
        stretches = 0
        for name, (ratio, _) in ratios.items():
            own = passages[name]
            self.passages[name] = replace(
                own,
                turned=own.turned / ratio,
                std=own.std / ratio,
                stretch=own.stretch + stretches,
                pitch=own.pitch / ratio,
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
            self.fit: AnglePieces = fit_angle_pieces(
                self.time, self.angle, pull / spread**2, self.stretch, _SPACING / bandwidth_hz
            )
            self.residual = self.angle + self.fit.offsets[self.stretch] - self.fit.angle(self.time)
            # The spline follows part of the scatter, so the residuals are too small by that part.
            taken = np.sqrt(len(self.time) / max(len(self.time) - self.fit.size, 1))
            score = taken * np.abs(self.residual) / self.std
            self.scatter = np.array([_robust_scale(score[self.train == k]) for k in range(len(parts))])
            score /= np.maximum(self.scatter, 1.0)[self.train]
            pull = _HUBER / np.maximum(score, _HUBER)

    def at(self, grid: Array) -> tuple[Array, Array]:
        """Speed and standard deviation on a grid, NaN where no pulses are near."""
        speed, std = self.fit.speed(grid), np.sqrt(self.fit.speed_variance(grid))
        with np.errstate(invalid="ignore"):
            lost = ~(std <= _UNKNOWN * np.abs(speed))
        speed[lost] = std[lost] = np.nan
        return speed, std

    def ratio(self, own: Passages) -> tuple[float, float]:
        """Turns of a train's shaft per turn of the fused one, and the standard deviation."""
        fused = self.fit.angle(own.time_s)
        inside = np.isfinite(fused)
        if np.count_nonzero(inside) < 3:
            raise InputError("trains: a ratio can't be estimated, the trains have no time in common")
        return _slope(
            fused[inside], own.turned[inside], own.std[inside], self._runs(own.time_s, own.stretch)[inside]
        )

    def _runs(self, time: Array, stretch: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Number the runs of passages: each lies within one stretch of the train and one piece of the fused angle."""
        return np.asarray(
            (stretch - stretch.min()) * len(self.fit.splines) + np.maximum(self.fit.piece_at(time), 0)
        )

    def slips(self, name: str) -> npt.NDArray[np.intp]:
        """Passages at which a train's angle shifts by about a pulse relative to the fused one."""
        own = self.passages[name]
        residual = self.residual[self.train == list(self.passages).index(name)]
        if len(residual) < 2 * _NEARBY:
            return np.empty(0, dtype=np.intp)
        level = np.median(np.lib.stride_tricks.sliding_window_view(residual, _NEARBY), axis=1)
        jump = np.zeros(len(residual))
        jump[_NEARBY : len(level)] = np.abs(level[_NEARBY:] - level[:-_NEARBY])
        moved = jump > _SLIP * own.pitch
        peaks = np.array([first + np.argmax(jump[first:last]) for first, last in runs(moved)], dtype=np.intp)
        # The offset may change between stretches without a slip.
        return np.asarray(peaks[own.stretch[peaks] == own.stretch[peaks - 1]])

    def report(self, name: str) -> TrainReport:
        """Compare a train with the fused angle."""
        k = list(self.passages).index(name)
        own, mine = self.passages[name], self.train == k
        spread = own.std * np.clip(self.scatter[k], 1.0, _UNEXPLAINED)
        run = self._runs(own.time_s, own.stretch)
        slope, slope_std = _slope(self.fit.angle(own.time_s), own.turned, spread, run)
        apart = np.abs(self.residual[mine]) > _APART * spread
        edges = runs(apart)
        ratio, ratio_std = self.ratios[name]
        return TrainReport(
            ratio=ratio,
            ratio_std=ratio_std,
            scatter=float(self.scatter[k]),
            difference=slope - 1.0,
            difference_std=slope_std,
            apart_s=np.column_stack([own.time_s[edges[:, 0]], own.time_s[edges[:, 1] - 1]]),
            slips_s=own.slips_s,
        )


def _robust_scale(size: Array) -> float:
    """Root mean square of absolute values, with large ones cut off.

    Tau scale of V. Yohai and R. Zamar, Journal of the American Statistical Association 83 (1988) 406. A median alone
    would be a quarter too large for edges distributed uniformly between two samples.
    """
    median = max(_ROBUST * float(np.median(size)), np.finfo(np.float64).tiny)
    return float(median * np.sqrt(np.mean(np.minimum(size / median, _HUBER) ** 2) / _CUT_OFF))


def _slope(turned: Array, own: Array, std: Array, run: npt.NDArray[np.intp]) -> tuple[float, float]:
    """Slope of a train's turns against the fused ones, and its standard deviation, with an offset for each run."""
    weight = 1.0 / std**2
    _, numbers = np.unique(run, return_inverse=True)
    total = np.bincount(numbers, weight)
    x = turned - (np.bincount(numbers, weight * turned) / total)[numbers]
    y = own - (np.bincount(numbers, weight * own) / total)[numbers]
    power = float(np.sum(weight * x**2))
    return float(np.sum(weight * x * y)) / power, power**-0.5
