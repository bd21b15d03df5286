"""Signals of an experiment, prepared for a fit: low-pass, common rate, operating point, trend, ripple.

Blades in the wake and firing cylinders make the torque oscillate at multiples of the rotation frequency. Such ripple
does not help a fit, and below half the sample rate its power may be twenty times that of the other noise. The frequency
of the ripple varies with the speed, so a fixed filter can't remove it, but the angle is known from the tachometers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from scipy import fft
from scipy.ndimage import convolve1d
from scipy.signal import resample_poly, upfirdn

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import DRIVES, Experiment
from shipfp_rs.logs.channel import Channel, Samples
from shipfp_rs.logs.log import Log
from shipfp_rs.support.arrays import Array, ComplexArray, Mask, runs
from shipfp_rs.support.derivatives import taps
from shipfp_rs.support.spikes import bridge

FINER = 8
"""Number of steps per sample in which the angle is computed."""
SLOWEST_HZ = 1.0
"""Lowest mean frequency of a removed line [Hz]; slower motion may be due to the set point."""
BESIDE_HZ = 1.0
"""Bandwidth on either side of a line in which its noise is estimated [Hz]."""
NEAR = 3
"""Number of frequency bins on either side of a line that are not noise, since the line's amplitude may vary slowly."""
LINE = 30.0
"""Least ratio of a line's power to the noise beside it; noise alone exceeds this ratio with probability 1e-13."""
SLOW_S = 0.2
"""Length of the running mean of the torque [s]; the amplitude of a line may vary with this mean."""
LEVEL_S = 1.0
"""Length of the running mean [s] that is subtracted before the search for lines."""
ROUNDED = 2e-4
"""Largest relative error of an order: gear ratios are given with four digits."""
FINER_LINES = 4
"""Number of search frequencies per bin of the record's spectrum."""
SHORTEST_S = 20.0
"""Shortest record in which lines can be separated from the response to the set point [s]."""
TURNS = 24
"""Highest searched multiple of the rotation of engine and shaft, which includes two blade harmonics of any propeller."""
MOST = 12
"""Largest number of lines that are removed."""


class Ripple(NamedTuple):
    """Ripple line: frequency per engine speed, mean frequency [Hz], amplitude in the torque's unit, power over noise."""

    order: float
    frequency_hz: float
    amplitude: float
    power: float


def without_ripple(torque: Array, speed: Array, rate_hz: float, ratio: float) -> tuple[Array, list[Ripple]]:
    """Remove ripple lines from a low-passed torque (NaN: masked) by the engine speed [rpm]; also return the lines."""
    valid = np.isfinite(torque)
    if valid.sum() < SHORTEST_S * rate_hz or not np.isfinite(speed).any():
        return torque, []
    turns_hz = bridge(speed, np.isnan(speed)) / 60.0
    filled = bridge(torque, ~valid)
    beyond = _beyond(filled, rate_hz)
    slow = _running_mean(filled, SLOW_S * rate_hz)
    # Cosine and sine amplitude of a line each have a constant part and a part proportional to the mean torque.
    # No part is proportional to the speed, since it would also fit the torque's response to a step.
    # In a step test, speed and torque differ only while the shaft accelerates.
    shapes = [np.ones(len(torque)), (slow - slow.mean()) / max(float(np.std(slow)), 1e-300)]
    angle = _angle(turns_hz, rate_hz)
    turning = {order: _turning(order, angle) for order in _orders(float(turns_hz.mean()), rate_hz, ratio)}
    found: list[Ripple] = []
    columns, seen = np.empty((0, len(torque))), np.empty((0, len(torque)))
    ripple, rest = np.zeros(len(torque)), np.where(valid, beyond, 0.0)
    while turning and len(found) < MOST:
        lines = {
            order: _line(rest, turned, valid, order, turns_hz, rate_hz) for order, turned in turning.items()
        }
        nominal = max(lines, key=lambda order: lines[order].power)
        line = lines[nominal]
        if line.power < LINE:
            break
        del turning[nominal]
        found.append(line)
        # The gear ratio may be rounded, so the order is estimated from the line itself.
        turned = _turning(line.order, angle)
        own = np.array([part * shape for shape in shapes for part in (turned.real, turned.imag)])
        columns = np.vstack([columns, own])
        seen = np.vstack([seen, [_beyond(column, rate_hz) for column in own]])
        factors, *_ = np.linalg.lstsq(seen[:, valid].T, beyond[valid], rcond=1e-9)
        ripple = np.asarray(factors @ columns)
        rest = np.where(valid, beyond - factors @ seen, 0.0)
    return (torque - ripple, found) if found else (torque, [])


def _orders(mean_hz: float, rate_hz: float, ratio: float) -> list[float]:
    """Multiples of the engine's rotation in the record's band: half orders of the engine, whole ones of the shaft."""
    if mean_hz < SLOWEST_HZ:
        return []
    engine, shaft = 0.5 * np.arange(1, 2 * TURNS + 1), np.arange(1, TURNS + 1) / ratio
    shaft = shaft[np.abs(shaft * 2.0 - np.round(shaft * 2.0)) > 1e-6]
    return [
        float(order) for order in np.append(engine, shaft) if SLOWEST_HZ < order * mean_hz < 0.5 * rate_hz
    ]


def _angle(turns_hz: Array, rate_hz: float) -> Array:
    """Angle of the engine at each fine step [rad], shape (FINER N,)."""
    level = turns_hz[0]
    fine = level + resample_poly(turns_hz - level, FINER, 1, padtype="line")
    turns = np.append(0.0, np.cumsum(0.5 * (fine[1:] + fine[:-1]))) / (FINER * rate_hz)
    return np.asarray(2.0 * np.pi * turns)


def _turning(order: float, angle: Array) -> ComplexArray:
    """Low-passed exp(i order angle) at the samples, shape (N,)."""
    turned, kernel = order * angle, taps(1.0 / FINER, 0.0)
    real, imaginary = (
        resample_poly(part, 1, FINER, window=kernel) for part in (np.cos(turned), np.sin(turned))
    )
    return np.asarray(real + 1j * imaginary)


def _line(
    rest: Array, turned: ComplexArray, valid: Mask, order: float, turns_hz: Array, rate_hz: float
) -> Ripple:
    """Strongest line near an order in the remaining torque, with the ratio of its power to the noise."""
    mean = float(turns_hz.mean())
    weight = float(np.sum(np.abs(turned[valid]) ** 2))
    if weight < NEAR * rate_hz:
        return Ripple(order, order * mean, 0.0, 0.0)
    length = fft.next_fast_len(FINER_LINES * len(rest))
    spectrum = np.abs(fft.fft(rest * turned.conj(), length)) ** 2
    step = rate_hz / length
    width, near = max(int(BESIDE_HZ / step), 10 * NEAR), NEAR * FINER_LINES
    reach = int(ROUNDED * order * mean / step)
    beside = np.append(spectrum[reach + near : width], spectrum[-width : -reach - near])
    noise = float(np.median(beside) / np.log(2.0))
    offsets = np.arange(-reach, reach + 1)
    best = int(offsets[np.argmax(spectrum[offsets])])
    power = float(spectrum[best])
    # The order is refined by the maximum of a parabola through the strongest spectral line and its two neighbours.
    before, after = float(spectrum[best - 1]), float(spectrum[best + 1])
    lean = 0.5 * (after - before) / max(2.0 * power - before - after, 1e-300)
    placed = order + (best + float(np.clip(lean, -0.5, 0.5))) * step / mean
    amplitude = 2.0 * float(np.sqrt(power)) / weight
    return Ripple(placed, placed * mean, amplitude, power / max(noise, 1e-300))


def _beyond(signal: Array, rate_hz: float) -> Array:
    return np.asarray(signal - _running_mean(signal, LEVEL_S * rate_hz))


def _running_mean(signal: Array, samples: float) -> Array:
    width = 2 * int(0.5 * samples) + 1
    return np.asarray(convolve1d(signal, np.full(width, 1.0 / width), mode="nearest"))


@dataclass(frozen=True)
class Grid:
    """Grid of sample times in a stretch, which all signals share."""

    label: str
    start_s: float
    rate_hz: float
    count: int

    @property
    def stop_s(self) -> float:
        """End of the stretch [s], one interval after the last sample."""
        return self.start_s + self.count / self.rate_hz

    def low_passed(self, channel: Channel, source: Source) -> Array:
        """Low-pass the samples of `source`, which are indexed as in the channel, and resample them on the grid."""
        channel, source = on_a_simple_rate(channel, source, self.rate_hz)
        start = (self.start_s - channel.start_s) * channel.rate_hz
        return LowPass(channel, self.rate_hz, start)(source, self.count)


def block_means(log: Log, name: str, block: int) -> Array:
    """Mean of each block of samples, shape (N // block,); NaN where a sample is missing."""
    return np.concatenate([np.empty(0), *mean_pieces(log, name, block)])


def mean_pieces(
    log: Log, name: str, block: int, start_s: float | None = None, stop_s: float | None = None
) -> Iterator[Array]:
    """Yield the means of whole blocks of a stretch, in pieces."""
    for rows in whole_blocks(log.chunks(name, start_s=start_s, stop_s=stop_s), block):
        yield rows.mean(axis=1)


def whole_blocks(pieces: Iterable[Samples], block: int) -> Iterator[Array]:
    """Regroup the samples of pieces into whole blocks; yield them in arrays of shape (K, block)."""
    held = np.empty(0)
    for piece in pieces:
        held = np.concatenate([held, np.asarray(piece, dtype=np.float64)])
        whole = len(held) // block * block
        yield held[:whole].reshape(-1, block)
        held = held[whole:]


Source = Callable[[int, int], Array]
"""Function (first, stop) that returns samples [first, stop) of a channel, NaN where masked."""
MARGIN_S = 1.0
"""Margin read before and after each piece [s], which running medians need at the piece's ends."""
PIECE = 1 << 17
"""Number of samples cleaned at once, since a window may be larger than the memory."""
MASKED_SHARE = 0.05
"""An output is masked if more than this fraction of the filter's weight is on masked samples."""
ALIGNED = 1e-6
"""Largest difference between two clocks due to rounding, in samples."""
SAME_CLOCK, SAME_RATE = 1e-6, 1e-3
"""Largest relative difference between two rates of one clock, due to rounding, and of two clocks with the same nominal
rate.
"""
REACH = 16
"""Number of samples on either side that contribute to an interpolated value."""
KAISER = 8.0
"""Shape parameter of the interpolation's Kaiser window; the error is at most 1e-3 up to two fifths of the sample rate."""


def nearest_rate(channel: Channel, wanted_hz: float) -> float:
    """Rate [Hz] nearest to `wanted_hz` that is a simple fraction of a channel's rate."""
    if wanted_hz > channel.rate_hz * (1.0 + 1e-3):
        raise InputError(
            f"processing.rate_hz is {wanted_hz:g}, expected no more than the {channel.rate_hz:g} Hz of channel "
            f"{channel.name!r}"
        )
    # At such a rate, the signals keep the channel's clock; no resampling to a clock that differs by a few ppm is needed.
    share = wanted_hz / channel.rate_hz
    return channel.rate_hz * float(Fraction(share).limit_denominator(max(100, round(1.0 / share))))


def on_a_simple_rate(channel: Channel, source: Source, rate_hz: float) -> tuple[Channel, Source]:
    """Resample a channel whose rate is nearly in a simple ratio to the common rate; return others unchanged."""
    # The nodes of a bus have separate clocks, which differ by a few to some hundred ppm.
    share = rate_hz / channel.rate_hz
    nearest = Fraction(share).limit_denominator(max(500, round(1.0 / share)))
    if math.isclose(nearest, share, rel_tol=SAME_CLOCK) or not math.isclose(
        nearest, share, rel_tol=SAME_RATE
    ):
        return channel, source
    step = channel.rate_hz * float(nearest) / rate_hz
    samples = int((channel.samples - 1) / step) + 1
    resampled = partial(_between, source, channel.samples, step)
    return replace(channel, rate_hz=rate_hz / float(nearest), samples=samples), resampled


def _between(source: Source, samples: int, step: float, first: int, stop: int) -> Array:
    """Samples [first, stop) interpolated by a windowed sinc, each `step` source samples apart; NaN beside masked samples."""
    at = np.arange(first, stop) * step
    low = max(int(at[0]) - REACH, 0)
    values = source(low, min(int(at[-1]) + REACH + 2, samples))
    missing = np.isnan(values)
    filled = bridge(values, missing)
    whole = np.floor(at).astype(np.int64)
    taps_at = np.arange(1 - REACH, REACH + 1)
    distance = (at - whole)[:, None] - taps_at
    weights = np.sinc(distance) * np.i0(KAISER * np.sqrt(np.maximum(1.0 - (distance / REACH) ** 2, 0.0)))
    places = np.clip(whole[:, None] + taps_at - low, 0, len(values) - 1)
    found = np.sum(weights * filled[places], axis=1) / weights.sum(axis=1)
    found[missing[places[:, REACH - 1 : REACH + 1]].any(axis=1)] = np.nan
    return np.asarray(found)


class LowPass:
    """Zero-phase FIR low-pass with resampling to the common rate; `start` is the first output's time [channel samples]."""

    def __init__(self, channel: Channel, rate_hz: float, start: float) -> None:
        ratio = Fraction(rate_hz / channel.rate_hz).limit_denominator(4096)
        if ratio > 1 or not math.isclose(ratio, rate_hz / channel.rate_hz, rel_tol=SAME_CLOCK):
            raise InputError(
                f"channel {channel.name!r}: found {channel.rate_hz:g} Hz, expected {rate_hz:g} Hz or a multiple of "
                "it by a simple ratio; choose another processing.rate_hz"
            )
        self.up, self.down = ratio.numerator, ratio.denominator
        self.samples = channel.samples
        self.start = max(round(start), 0)
        inner_rate = channel.rate_hz * self.up
        shift = start - self.start
        self.taps = taps(rate_hz / inner_rate, shift * self.up if abs(shift) > ALIGNED else 0.0)
        # Longer masked runs are not bridged, so no output depends on samples on both sides of one.
        self.longest_bridge = math.ceil(len(self.taps) / self.up) + 1
        self.margin = max(round(MARGIN_S * channel.rate_hz), self.longest_bridge + 1)

    def __call__(self, source: Source, count: int) -> Array:
        """Compute `count` outputs; NaN after the channel's end, and where too many samples in the filter are masked."""
        result = np.full(count, np.nan)
        total = min(count, math.ceil((self.samples - self.start) * self.up / self.down))
        each = max(PIECE * self.up // self.down, 1)
        for begin in range(0, total, each):
            end = min(begin + each, total)
            result[begin:end] = self._outputs(source, begin, end)
        return result

    def _outputs(self, source: Source, begin: int, end: int) -> Array:
        """Compute outputs [begin, end); the channel is extended by its first and last samples."""
        half = len(self.taps) // 2
        first = self.start + (begin * self.down - half) // self.up
        stop = self.start + ((end - 1) * self.down + half) // self.up + 1
        low = max(first - self.margin, 0)
        samples = source(low, min(stop + self.margin, self.samples))
        missing, places = np.isnan(samples), np.arange(first, stop)
        inside = np.clip(places, 0, self.samples - 1)
        # Leading zeros of the taps put the first output at a multiple of `down`.
        at = begin * self.down + half - (first - self.start) * self.up
        ahead = np.zeros(-at % self.down)
        skipped = (at + len(ahead)) // self.down

        def filtered(values: Array, weights: Array) -> Array:
            outputs = upfirdn(np.append(ahead, weights), values, self.up, self.down)
            return np.asarray(outputs[skipped : skipped + end - begin])

        outputs = filtered(self._bridged(samples, missing)[inside - low], self.up * self.taps)
        if missing.any():
            masked, weights = missing[inside - low] & (inside == places), np.abs(self.taps)
            share = self.up * filtered(masked.astype(np.float64), weights) / weights.sum()
            outputs[share > MASKED_SHARE] = np.nan
        return outputs

    def _bridged(self, samples: Array, missing: Mask) -> Array:
        """Bridge short runs of masked samples by straight lines; fill long runs with the nearest values."""
        if not missing.any():
            return samples
        # Samples outside the margin have no effect, so the result does not depend on the division into pieces.
        bridged = samples.copy()
        for start, stop in runs(missing).tolist():
            before = samples[start - 1] if start > 0 else np.nan
            after = samples[stop] if stop < len(samples) else np.nan
            if stop - start <= self.longest_bridge and np.isfinite(before + after):
                bridged[start:stop] = before + (after - before) / (stop + 1 - start) * np.arange(
                    1, stop - start + 1
                )
            elif np.isfinite(before):
                held = start + self.longest_bridge if np.isfinite(after) else stop
                bridged[start:held] = before
                bridged[held:stop] = after
            else:
                bridged[start:stop] = after if np.isfinite(after) else 0.0
        return bridged


MOST_DEGREE = 3
"""Highest degree of a trend; a higher polynomial would follow the slow sines of a trial."""
LEAST_LOADED = 0.5
"""Least ratio of the operating point's torque to the range of the torque, with a measured load or in open loop."""
TORQUES = ("M_b", "M_s", "M_g")
LEAST_OWN = 0.2
"""A set point is a trend if less than this fraction of its power remains after a polynomial is subtracted."""


def about_local_point(experiment: Experiment) -> Experiment:
    """Make an experiment relative to the means of its own signals, instead of the trial's operating point.

    Examples
    --------
    >>> from shipfp_rs import signals, simulate
    >>> sine = signals.sine_sequence([0.1], 4, 13.0)
    >>> local = about_local_point(simulate(Vessel.load("stan-launch-804"), sine))
    >>> bool(abs(local.normalised("n_e").mean()) < 1e-12)
    True
    """
    # The offset of the torque differs between experiments (1651 to 1721 Nm in appendix E), so each has a point of its own.
    # The mean is the operating point only over whole periods of an oscillation.
    means = {
        name: float(np.nanmean(experiment.signals[name]))
        for name in experiment.operating_point
        if name in experiment.signals and name != "E_n"
    }
    return replace(experiment, operating_point={**experiment.operating_point, **means})


def driven_point(
    point: dict[str, float],
    windows: Sequence[Mapping[str, Array]],
    torque_Nm: float | None,
    to_shaft: float = 1.0,
) -> dict[str, float]:
    """Operating point, or the windows' means if its torque is near zero and there is a load or command."""
    # Torques normalised by the point of an idling engine would be very large; the mean under load is then the better point.
    # Quantities missing from `point` are means; the load's mean is corrected by `torque_Nm`.
    every = {name: np.concatenate([signals[name] for signals in windows]) for name in windows[0]}
    means = {name: float(np.nanmean(values)) for name, values in every.items()}
    known = {**means, **point}
    inputs = [name for name in (*TORQUES, "command", "M_load") if name in every]
    if torque_Nm is not None and "M_load" in every and "M_load" not in point:
        known["M_load"] += to_shaft * (torque_Nm - means[inputs[0]])
    if torque_Nm is not None or not {"command", "M_load"} & set(inputs):
        return known
    swing = float(np.nanmax(every[inputs[0]]) - np.nanmin(every[inputs[0]]))
    return known if abs(known[inputs[0]]) > LEAST_LOADED * swing else means


def conditioned(experiment: Experiment, detrend: int, normalise: Literal["global", "local"]) -> Experiment:
    """Remove drift of degree `detrend` unless the set point itself is such a trend; "local" normalises by own means."""
    if detrend:
        degree = 0 if set_point_is_trend(experiment, detrend) else detrend
        experiment = detrended(experiment, degree) if degree else experiment
        experiment = replace(experiment, provenance={**experiment.provenance, "detrend": degree})
    return about_local_point(experiment) if normalise == "local" else experiment


def detrended(experiment: Experiment, degree: int = 1) -> Experiment:
    """Remove slow drift from the outputs of an experiment; its inputs stay unchanged.

    A polynomial of time is fitted to each output, together with the set point and its slope, which represent the
    plant's response. The polynomial is subtracted without its mean, so the operating point is unchanged. This removes,
    for example, the temperature drift of a strain gauge.

    Parameters
    ----------
    experiment
        Experiment whose masked samples are NaN; they remain NaN.
    degree
        Degree of the polynomial, 1 to 3.

    Raises
    ------
    InputError
        If the degree is out of range, or the set point is close to such a polynomial, since the response to it looks
        like drift.
    """
    if not 1 <= degree <= MOST_DEGREE:
        raise InputError(f"degree: found {degree}, expected 1 to {MOST_DEGREE}")
    if set_point_is_trend(experiment, degree):
        raise InputError(
            f"experiment {experiment.name!r}: the set point itself is a trend, and the response to it looks like drift; "
            "leave the signals as they are"
        )
    polynomials = _polynomials(experiment, degree)
    set_point = experiment.signals[experiment.driver] - experiment.signals[experiment.driver].mean()
    answer = np.column_stack([set_point, np.gradient(set_point)])
    answer /= np.maximum(np.abs(answer).max(axis=0), np.finfo(np.float64).tiny)
    basis = np.column_stack([np.ones(len(experiment)), polynomials, answer])

    def without(values: Array) -> Array:
        known = np.isfinite(values)
        trend = polynomials @ np.linalg.lstsq(basis[known], values[known])[0][1 : degree + 1]
        return np.asarray(values - trend + trend[known].mean())

    signals = {
        name: without(values) if name not in DRIVES and np.isfinite(values).any() else values
        for name, values in experiment.signals.items()
    }
    return replace(experiment, signals=signals)


def set_point_is_trend(experiment: Experiment, degree: int = 1) -> bool:
    """Whether the set point is close to a polynomial of time, so that the response to it looks like drift."""
    set_point = experiment.signals[experiment.driver] - experiment.signals[experiment.driver].mean()
    basis = np.column_stack([np.ones(len(experiment)), _polynomials(experiment, degree)])
    left = set_point - basis @ np.linalg.lstsq(basis, set_point)[0]
    return bool(set_point.any() and left @ left < LEAST_OWN * (set_point @ set_point))


def _polynomials(experiment: Experiment, degree: int) -> Array:
    """Legendre polynomials of time without the constant, shape (N, degree)."""
    time = np.linspace(-1.0, 1.0, len(experiment))
    return np.asarray(np.polynomial.legendre.legvander(time, degree)[:, 1:])
