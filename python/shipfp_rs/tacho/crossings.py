"""Pulse trains to crossing times, with levels that follow the train."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from shipfp_rs._core import PulseCrossings, pulse_levels
from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import checked
from shipfp_rs.tacho.tracks import require_positive

Array = npt.NDArray[np.float64]

_HYSTERESIS = 0.4
"""Distance between the two thresholds, as a part of the distance between the train's levels."""
_AT_REST = 1 / 3
"""Levels closer together than this part of their usual distance are the noise of a shaft at rest."""


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
        Levels used, in the unit of the samples: armed at `low`, timed at `middle`, fired at `high`. Medians where they
        followed the train.
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

    A crossing counts when the train was low before and gets high after, so that saw-tooth edges and noise at the level
    make no second one. Levels that are not given follow the train: the two most frequent ones of each window. Windows
    whose levels lie together much closer than usual are the noise of a shaft at rest, and give no crossings.

    Parameters
    ----------
    samples
        The train: an array, shape (N,), or an iterable of such arrays that follow one another (a log read piece by
        piece, in pieces of any length). NaN marks a missing sample.
    rate_hz
        Sample rate [Hz].
    threshold
        Level of the crossings in the unit of the samples (the thesis uses 2 V); by default midway between the levels.
    hysteresis
        Distance between the thresholds that arm and fire, around `threshold`; by default 0.4 of that between the levels.
    window_s
        Time over which the levels are taken [s].

    Returns
    -------
    PulseTimes

    Raises
    ------
    InputError
        If the train has no two levels, or `threshold` never lies between them.

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
    detector: PulseCrossings | None = None
    skipped = 0
    times: list[Array] = []
    spans: list[float] = []
    used: list[tuple[float, float, float]] = []
    bottom = top = np.nan
    for window in _windows(samples, max(1, round(window_s * rate_hz))):
        bottom, top = pulse_levels(window)
        levels = _thresholds(bottom, top, threshold, hysteresis) or (used[-1] if used else None)
        if levels is None:
            skipped += len(window)
            continue
        if detector is None:
            detector = PulseCrossings(*levels)
        else:
            detector.set_levels(*levels)
        times.append(detector.feed(window))
        spans.append(float(np.nan_to_num(top - bottom)))
        used.append(levels)
    if detector is None:
        raise InputError(_complaint(bottom, top, threshold))
    if threshold is None or hysteresis is None:
        # Only the whole record tells noise at rest from pulses; the median passes over a disturbed window or two.
        usual = np.max(median_filter(spans, size=5, mode="nearest"))
        times = [part for part, span in zip(times, spans, strict=True) if span >= _AT_REST * usual]
    low, high, middle = np.median(used, axis=0)
    return PulseTimes(
        (np.concatenate(times) + skipped) / rate_hz,
        (detector.gaps + skipped) / rate_hz,
        low=float(low),
        middle=float(middle),
        high=float(high),
        rate_hz=rate_hz,
    )


def _thresholds(
    bottom: float, top: float, threshold: float | None, hysteresis: float | None
) -> tuple[float, float, float] | None:
    """Thresholds (low, high, middle) for a train between two levels; None where it has none around the threshold."""
    if threshold is not None and hysteresis is not None:
        return threshold - hysteresis / 2, threshold + hysteresis / 2, threshold
    middle = (bottom + top) / 2 if threshold is None else threshold
    if not bottom < middle < top:
        return None
    width = _HYSTERESIS * (top - bottom) if hysteresis is None else hysteresis
    # A threshold near one of the levels leaves room for half the way to it only.
    return middle - min(width, middle - bottom) / 2, middle + min(width, top - middle) / 2, middle


def _complaint(bottom: float, top: float, threshold: float | None) -> str:
    """What is wrong with a train that never had thresholds."""
    if np.isnan(bottom):
        return "samples: found no finite one, expected a train of pulses"
    if bottom == top:
        return f"samples: constant at {bottom:g}, expected a train of pulses between two levels"
    return f"threshold: found {threshold}, expected between the train's levels {bottom:g} and {top:g}"


def _windows(samples: npt.NDArray[Any] | Iterable[npt.ArrayLike], size: int) -> Iterator[npt.NDArray[Any]]:
    """Cut the samples into windows of `size` whatever pieces they come in; views where a piece holds a window."""
    held: list[npt.NDArray[Any]] = []
    count = 0
    for piece in [samples] if isinstance(samples, np.ndarray) else samples:
        array = np.asarray(piece)
        if array.ndim != 1:
            raise InputError(
                f"samples: found shape {array.shape}, expected one axis, or an iterable of such arrays"
            )
        while len(array):
            held.append(array[: size - count])
            array = array[size - count :]
            count += len(held[-1])
            if count == size:
                yield _for_kernel(held)
                held, count = [], 0
    if held:
        yield _for_kernel(held)


def _for_kernel(parts: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    array = parts[0] if len(parts) == 1 else np.concatenate(parts)
    fits = array.dtype in (np.float32, np.float64, np.int16)
    return np.require(array, dtype=array.dtype if fits else np.float64, requirements=["C", "A"])
