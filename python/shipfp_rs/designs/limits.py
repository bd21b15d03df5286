"""Limits of a trial: amplitude, rate of change, duration, excluded bands, and the signal generator."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.signals import Excitation
from shipfp_rs.signals.checks import bands
from shipfp_rs.support.arrays import Array, Mask
from shipfp_rs.support.calibration import Calibration
from shipfp_rs.support.checks import positive

RATES_HZ = (100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0)
"""Sample rates to try, highest first; the ships of interest respond up to a few hertz."""
SAMPLES_A_PERIOD = 10.0
"""Fewest samples per period: linear interpolation is then within 5 % of a sine."""
TOP_HZ = 5.0
"""Highest useful frequency, limited by pulse trains and governors."""


@dataclass(frozen=True)
class Generator:
    """Arbitrary-waveform generator on the set-point line.

    Parameters
    ----------
    calibration
        Conversion of its volts to the set point [rpm], as in eq. 6.7.
    lowest_V, highest_V
        Range of the output [V].
    """

    calibration: Calibration
    lowest_V: float = -10.0
    highest_V: float = 10.0

    def __post_init__(self) -> None:
        if not self.lowest_V < self.highest_V:
            raise InputError(
                f"generator: range {self.lowest_V:g} to {self.highest_V:g} V, expected low before high"
            )

    def volts(self, set_point_rpm: Array) -> Array:
        """Volts for a set point (N,); `InputError` if they are outside the output's range."""
        volts = self.calibration.inverse(set_point_rpm)
        if volts.min() < self.lowest_V or volts.max() > self.highest_V:
            raise InputError(
                f"the set point {set_point_rpm.min():.6g} to {set_point_rpm.max():.6g} rpm needs {volts.min():.4g} to "
                f"{volts.max():.4g} V, expected {self.lowest_V:g} to {self.highest_V:g} V; lower the amplitude or check "
                "the calibration"
            )
        return volts


@dataclass(frozen=True)
class Limits:
    """Limits of a trial.

    Parameters
    ----------
    amplitude_rpm
        Largest deviation of the set point [rpm of the engine].
    rate_rpm_s
        Largest rate of change of the set point [rpm/s]; None: unlimited.
    avoid_hz
        Bands (low, high) around resonances [Hz].
    lowest_hz, highest_hz
        Range of the frequencies; None: from two periods in the available time to 5 Hz.
    longest_samples
        Longest waveform that fits the generator; None: unlimited.
    """

    amplitude_rpm: float
    rate_rpm_s: float | None = None
    avoid_hz: tuple[tuple[float, float], ...] = ()
    lowest_hz: float | None = None
    highest_hz: float | None = None
    longest_samples: int | None = None

    def __post_init__(self) -> None:
        positive("amplitude_rpm", self.amplitude_rpm)
        for name in ("rate_rpm_s", "lowest_hz", "highest_hz", "longest_samples"):
            if getattr(self, name) is not None:
                positive(name, getattr(self, name))
        object.__setattr__(self, "avoid_hz", tuple(bands(self.avoid_hz)))

    def sample_rate(self, duration_s: float) -> float:
        """Highest sample rate [Hz] whose waveform fits the generator; `InputError` if none does or it is too low."""
        for rate in RATES_HZ:
            if self.longest_samples is None or duration_s * rate <= self.longest_samples:
                break
        else:
            raise InputError(
                f"longest_samples is {self.longest_samples}, {duration_s:g} s at {RATES_HZ[-1]:g} Hz are "
                f"{duration_s * RATES_HZ[-1]:.0f}; shorten the trial or split it"
            )
        if self.highest_hz is not None and self.highest_hz * SAMPLES_A_PERIOD > rate:
            raise InputError(
                f"highest_hz is {self.highest_hz:g}, expected at most {rate / SAMPLES_A_PERIOD:g}: ten samples a "
                f"period, and {duration_s:g} s within the generator's "
                + (f"{self.longest_samples} samples" if self.longest_samples else f"{rate:g} Hz")
            )
        return rate

    def span(self, duration_s: float, rate_hz: float) -> tuple[float, float]:
        """Lowest and highest frequency [Hz]."""
        low = self.lowest_hz or 2.0 / duration_s
        high = self.highest_hz or min(TOP_HZ, rate_hz / SAMPLES_A_PERIOD)
        if low >= high:
            raise InputError(
                f"frequencies from {low:.4g} to {high:.4g} Hz, expected low before high; a longer trial or a longer "
                "waveform has room for more"
            )
        return low, high

    def amplitude_at(self, frequency_hz: Array) -> Array:
        """Largest amplitude of a sine within the rate limit [rpm], shape (F,)."""
        steepest = math.inf if self.rate_rpm_s is None else self.rate_rpm_s
        return np.minimum(self.amplitude_rpm, steepest / (2.0 * math.pi * frequency_hz))

    def outside(self, frequency_hz: Array) -> Mask:
        """Which frequencies (F,) lie outside all bands."""
        inside = [(low <= frequency_hz) & (frequency_hz <= high) for low, high in self.avoid_hz]
        return ~np.any(inside, axis=0) if inside else np.ones(len(frequency_hz), dtype=bool)

    def within(self, excitation: Excitation) -> float:
        """Factor, at most 1, that brings an excitation within amplitude and rate of change."""
        factor = self.amplitude_rpm / excitation.amplitude_rpm
        if self.rate_rpm_s is not None:
            factor = min(factor, self.rate_rpm_s / steepest_rpm_s(excitation))
        # Exceeding a limit by rounding is permitted.
        return 1.0 if factor > 1.0 - 1e-9 else factor


def steepest_rpm_s(excitation: Excitation) -> float:
    """Largest rate of change of an excitation [rpm/s]."""
    return float(np.abs(np.diff(excitation.samples)).max() * excitation.rate_hz)
