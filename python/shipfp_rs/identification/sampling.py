"""Excited bandwidth of a record, the course of inputs between samples, and the interpolation of masked samples."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, prev_fast_len, rfft
from scipy.linalg import solve

from shipfp_rs.support.arrays import Array

Between = Literal["band-limited", "straight", "held"]
"""Course of the inputs between samples: smooth, piecewise linear, or held."""
BAND_HZ = 4.0
"""Highest frequency that is compared [Hz]; above it ships' tachometers and loops carry little information."""
EXCITED = 0.99
"""Share of the inputs' power times frequency that is inside the band; beyond it the data are noise."""
LEAST_HZ, LEAST_PERIODS = 0.5, 40
"""Least bandwidth [Hz], and least number of a record's frequencies in it, so that the noise can be estimated."""
EDGE_S = 2.0
"""Time over which a record fades in and out [s], so that its edges do not leak into the band."""
SHORTEST_S = 10.0 * EDGE_S
"""Least length of a record for a spectrum [s]."""
BEFORE_S = 2.0
"""Initial time that is not compared [s]: through dead times it depends on inputs before the record, which are unknown if the
record starts during an excitation."""


def down_of(rate_hz: float, seen_hz: float) -> int:
    """Decimation factor that keeps three or more samples per period of the highest frequency."""
    return max(1, int(rate_hz / (3.0 * seen_hz) + 1e-9))


LEAST_SWING = 2e-3
"""Least standard deviation of a set point or load, relative to the operating point, that counts as excitation."""
WHITE, ONE_RECORD_IN = 1.4, 100.0
"""Largest ratio of the median powers in two bands of white noise; and number of records of white noise of which one exceeds
the floor by chance."""


def white_floor(power: Array) -> float:
    """Return the power below which an input is white noise, from its powers between 0 Hz and half the sample rate."""
    ends = [round(share * len(power)) for share in (0.24, 0.4, 0.56)]
    lower, upper = (float(np.median(power[first:last])) for first, last in pairwise(ends))
    # The power of white noise is exponentially distributed, with a mean of median / log 2.
    above = float(np.log(ONE_RECORD_IN * len(power)) / np.log(2.0))
    return above * lower if upper < WHITE * lower < WHITE**2 * upper else 0.0


def excitation(values: Array, rate_hz: float, most_hz: float) -> tuple[Array, float]:
    """Return an input without its white noise, and the bandwidth [Hz] that has `EXCITED` of its power times frequency."""
    if not len(values):
        return values, 0.0
    count, mean = prev_fast_len(len(values), real=True), values.mean()
    fade = np.minimum(np.arange(count), np.arange(count)[::-1]) / (EDGE_S * rate_hz)
    spectrum = rfft(values[:count] - mean)
    power = np.abs(rfft((values[:count] - mean) * np.clip(fade, 0.0, 1.0))) ** 2
    frequency = np.fft.rfftfreq(count, 1.0 / rate_hz)
    floor = white_floor(power)
    kept = np.maximum(power, np.abs(spectrum) ** 2) >= floor
    clean = values.copy()
    # The noise of a measured input moves the model but not the ship.
    clean[:count] = mean + irfft(spectrum * kept, count)
    # White noise as strong as an excitation counts as an excitation.
    if np.std(values - clean) >= LEAST_SWING:
        clean, floor = values, 0.0
    power[power < floor] = 0.0
    grown = np.cumsum(np.where(frequency <= most_hz, power * frequency, 0.0))
    least_hz = max(LEAST_PERIODS * rate_hz / count, 0.0 if floor else LEAST_HZ)
    return clean, min(max(float(frequency[np.searchsorted(grown, EXCITED * grown[-1])]), least_hz), most_hz)


NUGGET = 1e-4
"""Share of the variance that cannot be predicted from neighbouring samples."""


def kriged(values: Array, gaps: npt.NDArray[np.bool_], reach: int) -> Array:
    """Return signals (O, N) with gaps (O, N) filled by kriging (Cressie 1993, "Statistics for Spatial Data", 3.4.5)."""
    mean = np.array(
        [row[~own].mean() if not own.all() else 0.0 for row, own in zip(values, gaps, strict=True)]
    )
    centred = np.where(gaps, 0.0, values - mean[:, None])
    stretches = [_stretches(row) for row in gaps]
    longest = max((int(end - first) for rows in stretches for first, end in rows), default=0)
    covariance = _covariance(centred, gaps, 2 * reach + longest + 1)
    nugget = np.maximum(NUGGET * covariance[:, :, 0].diagonal(), 1e-30)
    found = centred.copy()
    for output, rows in enumerate(stretches):
        for first, end in rows:
            # Best linear estimate from `reach` samples of all signals on either side; far inside a gap of all signals it
            # equals the mean.
            around = np.arange(max(first - reach, 0), min(end + reach, values.shape[1]))
            whose, when = np.nonzero(~gaps[:, around])
            when = around[when]
            square = _between(covariance, whose, when, whose, when)
            square.flat[:: len(when) + 1] += nugget[whose]
            inside = np.arange(first, end)
            across = _between(covariance, np.full(len(inside), output), inside, whose, when)
            found[output, inside] = across @ solve(square, centred[whose, when], assume_a="pos")
    return np.where(gaps, found + mean[:, None], values)


def _stretches(gaps: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """First sample of each gap, and the first after it, shape (G, 2)."""
    return np.flatnonzero(np.diff(np.concatenate([[False], gaps, [False]]))).reshape(-1, 2)


def _covariance(centred: Array, gaps: npt.NDArray[np.bool_], lags: int) -> Array:
    """Covariance (O, O, 2 `lags` - 1) of signals outside gaps; lag k from -`lags` + 1 to `lags` - 1 has index k."""
    size = next_fast_len(centred.shape[1] + lags, real=True)
    spectra = rfft(centred, size)
    counts = np.sqrt((~gaps).sum(axis=1))
    # A common divisor for all lags keeps the covariance matrix positive definite.
    products = irfft(spectra[:, None] * spectra[None].conj(), size) / np.outer(counts, counts)[..., None]
    return np.asarray(products[:, :, np.r_[0:lags, size - lags + 1 : size]])


def _between(
    covariance: Array,
    a: npt.NDArray[np.intp],
    at: npt.NDArray[np.intp],
    b: npt.NDArray[np.intp],
    then: npt.NDArray[np.intp],
) -> Array:
    """Covariances of samples `at` of signals `a` with samples `then` of signals `b`."""
    return np.asarray(covariance[a[:, None], b, at[:, None] - then])
