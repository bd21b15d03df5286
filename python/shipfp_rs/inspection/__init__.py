"""Inspection of a raw log before a fit (section 6.3): channels, gaps, faults, spectra, checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import UNITS, Experiment
from shipfp_rs.inspection.channels import ChannelReport, describe, looked_for
from shipfp_rs.inspection.checks import (
    LEAST_SAMPLES,
    SETTLE_S,
    Peak,
    SteadyPoint,
    amplitude_spectrum,
    find_peaks,
    found_experiments,
    found_or_named,
    linearity,
    rates_of,
    static_check,
    static_torque,
    steady_points,
    tells_static_torque,
    trains,
)
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.faults.scan import scan
from shipfp_rs.logs.faults.spikes import spikes_of
from shipfp_rs.logs.log import STRETCH_BYTES, Log, Rows
from shipfp_rs.processing.cleaning import spike_rule
from shipfp_rs.processing.roles import named_roles
from shipfp_rs.processing.trial import Processing, Trial
from shipfp_rs.processing.trial_channels import SIGNAL_OF_LOCATION
from shipfp_rs.processing.trial_template import moved
from shipfp_rs.processing.windows import FoundWindow, longest_rest
from shipfp_rs.support.arrays import Array, joined
from shipfp_rs.support.derivatives import PASSBAND
from shipfp_rs.vessel.vessel import Vessel

__all__ = [
    "ChannelReport",
    "Inspection",
    "Peak",
    "SteadyPoint",
    "inspect_log",
    "static_check",
    "static_torque",
]


LONGEST_SPECTRUM_S = 300.0


@dataclass(frozen=True)
class Inspection:
    """Result of inspecting a log."""

    log: str
    channels: tuple[ChannelReport, ...]
    faults: tuple[dict[str, Any], ...]
    """JSON forms: kind (`shipfp_rs.logs.faults.KINDS`), channel, count, spans [first sample, last sample + 1]."""
    windows: tuple[FoundWindow, ...]
    """Windows of the set point, at rest or not; empty if no channel is recognised as a set point."""
    spectra: Mapping[str, tuple[Array, Array]]
    """Frequencies [Hz] and amplitudes of each channel over a stretch of constant set point."""
    peaks: Mapping[str, tuple[Peak, ...]]
    points: tuple[SteadyPoint, ...]
    """Steady points in order of speed; empty without a trial."""
    checks: Mapping[str, Any]
    """JSON form of all checks."""

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "log": self.log,
            "channels": [report.to_dict() for report in self.channels],
            "faults": list(self.faults),
            "windows": [
                {"name": w.name, "kind": w.kind, "start_s": w.start_s, "stop_s": w.stop_s}
                for w in self.windows
            ],
            "checks": dict(self.checks),
        }


def inspect_log(
    log: Log, trial: Trial | None = None, vessel: Vessel | None = None, *, C_Q: float | None = None
) -> Inspection:
    """Inspect a log, with or without its trial; `C_Q` (eq. 6.3) is by default that of the vessel's operating point."""
    # Without a trial: channels, faults of clock and level, spikes, windows, and lines of the spectra at constant set point.
    # With a trial: also all faults that processing detects, named lines of the torque, and the line of set point and speed.
    # Pulse trains and their reflectors are then compared, and the static torque with eq. 6.3.
    if trial is not None:
        log = trial.completed(log)
    reports = describe(log)
    faults = [fault.to_dict() for fault in [*log.faults, *_recorded(log, reports, trial)]]
    mover, windows = _windows(log, trial)
    rest = longest_rest(windows)
    checks: dict[str, Any] = {}
    points: tuple[SteadyPoint, ...] = ()
    rates: dict[str, float] = {}
    scale: dict[str, float] = {}
    if trial is not None:
        vessel = vessel or Vessel.load(trial.trial.vessel)
        every = found_experiments(log, trial, vessel, windows)
        torque = trial.channels.torque
        steady = [experiment for experiment in every if experiment.kind == "steady"]
        if steady and trial.channels.command is None:  # in open loop, no set point of speed exists
            name = SIGNAL_OF_LOCATION[torque.location] if torque is not None else None
            points = tuple(steady_points(steady, name))
            longest = max(steady, key=len)
            rates = rates_of(vessel, float(np.nanmean(longest.signals["n_e"])))
            checks |= _at_rest(points, steady, longest)
        if torque is not None:
            if points and tells_static_torque(vessel, C_Q):
                checks["static_torque"] = static_check(vessel, points, C_Q)
            scale[torque.column] = torque.calibration.calibration("Nm").scale
        # A set point at rest looks stuck in its window; whether it is stuck was determined from the whole log.
        known = {("stuck", trial.channels.driver.column)}
        known |= {(fault["kind"], fault["channel"]) for fault in faults}
        faults += _processed(every, known)
    spectra = {
        report.channel.name: _spectrum(log, report, rest, abs(scale.get(report.channel.name, 1.0)))
        for report in reports
        if report.pulses_hz is None and np.isfinite(report.noise) and report.channel.samples >= LEAST_SAMPLES
    }
    peaks = {key: tuple(find_peaks(*spectrum, rates)) for key, spectrum in spectra.items()}
    checks["spectra"] = {
        key: {
            "unit": "Nm" if key in scale else log.channel(key).unit,
            "peaks": [peak.to_dict() for peak in found],
        }
        for key, found in peaks.items()
    }
    checks["looked_for"] = looked_for(reports, trial)
    if rates:
        checks["rates_hz"] = rates
    if windows:
        checks["set_point_channel"] = mover
    return Inspection(log.name, tuple(reports), tuple(faults), tuple(windows), spectra, peaks, points, checks)


def _at_rest(points: Sequence[SteadyPoint], steady: list[Experiment], longest: Experiment) -> dict[str, Any]:
    """Checks in steady experiments: set point, pulse trains, noise and bandwidth."""
    return {
        "set_point_to_speed": linearity(points),
        "pulse_trains": trains(steady),
        "noise": {
            key: {"std": float(np.nanstd(values)), "unit": UNITS[key]}
            for key, values in longest.signals.items()
        },
        "bandwidth_hz": {
            "speed": longest.provenance["speed"]["bandwidth_hz"],
            "signals": PASSBAND * longest.rate_hz,
        },
    }


def _windows(log: Log, trial: Trial | None) -> tuple[str, list[FoundWindow]]:
    """Channel that moves, and its windows, as in `init`; none if no set point or load is recognised."""
    if trial is not None:
        return found_or_named(log, trial)
    try:
        roles = named_roles(list(log.channels.values()))
        return moved(log, roles.set_point or roles.command, roles.load)
    except InputError:
        return "", []


def _spectrum(log: Log, report: ChannelReport, rest: FoundWindow | None, scale: float) -> tuple[Array, Array]:
    """Spectrum of a channel over a stretch of constant set point, or over its start if there is no such stretch."""
    channel = report.channel
    start_s, stop_s = (channel.start_s, channel.stop_s) if rest is None else (rest.start_s, rest.stop_s)
    if rest is not None and stop_s - start_s > 3.0 * SETTLE_S:
        start_s += SETTLE_S
    longest_s = max(LONGEST_SPECTRUM_S, LEAST_SAMPLES / channel.rate_hz)
    start_s, stop_s = max(start_s, channel.start_s), min(stop_s, start_s + longest_s, channel.stop_s)
    frequency, amplitude = amplitude_spectrum(log.read(channel.name, start_s, stop_s), channel.rate_hz)
    return frequency, scale * amplitude


def _recorded(log: Log, reports: Sequence[ChannelReport], trial: Trial | None) -> list[Fault]:
    """Faults visible in the recorded samples of the whole log."""
    found = []
    channels = None if trial is None else trial.channels
    sensors = (
        {} if channels is None else {one.column: one for one in (channels.driver, *channels.levels.values())}
    )
    processing = Processing() if trial is None else trial.processing
    for report in reports:
        channel = report.channel
        if report.pulses_hz is None and channel.samples:
            rows = Rows(log, channel.name, kept_bytes=STRETCH_BYTES)
            spans = scan(rows, 0, channel.samples, repeats=True)
            sensor = sensors.get(channel.name)
            if channels is not None and channels.load is not None and sensor is channels.driver:
                spans.pop("stuck", None)  # with a varying load, the set point may be constant
            kind, limits = spike_rule(sensor, processing)
            line = None if sensor is None else sensor.calibration.calibration("")
            spans[kind] = spikes_of(
                rows, joined(spans.values()), limits, report.noise, line, steps=sensor is None or kind == "D1"
            )
        else:
            spans = {"gap": report.gaps}
        found += [Fault(kind, channel.name, "as recorded", where) for kind, where in spans.items()]
    return [fault for fault in found if len(fault.spans)]


def _processed(experiments: list[Experiment], known: set[tuple[str, str]]) -> list[dict[str, Any]]:
    """Faults that processing found in the windows, merged by kind and channel, without those known from the whole log."""
    merged: dict[tuple[str, str], dict[str, Any]] = {}
    for experiment in experiments:
        for fault in experiment.provenance["faults"]:
            key = (fault["kind"], fault["channel"])
            if key in known:
                continue
            entry = merged.setdefault(key, {**fault, "count": 0, "spans": []})
            entry["count"] += fault["count"]
            entry["spans"] = entry["spans"] + list(fault["spans"])
    return list(merged.values())
