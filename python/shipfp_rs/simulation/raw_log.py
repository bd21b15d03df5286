"""Simulated raw logs: a virtual trial as recorded by sensors and a logger, with realistic faults."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
import tomlkit

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.logs.log import Log
from shipfp_rs.signals import Excitation
from shipfp_rs.simulation.sensors import Kind, Recorder, Sensors, TrueWindow, without_own_ripple
from shipfp_rs.simulation.simulate import Inflow, disturbed, simulate
from shipfp_rs.support.arguments import Whole, at_most, checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.units import Calibration
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.vessel import Vessel

EVEN_CYCLES = 4
"""Periods of a chirp with fault D3 during which the signal generator keeps its frequency constant."""


@dataclass(frozen=True)
class Truth:
    """True values behind a simulated log.

    Parameters
    ----------
    linear
        Parameters of the linear structure at the operating point.
    windows
        Time range of each excitation.
    steady_s
        Start and stop of the steady time range [s].
    faults
        Fault to channel to its time ranges, start and stop [s], shape (K, 2), in order.
    reflector_angles
        Pulse train to the angles of its reflectors [rev], ascending from 0.
    clean
        Signals of the plant, at the rate of the simulation.
    """

    linear: Mapping[str, float]
    windows: tuple[TrueWindow, ...]
    steady_s: tuple[float, float]
    faults: Mapping[Kind, Mapping[str, Array]]
    reflector_angles: Mapping[str, Array]
    clean: Experiment


@checked
def simulate_raw_log(
    vessel: Vessel,
    excitations: Excitation | Sequence[Excitation],
    *,
    sensors: Sensors | None = None,
    faults: Iterable[Kind] = ("A", "C", "D1"),
    n_e_rpm: float | None = None,
    steady_s: float = 60.0,
    pause_s: float = 20.0,
    inflow: Inflow | None = None,
    simulated_hz: float | None = None,
    seed: Whole = 0,
) -> tuple[Log, Truth]:
    """Simulate a trial as a logger would record it.

    The record has a steady time range, then the excitations with pauses at the operating point between them, in the channels
    U_setpoint, U_torque (gauge), PTM_1 and PTM_4 (one and four reflectors on the propeller shaft) and PTM_e (one pulse per
    engine revolution), all in volts. Pulses follow the shaft's continuous angle. Relay jumps are only on the recorded set
    point.

    Parameters
    ----------
    vessel
        The ship.
    excitations
        One or several; those of another rate than the logger's are resampled.
    sensors
        The measurement chain.
    faults
        Kinds of faults to simulate.
    n_e_rpm
        Operating point [rpm]; None: the ship's.
    steady_s, pause_s
        Length of the steady time range, and of each pause [s].
    inflow
        Fluctuations of the water's flow into the propeller; None: still water.
    simulated_hz
        Rate of the drive train's simulation; None: the logger's. For a tug's, 200 Hz are enough, in a fifth of the time.
    seed
        Seed of noise, faults and inflow.

    Raises
    ------
    InputError
        For an unknown fault, or arguments that `simulate` refuses.

    Examples
    --------
    >>> from shipfp_rs import signals
    >>> log, truth = simulate_raw_log(Vessel.load("stan-tug-1205"), signals.steps([60.0], 10.0))
    >>> list(log.channels)
    ['U_setpoint', 'U_torque', 'PTM_1', 'PTM_4', 'PTM_e']
    >>> truth.windows[0].start_s
    60.0
    """
    sensors = sensors or Sensors()
    strikes = frozenset(faults)
    if unknown := strikes - set(get_args(Kind)):
        raise InputError(f"faults: found {sorted(unknown)}, expected some of {', '.join(get_args(Kind))}")
    rate = simulated_hz or sensors.rate_hz
    set_point, windows = _joined(excitations, rate, steady_s, pause_s, even="D3" in strikes)
    clean = simulate(vessel, set_point, n_e_rpm=n_e_rpm)
    model = linearise(vessel, n_e_rpm)
    moving = clean if inflow is None else disturbed(clean, model, inflow, seed)
    log, recorder = _recorded(moving, vessel, windows, sensors, strikes, seed)
    truth = Truth(
        linear=dataclasses.asdict(model),
        windows=windows,
        steady_s=(0.0, steady_s),
        faults=recorder.faults,
        reflector_angles=recorder.reflectors,
        clean=clean,
    )
    return log, truth


def _recorded(
    moving: Experiment,
    vessel: Vessel,
    windows: Sequence[TrueWindow],
    sensors: Sensors,
    strikes: frozenset[Kind],
    seed: int,
) -> tuple[Log, Recorder]:
    """Return the recorded channels, and the recorder with the list of their faults."""
    sensors = without_own_ripple(sensors, vessel)
    rows = _at_rate(moving, sensors.rate_hz)
    gear = vessel.gearbox.ratio
    angle = _angle(rows["n_s"], sensors.rate_hz)
    twisted = vessel.shaft.stiffness_Nm_rad is not None
    engine_angle = _angle(rows["n_e"] / 60.0, sensors.rate_hz) if twisted else gear * angle
    recorder = Recorder(sensors, strikes, moving.duration, seed)
    chirps = [window for window in windows if window.kind == "chirp"]
    firing = vessel.engine.cylinders / (vessel.engine.strokes / 2)
    volts = {
        "U_setpoint": recorder.set_point(rows["n_set"], chirps),
        "U_torque": recorder.torque(
            rows["M_g"], angle, (1.0, float(vessel.propeller.blades), gear, firing * gear)
        ),
        "PTM_1": recorder.pulses("PTM_1", angle, np.zeros(1)),
        "PTM_4": recorder.pulses("PTM_4", angle, (np.arange(4) + np.array(sensors.reflector_errors)) / 4.0),
        "PTM_e": recorder.pulses("PTM_e", engine_angle, np.zeros(1)),
    }
    volts = recorder.recorded_twice(volts)
    log = Log.from_arrays(
        {name: samples.astype(np.float32) for name, samples in volts.items()},
        rate_hz=sensors.rate_hz,
        units=dict.fromkeys(volts, "V"),
        name="simulated log",
    )
    return log, recorder


def _at_rate(moving: Experiment, rate_hz: float) -> dict[str, Array]:
    """Recorded signals at the logger's rate."""
    rows = {name: moving.signals[name] for name in ("n_set", "n_e", "n_s", "M_g")}
    if moving.rate_hz == rate_hz:
        return rows
    count = round(len(moving) * rate_hz / moving.rate_hz)
    at = np.arange(count) * (moving.rate_hz / rate_hz)
    return {name: np.interp(at, np.arange(len(moving)), row) for name, row in rows.items()}


def trial_tables(vessel_name: str, log_name: str, sensors: Sensors, truth: Truth) -> dict[str, Any]:
    """Return the tables of TRIAL.toml for a simulated log."""

    def volts(column: str, line: Calibration) -> dict[str, Any]:
        return {"column": column, "unit": "V", "calibration": {"scale": line.scale, "offset": line.offset}}

    def train(column: str, pulses_per_rev: int, shaft: str) -> dict[str, Any]:
        return {"column": column, "pulses_per_rev": pulses_per_rev, "shaft": shaft}

    return {
        "trial": {"name": "Simulated trial", "vessel": vessel_name, "log": log_name},
        "channels": {
            "set_point": volts("U_setpoint", sensors.set_point),
            "torque": {**volts("U_torque", sensors.torque), "location": "gauge"},
            "PTM_1": train("PTM_1", 1, "propeller"),
            "PTM_4": train("PTM_4", 4, "propeller"),
            "PTM_e": train("PTM_e", 1, "engine"),
        },
        "operating_point": {"n_e_rpm": "auto", "M_Nm": "auto", "steady_s": list(truth.steady_s)},
        "processing": {"rate_hz": 50.0},
        "windows": [dataclasses.asdict(window) for window in truth.windows],
    }


def trial_toml(vessel_name: str, log_name: str, sensors: Sensors, truth: Truth) -> str:
    """Return TRIAL.toml for a simulated log."""
    return tomlkit.dumps(trial_tables(vessel_name, log_name, sensors, truth))


def _joined(
    excitations: Excitation | Sequence[Excitation],
    rate_hz: float,
    steady_s: float,
    pause_s: float,
    *,
    even: bool,
) -> tuple[Excitation, tuple[TrueWindow, ...]]:
    """Return one excitation at a rate: steady time range, then each excitation and a pause; `even`: chirps of fault D3."""
    parts = [excitations] if isinstance(excitations, Excitation) else list(excitations)
    if not parts:
        raise InputError("excitations is empty, expected at least one")
    if not steady_s + sum(part.duration for part in parts) > 10.0:
        raise InputError(
            "excitations are too short for a raw log, expected 10 s or more with the steady stretch"
        )
    pause = np.zeros(at_most("pause_s", pause_s * rate_hz))
    pieces, windows = [np.zeros(at_most("steady_s", steady_s * rate_hz))], []
    length = len(pieces[0])
    for part in parts:
        count = round(part.duration * rate_hz)
        at = np.arange(count) * (part.rate_hz / rate_hz)
        held = part.samples[np.minimum(at.astype(np.int64), len(part) - 1)]
        samples = held if part.hold == "zero" else np.interp(at, np.arange(len(part)), part.samples)
        if even and part.kind == "chirp":
            samples = np.max(np.abs(samples)) * np.sin(2.0 * np.pi * EVEN_CYCLES / count * np.arange(count))
        windows.append(TrueWindow(part.name, part.kind, length / rate_hz, (length + count) / rate_hz))
        pieces += [samples, pause]
        length += len(samples) + len(pieces[-1])
    return Excitation("simulated log", "joined", rate_hz, np.concatenate(pieces)), tuple(windows)


def _angle(speed: Array, rate_hz: float) -> Array:
    """Angle [rev], shape (N,): the integral of a speed [rev/s] with end correction, of fourth order."""
    step = 1.0 / rate_hz
    slope = np.gradient(speed, step)
    turned = 0.5 * step * (speed[1:] + speed[:-1]) + step**2 / 12.0 * (slope[:-1] - slope[1:])
    return np.concatenate([[0.0], np.cumsum(turned)])
