"""Sampling period of a governor, from the spectral lines of its stepwise output in the raw torque."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.signal import zoom_fft
from scipy.signal.windows import tukey

from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.spikes import bridge

RATE_HZ = 800.0
"""Highest sample rate at which the torque is analysed. Its band contains two harmonics of stairs with a 5 ms period."""
SHORTEST_S = 10.0
"""Shortest stretch that is analysed."""
LEAST_TOLD = 0.5
"""Least fraction of unmasked samples."""
LONGEST_S = 1000.0
"""Longest stretch that is analysed; it suffices to detect a clock, and longer stretches take more memory."""
DRIVEN_HZ = 6.0
"""Highest frequency of the shaft's response to the set point, and so of changes in the height of the stairs."""
SLOWEST_HZ, FASTEST_HZ = 14.0, 200.0
"""Range of the search: periods of 5 to 71 ms."""
HARMONICS = 6
"""Number of harmonics that are searched."""
SEEN = 0.45
"""Fraction of the sample rate up to which the torque's spectrum is used."""
FLOOR_HZ = 2.0
"""Bandwidth in which the noise beside a line is estimated."""
MEDIAN = 1.678
"""Median of the explained power for noise alone and two regressors, a gamma distribution of order two."""
LINE = 60.0
"""Least ratio of power to noise of a clock's second strongest harmonic. Noise alone exceeds 25 with probability 1e-9;
firing and blade lines, whose frequency varies with the speed, spread beside their orders and may exceed it.
"""
PIECES = 8
"""Number of parts of the record, with equal variation of the speed, in all of which a clock has the same phase."""
COHERENT = 0.75
"""Least coherence of two harmonics: power explained by one line over all parts, relative to the sum over separate lines."""
MANY, COHERENT_MANY = 4, 0.5
"""Number of harmonics for which a smaller coherence suffices. In 60 records of noise, the fourth best of six was below
0.2.
"""
ALONE = 100.0
"""Least ratio of power to noise if a clock has only one visible line, since torsion of the shaft may suppress the
harmonics.
"""
STEADY = 0.92
"""Least coherence of a clock's only visible line."""
FAR_FROM_ORDERS = 1e-2
"""Least relative distance of a clock's only visible line from any order, since variations of speed shift the lines of
orders.
"""
CHANCE = 20.0
"""Ratio of power to noise that one of several harmonics may reach by noise alone."""
PART = 0.7
"""Fraction of the best candidate's mean evidence that a lower clock frequency needs to replace this candidate, which
may be a harmonic of the lower one.
"""
BESIDE_ORDER = 5e-4
"""Relative distance from an order of shaft or engine within which a line is attributed to the order."""
QUARTZ = 2e-5
"""Relative error of a logger's clock, and so of a period measured by this clock."""


class GovernorClock(NamedTuple):
    """Sampling period of a governor [s], its standard deviation [s], and the ratio of its lines' power to the noise."""

    period_s: float
    std_s: float
    power: float


def governor_clock(
    torque: Array, speed: Array, factor: int, rate_hz: float, orders_hz: Array
) -> GovernorClock | None:
    """Find the sampling period of a governor that holds its output between samples.

    The engine's torque is then a staircase, which deviates from the smooth torque by a saw-tooth with the governor's period.
    Its height is the change of the torque in one period; by the equation of motion this is proportional to
    tau_n dn'/dt + (p - g) n', where n' is the slope of the speed. Multiplied by n' and by dn'/dt, the measured torque has
    spectral lines at the sampling frequency and its harmonics. The shaft attenuates the lines, but does not shift them.

    Parameters
    ----------
    torque
        Torque at `factor` times the rate of the speed, shape (factor N,), any unit, NaN where masked.
    speed
        Engine speed from the same time on, shape (N,), any unit, NaN where masked.
    factor
        Number of torque samples per speed sample.
    rate_hz
        Sample rate of the torque.
    orders_hz
        Mean frequencies of a shaft's turn and of the engine's cycle [Hz]; their multiples are lines of the rotation.

    Returns
    -------
    GovernorClock or None
        None if no clock stands out from the noise.
    """
    share = min(np.isfinite(torque).mean(), np.isfinite(speed).mean())
    if share < LEAST_TOLD or len(torque) < SHORTEST_S * rate_hz:
        return None
    slopes = _slopes(speed, factor, rate_hz)
    if not slopes.any():
        return None
    stairs = _without(bridge(torque, np.isnan(torque)), rate_hz)
    length = fft.next_fast_len(2 * len(stairs), real=True)
    spectra = np.array([fft.rfft(stairs * slope, length) for slope in slopes])
    inverse = np.asarray(np.linalg.inv(slopes @ slopes.T), dtype=np.float64)
    step = rate_hz / length
    power = _over_noise(_explained(spectra, inverse), step)
    found = _comb(power, step, min(SEEN * rate_hz, 2.0 * FASTEST_HZ), orders_hz)
    if found is not None:
        clock, harmonic = found
        top = float(power[round(harmonic * clock / step)])
        told = _refined(stairs, slopes, inverse, rate_hz, clock, harmonic, top)
        most = min(HARMONICS, int(SEEN * rate_hz * told.period_s))
        numbers = range(1, most + 1)
        shares = sorted(_coherence(stairs, slopes, rate_hz, number / told.period_s) for number in numbers)
        if len(shares) > 1 and shares[-2] > COHERENT:
            return told
        # An oscillating shaft changes the shape of the stairs and so reduces the coherence of all harmonics.
        if len(shares) >= MANY and shares[-MANY] > COHERENT_MANY:
            return told
    line = _line(power, step, orders_hz)
    if line is None:
        return None
    told = _refined(stairs, slopes, inverse, rate_hz, line, 1, float(power[round(line / step)]))
    return told if _coherence(stairs, slopes, rate_hz, 1.0 / told.period_s) > STEADY else None


def _slopes(speed: Array, factor: int, rate_hz: float) -> Array:
    """First and second derivative of the speed below `DRIVEN_HZ`, at the torque's rate, of unit power: (2, factor N)."""
    count = len(speed)
    filled = bridge(speed, np.isnan(speed))
    level = (filled - filled.mean()) * tukey(count, 0.02)
    frequency = fft.rfftfreq(count, factor / rate_hz)
    derivative = 2j * np.pi * frequency * (frequency < DRIVEN_HZ)
    spectrum = fft.rfft(level) * derivative
    slopes = np.array([fft.irfft(one, count * factor) for one in (spectrum, spectrum * derivative)])
    scale = np.sqrt(np.mean(np.square(slopes), axis=1, keepdims=True))
    return slopes / np.where(scale > 0.0, scale, 1.0)


def _without(torque: Array, rate_hz: float) -> Array:
    """Torque without the frequencies of the response to the set point."""
    spectrum = fft.rfft(torque - torque.mean())
    spectrum[: round(0.5 * (DRIVEN_HZ + SLOWEST_HZ) * len(torque) / rate_hz)] = 0.0
    return np.asarray(fft.irfft(spectrum, len(torque)))


def _explained(spectra: ComplexArray, inverse: Array) -> Array:
    """Power of the torque explained by two regressors at each frequency, shape (F,)."""
    return np.asarray(np.einsum("if,ij,jf->f", spectra.conj(), inverse, spectra, optimize=True).real)


def _over_noise(power: Array, step: float) -> Array:
    """Ratio of power to nearby noise, estimated from the median of a stretch."""
    width = max(round(FLOOR_HZ / step), 8)
    stretches = len(power) // width
    floors = np.median(power[: stretches * width].reshape(stretches, width), axis=1) / MEDIAN
    floor = np.interp(np.arange(len(power)), (np.arange(stretches) + 0.5) * width, floors)
    return np.asarray(power / np.maximum(floor, 1e-300))


def _comb(power: Array, step: float, top_hz: float, orders_hz: Array) -> tuple[float, int] | None:
    """Clock [Hz] with the strongest second harmonic, and the number of its strongest harmonic."""
    first, last = round(SLOWEST_HZ / step), round(min(FASTEST_HZ, top_hz) / step)
    bins = np.arange(first, last)
    teeth = np.zeros((HARMONICS, len(bins)))
    for harmonic in range(1, HARMONICS + 1):
        within = bins * harmonic * step < top_hz
        for beside in range(-(harmonic // 2) - 1, harmonic // 2 + 2):
            there = power[np.minimum(bins * harmonic + beside, len(power) - 1)]
            np.maximum(teeth[harmonic - 1], np.where(within, there, 0.0), out=teeth[harmonic - 1])
    for order in orders_hz:
        turns = bins * step / order
        teeth[:, np.abs(turns - np.round(turns)) < BESIDE_ORDER * turns] = 0.0
    second = np.partition(teeth, HARMONICS - 2, axis=0)[HARMONICS - 2]
    if not len(second) or second.max() < LINE:
        return None
    best = int(np.argmax(second))
    around = (int(np.argmax(teeth[:, best])) + 1) * int(bins[best]) + np.arange(-HARMONICS, HARMONICS + 1)
    strongest = int(around[np.argmax(power[around])])
    # The best candidate may be a (sub)harmonic of the clock: take the lowest frequency with all harmonics.
    candidates = []
    for part in range(1, 2 * HARMONICS + 1):
        place = round(strongest / part) - first
        if 0 <= place < len(bins):
            count = max(int(top_hz / (bins[place] * step)), 1)
            evidence = float(np.mean(np.log(np.maximum(teeth[: min(count, HARMONICS), place] / CHANCE, 1.0))))
            candidates.append((evidence, part, float(bins[place] * step)))
    if not candidates:
        return None
    enough = PART * max(candidates)[0]
    _, part, clock = min((one for one in candidates if one[0] >= enough), key=lambda one: one[2])
    return clock, part


def _line(power: Array, step: float, orders_hz: Array) -> float | None:
    """Frequency [Hz] of the strongest line, if it is strong enough and is not at a multiple of an order."""
    bins = np.arange(round(SLOWEST_HZ / step), min(round(FASTEST_HZ / step), len(power)))
    if not bins.size:  # the torque is too slow to show any clock
        return None
    line = float(bins[np.argmax(power[bins])] * step)
    turns = line / orders_hz
    is_order = (np.abs(turns - np.round(turns)) < FAR_FROM_ORDERS * turns).any()
    return None if power[round(line / step)] < ALONE or is_order else line


def _refined(
    stairs: Array, slopes: Array, inverse: Array, rate_hz: float, clock: float, harmonic: int, power: float
) -> GovernorClock:
    """Period at the strongest line's maximum; its standard deviation is the Cramer-Rao bound for a line of this power."""
    bin_hz = rate_hz / len(stairs)
    around = harmonic * clock + bin_hz * np.array([-3.0, 3.0])
    count = 601
    spectra = np.array(
        [zoom_fft(stairs * slope, around, count, fs=rate_hz, endpoint=True) for slope in slopes]
    )
    frequency = np.linspace(around[0], around[1], count)
    top = float(frequency[int(np.argmax(_explained(spectra, inverse)))])
    weight = np.square(slopes).sum(axis=0)
    time = np.arange(len(stairs)) / rate_hz
    middle = float(weight @ time / weight.sum())
    spread = float(weight @ np.square(time - middle) / weight.sum())
    std = 1.0 / (2.0 * np.pi * np.sqrt(2.0 * power * spread))
    # The resolution of the search and the error of the logger's clock are added.
    std = float(np.linalg.norm([std, (frequency[1] - frequency[0]) / np.sqrt(12.0), QUARTZ * top]))
    period = harmonic / top
    return GovernorClock(period, period * std / top, power)


def _coherence(stairs: Array, slopes: Array, rate_hz: float, line_hz: float) -> float:
    """Power explained by one line over the whole record, relative to that explained by a separate line in each piece."""
    turned = stairs * np.exp(-2j * np.pi * line_hz / rate_hz * np.arange(len(stairs)))
    lively = np.cumsum(np.square(slopes).sum(axis=0))
    ends = np.searchsorted(lively, lively[-1] * np.arange(PIECES + 1) / PIECES)
    pieces = [slice(*pair) for pair in pairwise(ends)]
    along = np.array([slopes[:, piece] @ turned[piece] for piece in pieces])
    grams = np.array([slopes[:, piece] @ slopes[:, piece].T for piece in pieces])

    def explained(spectrum: ComplexArray, gram: Array) -> float:
        return float((spectrum.conj() @ np.linalg.pinv(gram) @ spectrum).real)

    each = sum(map(explained, along, grams))
    return explained(along.sum(axis=0), grams.sum(axis=0)) / max(each, 1e-300)


def liveliest_of(speeds: Mapping[str, Array], longest: int) -> tuple[str, slice] | None:
    """Record and stretch of at most `longest` samples with the most motion of the speed; None if the speed is constant."""
    parts = {label: liveliest(speed, longest) for label, speed in speeds.items()}
    moved = {label: np.nansum(np.square(np.diff(speeds[label][part]))) for label, part in parts.items()}
    label = max(moved, key=lambda label: moved[label])
    return (label, parts[label]) if moved[label] > 0.0 else None


def liveliest(speed: Array, longest: int) -> slice:
    """Stretch of at most `longest` samples with the most motion of the speed."""
    if len(speed) <= longest:
        return slice(0, len(speed))
    filled = bridge(speed, np.isnan(speed))
    moved = np.concatenate([[0.0], np.cumsum(np.square(np.diff(filled, append=filled[-1:])))])
    first = int(np.argmax(moved[longest:] - moved[:-longest]))
    return slice(first, first + longest)
