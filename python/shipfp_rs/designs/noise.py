"""Sensor noise: level, bandwidth, and accuracy of the calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from shipfp_rs.errors import InputError
from shipfp_rs.identification.likelihood import ACCURACY
from shipfp_rs.support.arrays import Array

MOST_INACCURATE = 0.2
"""Largest relative error of a calibration."""
LEAST_LEVEL = 1e-9
"""Least level of noise; smaller ones have weights out of numerical range."""


@dataclass(frozen=True)
class Noise:
    """Stationary noise with a first-order spectrum.

    Its density is flat up to the corner frequency and falls with the square of the frequency above.

    Parameters
    ----------
    level
        Standard deviation relative to the signal's operating point [-].
    corner_hz
        Corner frequency [Hz]; None: white up to half the sample rate, on which the density then depends.
    accuracy
        Smooth relative error of the sensor's response after calibration, one standard deviation [-]. It does not decrease
        with the length of a trial.
    """

    level: float
    corner_hz: float | None = None
    accuracy: float = ACCURACY

    def __post_init__(self) -> None:
        if not LEAST_LEVEL <= self.level <= 1.0:
            raise InputError(
                f"noise level is {self.level}, expected a share of the operating point from {LEAST_LEVEL:g} to 1"
            )
        if self.corner_hz is not None and not self.corner_hz > 0.0:
            raise InputError(f"noise corner_hz is {self.corner_hz}, expected a positive frequency or None")

        if not 0.0 <= self.accuracy <= MOST_INACCURATE:
            raise InputError(f"noise accuracy is {self.accuracy}, expected 0 to {MOST_INACCURATE:g}")

    def correlation(self, rate_hz: float) -> float:
        """Correlation between successive samples [-]."""
        return 0.0 if self.corner_hz is None else math.exp(-2.0 * math.pi * self.corner_hz / rate_hz)

    def innovation(self, rate_hz: float) -> float:
        """Standard deviation of a sample given the previous one, relative to the operating point [-]."""
        return self.level * math.sqrt(1.0 - self.correlation(rate_hz) ** 2)

    def density(self, frequency_hz: Array, rate_hz: float) -> Array:
        """One-sided power spectral density of the samples at frequencies (F,) [1/Hz]."""
        turn = np.exp(-2j * math.pi * frequency_hz / rate_hz)
        whitened = np.abs(1.0 - self.correlation(rate_hz) * turn) ** 2
        return np.asarray(2.0 * self.innovation(rate_hz) ** 2 / rate_hz / whitened)

    def typical(self, turns: Array, samples: int, rate_hz: float) -> Array:
        """Samples (N,), relative to the operating point, with the density as periodogram and given phases [turns]."""
        density = self.density(np.arange(len(turns), dtype=np.float64) * (rate_hz / samples), rate_hz)
        waves = np.sqrt(0.5 * samples * rate_hz * density) * np.exp(2j * math.pi * turns)
        return np.asarray(np.fft.irfft(waves, samples))

    def draw(self, samples: int, rate_hz: float, generator: np.random.Generator) -> Array:
        """Draw samples (N,), relative to the operating point; the first is from the stationary distribution."""
        correlation = self.correlation(rate_hz)
        shocks = self.level * generator.standard_normal(samples)
        shocks[1:] *= math.sqrt(1.0 - correlation**2)
        return np.asarray(lfilter([1.0], [1.0, -correlation], shocks))


USUAL: Mapping[str, Noise] = {
    "n_e": Noise(0.003, 10.0),
    "n_s": Noise(0.003, 10.0),
    "M_g": Noise(0.01, 10.0),
    "M_b": Noise(0.01, 10.0),
    "M_s": Noise(0.01, 10.0),
    "X_f": Noise(0.01, 10.0),
    "E_n": Noise(0.003, 10.0),
}
"""Defaults without data of a sensor: four reflectors resolve about 10 Hz of shaft speed, and edges between samples at 2 kHz
scatter by some tenths of a per cent; a telemetry gauge by about one per cent.
"""


def sensors_of(given: Mapping[str, Noise] | None, signals: Mapping[str, str]) -> dict[str, Noise]:
    """Sensor noise by output; `InputError` for a signal unused by the structure, or one without noise."""
    for name in given or {}:
        if name not in signals.values():
            raise InputError(f"sensors: found {name!r}, expected some of {', '.join(signals.values())}")
    known = {**USUAL, **(given or {})}
    for signal in signals.values():
        if signal not in known:
            raise InputError(
                f"sensors: no noise of {signal!r}, expected one; give sensors={{{signal!r}: Noise(...)}}"
            )
    return {output: known[signal] for output, signal in signals.items()}
