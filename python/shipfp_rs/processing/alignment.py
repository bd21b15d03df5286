"""Alignment of several loggers' clocks: offset and drift, estimated from a signal that all loggers recorded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import ndimage, signal, stats
from scipy.interpolate import CubicSpline

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Samples
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.log import Log, Rows
from shipfp_rs.processing.conditioning import LowPass, nearest_rate
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.spikes import ROBUST_SIGMA
from shipfp_rs.tacho import pulse_times

COARSE_HZ, FINE_HZ = 10.0, 100.0
"""Sample rates at which the lag is searched and refined."""
COARSE_S, FINE_S = 300.0, 60.0
"""Lengths of the stretches whose lags are estimated [s]; over the longer ones, a drift of 100 ppm is 30 ms."""
SMOOTH_S = 0.03
"""Standard deviation [s] of the Gaussian that smooths the fine signals, which makes linear interpolation accurate."""
ALIKE = 0.8
"""Least correlation of a stretch of one logger's signal with the other logger's signal."""
MOST_DRIFT = 1e-3
"""Largest relative difference in rate between two working clocks."""
STEPS = 4
"""Number of Gauss-Newton steps for the lag of a stretch, and largest number of passes of the robust line through the
lags.
"""
PASSES = 3
"""Number of times that the lags of all stretches are refitted."""
NEXT_PULSE = 0.25
"""Largest time difference between the same pulse in two loggers, relative to the pulse interval."""


@dataclass(frozen=True)
class Alignment:
    """Conversion of a logger's clock to the reference's: t_reference = offset_s + (1 + drift) t."""

    offset_s: float
    """Time on the reference's clock when the logger's clock is at zero [s]."""
    drift: float
    """Relative difference in rate."""
    std_s: float
    """Standard deviation of the converted time [s], the larger of those at the two ends of the log."""

    def __call__(self, time_s: npt.ArrayLike) -> Array:
        """Convert times to the reference's clock [s]."""
        return np.asarray(self.offset_s + (1.0 + self.drift) * np.asarray(time_s, dtype=np.float64))


def align(
    reference: Log, other: Log, common: str, *, pulses: bool = False, search_s: float = 120.0
) -> Alignment:
    """Estimate a logger's clock relative to the reference's, at most `search_s` apart, by a channel recorded in both."""
    # A line through the lags of correlated stretches (Theil and Sen) is refined by the lag of each minute.
    # A minute is weighted by its inverse variance; without changes, it contributes nothing.
    trains = [_pulses(log, common) for log in (reference, other)] if pulses else []
    here, there = map(_frequency, trains) if pulses else (_smooth(log, common) for log in (reference, other))
    coarse = _coarse(here, there, search_s)
    if coarse is None:
        raise InputError(
            f"{other.name}: channel {common!r} never varies as in {reference.name} within {search_s:g} s of its "
            "clock; name another common channel or a wider search"
        )
    found = _refined(here, there, coarse)
    return _matched(trains[0], trains[1], found) if pulses else found


def merged(reference: Log, others: Sequence[Log], common: str, *, pulses: bool = False) -> Log:
    """Combine all channels in one log on the reference's clock; each clock's offset and drift are recorded as a fault."""
    channels = dict(reference.channels)
    sources = {name: (reference, name) for name in channels}
    faults = list(reference.faults)
    for log in others:
        alignment = align(reference, log, common, pulses=pulses)
        moved, names = on_clock(log, alignment), {}
        for name, channel in moved.channels.items():
            own = names[name] = name if name not in channels else f"{name} ({Path(log.name).name})"
            channels[own] = replace(channel, name=own)
            sources[own] = (moved, name)
        faults += moved.faults_under(names)
        told = Sentence(
            "offset {offset} s and drift {drift} ppm taken off",
            offset=f"{alignment.offset_s:.6g}",
            drift=f"{1e6 * alignment.drift:.4g}",
        )
        whole = np.array([[0, log.channel(common).samples]])
        faults.append(Fault("drift", f"{common} ({Path(log.name).name})", told, whole, excluded=False))

    def blocks(channel: str, first: int, size: int) -> Iterator[Samples]:
        log, name = sources[channel]
        return log.raw_blocks(name, first, size)

    return Log(reference.name, list(channels.values()), blocks, reference.start_utc, tuple(faults))


def on_clock(log: Log, alignment: Alignment) -> Log:
    """Interpolate a log's samples linearly at even times of the reference's clock."""
    stretch = 1.0 + alignment.drift
    channels = [
        replace(
            channel,
            start_s=float(alignment(channel.start_s)),
            samples=math.floor((channel.samples - 1) * stretch) + 1 if channel.samples else 0,
        )
        for channel in log.channels.values()
    ]
    lengths = {channel.name: channel.samples for channel in channels}

    def blocks(channel: str, first: int, size: int) -> Iterator[Samples]:
        rows = Rows(log, channel, size=size)
        last = rows.channel.samples
        for start in range(first, lengths[channel], size):
            place = np.arange(start, min(start + size, lengths[channel])) / stretch
            begin, end = int(place[0]), min(int(place[-1]) + 2, last)
            samples = rows.read(begin, end).astype(np.float64)
            yield np.interp(place - begin, np.arange(len(samples)), samples).astype(np.float32)

    return Log(log.name, channels, blocks, log.start_utc, log.faults)


@dataclass(frozen=True)
class _Series:
    """Signal at even times."""

    start_s: float
    rate_hz: float
    values: Array

    def cut(self, start_s: float, stop_s: float) -> _Series:
        first = max(round((start_s - self.start_s) * self.rate_hz), 0)
        stop = max(round((stop_s - self.start_s) * self.rate_hz), first)
        return replace(self, start_s=self.start_s + first / self.rate_hz, values=self.values[first:stop])

    def slower(self, rate_hz: float) -> _Series:
        count = round(self.rate_hz / rate_hz)
        whole = len(self.values) // count * count
        start_s = self.start_s + 0.5 * (count - 1) / self.rate_hz
        return _Series(start_s, self.rate_hz / count, self.values[:whole].reshape(-1, count).mean(axis=1))

    @property
    def time_s(self) -> Array:
        return self.start_s + np.arange(len(self.values)) / self.rate_hz

    @property
    def stop_s(self) -> float:
        return self.start_s + len(self.values) / self.rate_hz


def _smooth(log: Log, name: str) -> _Series:
    """Low-pass a channel far below the fine rate, since a step between two samples has no exact time."""
    rows = Rows(log, name)
    channel = rows.channel
    rate_hz = nearest_rate(channel, FINE_HZ)
    low_pass = LowPass(channel, rate_hz, 0.0)
    count = int(channel.samples * rate_hz / channel.rate_hz)
    values = low_pass(lambda first, stop: rows.read(first, stop).astype(np.float64), count)
    return _Series(channel.start_s, rate_hz, ndimage.gaussian_filter1d(values, SMOOTH_S * rate_hz))


def _pulses(log: Log, name: str) -> Array:
    channel = log.channel(name)
    return pulse_times(log.chunks(name), channel.rate_hz).times_s + channel.start_s


def _frequency(times: Array) -> _Series:
    """Pulse rate [Hz] at evenly spaced times."""
    if len(times) < 3:
        raise InputError("the common pulse train has fewer than three pulses; name another common channel")
    middle = 0.5 * (times[1:] + times[:-1])
    even = np.arange(middle[0], middle[-1], 1.0 / FINE_HZ)
    return _Series(float(middle[0]), FINE_HZ, np.interp(even, middle, 1.0 / np.diff(times)))


def _coarse(here: _Series, there: _Series, search_s: float) -> Alignment | None:
    """Fit a line through the lags of long stretches; None if no stretch correlates."""
    here, there = here.slower(COARSE_HZ), there.slower(COARSE_HZ)
    length_s = min(COARSE_S, (there.stop_s - there.start_s) / 4.0)
    found = []
    for start_s in np.arange(there.start_s, there.stop_s - length_s, length_s):
        part = there.cut(start_s, start_s + length_s)
        around = here.cut(start_s - search_s, start_s + length_s + search_s)
        like = _correlation(around.values, part.values)
        if len(like) and like.max() > ALIKE:
            found.append((part.start_s, around.start_s + like.argmax() / here.rate_hz - part.start_s))
    if not found:
        return None
    time, lag = np.array(found).T
    slope = float(stats.theilslopes(lag, time)[0]) if len(found) > 2 else 0.0
    slope = slope if abs(slope) < MOST_DRIFT else 0.0
    return Alignment(float(np.median(lag - slope * time)), slope, np.inf)


def _correlation(around: Array, part: Array) -> Array:
    """Correlation coefficients between `part` and each stretch of the same length in `around`."""
    count = len(part)
    if len(around) < count or not np.isfinite(part).all() or np.ptp(part) == 0.0:
        return np.empty(0)
    around = np.nan_to_num(around - np.nanmean(around))
    ones = np.ones(count)
    mean = signal.oaconvolve(around, ones, "valid") / count
    spread = np.sqrt(np.maximum(signal.oaconvolve(around**2, ones, "valid") / count - mean**2, 0.0))
    floor = 1e-6 * np.std(around) + np.finfo(float).tiny
    product = signal.oaconvolve(around, (part - part.mean())[::-1], "valid") / count
    return np.asarray(product / (np.maximum(spread, floor) * np.std(part)))


def _refined(here: _Series, there: _Series, found: Alignment) -> Alignment:
    """Fit a line through the lags of short stretches, with a resolution finer than a sample."""
    # A lag is assigned to the middle of its stretch, although the signal may change elsewhere in it.
    # Repeated passes, each with the drift of the previous pass removed, make this error small.
    length_s = min(FINE_S, (there.stop_s - there.start_s) / 4.0)
    parts = [
        there.cut(start_s, start_s + length_s)
        for start_s in np.arange(there.start_s, there.stop_s - length_s, length_s)
    ]
    for _ in range(PASSES):
        lags = [told for part in parts if (told := _lag(here, part, found)) is not None]
        if len(lags) < 2:
            return found
        time, lag, std = np.array(lags).T
        found = _line(time, lag, std, there)
    return found


def _lag(here: _Series, part: _Series, found: Alignment) -> tuple[float, float, float] | None:
    """Middle of a stretch, its lag, and the lag's standard deviation [s]; None if the lag can't be determined."""
    time, values = found(part.time_s), part.values
    around = here.cut(time[0] - 1.0, time[-1] + 1.0)
    if len(around.values) < len(values) or not np.isfinite(values.sum() + around.values.sum()):
        return None
    spline = CubicSpline(around.time_s, around.values)
    slope = spline.derivative()
    scale, more = 1.0, 0.0
    for _ in range(STEPS):
        basis = np.column_stack([np.ones(len(time)), spline(time + more), scale * slope(time + more)])
        fit, _, rank, _ = np.linalg.lstsq(basis, values, rcond=None)
        if rank < 3:
            return None
        scale = float(fit[1])
        more += float(np.clip(fit[2], -0.2, 0.2))
    left = values - basis @ fit
    variance = float(np.linalg.inv(basis.T @ basis)[2, 2]) * float(left @ left) / (len(time) - 3)
    told = 1.0 - float(np.var(left)) / max(float(np.var(values)), np.finfo(float).tiny)
    if told < ALIKE**2 or not variance > 0.0:
        return None
    middle = float(part.time_s.mean())
    return middle, float(found(middle)) - middle + more, math.sqrt(variance)


def _line(time: Array, lag: Array, std: Array, there: _Series) -> Alignment:
    """Fit a weighted line through lags, without outliers."""
    kept = np.ones(len(time), dtype=np.bool_)
    centre = float(time.mean())
    basis = np.column_stack([np.ones(len(time)), time - centre])
    for _ in range(STEPS):
        weighted = basis[kept] / std[kept, None]
        fit = np.linalg.lstsq(weighted, lag[kept] / std[kept], rcond=None)[0]
        score = np.abs(lag - basis @ fit) / std
        limit = 4.0 * max(ROBUST_SIGMA * float(np.median(score[kept])), 1.0)
        if kept.sum() <= 3 or np.array_equal(kept, score < limit):
            break
        kept = score < limit
    excess = max(float(np.mean(score[kept] ** 2)), 1.0)
    covariance = np.linalg.pinv(weighted.T @ weighted) * excess
    ends = np.array([[1.0, there.start_s - centre], [1.0, there.stop_s - centre]])
    worst = float(np.sqrt(np.einsum("ij,jk,ik->i", ends, covariance, ends).max()))
    return Alignment(float(fit[0] - fit[1] * centre), float(fit[1]), worst)


def _matched(here: Array, there: Array, found: Alignment) -> Alignment:
    """Fit a line through the time differences of pulses that both loggers recorded."""
    pitch = float(np.median(np.diff(here)))
    for _ in range(STEPS):
        place = np.clip(np.searchsorted(here, found(there)), 1, len(here) - 1)
        before, after = here[place - 1], here[place]
        nearest = np.where(found(there) - before < after - found(there), before, after)
        same = np.abs(nearest - found(there)) < NEXT_PULSE * pitch
        if same.sum() < 3:
            return found
        lag = nearest[same] - there[same]
        series = _Series(float(there[0]), 1.0, np.empty(math.ceil(there[-1] - there[0])))
        spread = ROBUST_SIGMA * float(np.median(np.abs(nearest[same] - found(there[same])))) + 1e-9
        found = _line(there[same], lag, np.full(len(lag), spread), series)
    return found
