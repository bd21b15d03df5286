"""Argument checks shared by the builders of excitations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.checks import MOST_SAMPLES, positive

Bands = Sequence[tuple[float, float]]


def sample_times(duration_s: float, rate_hz: float) -> Array:
    """Sample times of a stretch, at least one sample."""
    return np.arange(_sample_count("duration", duration_s, rate_hz)) / rate_hz


def _sample_count(name: str, duration_s: float, rate_hz: float) -> int:
    positive(name, duration_s)
    positive("rate_hz", rate_hz)
    samples = duration_s * rate_hz
    if not 1.0 <= samples + 0.5 <= MOST_SAMPLES:
        raise InputError(
            f"{duration_s:g} s at {rate_hz:g} Hz are {samples:.3g} samples, expected 1 to {MOST_SAMPLES}"
        )
    return round(samples)


def whole_samples(name: str, duration_s: float, rate_hz: float) -> int:
    """Number of samples in a duration [s]; `InputError` if it is not a whole number."""
    count, samples = _sample_count(name, duration_s, rate_hz), duration_s * rate_hz
    if not math.isclose(count, samples, rel_tol=1e-9):
        raise InputError(f"{name} is {duration_s:g}, {samples:g} samples, expected a whole number of samples")
    return count


def zero_or_more(name: str, value: float) -> None:
    """Raise `InputError` unless a value is finite and not negative."""
    if not (math.isfinite(value) and value >= 0.0):
        raise InputError(f"{name} is {value}, expected zero or more")


def numbers(name: str, values: npt.ArrayLike) -> list[float]:
    """Convert values to a list of finite numbers, at least one."""
    numbers = np.array(values, dtype=np.float64)
    if numbers.ndim != 1 or not numbers.size or not np.isfinite(numbers).all():
        raise InputError(f"{name} is {values!r}, expected a list of at least one finite number")
    return [float(number) for number in numbers]


def below_nyquist(name: str, frequency: float, rate_hz: float) -> None:
    """Raise `InputError` for a frequency above half the sample rate."""
    positive(name, frequency)
    positive("rate_hz", rate_hz)
    if frequency >= 0.5 * rate_hz:
        raise InputError(
            f"{name} is {frequency:g} Hz, expected less than half of rate_hz {rate_hz:g}; sample faster"
        )


def bands(avoid_hz: Bands) -> list[tuple[float, float]]:
    """Sorted bands to avoid [Hz], each a pair (low, high)."""
    for index, band in enumerate(avoid_hz):
        if len(band) != 2 or not 0.0 <= band[0] < band[1] or not math.isfinite(band[1]):
            raise InputError(f"avoid_hz[{index}] is {tuple(band)}, expected (low, high) with 0 <= low < high")
    return sorted((float(low), float(high)) for low, high in avoid_hz)


def outside(frequencies: Sequence[float], avoid_hz: Bands) -> list[float]:
    """Frequencies [Hz] outside all bands; `InputError` if there are none."""
    left = [f for f in frequencies if not any(low <= f <= high for low, high in bands(avoid_hz))]
    if not left:
        raise InputError(f"every frequency lies in a band of avoid_hz {list(avoid_hz)}; leave some outside")
    return left
