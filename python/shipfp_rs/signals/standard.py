"""An excitation of any kind from a few values, for the command line and for sweeps."""

from __future__ import annotations

from typing import Literal

import numpy as np

from shipfp_rs.signals.chirps import chirp, multisine, sine_sequence
from shipfp_rs.signals.excitation import Excitation
from shipfp_rs.signals.noise import band_limited_noise, prbs, steps
from shipfp_rs.support.arguments import Whole, checked, positive

TOP_HZ = 5.0
"""Highest frequency of interest: pulse trains do not resolve higher ones, and governors do not follow them."""
TONES = 16
SPAN = 100.0
"""Ratio of the highest to the lowest frequency of a sine sequence; the duration determines the lowest."""
SHORTEST_BIT_S = 0.5
"""Shortest bit of the binary sequence [s]: about the response time of a launch."""


Kind = Literal["chirp", "steps", "multisine", "sines", "prbs", "noise"]


@checked
def standard(
    kind: Literal["chirp", "steps", "multisine", "sines", "prbs", "noise"],
    duration_s: float,
    amplitude_rpm: float,
    *,
    start_hz: float | None = None,
    stop_hz: float | None = None,
    rate_hz: float = 100.0,
    seed: Whole = 0,
) -> Excitation:
    """Return an excitation of the given kind, with its usual band and shape.

    Parameters
    ----------
    kind
        "chirp" (logarithmic), "steps" (each held for a fifth of the duration), "multisine" and "sines" (16 frequencies, the
        latter over two decades), "prbs" or "noise".
    duration_s
        Length [s]; for "prbs" rounded down to whole periods of the binary sequence.
    amplitude_rpm
        Largest deviation [rpm of the engine]; for "noise" three times the root mean square.
    start_hz, stop_hz
        Band [Hz]; by default from two periods in the duration to 5 Hz or a fifth of the rate. Ignored for "steps",
        "sines" and "prbs".
    rate_hz
        Sample rate [Hz].
    seed
        Seed of "prbs" and "noise".

    Examples
    --------
    >>> standard("steps", 50.0, 65.0).kind
    'steps'
    """
    positive("duration_s", duration_s)
    positive("rate_hz", rate_hz)
    low = 2.0 / duration_s if start_hz is None else start_hz
    high = min(TOP_HZ, rate_hz / 5.0) if stop_hz is None else stop_hz
    match kind:
        case "chirp":
            return chirp(low, high, duration_s, amplitude_rpm, rate_hz=rate_hz)
        case "steps":
            sizes = [amplitude_rpm, -amplitude_rpm, -amplitude_rpm, amplitude_rpm]
            return steps(sizes, duration_s / 5.0, lead_s=duration_s / 5.0, rate_hz=rate_hz)
        case "multisine":
            lines = np.unique((duration_s * np.geomspace(low, high, TONES)).round())
            return multisine(lines / duration_s, duration_s, amplitude_rpm, rate_hz=rate_hz)
        case "sines":
            # Four periods of each frequency fill the duration.
            ratios = np.geomspace(1.0, SPAN, TONES)
            lowest = 4.0 * np.sum(1.0 / ratios) / duration_s
            return sine_sequence(lowest * ratios, 4, amplitude_rpm, rate_hz=rate_hz)
        case "prbs":
            bits = int(duration_s / SHORTEST_BIT_S)
            order = max(bits + 1, 4).bit_length() - 1
            return prbs(
                order, round(SHORTEST_BIT_S * rate_hz) / rate_hz, amplitude_rpm, seed=seed, rate_hz=rate_hz
            )
        case "noise":
            return band_limited_noise(low, high, duration_s, amplitude_rpm / 3.0, seed=seed, rate_hz=rate_hz)
