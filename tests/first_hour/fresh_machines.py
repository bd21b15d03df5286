"""Podded drives by equations of their own: what moves them, and their loop.

With N and the torques over the operating point: tau_n dN/dt = M_b - N^p - waves, M_b = 1 + g (N - 1) + fuel, and
tau_act d(fuel)/dt = order(t - T_d) - fuel. The order is that of a PI governor, at all times or each T_s.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from tests.families import small_steps
from tests.families.plant import physical

STEP_S = 1e-3
WAYS = ("steps", "chirp", "multisine")
REST_S = 25.0
"""Before and after what moves."""


class Ranges(NamedTuple):
    """Of podded drives; the crossover is vK_p over the inertia [1/s], the reset vK_i over vK_p, over that."""

    tau_n: tuple[float, float]
    g: tuple[float, float]
    p: tuple[float, float]
    crossover: tuple[float, float]
    reset: tuple[float, float]
    T_d: tuple[float, float]
    tau_act: tuple[float, float]
    T_s: tuple[float, float]
    T_set: tuple[float, float]


RANGES = Ranges((1.0, 4.0), (-0.1, 0.0), (1.8, 2.2), (1.0, 3.5), (0.1, 0.4), (0.02, 0.1), (0.01, 0.06),
                (0.02, 0.1), (0.0, 0.1))  # fmt: skip


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

    def random(self, place: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, place])


def drawn(kind: str, seed: int, length_s: float = 200.0) -> System:
    """Draw a system whose loop is as well tuned as loops at sea are."""
    random = np.random.default_rng([seed, 0])
    while True:
        true = {name: random.uniform(*getattr(RANGES, name)) for name in ("g", "p", "T_d", "T_set")}
        true["tau_n"] = float(np.exp(random.uniform(*np.log(RANGES.tau_n))))
        true["tau_act"] = random.uniform(*RANGES.tau_act) * (random.random() < 0.7)
        true["T_s"] = round(random.uniform(*RANGES.T_s), 3) * (random.random() < 1 / 3)
        true["update"] = float(random.random() < 0.5)
        crossover = random.uniform(*RANGES.crossover)
        true["vK_p"] = crossover * true["tau_n"]
        true["vK_i"] = true["vK_p"] * crossover * random.uniform(*RANGES.reset)
        true["tau_prop"] = true["tau_n"] * random.uniform(0.2, 0.6)
        true |= {name: round(true[name], 3) for name in ("T_d", "T_set")}
        phase, gain = margins(loop_of(true))
        if 35.0 <= phase <= 80.0 and gain >= 2.2:
            break
    rpm, torque_Nm = float(random.integers(9, 19) * 10), random.uniform(3e4, 3e5)
    return System(kind, seed, true, rpm, torque_Nm, 1.0, length_s)


def loop_of(true: Mapping[str, float]) -> Callable[[np.ndarray], np.ndarray]:
    """Return the open loop over frequency [rad/s], with what a governor that samples does exactly."""

    def loop(omega: np.ndarray) -> np.ndarray:
        s, period = 1j * omega, true["T_s"]
        governor = true["vK_p"] + true["vK_i"] / s
        if period:
            z = np.exp(s * period)
            summed = true["vK_i"] * period * (z if true["update"] else 1.0) / (z - 1.0)
            governor = (true["vK_p"] + summed) * (1.0 - 1.0 / z) / (s * period)
        late = np.exp(-s * true["T_d"]) / (1.0 + s * true["tau_act"])
        return governor * late / (true["tau_n"] * s + true["p"] - true["g"])

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
    """Over the operating point, at each step."""

    asked: np.ndarray
    speed: np.ndarray
    brake: np.ndarray


def stairs(random: np.random.Generator, length_s: float, levels: tuple[float, float], pause_s: float):
    """Return levels over time, each held for about a pause, and reached in 50 ms; they begin and end at the first."""
    starts = REST_S + np.cumsum(random.uniform(0.6, 1.4, int(length_s / pause_s)) * pause_s)
    starts = starts[starts < REST_S + length_s]
    heights = random.uniform(*levels, len(starts))
    heights[-1] = 0.0
    at = np.column_stack([starts, starts + 0.05]).ravel()
    grid = np.arange(round((length_s + 2.0 * REST_S) / STEP_S)) * STEP_S
    return np.interp(grid, at, np.repeat(np.append(0.0, heights), 2)[1:-1])


def asked_of(system: System) -> np.ndarray:
    """Return the set point less 1: steps, a chirp or a multisine."""
    random, length_s = system.random(1), system.length_s
    grid = np.arange(round((length_s + 2.0 * REST_S) / STEP_S)) * STEP_S
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


def waves_of(system: System) -> np.ndarray:
    """Return the part of the load that nobody measures, over the operating torque."""
    random = system.random(2)
    count = round((system.length_s + 2.0 * REST_S) / STEP_S)
    keep = np.exp(-2.0 * np.pi * random.uniform(0.3, 1.5) * STEP_S)
    rough = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], random.standard_normal(count))
    return random.uniform(0.001, 0.004) * rough


def moved(system: System, hold_s: float = 0.0) -> Motion:
    """Run the machine; the set point is held for `hold_s`."""
    asked = 1.0 + asked_of(system)
    if hold_s:
        asked = asked[np.arange(len(asked)) // round(hold_s / STEP_S) * round(hold_s / STEP_S)]
    grid = np.arange(len(asked)) * STEP_S
    heard, push = (partial(np.interp, xp=grid, fp=row) for row in (asked, waves_of(system)))
    plant = physical(dict(system.true), engine_speed=1.0, shaft_torque=1.0)
    ran = small_steps.simulate(plant, heard, len(asked) * STEP_S, step_s=STEP_S, load=push)
    return Motion(asked, ran.engine_speed, ran.brake_torque)
