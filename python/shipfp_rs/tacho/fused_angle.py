"""One angle through the passages of several trains, and what each train has to do with it."""

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
"""Distance of the knots over the period of the bandwidth. At the bandwidth the spline's gain is 0.1 % low."""
_ROUNDS = 10
"""Rounds of reweighting. A count that slipped bends the whole angle at first; each round gives it less weight."""
_HUBER = 2.5
"""Distance from the fused angle, in standard deviations, beyond which a pulse's pull on it grows no more."""
_APART = 6.0
"""Distance from the fused angle, in standard deviations, beyond which a pulse is reported as apart from it."""
_NEARBY, _SLIP = 5, 0.4
"""A count slipped where the medians of so many passages before and after differ by more than this part of a pulse."""
_SAME_SPEED = 5.0, 1e-5
"""Two trains have the same mean speed where they differ by less: in standard deviations, or as a part of the speed."""
_UNEXPLAINED = 3.0
"""Ratio of a train's scatter to what its timing and reflectors explain, beyond which something else is wrong."""
_UNKNOWN = 0.05
"""Relative standard deviation beyond which a speed is masked: no pulses are near, the spline only bridges a gap."""
_ROBUST, _CUT_OFF = 1.4826, 0.978
"""Standard deviation over median absolute deviation of Gaussian noise, and its mean square when cut at `_HUBER`."""


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
        Stretches where its angle parts from the fused one [s], shape (K, 2): wrong pulses, a slip of the count that
        the other trains could not settle.
    slips_s
        Times at which its count slipped, by the word of the others [s], shape (K,); it was cut there.
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
        """Whether its mean speed and its angle are those of the fused speed, within what their noise explains."""
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
            # The spline follows the scatter in part; the residuals lack that part.
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
        """Number the runs of passages: each lies in one stretch of the train and in one piece of the fused angle."""
        return np.asarray(
            (stretch - stretch.min()) * len(self.fit.splines) + np.maximum(self.fit.piece_at(time), 0)
        )

    def slips(self, name: str) -> npt.NDArray[np.intp]:
        """Passages from which on a train's angle has moved by about a pulse against the fused one."""
        own = self.passages[name]
        residual = self.residual[self.train == list(self.passages).index(name)]
        if len(residual) < 2 * _NEARBY:
            return np.empty(0, dtype=np.intp)
        level = np.median(np.lib.stride_tricks.sliding_window_view(residual, _NEARBY), axis=1)
        jump = np.zeros(len(residual))
        jump[_NEARBY : len(level)] = np.abs(level[_NEARBY:] - level[:-_NEARBY])
        moved = jump > _SLIP * own.pitch
        peaks = np.array([first + np.argmax(jump[first:last]) for first, last in runs(moved)], dtype=np.intp)
        # From one stretch to the next the offset may change without a slip.
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
    """Return the root mean square of absolute values, large ones cut off.

    The tau scale of V. Yohai and R. Zamar, Journal of the American Statistical Association 83 (1988) 406. A median alone
    would be a quarter too large for edges that lie evenly between two samples.
    """
    median = max(_ROBUST * float(np.median(size)), np.finfo(np.float64).tiny)
    return float(median * np.sqrt(np.mean(np.minimum(size / median, _HUBER) ** 2) / _CUT_OFF))


def _slope(turned: Array, own: Array, std: Array, run: npt.NDArray[np.intp]) -> tuple[float, float]:
    """Slope of a train's turns over the fused ones, and its standard deviation; each run has an offset of its own."""
    weight = 1.0 / std**2
    _, numbers = np.unique(run, return_inverse=True)
    total = np.bincount(numbers, weight)
    x = turned - (np.bincount(numbers, weight * turned) / total)[numbers]
    y = own - (np.bincount(numbers, weight * own) / total)[numbers]
    power = float(np.sum(weight * x**2))
    return float(np.sum(weight * x * y)) / power, power**-0.5
