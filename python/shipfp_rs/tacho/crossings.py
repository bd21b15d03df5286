"""Crossing times of pulse trains; the levels follow the train."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from shipfp_rs._core import PulseTracker, pulse_levels
from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array, even_parts, joined
from shipfp_rs.tacho.clarity import (
    AT_REST,
    FAR_FROM_LIMIT,
    IN_A_ROW,
    NEAR_LIMIT,
    Flags,
    clear_pulses,
    unclear,
    without_noise,
)
from shipfp_rs.tacho.tracks import MISSED_FROM, require_positive


def _no_spans() -> Array:
    return np.empty((0, 2))


@dataclass(frozen=True)
class PulseTimes:
    """Rising crossings of a pulse train.

    Parameters
    ----------
    times_s
        Times of the crossings after the first sample [s], shape (N,).
    gaps_s
        Stretches in which pulses may be missing from `times_s` [s], shape (G, 2): stretches without samples, from the
        first missing sample to the next present one, and stretches where pulses can't be distinguished from noise.
    low, middle, high
        Levels of the detector, in the unit of the samples: below `low` it is armed, above `high` it fires, and the
        time is that of the crossing of `middle`. Medians over the record if the levels followed the train.
    rate_hz
        Sample rate of the train [Hz].
    faint_s
        Gaps that have samples, but no pulses distinguishable from noise, from pulse to pulse [s], shape (K, 2).
    limit
        Detection limit, in the unit of the samples. Higher pulses always count; lower pulses count only in rows of at
        least twenty even periods. If the noise changes, the limit is the median over the record.
    grid_std_s
        Standard deviations of the times due to sampling [s], shape (N,); None if every edge rises within one sample.
    noise_std_s
        Standard deviations of the times due to noise [s], shape (N,).
    """

    times_s: Array
    gaps_s: Array
    low: float
    middle: float
    high: float
    rate_hz: float
    faint_s: Array = field(default_factory=_no_spans)
    limit: float = np.nan
    grid_std_s: Array | None = None
    noise_std_s: Array | None = None

    def at(self, times_s: Array) -> PulseTimes:
        """Return pulses with other times, such as inserted teeth; standard deviations are those of nearby pulses."""
        grid, noise = (
            None if std is None or not len(std) else np.interp(times_s, self.times_s, std)
            for std in (self.grid_std_s, self.noise_std_s)
        )
        return replace(self, times_s=times_s, grid_std_s=grid, noise_std_s=noise)

    @property
    def missing_s(self) -> Array:
        """Gaps without samples [s], shape (K, 2)."""
        begins, ends = self.faint_s.T
        return np.asarray(
            self.gaps_s[~(np.isin(self.gaps_s[:, 0], begins) & np.isin(self.gaps_s[:, 1], ends))]
        )

    @property
    def time_std_s(self) -> Array:
        """Standard deviation of each crossing [s], shape (N,).

        The time of an edge that rises within one sample is uniformly distributed between two samples: Ts / sqrt(12).
        Edges that last several samples are more accurate; their accuracy is limited by noise.
        """
        step = np.full(len(self.times_s), 1.0 / (self.rate_hz * np.sqrt(12.0)))
        grid = step if self.grid_std_s is None else self.grid_std_s
        return np.asarray(grid if self.noise_std_s is None else np.hypot(grid, self.noise_std_s))


@checked
def pulse_times(
    samples: npt.NDArray[Any] | Iterable[npt.ArrayLike],
    rate_hz: float,
    *,
    threshold: float | None = None,
    hysteresis: float | None = None,
    window_s: float = 30.0,
) -> PulseTimes:
    """Times at which a pulse train rises through a level, interpolated between samples.

    A crossing counts if the train is below the arming level before it and rises above the firing level after it, so
    saw-tooth edges and noise at the crossing level are not counted twice. By default the levels follow the turning
    points of nine pulses before and after, since the amplitude of a variable-reluctance pick-up increases with speed
    and that of an optical pick-up may decrease with time. The noise determines the least height of a pulse. Where
    pulses can't be distinguished from noise or from the hum of a shaft at rest, or last less than a sample, no times
    are returned and the stretch is listed in `gaps_s`.

    The gap of a wheel with missing teeth is not listed in `gaps_s`; `speed_from_pulses` inserts the missing teeth.

    Parameters
    ----------
    samples
        Samples of the train: an array, shape (N,), or an iterable of successive arrays of any length (a log read in
        pieces). NaN marks a missing sample.
    rate_hz
        Sample rate [Hz].
    threshold
        Level of the crossings in the unit of the samples (2 V in the thesis); by default midway between low and high
        level.
    hysteresis
        Distance between the arming and the firing level, centred on `threshold`; by default 0.4 of the level
        difference.
    window_s
        Length of the windows in which noise and levels are estimated [s].

    Returns
    -------
    PulseTimes

    Raises
    ------
    InputError
        If the train does not have two levels, or `threshold` never lies between them.

    Examples
    --------
    >>> import numpy as np
    >>> train = np.where(np.arange(1000) % 100 < 30, 5.0, 0.0)
    >>> pulse_times(train, 1000.0).times_s[:3]
    array([0.0995, 0.1995, 0.2995])
    """
    require_positive("rate_hz", rate_hz)
    require_positive("window_s", window_s)
    if hysteresis is not None:
        require_positive("hysteresis", hysteresis)
    tracker, size = PulseTracker(threshold, hysteresis), max(1, round(window_s * rate_hz))
    found = _Found()
    if isinstance(samples, np.ndarray) and samples.ndim == 1:
        whole = _for_kernel(samples)
        found.take(tracker.follow(whole, size), whole[-((len(whole) - 1) % size + 1) :], whole)
    else:
        held: npt.NDArray[Any] | None = None
        for window in _windows(samples, size):
            tracker.look(window)
            if held is not None:
                found.take(tracker.cross(held), held, held)
            held = window
        if held is not None:
            found.take(tracker.cross(held), held, held)
    if not found.levels:
        raise InputError(_complaint(*pulse_levels(found.silent), threshold))
    missing = tracker.gaps
    times, grid, noise = found.column(0), found.column(2), found.column(3)
    faint, given = _no_spans(), threshold is not None and hysteresis is not None
    if not given or any(found.short):
        kept, low = found.clear(times, given)
        faint = unclear(times, kept, low, missing, found.samples)
        if not kept.all():
            times, grid, noise = times[kept], grid[kept], noise[kept]
    bottom, top, middle = map(float, np.median(np.concatenate(found.levels), axis=0))
    for column in (times, grid, noise):
        column /= rate_hz
    gaps, limit = joined([missing, faint]) / rate_hz, float(np.median(found.windows[:, 1]))
    return PulseTimes(times, gaps, bottom, middle, top, rate_hz, faint / rate_hz, limit, grid, noise)


class _Found:
    """Crossings of successive windows."""

    def __init__(self) -> None:
        self.columns: list[tuple[Array, Array, Array, Array]] = []
        self.levels: list[Array] = []
        self.samples = 0
        self._states = True
        self._windows: list[Array] = []
        self.short: list[bool] = []
        self.silent: npt.NDArray[Any] = np.empty(0)
        """Last window of a record without a pulse train."""

    def take(
        self,
        crossed: tuple[Array, Array, Array, Array, Array, Array],
        last: npt.NDArray[Any],
        samples: npt.NDArray[Any],
    ) -> None:
        """Add the crossings in windows of `samples`; `last` has the samples of the last window."""
        *columns, levels, windows = crossed
        self.columns.append((columns[0], columns[1], columns[2], columns[3]))
        self._windows.append(windows)
        counts = np.cumsum(windows[:-1, 0]).astype(np.intp)
        self.short += [_are_short(samples, part) for part in np.split(columns[0] - self.samples, counts)]
        self.samples += len(samples)
        self._states = self._states and _of_two_values(samples)
        if len(levels):
            self.levels.append(levels)
        elif not self.levels:
            self.silent = last

    @property
    def windows(self) -> Array:
        """Number of crossings, limit, least and median height of each window, shape (K, 4)."""
        return np.concatenate(self._windows)

    def column(self, which: int) -> Array:
        """One column of all windows (times, heights or a standard deviation of the times), shape (N,)."""
        every = [columns[which] for columns in self.columns]
        return every[0] if len(every) == 1 else np.concatenate(every)

    def clear(self, times: Array, given: bool) -> tuple[Flags, Flags]:
        """Mark the crossings that are pulses (all at given levels), and those barely higher than noise, shape (N,)."""
        count, limit, least, known = self.windows.T
        known = known[count > 0]
        # Usual height: the largest median height of the windows; one or two disturbed windows are ignored.
        usual = float(np.max(median_filter(known, size=5, mode="nearest"))) if len(known) else 0.0
        # A train of two values, such as 0 and 1, has no noise; its estimated noise is an effect of sampling its edges.
        far = (least >= np.maximum(FAR_FROM_LIMIT * limit, AT_REST * usual)).all()
        whole = np.repeat(np.logical_not(self.short), count.astype(np.int64))
        if given or self._states or far:
            return whole, np.zeros(len(times), dtype=np.bool_)
        limits = np.repeat(limit, count.astype(np.int64))
        every = without_noise(times, self.column(1), limits)
        return whole & clear_pulses(times, every, limits, usual), every < NEAR_LIMIT * limits


def _of_two_values(samples: npt.NDArray[Any]) -> bool:
    """Whether samples have one of two values, or are missing, except two samples at each edge."""
    for part in (samples[:64], samples) if len(samples) else ():  # the first samples mostly suffice
        between = (part > np.fmin.reduce(part)) & (part < np.fmax.reduce(part))
        if (between[2:] & between[1:-1] & between[:-2]).any():
            return False
    return True


def _are_short(samples: npt.NDArray[Any], times: Array) -> bool:
    """Whether each crossing has a single high (or low) sample, and periods jump: some pulses lie between two samples."""
    for part in (times[:64], times) if len(times) > IN_A_ROW else ():
        places = np.clip(part.astype(np.intp)[:, None] + np.arange(-1, 3), 0, len(samples) - 1)
        earlier, before, above, after = samples[places].astype(np.float64).T
        if (0.5 * (above - before) <= [after - before, above - earlier]).any(axis=1).all():
            return False
    ratios = np.abs(np.diff(np.log(np.diff(times))))
    return len(times) > IN_A_ROW and bool(ratios.max() > np.log(MISSED_FROM))


def _complaint(bottom: float, top: float, threshold: float | None) -> str:
    """Error text for a train without levels."""
    if np.isnan(bottom):
        return "samples: found no finite one, expected a train of pulses"
    if bottom == top:
        return f"samples: constant at {bottom:g}, expected a train of pulses between two levels"
    return f"threshold: found {threshold}, expected between the train's levels {bottom:g} and {top:g}"


def _windows(samples: npt.NDArray[Any] | Iterable[npt.ArrayLike], size: int) -> Iterator[npt.NDArray[Any]]:
    """Cut the samples into windows of `size` for the kernel; a window within one piece is a view."""
    for parts in even_parts(map(_flat, [samples] if isinstance(samples, np.ndarray) else samples), size):
        yield _for_kernel(parts[0] if len(parts) == 1 else np.concatenate(parts))


def _for_kernel(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    fits = array.dtype in (np.float32, np.float64, np.int16)
    return np.require(array, dtype=array.dtype if fits else np.float64, requirements=["C", "A"])


def _flat(piece: npt.ArrayLike) -> npt.NDArray[Any]:
    array = np.asarray(piece)
    if array.ndim != 1:
        raise InputError(
            f"samples: found shape {array.shape}, expected one axis, or an iterable of such arrays"
        )
    return array
