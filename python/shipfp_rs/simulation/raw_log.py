"""Simulated raw logs: a simulated trial as sensors and a logger record it (section 6.1), with realistic faults."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
import tomlkit
from scipy import signal

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.logs.faults import simulated
from shipfp_rs.logs.log import Log
from shipfp_rs.signals import Excitation
from shipfp_rs.simulation.simulate import Inflow, disturbed, simulate
from shipfp_rs.support.arguments import Whole, at_most, between, check_fields, checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.units import Calibration
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.vessel import Vessel

Kind = Literal["A", "B", "C", "D1", "D2", "D3", "gap", "dropout", "stuck", "clipped", "repeated"]
"""Faults of `shipfp_rs.logs.faults.KINDS` that can be simulated."""

EQUATION_6_7 = Calibration(-251.38, -85.29, "rpm")
"""Calibration of the set point's voltage [rpm/V]."""
TABLE_6_6 = Calibration(1059.0, 0.0, "Nm")
"""Calibration of the torque's voltage [Nm/V]; the thesis prints 1.059 Nm/mV."""
MAINS_HZ = 50.0
PULSE_HEIGHT_V = 5.0
PULSE_WIDTH = 0.3
"""Width of a pulse relative to the pitch of the reflectors."""

VOLTS = (0.0, 1000.0)
RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "rate_hz": (0.01, 1e6),
        "set_point_noise_V": VOLTS,
        "torque_noise_V": VOLTS,
        "pulse_noise_V": VOLTS,
        "telemetry_hz": (1e-3, 1e9),
        "receiver_limit_V": (1e-3, 1000.0),
        "ripple_Nm": (0.0, 1e9),
        "reflector_errors": (-0.5, 0.5),
        "edge_s": (0.0, 1.0),
        "hum_V": VOLTS,
        "clipped_share": (0.0, 0.5),
    }
)
"""Valid range of each numeric field of `Sensors`."""
FAULTS_PER_MINUTE = (0.0, 600.0)


@dataclass(frozen=True)
class Sensors:
    """The measurement chain of section 6.1: rates, calibrations, noise and faults.

    Parameters
    ----------
    rate_hz
        Sample rate of the logger [Hz].
    set_point, torque
        Calibrations, whose inverses give the recorded volts.
    set_point_noise_V, torque_noise_V, pulse_noise_V
        Standard deviations [V].
    telemetry_hz
        Bandwidth of the torque's telemetry noise [Hz].
    receiver_limit_V
        Voltage at which the torque receiver saturates [V].
    ripple_Nm
        Amplitudes of the torque ripple at the frequencies of shaft rotation, blade passage, engine rotation and firing
        [Nm] (Table 6.9). A component that the vessel's own model already has is not added.
    reflector_errors
        Displacements of the four reflectors from even spacing, relative to their pitch; the first one is the origin.
    edge_s
        Rise and fall time of the pulses [s]; with zero, a pulse rises and falls within one sample interval.
    faults_per_minute
        Number of faults per minute, by kind: A and B on every pulse train; gaps, dropouts and stuck samples on the
        torque; repeated rows, which overwrite the following rows. Three kinds have no rate: hum (D2) is in every chirp,
        D3 replaces every chirp by a sine, and the torque is clipped wherever it exceeds the sensor's range.
    hum_V
        Amplitude of the mains hum on the set point [V].
    clipped_share
        Share of the torque's samples beyond the sensor's range, for the fault "clipped".
    """

    rate_hz: float = 2000.0
    set_point: Calibration = EQUATION_6_7
    torque: Calibration = TABLE_6_6
    set_point_noise_V: float = 0.004
    torque_noise_V: float = 0.02
    pulse_noise_V: float = 0.03
    telemetry_hz: float = 250.0
    receiver_limit_V: float = 5.0
    ripple_Nm: tuple[float, float, float, float] = (12.0, 25.0, 10.0, 40.0)
    reflector_errors: tuple[float, float, float, float] = (0.0, 0.012, -0.008, 0.006)
    edge_s: float = 1.5e-3
    faults_per_minute: Mapping[Kind, float] = field(
        default_factory=lambda: {
            "A": 6.0,
            "B": 2.0,
            "C": 3.0,
            "D1": 2.0,
            "gap": 1.0,
            "dropout": 1.0,
            "stuck": 1.0,
            "repeated": 1.0,
        }
    )
    hum_V: float = 0.05
    clipped_share: float = 0.002

    def __post_init__(self) -> None:
        check_fields(self, "sensors")
        for name, (low, high) in RANGES.items():
            given = getattr(self, name)
            for value in given if isinstance(given, tuple | list) else (given,):
                between(f"sensors: {name}", value, low, high)
        for fault, often in self.faults_per_minute.items():
            between(f"sensors: faults_per_minute[{fault!r}]", often, *FAULTS_PER_MINUTE)


@dataclass(frozen=True)
class TrueWindow:
    """Time range of an excitation on the log's clock [s]."""

    name: str
    kind: str
    start_s: float
    stop_s: float


def without_own_ripple(sensors: Sensors, vessel: Vessel) -> Sensors:
    """Set the amplitudes of ripple components that the vessel's own model already has to zero."""
    firing, propeller = vessel.engine.firing, vessel.propeller
    unequal = firing is not None and len(set(firing.strength or ())) > 1
    made = (propeller.shaft_ripple > 0.0, propeller.blade_ripple > 0.0, unequal, firing is not None)
    shaft, blades, engine, fires = (
        0.0 if own else amplitude for own, amplitude in zip(made, sensors.ripple_Nm, strict=True)
    )
    return dataclasses.replace(sensors, ripple_Nm=(shaft, blades, engine, fires))


class Recorder:
    """Converter of the plant's signals to volts, which adds faults and records their time ranges."""

    def __init__(self, sensors: Sensors, strikes: frozenset[Kind], duration: float, seed: int) -> None:
        self.sensors = sensors
        self.strikes = strikes
        self.duration = duration
        # Each channel and purpose has its own random stream: the noise does not depend on the faults.
        self._seed = seed
        self._streams = 0
        self.faults: dict[Kind, dict[str, Array]] = {}
        self.reflectors: dict[str, Array] = {}

    def set_point(self, n_set: Array, chirps: Sequence[TrueWindow]) -> Array:
        """Return the set point [V] of `n_set` [rpm], with relay jumps and hum."""
        noise, chance = self._stream(), self._stream()
        volts = self.sensors.set_point.inverse(n_set)
        volts += noise.normal(0.0, self.sensors.set_point_noise_V, len(volts))
        for start, stop in self._strike_for("D1", "U_setpoint", chance):
            height = chance.choice([-1.0, 1.0]) * chance.uniform(1.0, 3.0)
            middle = (start + stop) // 2
            volts[start:middle] += height
            volts[middle:stop] += height * chance.choice([-1.0, 1.0])
        rate = self.sensors.rate_hz
        for fault in self.strikes & {"D2", "D3"}:
            self.faults[fault] = {
                "U_setpoint": np.array([(chirp.start_s, chirp.stop_s) for chirp in chirps]).reshape(-1, 2)
            }
        if "D2" in self.strikes:
            for chirp in chirps:
                span = round(chirp.start_s * rate), round(chirp.stop_s * rate)
                volts = simulated.hum(volts, rate, MAINS_HZ, self.sensors.hum_V, *span)
        return volts

    def torque(self, M_g: Array, angle: Array, orders: Sequence[float]) -> Array:
        """Return the gauge's torque [V] of `M_g` [Nm], with ripple at `orders` of the shaft's angle [rev]."""
        noise, chance = self._stream(), self._stream()
        total = M_g.copy()
        for amplitude, order in zip(self.sensors.ripple_Nm, orders, strict=True):
            total += amplitude * np.sin(2.0 * np.pi * (order * angle + noise.uniform()))
        volts = self.sensors.torque.inverse(total)
        volts += self._telemetry_noise(noise, len(volts))
        for start, stop in self._strike_for("C", "U_torque", chance):
            volts[start:stop] = self.sensors.receiver_limit_V
        limit = self.sensors.receiver_limit_V
        np.clip(volts, -limit, limit, out=volts)
        # Each kind has its own random stream: its faults do not depend on the other kinds.
        for kind in simulated.LOSSES:
            chance = np.random.default_rng([simulated.LOSSES.index(kind), 1, self._seed])
            if lost := self._strike_for(kind, "U_torque", chance, longest_s=2.0):
                volts = simulated.lose(volts, kind, lost)
        if "clipped" in self.strikes:
            volts, spans = simulated.clip(volts, self.sensors.clipped_share)
            self.faults["clipped"] = {"U_torque": spans / self.sensors.rate_hz}
        return volts

    def recorded_twice(self, volts: Mapping[str, Array]) -> dict[str, Array]:
        """Overwrite samples of all channels by copies of the preceding samples."""
        chance = np.random.default_rng([len(simulated.LOSSES), 1, self._seed])
        twice = dict(volts)
        for start, stop in self._strike_for("repeated", "U_setpoint", chance, longest_s=0.2, shortest_s=0.1):
            twice = simulated.write_twice(twice, start - (stop - start), stop - start, over=True)
        return twice

    def pulses(self, name: str, angle: Array, places: Array) -> Array:
        """Return a pulse train [V] with pulses at the angles k + `places` [rev] for every revolution k."""
        noise, chance, rate = self._stream(), self._stream(), self.sensors.rate_hz
        start = noise.uniform()
        self.reflectors[name] = places
        turns = np.arange(math.floor(angle[0] + start) - 1, math.ceil(angle[-1] + start) + 1)
        rising = (turns[:, None] + places).ravel() - start
        pitch = PULSE_WIDTH / len(places)
        time = np.arange(len(angle)) / rate
        rise_s, fall_s = np.interp(rising, angle, time), np.interp(rising + pitch, angle, time)
        # Keep only complete pulses: interpolation would place incomplete ones at the record's ends.
        kept = (rising > angle[0]) & (rising + pitch < angle[-1])
        rise_s, fall_s = rise_s[kept], fall_s[kept]
        if lost := [int(np.searchsorted(rise_s, at / rate)) for at in self._strike("B", name, chance)]:
            self.faults["B"][name] = np.column_stack([rise_s[lost], fall_s[lost]])
            rise_s, fall_s = np.delete(rise_s, lost), np.delete(fall_s, lost)
        volts = _trapezoids(len(angle), rate, rise_s, fall_s, self.sensors.edge_s)
        volts += noise.normal(0.0, self.sensors.pulse_noise_V, len(volts))
        if struck := [int(np.searchsorted(rise_s, at / rate)) for at in self._strike("A", name, chance)]:
            # After a rising edge, one sample falls below 2 V and the next sample is high again (Fig. 6.15).
            dips = np.ceil((rise_s[struck] + 0.5 * self.sensors.edge_s) * rate).astype(np.int64) + 1
            volts[dips] = chance.uniform(0.3, 1.8, len(dips))
            self.faults["A"][name] = np.column_stack([dips, dips + 1]) / rate
        return volts

    def _telemetry_noise(self, stream: np.random.Generator, samples: int) -> Array:
        noise = stream.standard_normal(samples)
        nyquist = 0.5 * self.sensors.rate_hz
        if self.sensors.telemetry_hz < nyquist:
            filter_ = signal.butter(2, self.sensors.telemetry_hz / nyquist, output="sos")
            noise = signal.sosfilt(filter_, noise)
            noise /= np.std(noise)
        return np.asarray(self.sensors.torque_noise_V * noise)

    def _strike_for(
        self,
        fault: Kind,
        channel: str,
        chance: np.random.Generator,
        longest_s: float = 0.04,
        shortest_s: float | None = None,
    ) -> list[tuple[int, int]]:
        """Draw and record a fault's spans (first and last sample); `shortest_s` is a tenth of `longest_s` unless given."""
        starts = np.array(self._strike(fault, channel, chance), dtype=np.int64)
        lengths = np.round(
            chance.uniform(shortest_s or 0.1 * longest_s, longest_s, len(starts)) * self.sensors.rate_hz
        ).astype(np.int64)
        spans = np.column_stack([starts, starts + lengths])
        if len(spans):
            self.faults[fault][channel] = spans / self.sensors.rate_hz
        return [(start, stop) for start, stop in spans.tolist()]

    def _strike(self, fault: Kind, channel: str, chance: np.random.Generator) -> list[float]:
        """Draw the samples at which a fault occurs: one in each of equal time slots, which keeps the faults apart."""
        if fault not in self.strikes:
            return []
        slots = max(int(self.sensors.faults_per_minute[fault] * self.duration / 60.0), 1)
        starts = (np.arange(slots) + chance.uniform(0.2, 0.7, slots)) * (self.duration / slots)
        self.faults.setdefault(fault, {})[channel] = np.column_stack([starts, starts])
        return [float(sample) for sample in np.round(starts * self.sensors.rate_hz)]

    def _stream(self) -> np.random.Generator:
        self._streams += 1
        return np.random.default_rng([self._streams, self._seed])


def _trapezoids(samples: int, rate_hz: float, rise_s: Array, fall_s: Array, edge_s: float) -> Array:
    """Pulses from 0 to 5 V, whose edges pass half their height at the given times, shape (samples,)."""
    first = np.ceil((rise_s - 0.5 * edge_s) * rate_hz).astype(np.int64)
    latest = np.cumsum(np.bincount(np.maximum(first, 0), minlength=samples)[:samples]) - 1
    time = np.arange(samples) / rate_hz
    steepness = 1.0 / max(edge_s, 1e-9)
    # Before the first pulse, `latest` is -1, which indexes the last pulse; these samples are set to 0 below.
    height = np.clip((time - rise_s[latest]) * steepness + 0.5, 0.0, 1.0)
    height -= np.clip((time - fall_s[latest]) * steepness + 0.5, 0.0, 1.0)
    height[latest < 0] = 0.0
    return PULSE_HEIGHT_V * height


EVEN_CYCLES = 4
"""Number of periods of the sine that replaces a chirp with fault D3."""


@dataclass(frozen=True)
class Truth:
    """True values of a simulated log.

    Parameters
    ----------
    linear
        Parameters of the linear structure at the operating point.
    windows
        Time range of each excitation.
    steady_s
        Start and stop of the steady time range [s].
    faults
        For each kind of fault and each channel: starts and stops of the faults [s], shape (K, 2), ascending.
    reflector_angles
        Angles of the reflectors [rev], ascending from 0, by pulse train.
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
    engine revolution), all in volts. The pulses' times follow from the shaft's continuous angle. Relay jumps (D1) are
    in the recorded set point only; the ship does not follow them.

    Parameters
    ----------
    vessel
        The ship.
    excitations
        One excitation or several, which are resampled to the simulation's rate.
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
        Rate of the drive train's simulation; None: the logger's. For a tug, 200 Hz suffice and take a fifth of the
        time.
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
    """Return the recorded channels, and the recorder with the faults it added."""
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
    """The plant's signals at the logger's rate."""
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
    """Join excitations at a rate: a steady time range, then each excitation and a pause; `even` gives chirps fault D3."""
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
    """Angle [rev], shape (N,): integral of a speed [rev/s] by the trapezoidal rule with end correction, of fourth order."""
    step = 1.0 / rate_hz
    slope = np.gradient(speed, step)
    turned = 0.5 * step * (speed[1:] + speed[:-1]) + step**2 / 12.0 * (slope[:-1] - slope[1:])
    return np.concatenate([[0.0], np.cumsum(turned)])
