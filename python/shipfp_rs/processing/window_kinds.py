"""Kind of an excitation (sine, chirp, square wave ...), from its crossings, levels and spectral lines."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from shipfp_rs.support.arrays import Array

Kind = Literal["steady", "sine", "sines", "multisine", "chirp", "squares", "prbs", "steps", "other"]

CROSSED = 0.35
"""Hysteresis of the crossings for frequencies, as a fraction of the amplitude."""
JUMPED = 1.5
"""Distance from the mean, in amplitudes, above which a sample is a jump of the generator's relay."""
SAME_FREQUENCY = 1.15
"""Largest ratio between the last and first periods of an excitation with one frequency."""

IN_BAND = 0.95
"""Fraction of an excitation's power in its band."""
LINE_BINS, BETWEEN_LINES = 16, 0.4
"""In ranges of this many bins, the median power of a multisine is below this fraction of the mean, since there is no power
between its lines. For a swept frequency the two are similar, and for noise the median is 0.7 of the mean.
"""
SAME_LINES = 0.8
"""Least correlation between the amplitudes of a window's halves: a multisine has all lines all the time."""
REPEATS = 0.95
"""Least autocorrelation at one period of a periodic excitation."""
AT_LEVELS = 0.8
"""Least fraction of samples near the extremes in an excitation with two levels."""

IN_RUNS, SHORTEST_RUN = 0.75, 3
"""Least fraction of half periods in runs of at least this many equal ones, for excitations of successive frequencies."""


def middle_of(samples: Array) -> float:
    """Level halfway between the extremes of an excitation, without outliers."""
    return 0.5 * float(np.quantile(samples, 0.02) + np.quantile(samples, 0.98))


def kind_of(deviation: Array, rate_hz: float, *, swings: bool) -> tuple[Kind, tuple[float, float] | None]:
    """Kind of an excitation and its first and last frequency [Hz]; None if it hardly crosses its middle.

    `swings`: it moves most of the time. A stair does not, and has no lines.
    """
    crossings = _crossings(deviation) / rate_hz
    halves = np.diff(crossings)
    if len(halves) < 2:
        return "other", None
    count = max(len(halves) // 8, 1)
    early, late = (float(np.median(part)) for part in (halves[:count], halves[-count:]))
    frequencies, ratio = (0.5 / early, 0.5 / late), max(early / late, late / early)
    alike = np.quantile(halves, 0.9) < 1.3 * np.quantile(halves, 0.1)
    if _has_two_levels(deviation):
        return "squares" if alike or _come_in_runs(halves) else "prbs", frequencies
    if ratio < SAME_FREQUENCY and alike:
        mean = 0.5 * len(halves) / float(crossings[-1] - crossings[0])
        return "sine", (mean, mean)
    if swings and (band := _lines(deviation, rate_hz)) is not None:
        return "multisine", band
    if _come_in_runs(halves):
        return "sines", frequencies
    # The periods of a chirp change monotonically.
    logs = np.log(halves)
    order = np.corrcoef(np.arange(len(logs)), logs)[0, 1] if len(logs) > 2 else 1.0
    return "chirp" if ratio >= SAME_FREQUENCY and abs(order) > 0.5 else "other", frequencies


def _has_two_levels(samples: Array) -> bool:
    """Whether most samples are near one of the two extremes."""
    extremes = np.quantile(samples, [0.02, 0.98])
    near = np.abs(samples[:, None] - extremes).min(axis=1) < 0.1 * float(np.ptp(extremes))
    return bool(near.mean() > AT_LEVELS)


def _come_in_runs(halves: Array) -> bool:
    """Whether half periods form two or more runs, each of one frequency."""
    logs, same = np.log(halves), math.log(SAME_FREQUENCY)
    parts = np.split(logs, np.flatnonzero(np.abs(np.diff(logs)) > same) + 1)
    runs_ = [len(part) for part in parts if len(part) >= SHORTEST_RUN and abs(part[-1] - part[0]) < same]
    return len(runs_) > 1 and sum(runs_) > IN_RUNS * len(halves)


def _lines(samples: Array, rate_hz: float) -> tuple[float, float] | None:
    """Lowest and highest frequency of a sum of sines [Hz]; None for anything else."""
    deviation = samples - samples.mean()
    power = np.abs(np.fft.rfft(deviation * np.hanning(len(samples)))) ** 2
    power[:1] = 0.0
    if not power.sum() > 0.0:
        return None
    held = np.cumsum(power) / power.sum()
    low, high = (
        int(np.searchsorted(held, share)) for share in (0.5 * (1.0 - IN_BAND), 0.5 * (1.0 + IN_BAND))
    )
    blocks = power[low : low + (high - low) // LINE_BINS * LINE_BINS].reshape(-1, LINE_BINS)
    # Parts without a line have little power, and little weight.
    between = np.median(blocks, axis=1).sum() / blocks.mean(axis=1).sum() if len(blocks) > 1 else 1.0
    if _repeats(deviation) or (between < BETWEEN_LINES and _stays(deviation, low // 2, high // 2 + 1)):
        return low * rate_hz / len(samples), high * rate_hz / len(samples)
    return None


def _stays(deviation: Array, low: int, high: int) -> bool:
    """Whether both halves of a signal have the same amplitudes in a band of bins of a half."""
    half = len(deviation) // 2
    halves = (deviation[:half], deviation[half : 2 * half])
    early, late = (np.abs(np.fft.rfft(part * np.hanning(half)))[low:high] for part in halves)
    with np.errstate(all="ignore"):
        return bool(np.corrcoef(early, late)[0, 1] > SAME_LINES)


def _repeats(deviation: Array) -> bool:
    """Whether a signal is periodic."""
    count = len(deviation)
    spectrum = np.fft.rfft(deviation, 2 * count)
    products = np.fft.irfft(np.abs(spectrum) ** 2)[:count]
    energy = np.concatenate([[0.0], np.cumsum(deviation**2)])
    lags = np.arange(count // 2)
    scale = np.sqrt(energy[count - lags] * (energy[-1] - energy[lags]))
    alike = products[lags] / np.maximum(scale, 1e-300)
    apart = np.flatnonzero(alike < 0.0)
    return bool(apart.size and alike[apart[0] :].max() > REPEATS)


def _crossings(deviation: Array) -> Array:
    """Indices at which a signal crosses zero, shape (K,)."""
    amplitude = float(np.quantile(np.abs(deviation), 0.9))
    side = np.where(np.abs(deviation) > CROSSED * amplitude, np.sign(deviation), 0.0)
    side[np.abs(deviation) > JUMPED * amplitude] = 0.0
    known = np.flatnonzero(side)
    turns = np.flatnonzero(np.diff(side[known]))
    # A crossing lies midway between the last sample on one side and the first on the other.
    return np.asarray(0.5 * (known[turns] + known[turns + 1]), dtype=np.float64)
