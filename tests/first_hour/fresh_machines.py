"""Machines for `fresh_systems`: what moves them, their loop, and files as their loggers write them.

With N and the torques over the operating point: tau_n dN/dt = M_b - load N^p - waves, M_b = 1 + g (N - 1) + fuel, and
tau_act d(fuel)/dt = order(t - T_d) - fuel. The order is that of a PI governor, at all times or each T_s.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv
from scipy.signal import lfilter

from tests.families import small_steps
from tests.families.plant import physical

Answers = Mapping[str, str]
"""What `init` asks for, or offers, and what a person writes in its place."""
STEP_S = 1e-3
WAYS = ("steps", "chirp", "multisine")
REST_S = 25.0
"""Before and after what moves."""


class Ranges(NamedTuple):
    """Of one kind of machine; the crossover is vK_p over the inertia [1/s], the reset vK_i over vK_p, over that."""

    tau_n: tuple[float, float]
    g: tuple[float, float]
    p: tuple[float, float]
    crossover: tuple[float, float]
    reset: tuple[float, float]
    T_d: tuple[float, float]
    tau_act: tuple[float, float]
    T_s: tuple[float, float]
    T_set: tuple[float, float]


RANGES = {
    "genset": Ranges((1.0, 4.0), (-0.6, -0.1), (-1.0, 1.0), (1.5, 5.0), (0.1, 0.4), (0.015, 0.06), (0.03, 0.12),
                     (0.01, 0.04), (0.0, 0.0)),
    "pod": Ranges((1.0, 4.0), (-0.1, 0.0), (1.8, 2.2), (1.0, 3.5), (0.1, 0.4), (0.02, 0.1), (0.01, 0.06),
                  (0.02, 0.1), (0.0, 0.1)),
    "boat": Ranges((0.5, 2.0), (-0.8, -0.1), (1.8, 2.2), (2.0, 7.0), (0.1, 0.4), (0.02, 0.08), (0.02, 0.08),
                   (0.01, 0.05), (0.0, 0.05)),
}  # fmt: skip


@dataclass(frozen=True)
class System:
    """A machine at its operating point.

    `true` are parameters by a fingerprint's names; update is 1 where the governor sums before it uses the sum. `rpm` is the
    engine's or motor's, `torque_Nm` the shaft's, `ratio` the gear's, `length_s` that of what moves.
    """

    kind: str
    seed: int
    true: Mapping[str, float]
    rpm: float
    torque_Nm: float
    ratio: float
    length_s: float

    @property
    def turning(self) -> float:
        """Rise of the shaft's angle at the operating point [rad/s]."""
        return 2.0 * np.pi * self.rpm / self.ratio / 60.0

    def random(self, place: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, place])


def drawn(kind: str, seed: int, length_s: float = 200.0) -> System:
    """Draw a system whose loop is as well tuned as loops at sea are."""
    random, ranges = np.random.default_rng([seed, 0]), RANGES[kind]
    while True:
        true = {name: random.uniform(*getattr(ranges, name)) for name in ("g", "p", "T_d", "T_set")}
        true["tau_n"] = float(np.exp(random.uniform(*np.log(ranges.tau_n))))
        true["tau_act"] = random.uniform(*ranges.tau_act) * (random.random() < 0.7)
        true["T_s"] = round(random.uniform(*ranges.T_s), 3) * (random.random() < 1 / 3)
        true["update"] = float(random.random() < 0.5)
        crossover = random.uniform(*ranges.crossover)
        true["vK_p"] = crossover * true["tau_n"]
        true["vK_i"] = true["vK_p"] * crossover * random.uniform(*ranges.reset)
        true["tau_prop"] = true["tau_n"] * random.uniform(0.2, 0.6)
        true |= {name: round(true[name], 3) for name in ("T_d", "T_set")}
        phase, gain = margins(loop_of(kind, true))
        if 35.0 <= phase <= 80.0 and gain >= 2.2:
            break
    rpm, torque_Nm, ratio = sizes(kind, random)
    return System(kind, seed, true, rpm, torque_Nm, ratio, length_s)


def sizes(kind: str, random: np.random.Generator) -> tuple[float, float, float]:
    """Draw speed [rpm], torque at the shaft [Nm] and gear ratio."""
    if kind == "genset":
        return float(random.choice([1000.0, 1200.0, 1500.0, 1800.0])), random.uniform(600.0, 8000.0), 1.0
    if kind == "pod":
        return float(random.integers(9, 19) * 10), random.uniform(3e4, 3e5), 1.0
    ratio = float(random.choice([1.0, 1.52, 2.0, 2.63]))
    return ratio * random.uniform(600.0, 1200.0), random.uniform(80.0, 900.0), ratio


def loop_of(kind: str, true: Mapping[str, float]) -> Callable[[np.ndarray], np.ndarray]:
    """Return the open loop over frequency [rad/s], with what a governor that samples does exactly.

    A generating set's load is an input, so its loop is that at a load that does not care for the speed.
    """
    p = 0.0 if kind == "genset" else true["p"]

    def loop(omega: np.ndarray) -> np.ndarray:
        s, period = 1j * omega, true["T_s"]
        governor = true["vK_p"] + true["vK_i"] / s
        if period:
            z = np.exp(s * period)
            summed = true["vK_i"] * period * (z if true["update"] else 1.0) / (z - 1.0)
            governor = (true["vK_p"] + summed) * (1.0 - 1.0 / z) / (s * period)
        late = np.exp(-s * true["T_d"]) / (1.0 + s * true["tau_act"])
        return governor * late / (true["tau_n"] * s + p - true["g"])

    return loop


def margins(loop: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
    """Return phase margin [deg] and gain margin."""
    omega = np.geomspace(1e-2, 300.0, 40000)
    answer = loop(omega)
    size, phase = np.abs(answer), np.degrees(np.unwrap(np.angle(answer)))
    crossed = np.flatnonzero((size[:-1] >= 1.0) & (size[1:] < 1.0))
    turned = np.flatnonzero((phase[:-1] >= -180.0) & (phase[1:] < -180.0))
    if not len(crossed) or not len(turned):
        return float("nan"), float("nan")
    return 180.0 + float(phase[crossed[0]]), 1.0 / float(size[turned[0]])


class Motion(NamedTuple):
    """Over the operating point, at each step; power is that of the load."""

    asked: np.ndarray
    speed: np.ndarray
    brake: np.ndarray
    gauge: np.ndarray
    load: np.ndarray


def stairs(random: np.random.Generator, length_s: float, levels: tuple[float, float], pause_s: float):
    """Return levels over time, each held for about a pause, and reached in 50 ms; they begin and end at the first."""
    starts = REST_S + np.cumsum(random.uniform(0.6, 1.4, int(length_s / pause_s)) * pause_s)
    starts = starts[starts < REST_S + length_s]
    heights = random.uniform(*levels, len(starts))
    heights[-1] = 0.0
    at = np.column_stack([starts, starts + 0.05]).ravel()
    grid = np.arange(round((length_s + 2.0 * REST_S) / STEP_S)) * STEP_S
    return np.interp(grid, at, np.repeat(np.append(0.0, heights), 2)[1:-1])


def way_of(system: System) -> str:
    """Return what moves the machine."""
    random = system.random(1)
    return "load steps" if system.kind == "genset" else [random.random(), str(random.choice(WAYS))][1]


def asked_of(system: System) -> np.ndarray:
    """Return the set point less 1: steps, a chirp or a multisine; at rest in a generating set."""
    random, length_s = system.random(1), system.length_s
    grid = np.arange(round((length_s + 2.0 * REST_S) / STEP_S)) * STEP_S
    if system.kind == "genset":
        return np.zeros(len(grid))
    highest = system.true["vK_p"] / system.true["tau_n"] / (2.0 * np.pi) * 2.5
    size, way = random.uniform(0.02, 0.04), random.choice(WAYS)
    if way == "steps":
        return stairs(random, length_s, (-1.5 * size, 1.5 * size), 8.0)
    late = np.clip(grid - REST_S, 0.0, length_s)
    if way == "chirp":
        growth = np.log(highest / 0.03) / length_s
        moved = np.sin(2.0 * np.pi * 0.03 * np.expm1(growth * late) / growth)
    else:
        period = length_s / 4.0
        lines = np.unique(np.round(np.geomspace(0.04, highest, 12) * period)) / period
        phases = random.uniform(0.0, 2.0 * np.pi, len(lines))
        moved = sum(np.sin(2.0 * np.pi * f * late + a) for f, a in zip(lines, phases, strict=True))
        moved = moved / np.abs(moved).max() * 1.5
    return size * moved * np.interp(late, [0.0, 1.0, length_s - 1.0, length_s], [0.0, 1.0, 1.0, 0.0])


def loads_of(system: System) -> tuple[np.ndarray, np.ndarray]:
    """Return the load's steps over the operating torque, and what nobody measures: waves, or an uneven burning."""
    random = system.random(2)
    count = round((system.length_s + 2.0 * REST_S) / STEP_S)
    steps = np.zeros(count)
    if system.kind == "genset":
        steps = stairs(random, system.length_s, (-0.6, 0.2), 11.0)
    keep = np.exp(-2.0 * np.pi * random.uniform(0.3, 1.5) * STEP_S)
    rough = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], random.standard_normal(count))
    return steps, random.uniform(0.001, 0.004) * rough


def moved(system: System, hold_s: float = 0.0) -> Motion:
    """Run the machine; the set point is held for `hold_s`."""
    asked = 1.0 + asked_of(system)
    if hold_s:
        asked = asked[np.arange(len(asked)) // round(hold_s / STEP_S) * round(hold_s / STEP_S)]
    steps, rough = loads_of(system)
    grid = np.arange(len(asked)) * STEP_S
    heard, water, push = (partial(np.interp, xp=grid, fp=row) for row in (asked, steps, rough))
    plant = physical(dict(system.true), engine_speed=1.0, shaft_torque=1.0)
    ran = small_steps.simulate(plant, heard, len(asked) * STEP_S, step_s=STEP_S, water=water, load=push)
    load = (1.0 + steps) * ran.engine_speed ** system.true["p"]
    return Motion(asked, ran.engine_speed, ran.brake_torque, ran.gauge_torque, load)


def genset(system: System, folder: Path) -> tuple[Path, Answers]:
    """Write a power analyser's text: means over a cycle of the mains, 50 a second, in German or English."""
    random, motion = system.random(3), moved(system)
    pairs = 3 if system.rpm < 1300.0 else 2
    cycle = round(1.0 / (system.rpm / 60.0 * pairs) / STEP_S)
    efficiency = round(random.uniform(0.9, 0.965), 3)
    mean = lambda x: np.convolve(x, np.full(cycle, 1.0 / cycle))[cycle - 1 :: 20][: len(x) // 20 - 2]  # noqa: E731
    hertz = mean(motion.speed) * system.rpm / 60.0 * pairs
    power = mean(motion.load * motion.speed) * system.torque_Nm * system.turning * efficiency * 1e-3
    time_s = 0.02 * np.arange(1, len(hertz) + 1) + (cycle - 20) * STEP_S
    noisy = lambda x, part: x * (1.0 + part * random.standard_normal(len(x)))  # noqa: E731
    table = [time_s, noisy(np.full(len(hertz), 400.0), 4e-4), noisy(power, 1e-3), noisy(hertz, 4e-5)]
    lines = [f"{t:.3f};{u:.1f};{p:.2f};{f:.3f}" for t, u, p, f in zip(*table, strict=True)]
    body, path = "\n".join(lines) + "\n", folder / "log.csv"
    if random.random() < 0.5:
        head = "Leistungsanalysator;Messung 1\n\nZeit [s];U12 [V];P [kW];f [Hz]\n"
        body = body.replace(".", ",")
    else:
        head, body = "Time,Urms,P,fU\ns,V,kW,Hz\n", body.replace(";", ",")
    path.write_text(head + body, encoding="utf-8")
    return path, {
        'pole_pairs = "to be given"': f"pole_pairs = {pairs}",
        'rpm = "to be given"': f"rpm = {system.rpm}",
        "# efficiency = 0.95": f"efficiency = {efficiency}",
    }


def pod(system: System, folder: Path) -> tuple[Path, Answers]:
    """Write a PLC's text: set point, speed and torque in per cent of their ratings, at its cycle."""
    random = system.random(3)
    cycle_s = float(random.choice([0.02, 0.04, 0.05]))
    motion, every = moved(system, cycle_s), round(cycle_s / STEP_S)
    rated_rpm = round(system.rpm / random.uniform(0.6, 0.85))
    rated_Nm = float(f"{system.torque_Nm / random.uniform(0.5, 0.75):.3g}")
    noisy = lambda x, part: x[::every] + part * random.standard_normal(len(x[::every]))  # noqa: E731
    percent = [
        100.0 * system.rpm / rated_rpm * motion.asked[::every],
        100.0 * system.rpm / rated_rpm * noisy(motion.speed, 5e-4),
        100.0 * system.torque_Nm / rated_Nm * noisy(motion.brake, 3e-3),
    ]
    begun = datetime.datetime(2026, 3, 4, 8, 15, tzinfo=datetime.UTC)
    stamps = [begun + datetime.timedelta(seconds=cycle_s * k) for k in range(len(percent[0]))]
    lines = [
        f"{stamp.isoformat(timespec='milliseconds')},{n_set:.2f},{n:.2f},{torque:.1f}"
        for stamp, n_set, n, torque in zip(stamps, *percent, strict=True)
    ]
    path = folder / "log.csv"
    heads = "timestamp,POD1_SPEED_REF_PCT,POD1_SPEED_ACT_PCT,POD1_TORQUE_PCT"
    path.write_text("\n".join([heads, *lines]) + "\n", encoding="utf-8")
    return path, {
        'rated_torque_Nm = "to be given"': f"rated_torque_Nm = {rated_Nm}",
        'unit = "%"\ncalibration = "to be given"': (
            f'unit = "%"\nheld = true\ncalibration = {{ scale = {rated_rpm / 100.0} }}'
        ),
        'shaft = "engine"\ncalibration = "to be given"': (
            f'shaft = "engine"\ncalibration = {{ scale = {rated_rpm / 100.0} }}'
        ),
    }


def boat(system: System, folder: Path) -> tuple[Path, Answers]:
    """Write a logger's text: set point, strain gauge and a reflector's pulses in volts, at 2 to 5 kHz."""
    random, motion = system.random(3), moved(system)
    rate_hz = float(random.choice([2000.0, 2500.0, 4000.0, 5000.0]))
    count = int((len(motion.speed) - 1) * STEP_S * rate_hz)
    at, steps = np.arange(count) / rate_hz, np.arange(len(motion.speed)) * STEP_S
    on = lambda row: np.interp(at, steps, row)  # noqa: E731
    noise = lambda size: size * random.standard_normal(count)  # noqa: E731
    turns = on(np.cumsum(motion.speed) * STEP_S * system.turning / (2.0 * np.pi)) + random.random()
    rpm_a_volt, Nm_a_volt = (
        round(system.rpm / random.uniform(3.0, 6.0)),
        round(system.torque_Nm / random.uniform(2, 5)),
    )
    swing = random.uniform(0.005, 0.03) * np.sin(2.0 * np.pi * int(random.integers(3, 6)) * turns)
    swing += random.uniform(0.002, 0.01) * np.sin(2.0 * np.pi * turns)
    torque = system.torque_Nm * (on(motion.gauge) * (1.0 + swing) + noise(0.01))
    hum = random.uniform(0.0, 4e-3) * np.sin(2.0 * np.pi * 50.0 * at)
    volts = [
        system.rpm * on(motion.asked) / rpm_a_volt + hum + noise(1e-3),
        torque / Nm_a_volt + 2.0 * hum,
        0.1 + 4.7 * (turns % 1.0 < random.uniform(0.03, 0.08)) + noise(0.02),
    ]
    adc_V = 20.0 / 2**16
    table = [pa.array(at), *(pa.array(np.round(np.round(row / adc_V) * adc_V, 4)) for row in volts)]
    path = folder / "log.csv"
    with path.open("wb") as file:
        file.write(b"Time,Speed demand,Shaft torque,Tacho\ns,V,V,V\n")
        pa.csv.write_csv(pa.table(table, names=list("abcd")), file, pa.csv.WriteOptions(include_header=False))
    shaft = {'shaft = "to be given"': f'shaft = "{"propeller" if system.ratio > 1.0 else "engine"}"'}
    if system.ratio > 1.0:
        vessel = f'name = "Boat"\n[gearbox]\nratio = {system.ratio}\nefficiency = 0.96\n'
        (folder / "vessel.toml").write_text(vessel, encoding="utf-8")
        shaft["[trial]"] = '[trial]\nvessel = "vessel.toml"'
    return path, {
        'calibration = "to be given"  # from V to rpm': f"calibration = {{ scale = {rpm_a_volt} }}",
        'calibration = "to be given"  # from V to Nm': f"calibration = {{ scale = {Nm_a_volt} }}",
        'pulses_per_rev = "to be given"': "pulses_per_rev = 1",
        **shaft,
    }


WRITERS = {"genset": genset, "pod": pod, "boat": boat}
