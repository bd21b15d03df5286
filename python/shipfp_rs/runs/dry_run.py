"""Dry run of a trial: input, planned fit and expected accuracy; nothing is written."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.experiments.experiment import DRIVES, Experiment
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import foresee
from shipfp_rs.identification.question import TRIED
from shipfp_rs.identification.ship_estimates import FULL_SHIP
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.cleaning import require_columns
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.processing.trial_channels import Load, Rack, Tacho, Torque
from shipfp_rs.runs.run import choice, drawn, located, split, structure_from, with_drawn
from shipfp_rs.support.arrays import attributes
from shipfp_rs.support.progress import part, tell
from shipfp_rs.vessel.vessel import Vessel

Notify = Callable[[str], None]

TOLD = ("parameters", "derived", "identifiability")
"""Tables of the expected fingerprint in the JSON form."""
USES = ("fit", "validation")
LITTLE = 0.9
"""Fraction of usable samples of a signal below which a warning is given."""


@dataclasses.dataclass(frozen=True)
class Check:
    """Result of a dry run; `operating_point` has the value of each signal."""

    trial: str
    vessel: str
    channels: tuple[dict[str, Any], ...]
    """Channels read: log, column, meaning, unit, rate, samples."""
    windows: tuple[dict[str, Any], ...]
    """For each window after cleaning: `use` (fit or validation), fraction of usable samples of each signal, faults by
    kind.
    """
    operating_point: dict[str, float]
    structure: str
    outputs: tuple[str, ...]
    tried: tuple[str, ...]
    """Additional elements that the fit tries."""
    expected: Fingerprint
    """Expected accuracy of the fit, at a first estimate and without the elements in `tried`."""
    missing: tuple[str, ...]
    """Missing information and its consequence, one line each."""

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        told = {key: table for key, table in self.expected.to_dict().items() if key in TOLD}
        return (
            attributes(self, *(one.name for one in dataclasses.fields(self) if one.name != "expected")) | told
        )


def check(path: str | Path, *, notify: Notify = lambda _: None) -> Check:
    """Read, clean and resample a trial's windows as in a run, make a first estimate, and stop before the fit."""
    notify("reading the trial")
    trial = Trial.load(path)
    vessel = Vessel.load(trial.trial.vessel)
    declared = None if trial.identify.chooses else structure_from(trial.identify, located(trial))
    notify("opening the log")
    tell("opening the log", 0.1)
    logs = trial.logs()
    channels = [entry for log in logs for entry in _channels(trial, log)]
    notify("reading and cleaning the log")
    with part(0.2, 0.6):
        experiments = [experiment for log in logs for experiment in process(log, trial, vessel)]
    windows = [
        _window(experiment) | {"use": use}
        for use, group in zip(USES, split(trial, experiments), strict=True)
        for experiment in group
    ]
    experiments, _ = split(trial, experiments)
    notify("taking a first look")
    tell("taking a first look", 0.6)
    expected = (
        foresee(experiments, **choice(trial, experiments, vessel))
        if declared is None
        else foresee(experiments, with_drawn(declared, drawn(trial, experiments, vessel)))
    )
    return Check(
        trial.trial.name,
        vessel.name,
        tuple(channels),
        tuple(windows),
        {name: float(value) for name, value in experiments[0].operating_point.items()},
        _named(trial, expected) if declared is None else declared.name,
        tuple(expected.structure["outputs"]),
        tuple(name for name in TRIED if name not in trial.identify.elements)
        if declared is None and trial.channels.command is None
        else (),
        expected,
        tuple(_missing(trial, experiments)),
    )


def _named(trial: Trial, expected: Fingerprint) -> str:
    """Name of the structure from which a run selects by the data: the full ship, or an open-loop drive."""
    return FULL_SHIP if trial.channels.command is None else f"a drive in {expected.structure['name']}"


def _channels(trial: Trial, log: Log) -> list[dict[str, Any]]:
    channels = trial.channels
    require_columns(log, channels)
    sensors = [(DRIVES[channels.driver_signal], channels.driver.column)]
    sensors += [(_read_as(sensor), sensor.column) for sensor in channels.levels.values()]
    sensors += [(_source(tacho), tacho.column) for tacho in channels.tachos.values() if tacho.kind != "edges"]
    told = []
    for what, column in sensors:
        channel = log.channel(column)
        told.append(
            {
                "log": Path(log.name).name,
                "column": column,
                "what": what,
                "unit": channel.unit,
                "rate_hz": channel.rate_hz,
                "samples": channel.samples,
            }
        )
    return told


def _read_as(sensor: Torque | Rack | Load) -> str:
    if isinstance(sensor, Torque):
        return f"torque ({sensor.location})"
    return f"load ({sensor.quantity})" if isinstance(sensor, Load) else "fuel rack"


def _source(tacho: Tacho) -> str:
    if tacho.kind == "pulses":
        return f"pulse train, {tacho.pulses_per_rev} a turn of the {tacho.shaft}"
    return f"{tacho.kind} of the {tacho.shaft}"


def _window(experiment: Experiment) -> dict[str, Any]:
    faults: dict[str, int] = {}
    for fault in experiment.provenance["faults"]:
        faults[fault["kind"]] = faults.get(fault["kind"], 0) + int(fault["count"])
    start_s, stop_s = experiment.provenance["window_s"]
    speed = experiment.provenance["speed"]
    return {
        "name": experiment.name,
        "kind": experiment.kind,
        "start_s": start_s,
        "stop_s": stop_s,
        "rate_hz": experiment.rate_hz,
        "usable": {name: float(np.isfinite(values).mean()) for name, values in experiment.signals.items()},
        "speed_from": speed["train"],
        "speed_bandwidth_hz": speed["bandwidth_hz"],
        "faults": faults,
    }


def _missing(trial: Trial, experiments: Sequence[Experiment]) -> list[str]:
    lines, channels = [], trial.channels
    if channels.torque is None:
        lines.append("no torque channel: the speed alone is fitted")
    if len(channels.tachos) == 1:
        lines.append("one source of speed only: nothing to check it against")
    if channels.rack is None and channels.actuator is None and channels.command is None:
        lines.append("no fuel rack: v and the governor's gains are known as products only")
    for experiment in experiments:
        for name, values in experiment.signals.items():
            usable = float(np.isfinite(values).mean())
            if usable < LITTLE:
                lines.append(f"{experiment.name}: {usable:.0%} of {name} is usable")
    return lines
