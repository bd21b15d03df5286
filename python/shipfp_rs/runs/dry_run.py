"""A dry run of a trial: what was read, what would be fitted, what is missing; nothing is fitted and nothing written."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.runs.fit import located, structure_from
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.vessel import Vessel

Notify = Callable[[str], None]

LITTLE = 0.9
"""A warning is given where less than this share of a signal's samples is usable."""


@dataclasses.dataclass(frozen=True)
class Check:
    """What a run would begin with.

    Parameters
    ----------
    trial, vessel
        Their names.
    channels
        What was read: log, column, what it is, unit, rate, samples.
    windows
        What is left of each after cleaning: share of usable samples of every signal, faults by kind.
    operating_point
        Signal to value.
    parameters
        What would be fitted: name, unit, status (free, fixed, prior, tied), bounds, value.
    missing
        What is not there and costs something, a line each.
    """

    trial: str
    vessel: str
    channels: tuple[dict[str, Any], ...]
    windows: tuple[dict[str, Any], ...]
    operating_point: dict[str, float]
    structure: str
    outputs: tuple[str, ...]
    parameters: tuple[dict[str, Any], ...]
    missing: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return dataclasses.asdict(self)


def check(path: str | Path, *, notify: Notify = lambda _: None) -> Check:
    """Read, clean and resample a trial's windows as a run would, and stop before the fit.

    Parameters
    ----------
    path
        TRIAL.toml.
    notify
        Called with what is being done.

    Raises
    ------
    InputError
        Where a run would be refused.
    """
    notify("reading the trial")
    trial = Trial.load(path)
    vessel = Vessel.load(trial.trial.vessel)
    structure = structure_from(trial.identify, located(trial))
    notify("opening the log")
    logs = trial.logs()
    channels = [entry for log in logs for entry in _channels(trial, log)]
    notify("reading and cleaning the log")
    experiments = [experiment for log in logs for experiment in process(log, trial, vessel)]
    return Check(
        trial.trial.name,
        vessel.name,
        tuple(channels),
        tuple(_window(experiment) for experiment in experiments),
        {name: float(value) for name, value in experiments[0].operating_point.items()},
        structure.name,
        tuple(structure.outputs),
        tuple(_parameter(structure, index) for index in range(len(structure.parameters))),
        tuple(_missing(trial, structure, experiments)),
    )


def _channels(trial: Trial, log: Log) -> list[dict[str, Any]]:
    channels = trial.channels
    sensors: list[tuple[str, str]] = [("set point", channels.set_point.column)]
    if channels.torque is not None:
        sensors.append((f"torque ({channels.torque.location})", channels.torque.column))
    if (actuator := channels.rack or channels.actuator) is not None:
        sensors.append(("fuel rack", actuator.column))
    if channels.load is not None:
        sensors.append((f"load ({channels.load.quantity})", channels.load.column))
    for tacho in channels.tachos.values():
        pulses = f"pulse train, {tacho.pulses_per_rev} a turn" if tacho.kind == "pulses" else tacho.kind
        if tacho.kind != "edges":
            sensors.append((f"{pulses} of the {tacho.shaft}", tacho.column))
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


def _parameter(structure: Structure, index: int) -> dict[str, Any]:
    parameter = structure.parameters[index]
    status = (
        "fixed" if parameter.fixed else "tied" if parameter.tied is not None
        else "prior" if parameter.prior is not None else "free"
    )  # fmt: skip
    bounds = [bound if np.isfinite(bound) else None for bound in (parameter.lower, parameter.upper)]
    return {
        "name": parameter.name,
        "unit": parameter.unit,
        "status": status,
        "bounds": bounds,
        "value": parameter.start if parameter.fixed else parameter.prior[0] if parameter.prior else None,
    }


def _missing(trial: Trial, structure: Structure, experiments: Sequence[Experiment]) -> list[str]:
    lines, channels = [], trial.channels
    if channels.torque is None:
        lines.append(
            "no torque channel: the speed alone is fitted, and tau_n, g and the gains are known as ratios only"
        )
    if len(channels.tachos) == 1:
        lines.append("one source of speed only: nothing to check the speed against")
    if channels.rack is None and channels.actuator is None:
        lines.append("no fuel rack: v and the governor's gains are known as products only")
    known = {*trial.identify.fixed, *trial.identify.priors}
    if channels.torque is not None and channels.torque.location == "gauge" and "tau_n" not in known:
        lines.append(
            "a gauge between the inertias and no tau_n known beforehand: the whole of tau_n stays unknown"
        )
    for experiment in experiments:
        for name, values in experiment.signals.items():
            usable = float(np.isfinite(values).mean())
            if usable < LITTLE:
                lines.append(f"{experiment.name}: {usable:.0%} of {name} is usable")
    spread = [
        float(np.nanstd(one.signals["n_set"]) / abs(np.nanmean(one.signals["n_set"]))) for one in experiments
    ]
    if max(spread) < 1e-4:
        lines.append("the set point moves in no window: there is nothing to identify")
    return lines
