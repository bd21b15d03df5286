"""Noise of the sensors: how large, up to which frequency it is flat, and what calibration leaves open."""

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
"""Least level of noise; the weights of less are beyond what numbers hold."""


@dataclass(frozen=True)
class Noise:
    """Stationary noise with a first-order spectrum.

    Its density is flat up to the corner frequency and falls with its square above.

    Parameters
    ----------
    level
        Standard deviation over the signal's operating point [-].
    corner_hz
        Frequency above which it falls [Hz]; None: white up to half the sample rate, and then its density depends on it.
    accuracy
        Smooth relative error of the sensor's response that its calibration leaves open, one standard deviation [-]: what
        no length of a trial takes away.
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
        """Correlation of successive samples [-]."""
        return 0.0 if self.corner_hz is None else math.exp(-2.0 * math.pi * self.corner_hz / rate_hz)

    def innovation(self, rate_hz: float) -> float:
        """Standard deviation of what a sample has beyond the one before it, over the operating point [-]."""
        return self.level * math.sqrt(1.0 - self.correlation(rate_hz) ** 2)

    def density(self, frequency_hz: Array, rate_hz: float) -> Array:
        """One-sided power spectral density at frequencies (F,) [1/Hz], of the samples."""
        turn = np.exp(-2j * math.pi * frequency_hz / rate_hz)
        whitened = np.abs(1.0 - self.correlation(rate_hz) * turn) ** 2
        return np.asarray(2.0 * self.innovation(rate_hz) ** 2 / rate_hz / whitened)

    def typical(self, turns: Array, samples: int, rate_hz: float) -> Array:
        """Samples (N,), over the operating point, whose periodogram is the density, of phases (N // 2 + 1,) [turns]."""
        density = self.density(np.arange(len(turns), dtype=np.float64) * (rate_hz / samples), rate_hz)
        waves = np.sqrt(0.5 * samples * rate_hz * density) * np.exp(2j * math.pi * turns)
        return np.asarray(np.fft.irfft(waves, samples))

    def draw(self, samples: int, rate_hz: float, generator: np.random.Generator) -> Array:
        """Draw samples (N,), over the operating point; the first comes from the stationary distribution."""
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
"""Assumed where no figure of a sensor is given: a pulse train of four reflectors tells about 10 Hz of shaft speed, and its
edges between samples at 2 kHz scatter by some tenths of a percent; a telemetry gauge by about one."""


def sensors_of(given: Mapping[str, Noise] | None, signals: Mapping[str, str]) -> dict[str, Noise]:
    """Return the noise of the sensor behind each output, by name of the output.

    Raises
    ------
    InputError
        For a signal that the structure does not use, or one without noise.
    """
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
