"""Fusion of pulse trains of one shaft line: a spline of the angle through all pulses, and the speed with its variance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded

from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array, runs
from shipfp_rs.tacho.speed import Passages, Train, passages_of
from shipfp_rs.tacho.tracks import require_positive

_DEGREE = 4
"""Degree of the angle spline; the speed is its slope, a cubic spline."""
_STIFFNESS = 1e-6
"""Weight of the spline coefficients' second differences, relative to that of the pulses. It smooths the spline where
there are no pulses.
"""


@dataclass(frozen=True)
class AngleSpline:
    """Spline of the angle [rev]; its slope is the speed."""

    spline: BSpline
    factor: Array
    """Banded Cholesky factor of the normal matrix, lower form."""
    shift: Array
    """Derivative of the coefficients with respect to the offset of each stretch but the first, shape (M, R)."""
    offsets: Array
    """Angle at the start of each stretch [rev], shape (S,)."""
    offset_covariance: Array

    def speed(self, time: Array) -> Array:
        """Speed [rev/s]."""
        return np.asarray(self.spline(time, 1))

    def speed_variance(self, time: Array) -> Array:
        """Variance of the speed [(rev/s)^2]."""
        slope = _slopes(self.spline, time)
        own = np.asarray((slope @ _inverse_band(self.factor)).multiply(slope).sum(axis=1)).ravel()
        through = slope @ self.shift
        return np.asarray(own + np.einsum("ij,jk,ik->i", through, self.offset_covariance, through))


@dataclass(frozen=True)
class AnglePieces:
    """Angle splines in order of time, separated by gaps, and the angle at the start of each stretch [rev]."""

    splines: tuple[AngleSpline, ...]
    spans_s: Array
    offsets: Array

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return sum(len(piece.spline.c) for piece in self.splines)

    def piece_at(self, time: Array) -> npt.NDArray[np.intp]:
        """Index of the spline that covers each time, -1 if none does."""
        piece = np.searchsorted(self.spans_s[:, 0], time, side="right") - 1
        return np.where((piece >= 0) & (time <= self.spans_s[piece, 1]), piece, -1)

    def angle(self, time: Array) -> Array:
        """Angle [rev], NaN between the pieces."""
        return self._each(time, lambda piece, at: piece.spline(at))

    def speed(self, time: Array) -> Array:
        """Speed [rev/s], NaN between the pieces."""
        return self._each(time, lambda piece, at: piece.speed(at))

    def speed_variance(self, time: Array) -> Array:
        """Variance of the speed [(rev/s)^2], NaN between the pieces."""
        return self._each(time, lambda piece, at: piece.speed_variance(at))

    def _each(self, time: Array, value: Callable[[AngleSpline, Array], Array]) -> Array:
        result, at = np.full(len(time), np.nan), self.piece_at(time)
        for k, piece in enumerate(self.splines):
            if (inside := at == k).any():
                result[inside] = value(piece, time[inside])
        return result


def fit_angle_pieces(
    time: Array, angle: Array, weight: Array, stretch: npt.NDArray[np.intp], spacing_s: float
) -> AnglePieces:
    """Fit a spline to each run of stretches that overlap in time; arguments as in `fit_angle_spline`."""
    count = int(stretch.max()) + 1
    first, last = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(first, stretch, time)
    np.maximum.at(last, stretch, time)
    order = np.argsort(first)
    reached = np.maximum.accumulate(last[order])
    fresh = np.append(True, first[order][1:] > reached[:-1])
    piece_of = np.empty(count, dtype=np.intp)
    piece_of[order] = np.cumsum(fresh) - 1
    splines, offsets = [], np.empty(count)
    for k in range(int(piece_of.max()) + 1):
        own = np.flatnonzero(piece_of == k)
        chosen = np.isin(stretch, own) if len(own) < count else np.ones(len(time), dtype=np.bool_)
        rows = np.searchsorted(own, stretch[chosen])
        splines.append(fit_angle_spline(time[chosen], angle[chosen], weight[chosen], rows, spacing_s))
        offsets[own] = splines[-1].offsets
    spans = np.column_stack(
        [first[order][fresh], reached[np.append(np.flatnonzero(fresh)[1:] - 1, count - 1)]]
    )
    return AnglePieces(tuple(splines), spans, offsets)


def fit_angle_spline(
    time: Array, angle: Array, weight: Array, stretch: npt.NDArray[np.intp], spacing_s: float
) -> AngleSpline:
    """Fit a spline and an offset per stretch (0 for the first) to angles [rev], counted in each stretch."""
    # `weight` is the inverse variance of each angle [1/rev^2], `stretch` the index of its stretch, from 0.
    first, last = float(time.min()), float(time.max())
    pieces = max(int(np.ceil((last - first) / spacing_s)), 1)
    inner = np.linspace(first, last, pieces + 1)
    knots = np.concatenate([[first] * _DEGREE, inner, [last] * _DEGREE])
    basis = BSpline.design_matrix(time, knots, _DEGREE)
    normal = (basis.T @ basis.multiply(weight[:, None])).todia()
    size = basis.shape[1]
    differences = sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(size - 2, size))
    normal = normal + _STIFFNESS * np.median(normal.diagonal()) * (differences.T @ differences)
    band = np.zeros((_DEGREE + 1, size))
    for k in range(_DEGREE + 1):
        band[k, : size - k] = normal.diagonal(k)
    factor = cholesky_banded(band, lower=True)

    stretches = int(stretch.max()) + 1
    member = sparse.csr_array(
        (np.ones(len(time)), (np.arange(len(time)), stretch)), shape=(len(time), stretches)
    )[:, 1:]
    coupling = (basis.T @ member.multiply(weight[:, None])).toarray()
    right = basis.T @ (weight * angle)
    alone = cho_solve_banded((factor, True), right)
    shift = cho_solve_banded((factor, True), coupling) if stretches > 1 else np.zeros((size, 0))
    # Elimination of the spline's coefficients gives a small system for the offsets.
    # Long and short stretches have equal weight in it.
    total = member.T @ weight
    scale = 1.0 / np.sqrt(np.outer(total, total))
    covariance = scale * np.linalg.pinv(
        scale * (np.diag(total) - coupling.T @ shift), rcond=1e-9, hermitian=True
    )
    # The spline is angle + offset, so the offsets below are added to the counts of their stretches.
    offsets = covariance @ (coupling.T @ alone - member.T @ (weight * angle))
    coefficients = alone + shift @ offsets
    return AngleSpline(
        BSpline(knots, coefficients, _DEGREE), factor, shift, np.append(0.0, offsets), covariance
    )


def _slopes(spline: BSpline, time: Array) -> sparse.csr_array:
    lower = BSpline.design_matrix(time, spline.t[1:-1], _DEGREE - 1)
    size = len(spline.c)
    rise = _DEGREE / (spline.t[_DEGREE + 1 : size + _DEGREE] - spline.t[1:size])
    change = sparse.diags_array([-rise, rise], offsets=[0, 1], shape=(size - 1, size))
    return lower @ change


def _inverse_band(factor: Array) -> sparse.dia_matrix:
    """Band of the inverse of a matrix from its banded Cholesky factor (lower form), by Takahashi's recursion."""
    # K. Takahashi, J. Fagan, M. Chin, Eighth PICA Conference (1973) 63.
    # Rows are computed from the last to the first; within the band, each needs only rows below it.
    width, size = factor.shape
    reach = width - 1
    inverse = np.zeros((size + reach, width))  # inverse[i, d] is entry (i, i + d)
    window = np.zeros((reach, reach))  # rows i + 1 to i + reach, both triangles
    for i in range(size - 1, -1, -1):
        pivot = factor[0, i]
        column = factor[1:, i] / pivot
        beside = -window @ column
        corner = 1.0 / pivot**2 - column @ beside
        inverse[i, 0], inverse[i, 1:] = corner, beside
        window[1:, 1:] = window[:-1, :-1].copy()
        window[0, 0] = corner
        window[0, 1:] = window[1:, 0] = beside[:-1]
    diagonals = [inverse[: size - d, d] for d in range(width)]
    return sparse.diags_array(
        diagonals[:0:-1] + diagonals, offsets=list(range(-reach, width)), shape=(size, size)
    )


_SPACING = 1.0 / 3.0
"""Knot spacing as a fraction of the period at the bandwidth. At the bandwidth the spline's gain is then 0.1 % low."""
_ROUNDS = 10
"""Rounds of reweighting. At first, a slipped count of pulses distorts the whole angle; each round reduces the
weight of the pulses concerned.
"""
_HUBER = 2.5
"""Huber's constant: residual, in standard deviations, above which the influence of a pulse no longer increases."""
_APART = 6.0
"""Residual, in standard deviations, above which a pulse is reported as an outlier."""
_NEARBY, _SLIP = 5, 0.4
"""The count of pulses has slipped if the median residuals of this many pulses before and after differ by more than
this fraction of the angle between pulses.
"""
_SAME_SPEED = 5.0, 1e-5
"""Mean speeds agree within this number of standard deviations, or this fraction of the speed."""
_UNEXPLAINED = 3.0
"""Largest ratio of a train's scatter to the scatter expected from timing and reflectors."""
_UNKNOWN = 0.05
"""Relative standard deviation above which a speed is masked, since the spline only bridges a gap there."""
_ROBUST, _CUT_OFF = 1.4826, 0.978
"""For Gaussian noise: ratio of standard deviation to median absolute deviation, and mean square after clipping at
`_HUBER`.
"""


@dataclass(frozen=True)
class TrainReport:
    """Comparison of a train with the fused speed.

    Parameters
    ----------
    ratio, ratio_std
        Turns of the train's shaft per turn of the fused shaft; the standard deviation is 0 for a given ratio.
    scatter
        Scatter of the train's pulses about the fused angle, relative to the scatter expected from timing and
        reflectors [-]. If it exceeds 1, the train's weight is divided by its square.
    difference, difference_std
        Relative difference of the train's mean speed from the fused speed [-]; near 0 by construction for an
        estimated ratio.
    apart_s
        Stretches where the train's angle deviates from the fused angle [s], shape (K, 2), because of wrong pulses or
        of a slipped count that the other trains could not resolve.
    slips_s
        Times at which the train's count of pulses slipped relative to the other trains [s], shape (K,); each
        begins a new stretch.
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
        """Whether the train's mean speed and angle agree with the fused ones within their noise."""
        deviations, least = _SAME_SPEED
        same_speed = abs(self.difference) <= max(deviations * self.difference_std, least)
        return same_speed and self.scatter < _UNEXPLAINED and not len(self.apart_s) and not len(self.slips_s)


class FusedAngle:
    """Spline of the angle through the pulses of the trains with known ratios."""

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
            # The spline follows some of the scatter, so the residuals are scaled up by the degrees of freedom.
            taken = np.sqrt(len(self.time) / max(len(self.time) - self.fit.size, 1))
            score = taken * np.abs(self.residual) / self.std
            self.scatter = np.array([_robust_scale(score[self.train == k]) for k in range(len(parts))])
            score /= np.maximum(self.scatter, 1.0)[self.train]
            pull = _HUBER / np.maximum(score, _HUBER)

    def at(self, grid: Array) -> tuple[Array, Array]:
        """Speed and standard deviation on a grid; NaN if no pulses are near."""
        speed, std = self.fit.speed(grid), np.sqrt(self.fit.speed_variance(grid))
        with np.errstate(invalid="ignore"):
            lost = ~(std <= _UNKNOWN * np.abs(speed))
        speed[lost] = std[lost] = np.nan
        return speed, std

    def ratio(self, own: Passages) -> tuple[float, float]:
        """Turns of a train's shaft per turn of the fused shaft, with standard deviation."""
        fused = self.fit.angle(own.time_s)
        inside = np.isfinite(fused)
        if np.count_nonzero(inside) < 3:
            raise InputError("trains: a ratio can't be estimated, the trains have no time in common")
        return _slope(
            fused[inside], own.turned[inside], own.std[inside], self._runs(own.time_s, own.stretch)[inside]
        )

    def _runs(self, time: Array, stretch: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Run number of each pulse; a run lies within one stretch of the train and one piece of the fused angle."""
        return np.asarray(
            (stretch - stretch.min()) * len(self.fit.splines) + np.maximum(self.fit.piece_at(time), 0)
        )

    def slips(self, name: str) -> npt.NDArray[np.intp]:
        """Indices of pulses at which a train's angle shifts by about one pulse relative to the fused angle."""
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
    """Robust root mean square of absolute values, with large values clipped (tau scale)."""
    # V. Yohai, R. Zamar, Journal of the American Statistical Association 83 (1988) 406.
    # The median alone would be a quarter too large for errors distributed uniformly between two samples.
    median = max(_ROBUST * float(np.median(size)), np.finfo(np.float64).tiny)
    return float(median * np.sqrt(np.mean(np.minimum(size / median, _HUBER) ** 2) / _CUT_OFF))


def _slope(turned: Array, own: Array, std: Array, run: npt.NDArray[np.intp]) -> tuple[float, float]:
    """Slope of a train's turns against the fused turns, with its standard deviation; each run has its own offset."""
    weight = 1.0 / std**2
    _, numbers = np.unique(run, return_inverse=True)
    total = np.bincount(numbers, weight)
    x = turned - (np.bincount(numbers, weight * turned) / total)[numbers]
    y = own - (np.bincount(numbers, weight * own) / total)[numbers]
    power = float(np.sum(weight * x**2))
    return float(np.sum(weight * x * y)) / power, power**-0.5


_PULSES_PER_HZ, _LEAST_PULSES_PER_HZ = 6.0, 4.5
"""Default and least number of pulses per second per Hz of bandwidth: 2 and 1.5 pulses per spline coefficient."""


@dataclass(frozen=True)
class FusedSpeed:
    """Speed fused from several trains.

    Parameters
    ----------
    time_s
        Uniform grid [s], shape (N,).
    speed_rps, std_rps
        Speed and its standard deviation [rev/s], shape (N,); NaN where no train determines the speed.
    bandwidth_hz
        Frequency up to which the speed follows the shaft, with a gain of 1 within 0.2 % and no delay [Hz].
    trains
        Report on each train by name.
    """

    time_s: Array
    speed_rps: Array
    std_rps: Array
    bandwidth_hz: float
    trains: dict[str, TrainReport]


@checked
def fuse(
    trains: Sequence[Train],
    rate_hz: float,
    start_s: float,
    stop_s: float,
    *,
    bandwidth_hz: float | None = None,
) -> FusedSpeed:
    """Fuse several pulse trains into one speed on a uniform grid from `start_s` up to, not including, `stop_s`.

    Every pulse is a measurement of the angle of its shaft. A spline is fitted to the angles of all trains; its slope is
    the speed. Each angle is weighted by its inverse variance, and each unbroken stretch has its own offset. Unlike speeds
    between pulses, angles are not averaged over an interval: there is no boxcar gain or delay to correct, and the errors
    of successive pulses are independent.

    Parameters
    ----------
    trains
        One train or more, at least one with a known ratio.
    rate_hz
        Rate of the grid [Hz].
    start_s, stop_s
        Ends of the grid [s].
    bandwidth_hz
        Highest frequency f that the speed follows [Hz]; the noise of the speed grows as f^(3/2). By default a sixth of
        all pulses per second.

    Raises
    ------
    InputError
        If the trains have too few pulses for the bandwidth, or the standard deviation of their timing is unknown.

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
    fit, band = fused_angle(trains, bandwidth_hz)
    grid = start_s + np.arange(count) / rate_hz
    speed, std = fit.at(grid)
    return FusedSpeed(grid, speed, std, band, {name: fit.report(name) for name in fit.passages})


def fused_angle(trains: Sequence[Train], bandwidth_hz: float | None = None) -> tuple[FusedAngle, float]:
    """Fit the angle to the pulses of several trains; return it and the bandwidth [Hz]; see `fuse`."""
    if len(trains) == 0 or len({train.name for train in trains}) < len(trains):
        raise InputError(
            f"trains: found {[train.name for train in trains]}, expected one or more of different names"
        )
    if all(train.ratio is None for train in trains):
        raise InputError("trains: no ratio is known, expected that of one train at least")
    passages = {train.name: passages_of(train) for train in trains}
    pulses_per_s = sum(1.0 / np.median(np.diff(p.time_s)) for p in passages.values())
    band = pulses_per_s / _PULSES_PER_HZ if bandwidth_hz is None else bandwidth_hz
    require_positive("bandwidth_hz", band)
    if band > pulses_per_s / _LEAST_PULSES_PER_HZ:
        raise InputError(
            f"bandwidth_hz: found {band:g} with {pulses_per_s:.3g} pulses a second in all trains, expected at most "
            f"{pulses_per_s / _LEAST_PULSES_PER_HZ:.3g}"
        )
    ratios = {train.name: (train.ratio, 0.0) for train in trains if train.ratio is not None}
    known = {name: (ratio, std) for name, (ratio, std) in ratios.items() if ratio is not None}
    if len(known) < len(trains):
        fit = FusedAngle(passages, known, band)
        known |= {t.name: fit.ratio(passages[t.name]) for t in trains if t.ratio is None}
    fit = FusedAngle(passages, known, band)
    slips = {name: fit.slips(name) for name in passages}
    if any(len(places) for places in slips.values()):
        passages = {name: own.cut(slips[name]) for name, own in passages.items()}
        fit = FusedAngle(passages, known, band)
    return fit, float(band)
