"""Checks of calibrated signals at steady points: set point, speed, pulse trains, static torque, named spectral lines."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
from scipy import signal

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import OperatingPoint, Trial, Window
from shipfp_rs.processing.trial_template import moved
from shipfp_rs.processing.windows import FoundWindow, Kind
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.spikes import bridge, find_spikes
from shipfp_rs.vessel.vessel import PLANT_KEYS, Vessel

SEGMENT_S = 20.0
"""Length of a segment of the averaged spectrum [s]; it resolves lines 0.25 Hz apart."""
LEAST_SAMPLES = 64
"""Least number of samples in a segment, and in a channel with a spectrum."""
ABOVE_FLOOR = 4.0
"""Least ratio of a line's amplitude to the median amplitude around it."""
FLOOR_HZ = 4.0
"""Bandwidth of this median [Hz]."""
LOWEST_HZ = 0.5
MOST_PEAKS = 12
NAMED_WITHIN = 0.01
"""A line is named after a known rate, such as blade passage, if it differs from the rate by at most this fraction."""


@dataclass(frozen=True)
class Peak:
    """Spectral line: frequency [Hz], amplitude in the channel's unit, and source if known."""

    frequency_hz: float
    amplitude: float
    name: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {"frequency_hz": self.frequency_hz, "amplitude": self.amplitude, "name": self.name}


def amplitude_spectrum(samples: npt.ArrayLike, rate_hz: float) -> tuple[Array, Array]:
    """Frequencies [Hz] and averaged amplitudes of a steady signal, with spikes and gaps bridged."""
    values = np.asarray(samples, dtype=np.float64)
    values = bridge(values, ~np.isfinite(values))
    spikes = np.zeros(len(values), dtype=np.bool_)
    for start, stop in find_spikes(values, rate_hz, longest_s=0.05, threshold=6.0, least=0.05):
        spikes[max(start - 1, 0) : stop + 1] = True
    size = min(max(round(SEGMENT_S * rate_hz), LEAST_SAMPLES), len(values))
    # The flat-top window preserves the amplitude of a sine at any frequency.
    frequency, power = signal.welch(
        bridge(values, spikes), rate_hz, window="flattop", nperseg=size, detrend="linear", scaling="spectrum"
    )
    return np.asarray(frequency), np.sqrt(2.0 * power)


def rates_of(vessel: Vessel, n_e_rpm: float) -> dict[str, float]:
    """Rates [Hz] of rotating parts, by name, at an engine speed (eq. 6.4 to 6.6), as far as the vessel defines them.

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
    # A line is several bins wide; only the highest bin within half a hertz counts.
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


SETTLE_S = 4.0
"""Settling time that is excluded after a step [s]."""
SAME_POINT = 0.01
"""Stretches of constant set point count as one steady point if their speeds differ by less than this fraction."""
LEAST_SPAN = 1.1
"""Least ratio of highest to lowest speed, for the exponent to be fitted."""


@dataclass(frozen=True)
class SteadyPoint:
    """Means over all stretches at one set point: n_set and n_e [rpm], torque [Nm] (None if not measured), duration [s]."""

    n_set_rpm: float
    n_e_rpm: float
    torque_Nm: float | None
    duration_s: float


def static_torque(vessel: Vessel, n_e_rpm: npt.ArrayLike, C_Q: float | None = None) -> Array:
    """Propeller torque in bollard pull [Nm] (eq. 6.3); `C_Q` is C_Q* at beta 0 or 180 degrees, with eta_r assumed 1.

    Examples
    --------
    >>> round(float(static_torque(Vessel.load("stan-tug-1205"), 1184.0, 0.02709)), 1)
    1752.4
    """
    n_s = np.asarray(n_e_rpm, dtype=np.float64) / 60.0 / vessel.gearbox.ratio
    D = vessel.propeller.diameter_m
    # C_Q* refers to the blade's speed at 0.7 R and the disc's area: K_Q = C_Q* pi / 8 (0.7 pi)^2 = 1.899 C_Q*.
    K_Q = vessel.K_Q_over_eta_r if C_Q is None else C_Q * math.pi / 8.0 * (0.7 * math.pi) ** 2
    return np.asarray(K_Q * vessel.water.density_kg_m3 * D**5 * n_s**2)


def tells_static_torque(vessel: Vessel, C_Q: float | None) -> bool:
    """Whether a vessel has the values for `static_torque`."""
    plant = () if C_Q is not None else (*PLANT_KEYS, "operating_point")
    return vessel.given("water.density_kg_m3", "propeller.diameter_m", *plant)


def static_check(vessel: Vessel, points: Sequence[SteadyPoint], C_Q: float | None = None) -> dict[str, Any]:
    """Compare measured with calculated torque at every steady point, and fit the exponent of M = c n^p."""
    known = [point for point in points if point.torque_Nm is not None]
    n_e = np.array([point.n_e_rpm for point in known])
    measured = np.array([point.torque_Nm for point in known], dtype=np.float64)
    calculated = static_torque(vessel, n_e, C_Q)
    exponent = None
    if len(known) > 1 and n_e.max() > LEAST_SPAN * n_e.min() and (measured > 0.0).all():
        exponent = float(np.polyfit(np.log(n_e), np.log(measured), 1)[0])
    return {
        "n_e_rpm": n_e.tolist(),
        "measured_Nm": measured.tolist(),
        "calculated_Nm": calculated.tolist(),
        "error_pct": (100.0 * (1.0 - measured / calculated)).tolist(),
        "exponent": exponent,
    }


def linearity(points: Sequence[SteadyPoint]) -> dict[str, Any]:
    """Fit n_e = slope n_set + offset to the steady points; with three or more, also give the largest residual [rpm]."""
    n_set = np.array([point.n_set_rpm for point in points])
    n_e = np.array([point.n_e_rpm for point in points])
    result: dict[str, Any] = {
        "points": len(points),
        "largest_difference_rpm": float(np.abs(n_e - n_set).max()),
        "slope": None,
        "offset_rpm": None,
        "largest_residual_rpm": None,
    }
    if len(points) > 1 and np.ptp(n_set) > 1.0:
        slope, offset = (float(value) for value in np.polyfit(n_set, n_e, 1))
        result |= {"slope": slope, "offset_rpm": offset}
        if len(points) > 2:
            result["largest_residual_rpm"] = float(np.abs(n_e - slope * n_set - offset).max())
    return result


def found_or_named(log: Log, trial: Trial) -> tuple[str, list[FoundWindow]]:
    """Channel that moves, and the windows of a log, or those of the trial if the log is too short or never at rest."""
    mover, load = trial.channels.driver.column, trial.channels.load
    named = [
        (window.name, window.kind, window.start_s, window.stop_s) for window in trial.windows_of(log.name)
    ]
    if trial.operating_point.steady_s is not None:
        named.append(("R1", "steady", *trial.operating_point.steady_s))
    try:
        mover, found = moved(log, mover, None if load is None else load.column)
    except InputError:
        if not named:
            raise
        found = []
    if any(_lasts(window) for window in found):
        return mover, found
    kinds: Mapping[str, Kind] = {kind: kind for kind in get_args(Kind)}
    return mover, [
        FoundWindow(
            name,
            kinds.get(kind, "other"),
            start_s,
            stop_s,
            float(np.nanmedian(log.read(mover, start_s, stop_s))),
        )
        for name, kind, start_s, stop_s in named
    ] or found


def _lasts(window: FoundWindow) -> bool:
    """Whether a stretch of constant set point is longer than the settling time."""
    return window.kind == "steady" and window.stop_s - window.start_s > 2.0 * SETTLE_S


def found_experiments(
    log: Log, trial: Trial, vessel: Vessel, found: Sequence[FoundWindow]
) -> list[Experiment]:
    """Process each found window as a window of the trial; windows at rest begin after the settling time."""
    windows = tuple(
        Window(
            name=window.name,
            kind=window.kind,
            start_s=window.start_s + (SETTLE_S if window.kind == "steady" else 0.0),
            stop_s=window.stop_s,
        )
        for window in found
        if window.kind != "steady" or _lasts(window)
    )
    # Signals are not normalised, so any operating point is valid, except for a load, which is omitted.
    plain = trial.model_copy(
        update={
            "channels": trial.channels.model_copy(update={"load": None}),
            "windows": windows,
            "operating_point": OperatingPoint(n_e_rpm=1.0, M_Nm=1.0),
            "trial": trial.trial.model_copy(update={"log": (log.name,)}),
        }
    )
    return process(log, plain, vessel)


def steady_points(experiments: Sequence[Experiment], torque: str | None) -> list[SteadyPoint]:
    """Means of steady experiments in order of speed; experiments at the same speed are merged into one point."""
    groups: list[list[Experiment]] = []
    for experiment in sorted(experiments, key=_speed):
        if groups and _speed(experiment) < (1.0 + SAME_POINT) * _speed(groups[-1][0]):
            groups[-1].append(experiment)
        else:
            groups.append([experiment])

    def mean(group: list[Experiment], name: str) -> float:
        return float(np.nanmean(np.concatenate([experiment.signals[name] for experiment in group])))

    return [
        SteadyPoint(
            mean(group, "n_set"),
            mean(group, "n_e"),
            mean(group, torque) if torque is not None else None,
            sum(experiment.duration for experiment in group),
        )
        for group in groups
    ]


def trains(experiments: Sequence[Experiment]) -> dict[str, Any]:
    """Compare the speeds of the pulse trains, and report how far the reflectors deviate from even spacing."""
    best = max(experiments, key=len).provenance["speed"]
    apart = [
        max(speeds) / min(speeds) - 1.0
        for speeds in (experiment.provenance["speed"]["median_rpm"].values() for experiment in experiments)
    ]
    fractions = np.array(best["reflectors"]["fractions"])
    return {
        "train": best["train"],
        "median_rpm": dict(best["median_rpm"]),
        "largest_disagreement_pct": 100.0 * max(apart),
        "reflector_error_pct_of_pitch": (100.0 * (fractions * len(fractions) - 1.0)).tolist(),
    }


def _speed(experiment: Experiment) -> float:
    return float(np.nanmean(experiment.signals["n_e"]))
