"""The sampling period of a governor, from the spectral lines that its stepwise output leaves in the raw torque."""

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
"""Highest sample rate at which the torque is searched: stairs of 5 ms then have two harmonics in the band."""
SHORTEST_S = 10.0
"""Shortest stretch that is searched."""
LEAST_TOLD = 0.5
"""Least share of samples that are not masked."""
LONGEST_S = 1000.0
"""Longest stretch that is searched: it suffices to find a clock that acts, and longer ones cost memory."""
DRIVEN_HZ = 6.0
"""Highest frequency at which the set point moves the shaft, and so at which the height of the command's stairs changes."""
SLOWEST_HZ, FASTEST_HZ = 14.0, 200.0
"""Clocks looked for: periods of 5 to 71 ms."""
HARMONICS = 6
"""Number of the clock's harmonics that are searched."""
SEEN = 0.45
"""Share of the sample rate up to which the torque's spectrum is trusted."""
FLOOR_HZ = 2.0
"""Width over which the noise beside a line is taken."""
MEDIAN = 1.678
"""Median of what noise alone gives, for two regressors: the gamma law of order two."""
LINE = 60.0
"""Power over noise of the second strongest harmonic from which on it may be a clock's. Noise alone gives 25 in one of 1e9;
firing and blades, whose frequency goes with the speed, leave more beside their orders."""
PIECES = 8
"""Parts of the record, as lively each as the others, through all of which a clock keeps its phase."""
COHERENT = 0.75
"""Part of a harmonic's power, piece by piece, that one line through all pieces must explain; for two harmonics."""
MANY, COHERENT_MANY = 4, 0.5
"""Harmonics that are enough with a smaller such part. In 60 records of noise the fourth best of six had less than 0.2."""
ALONE = 100.0
"""Power over noise from which on a line may be a clock's although no harmonic of it is seen: twisting shafts take them."""
STEADY = 0.92
"""What such a line must reach in place of `COHERENT`."""
FAR_FROM_ORDERS = 1e-2
"""Part of an order by which such a line must be off any order: speeds that swing lopsidedly move those lines a little."""
CHANCE = 20.0
"""Power over noise that one of some harmonics may have by chance."""
PART = 0.7
"""Part of the best comb's mean evidence with which a lower clock takes its place: the best may be its harmonic."""
BESIDE_ORDER = 5e-4
"""Part of an order of the shaft or the engine within which a line may be that order's."""
QUARTZ = 2e-5
"""Relative error of a logger's clock; a period measured with that clock has the same error."""


class GovernorClock(NamedTuple):
    """A governor's sampling period [s], its standard deviation [s], and the power of its lines over the noise's."""

    period_s: float
    std_s: float
    power: float


def governor_clock(
    torque: Array, speed: Array, factor: int, rate_hz: float, orders_hz: Array
) -> GovernorClock | None:
    """Find the sampling period of a governor that holds its output in between.

    The engine's torque is then a staircase. Less the smooth torque it is a saw-tooth of the governor's period. Its height is
    the change of the torque in one period, by the equation of motion proportional to tau_n dn'/dt + (p - g) n' (n' the slope
    of the speed). Multiplied by n', and by dn'/dt, the measured torque has spectral lines at the sampling frequency and its
    harmonics. The shaft in between weakens them and does not shift them.

    Parameters
    ----------
    torque
        At `factor` times the rate of the speed, shape (factor N,), any unit, NaN where masked.
    speed
        Engine speed from the same moment on, shape (N,), any unit, NaN where masked.
    factor
        Samples of the torque a sample of the speed.
    rate_hz
        Of the torque.
    orders_hz
        Mean frequencies whose multiples are lines of the rotation: a turn of the shaft, a cycle of the engine.

    Returns
    -------
    GovernorClock or None
        None where there is no clock that can be told from noise.
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
        # A shaft that swings hands on stairs of another shape than the speed's slopes tell, all harmonics alike.
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
    """The torque without what the set point moves."""
    spectrum = fft.rfft(torque - torque.mean())
    spectrum[: round(0.5 * (DRIVEN_HZ + SLOWEST_HZ) * len(torque) / rate_hz)] = 0.0
    return np.asarray(fft.irfft(spectrum, len(torque)))


def _explained(spectra: ComplexArray, inverse: Array) -> Array:
    """Power of the torque that two regressors explain at each frequency, shape (F,)."""
    return np.asarray(np.einsum("if,ij,jf->f", spectra.conj(), inverse, spectra, optimize=True).real)


def _over_noise(power: Array, step: float) -> Array:
    """Divide by what noise gives nearby: the median of a stretch."""
    width = max(round(FLOOR_HZ / step), 8)
    stretches = len(power) // width
    floors = np.median(power[: stretches * width].reshape(stretches, width), axis=1) / MEDIAN
    floor = np.interp(np.arange(len(power)), (np.arange(stretches) + 0.5) * width, floors)
    return np.asarray(power / np.maximum(floor, 1e-300))


def _comb(power: Array, step: float, top_hz: float, orders_hz: Array) -> tuple[float, int] | None:
    """Return the clock [Hz] with the strongest second harmonic, and its strongest harmonic's number."""
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
    # The best is the clock, its harmonic, or a part of it: the lowest whose own harmonics are all there.
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
    """Return the strongest line [Hz], if it is strong enough and no order's."""
    bins = np.arange(round(SLOWEST_HZ / step), min(round(FASTEST_HZ / step), len(power)))
    line = float(bins[np.argmax(power[bins])] * step)
    turns = line / orders_hz
    is_order = (np.abs(turns - np.round(turns)) < FAR_FROM_ORDERS * turns).any()
    return None if power[round(line / step)] < ALONE or is_order else line


def _refined(
    stairs: Array, slopes: Array, inverse: Array, rate_hz: float, clock: float, harmonic: int, power: float
) -> GovernorClock:
    """Find the top of the strongest line, and its deviation by the Cramer-Rao bound of a line of that power."""
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
    # The grid of the search is a part of it, and so is the logger's clock.
    std = float(np.linalg.norm([std, (frequency[1] - frequency[0]) / np.sqrt(12.0), QUARTZ * top]))
    period = harmonic / top
    return GovernorClock(period, period * std / top, power)


def _coherence(stairs: Array, slopes: Array, rate_hz: float, line_hz: float) -> float:
    """Power that a line through the whole record explains over that of one of its own in each piece."""
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
    """Return the record, and its stretch of at most `longest` samples, in which the speed moves most; None: it stands."""
    parts = {label: liveliest(speed, longest) for label, speed in speeds.items()}
    moved = {label: np.nansum(np.square(np.diff(speeds[label][part]))) for label, part in parts.items()}
    label = max(moved, key=lambda label: moved[label])
    return (label, parts[label]) if moved[label] > 0.0 else None


def liveliest(speed: Array, longest: int) -> slice:
    """Return the stretch of at most `longest` samples in which the speed moves the most."""
    if len(speed) <= longest:
        return slice(0, len(speed))
    filled = bridge(speed, np.isnan(speed))
    moved = np.concatenate([[0.0], np.cumsum(np.square(np.diff(filled, append=filled[-1:])))])
    first = int(np.argmax(moved[longest:] - moved[:-longest]))
    return slice(first, first + longest)
