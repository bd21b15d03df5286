"""The measurement chain of section 6.1: the plant's signals in volts, with noise and realistic faults."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np
from scipy import signal

from shipfp_rs.logs.faults import simulated
from shipfp_rs.support.arguments import between, check_fields
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.units import Calibration
from shipfp_rs.vessel.vessel import Vessel

Kind = Literal["A", "B", "C", "D1", "D2", "D3", "gap", "dropout", "stuck", "clipped", "repeated"]
"""Faults of `shipfp_rs.logs.faults.KINDS` that can be simulated."""

EQUATION_6_7 = Calibration(-251.38, -85.29, "rpm")
"""Calibration of the set point's voltage."""
TABLE_6_6 = Calibration(1059.0, 0.0, "Nm")
"""Calibration of the torque's voltage; printed as 1.059 Nm/mV."""
MAINS_HZ = 50.0
PULSE_HEIGHT_V = 5.0
PULSE_WIDTH = 0.3
"""Share of a pulse's pitch during which the reflector is detected."""

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
"""Valid ranges of a measurement chain's numbers."""
FAULTS_PER_MINUTE = (0.0, 600.0)


@dataclass(frozen=True)
class Sensors:
    """The measurement chain of section 6.1: rates, calibrations, noise and faults.

    Parameters
    ----------
    rate_hz
        Sample rate of the logger [Hz].
    set_point, torque
        Calibrations, inverted to obtain volts.
    set_point_noise_V, torque_noise_V, pulse_noise_V
        Standard deviations [V].
    telemetry_hz
        Bandwidth of the torque's telemetry noise [Hz].
    receiver_limit_V
        Voltage at which the torque receiver saturates [V].
    ripple_Nm
        Amplitudes of the torque at shaft rotation, blade passage, engine rotation and firing [Nm] (Table 6.9), each for a
        vessel whose drive train does not produce it.
    reflector_errors
        Displacement of the four reflectors as shares of their pitch; the first reflector's position is the origin.
    edge_s
        Rise and fall time of the pulses [s]; zero for edges between two samples.
    faults_per_minute
        Frequency of each fault: A and B on every pulse train, gap, dropout or stuck samples on the torque, and rows that
        are recorded again over the following ones. Hum (D2) lasts through every chirp, D3 makes every chirp a sine, and the
        torque is clipped wherever it exceeds the sensor's range.
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
    """Omit torque lines that the vessel's drive train produces itself."""
    firing, propeller = vessel.engine.firing, vessel.propeller
    unequal = firing is not None and len(set(firing.strength or ())) > 1
    made = (propeller.shaft_ripple > 0.0, propeller.blade_ripple > 0.0, unequal, firing is not None)
    shaft, blades, engine, fires = (
        0.0 if own else amplitude for own, amplitude in zip(made, sensors.ripple_Nm, strict=True)
    )
    return dataclasses.replace(sensors, ripple_Nm=(shaft, blades, engine, fires))


class Recorder:
    """Converts the plant's signals to volts, and lists the faults that it adds."""

    def __init__(self, sensors: Sensors, strikes: frozenset[Kind], duration: float, seed: int) -> None:
        self.sensors = sensors
        self.strikes = strikes
        self.duration = duration
        # Each channel and purpose has its own random stream, so that adding a fault changes no noise.
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
        # Separate random streams, so that later faults do not change earlier ones.
        for kind in simulated.LOSSES:
            chance = np.random.default_rng([simulated.LOSSES.index(kind), 1, self._seed])
            if lost := self._strike_for(kind, "U_torque", chance, longest_s=2.0):
                volts = simulated.lose(volts, kind, lost)
        if "clipped" in self.strikes:
            volts, spans = simulated.clip(volts, self.sensors.clipped_share)
            self.faults["clipped"] = {"U_torque": spans / self.sensors.rate_hz}
        return volts

    def recorded_twice(self, volts: Mapping[str, Array]) -> dict[str, Array]:
        """Repeat stretches of all channels over the following samples."""
        chance = np.random.default_rng([len(simulated.LOSSES), 1, self._seed])
        twice = dict(volts)
        for start, stop in self._strike_for("repeated", "U_setpoint", chance, longest_s=0.2, shortest_s=0.1):
            twice = simulated.write_twice(twice, start - (stop - start), stop - start, over=True)
        return twice

    def pulses(self, name: str, angle: Array, places: Array) -> Array:
        """Return a pulse train with a pulse at every whole revolution plus each of `places` [rev]."""
        noise, chance, rate = self._stream(), self._stream(), self.sensors.rate_hz
        start = noise.uniform()
        self.reflectors[name] = places
        turns = np.arange(math.floor(angle[0] + start) - 1, math.ceil(angle[-1] + start) + 1)
        rising = (turns[:, None] + places).ravel() - start
        pitch = PULSE_WIDTH / len(places)
        time = np.arange(len(angle)) / rate
        rise_s, fall_s = np.interp(rising, angle, time), np.interp(rising + pitch, angle, time)
        # Only whole pulses: interpolation would place the others at the record's ends.
        kept = (rising > angle[0]) & (rising + pitch < angle[-1])
        rise_s, fall_s = rise_s[kept], fall_s[kept]
        if lost := [int(np.searchsorted(rise_s, at / rate)) for at in self._strike("B", name, chance)]:
            self.faults["B"][name] = np.column_stack([rise_s[lost], fall_s[lost]])
            rise_s, fall_s = np.delete(rise_s, lost), np.delete(fall_s, lost)
        volts = _trapezoids(len(angle), rate, rise_s, fall_s, self.sensors.edge_s)
        volts += noise.normal(0.0, self.sensors.pulse_noise_V, len(volts))
        if struck := [int(np.searchsorted(rise_s, at / rate)) for at in self._strike("A", name, chance)]:
            # After the edge has fired, a sample falls below 2 V and the next is high again (Fig. 6.15).
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
        """Draw and record spans (first and last sample) of a fault; `shortest_s` is a tenth of `longest_s` unless given."""
        starts = np.array(self._strike(fault, channel, chance), dtype=np.int64)
        lengths = np.round(
            chance.uniform(shortest_s or 0.1 * longest_s, longest_s, len(starts)) * self.sensors.rate_hz
        ).astype(np.int64)
        spans = np.column_stack([starts, starts + lengths])
        if len(spans):
            self.faults[fault][channel] = spans / self.sensors.rate_hz
        return [(start, stop) for start, stop in spans.tolist()]

    def _strike(self, fault: Kind, channel: str, chance: np.random.Generator) -> list[float]:
        """Draw the samples at which a fault occurs, one in each of equal slots, so that no two touch."""
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
    """Pulses from 0 to 5 V whose flanks have their middle at the given times, shape (samples,)."""
    first = np.ceil((rise_s - 0.5 * edge_s) * rate_hz).astype(np.int64)
    latest = np.cumsum(np.bincount(np.maximum(first, 0), minlength=samples)[:samples]) - 1
    time = np.arange(samples) / rate_hz
    steepness = 1.0 / max(edge_s, 1e-9)
    # Before the first pulse `latest` is -1 and would index the last one.
    height = np.clip((time - rise_s[latest]) * steepness + 0.5, 0.0, 1.0)
    height -= np.clip((time - fall_s[latest]) * steepness + 0.5, 0.0, 1.0)
    height[latest < 0] = 0.0
    return PULSE_HEIGHT_V * height
