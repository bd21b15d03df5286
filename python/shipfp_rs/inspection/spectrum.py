"""Spectral lines of a steady channel, named by rotating parts (section 6.3.1, Table 6.9)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import signal

from shipfp_rs.support.arrays import Array
from shipfp_rs.support.spikes import bridge, find_spikes
from shipfp_rs.vessel.vessel import Vessel

SEGMENT_S = 20.0
"""Length of a segment of the averaged spectrum: lines 0.25 Hz apart are resolved."""
LEAST_SAMPLES = 64
"""Fewest samples of a segment, and of a channel with a spectrum."""
ABOVE_FLOOR = 4.0
"""Least ratio of a line to the median around it."""
FLOOR_HZ = 4.0
"""Bandwidth of this median."""
LOWEST_HZ = 0.5
MOST_PEAKS = 12
NAMED_WITHIN = 0.01
"""Largest relative distance of a line from the known rate that names it."""


@dataclass(frozen=True)
class Peak:
    """Spectral line: frequency [Hz], amplitude in the channel's unit, and its source, if known."""

    frequency_hz: float
    amplitude: float
    name: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {"frequency_hz": self.frequency_hz, "amplitude": self.amplitude, "name": self.name}


def amplitude_spectrum(samples: npt.ArrayLike, rate_hz: float) -> tuple[Array, Array]:
    """Frequencies [Hz] and averaged amplitudes of a steady signal, with spikes and gaps bridged.

    A sine of amplitude a appears as a at any frequency (flat-top window).
    """
    values = np.asarray(samples, dtype=np.float64)
    values = bridge(values, ~np.isfinite(values))
    spikes = np.zeros(len(values), dtype=np.bool_)
    for start, stop in find_spikes(values, rate_hz, longest_s=0.05, threshold=6.0, least=0.05):
        spikes[max(start - 1, 0) : stop + 1] = True
    size = min(max(round(SEGMENT_S * rate_hz), LEAST_SAMPLES), len(values))
    frequency, power = signal.welch(
        bridge(values, spikes), rate_hz, window="flattop", nperseg=size, detrend="linear", scaling="spectrum"
    )
    return np.asarray(frequency), np.sqrt(2.0 * power)


def rates_of(vessel: Vessel, n_e_rpm: float) -> dict[str, float]:
    """Rates [Hz] of rotating parts by name at an engine speed (eq. 6.4 to 6.6), as far as the vessel defines them.

    Examples
    --------
    >>> rates = rates_of(Vessel.load("stan-tug-1205"), 1184.0)
    >>> {name: round(rate, 2) for name, rate in rates.items()}
    {'shaft': 5.17, 'blades': 15.5, 'engine': 19.73, 'firing': 59.2}
    """
    engine = n_e_rpm / 60.0
    shaft = engine / vessel.gearbox.ratio
    rates = {"shaft": shaft, "engine": engine}
    if vessel.given("propeller.blades"):
        rates["blades"] = vessel.propeller.blades * shaft
    if vessel.given("engine.cylinders", "engine.strokes"):
        rates["firing"] = engine * vessel.engine.cylinders / (vessel.engine.strokes / 2)
    return dict(sorted(rates.items(), key=lambda rate: rate[1]))


def find_peaks(frequency: Array, amplitude: Array, known: Mapping[str, float] | None = None) -> list[Peak]:
    """Prominent lines of an amplitude spectrum in order of frequency, named after the `known` rates [Hz]."""
    step = float(frequency[1] - frequency[0])
    half = int(np.clip(0.5 * FLOOR_HZ / step, 1, len(amplitude) - 1))
    padded = np.pad(amplitude, half, mode="reflect")
    floor = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    # The flat top of a line is several bins wide: the highest within half a hertz counts.
    places, _ = signal.find_peaks(amplitude, height=ABOVE_FLOOR * floor, distance=max(round(0.5 / step), 1))
    places = places[frequency[places] >= LOWEST_HZ]
    places = np.sort(places[np.argsort(amplitude[places])[::-1][:MOST_PEAKS]])
    found = []
    for place in places:
        line = slice(max(place - 2, 0), place + 3)
        centre = float(np.average(frequency[line], weights=amplitude[line] ** 2))
        names = [
            name
            for name, rate in (known or {}).items()
            if abs(centre - rate) < max(NAMED_WITHIN * rate, step)
        ]
        found.append(Peak(centre, float(amplitude[place]), names[0] if names else None))
    return found
