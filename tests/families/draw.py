"""One seeded draw of a family: a drive train, its trial, what was measured, and the truth.

    draw("tug", 7).experiment()    arrays at 50 Hz, without the pulse chain
    draw("tug", 7).raw()           raw channels as a logger records them
    draw("tug", 7).truth()         parameters at the operating point of the steady stretch, elements that are on

Draws that no trial would have are left out and drawn again: a loop with little stability margin, a brake torque below
15 per cent or above 2.5 times the operating one, a limit of torque or rate that acts less than 0.3 per cent of the time
or more than 40, or in which the ship hunts by itself or has two motions for one set point. That makes fast loops rarer on
heavy drive trains.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from tests.families import excitations, sensors
from tests.families.plant import ELEMENTS, LIMITS, Plant, Water, normalised, physical

FAMILIES = ("tug", "launch", "genset", "lab_drive")
SET_POINT_NOISE = 5e-5
"""Of the logged set point in experiments, over the operating point, white."""
STEP_S = 5e-4
"""Of the simulation where no raw log is asked for [s]."""
CHANNELS = ("n_set", "n_e", "torque")
LATEST_S = 7.1
"""Of a window that begins in the middle of the excitation [s]."""
LIKELY = {"rate": 0.35, "c_2": 0.4, "late": 0.3, "noise_free": 0.1}
"""How often a draw has them; everything else is there with probability 1/2."""
DRIFT = 0.5
"""Largest drift of the load's exponent per unit of relative speed."""
_SETTLED = 1e-3
"""A rate within this of its limit is held by it."""
MOST_MOVED, GAIN_CHANGE = 1.0, 1e-3
"""How far the speed of a limited ship may move, over its rms, by a relative change of the gain, over that change; and that
change. Ships have 0.03 to 0.6; one that hunts in its rate limit, or jumps between two motions, 1.2 to 200: nobody records a
trial in that."""
_TRIES = 400


class Ranges(NamedTuple):
    """What a family draws from, (lowest, highest)."""

    tau_n: tuple[float, float]
    p: tuple[float, float]
    g: tuple[float, float] = (-1.5, 0.3)
    T_s: tuple[float, float] = (0.005, 0.05)
    twist_hz: tuple[float, float] = (4.0, 15.0)
    longest_s: float = 600.0


@dataclass(frozen=True)
class Loads:
    """Steps of the electric load, each with a short ramp: time [s], load from there on over the operating torque."""

    table: np.ndarray
    torque: float
    """Operating torque [Nm]."""
    ramp_s: float = 0.05

    def __call__(self, times):
        steps = np.column_stack([self.table[:, 0], self.table[:, 0] + self.ramp_s]).ravel()
        levels = np.column_stack([np.r_[0.0, self.table[:-1, 1]], self.table[:, 1]]).ravel()
        return self.torque * np.interp(times, steps, levels, left=0.0)


@dataclass(frozen=True)
class Draw:
    """A drive train and its trial."""

    family: str
    seed: int
    plant: Plant
    excitation: excitations.Excitation
    place: str
    """Of the torque meter: "gauge" between the inertias, "brake" of the engine."""
    water: Water | None
    loads: Loads | None
    torque_delay_s: float
    noise: tuple[sensors.Noise, sensors.Noise]
    """Of speed and torque, in experiments."""
    late_s: float | None = None
    """When the window begins, after the excitation does [s]; None: with the steady stretch before it."""
    noise_free: tuple[str, ...] = ()
    """Some of `CHANNELS`."""

    @property
    def module(self):
        return importlib.import_module(f"tests.families.{self.family}")

    def random(self, purpose: int) -> np.random.Generator:
        """Return a stream of its own for each purpose."""
        return np.random.default_rng([FAMILIES.index(self.family), self.seed, purpose])

    @property
    def on(self) -> tuple[str, ...]:
        """Elements that act, by the names of `plant.ELEMENTS`, with "c_2" for the drift, "water" and "load"."""
        there = normalised(self.plant)
        named = [name for name in ELEMENTS if name not in LIMITS and there[name] > 0.0]
        named += [name for name in LIMITS if np.isfinite(there[name])]
        named += ["c_2"] if there["c_2"] else []
        named += ["water"] if self.water else []
        return tuple(named + (["load"] if self.loads else []))

    def truth(self) -> dict[str, Any]:
        """Return the truth: parameters in a fingerprint's names and how the trial was made; JSON can hold it."""
        values = normalised(self.plant)
        values |= {name: values[name] if np.isfinite(values[name]) else None for name in LIMITS}
        values |= {
            "K_p/K_i": values["vK_p"] / values["vK_i"],
            "T_n": 0.0,
            "T_M": self.torque_delay_s,
            "k_L": 1.0,
        }
        return {
            "family": self.family,
            "seed": self.seed,
            "place": self.place,
            "parameters": values,
            "on": list(self.on),
            "water": None
            if self.water is None
            else {"share": self.water.share, "memory_s": self.water.memory_s},
            "excitation": self.excitation.described(),
            "late_s": self.late_s,
            "noise_free": list(self.noise_free),
            "operating_point": {
                "n_e_rpm": 60.0 * self.plant.engine_speed,
                "M_Nm": self.plant.shaft_torque if self.place == "gauge" else self.plant.brake_torque,
            },
        }

    def motion(self, step_s: float = STEP_S):
        """Simulate the trial."""
        return fast_motion(self, step_s=step_s)

    def clean(self, motion=None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return set point, speed and torque over the operating point at `MIDDLE_HZ`, without noise."""
        motion = self.motion() if motion is None else motion
        torque = motion.gauge_torque / self.plant.shaft_torque
        if self.place == "brake":
            torque = motion.brake_torque / self.plant.brake_torque
        torque = sensors.delayed(torque, motion.step_s, self.torque_delay_s)
        asked, speed = motion.asked / self.plant.engine_speed, motion.engine_speed / self.plant.engine_speed
        asked, speed, torque = (sensors.to_middle(one, motion.step_s) for one in (asked, speed, torque))
        return asked, speed, torque

    def experiment(self) -> dict[str, Any]:
        """Return the trial at 50 Hz: `signals` in the units of a log, `operating_point` from its steady stretch.

        All signals have gone through one and the same filter; the noise joins before it. The torque is late by
        `torque_delay_s`.
        """
        motion = self.motion()
        asked, speed, torque = self.clean(motion)
        random = self.random(2)
        speed = speed + self.noise[0].samples(random, len(speed))
        torque = torque + self.noise[1].samples(random, len(torque))
        if "n_set" not in self.noise_free:
            density = SET_POINT_NOISE * np.sqrt(sensors.MIDDLE_HZ / sensors.COMMON_HZ)
            asked = asked + density * random.standard_normal(len(asked))
        rpm = 60.0 * self.plant.engine_speed
        name = "M_g" if self.place == "gauge" else "M_b"
        scale = self.plant.shaft_torque if self.place == "gauge" else self.plant.brake_torque
        signals = {"n_set": rpm * asked, "n_e": rpm * speed, name: scale * torque}
        if self.loads:
            load = self.plant.shaft_torque + motion.load_torque
            signals["M_load"] = sensors.to_middle(load, motion.step_s)
        whole = sensors.experiment(f"{self.family}-{self.seed}", self.excitation, signals)
        return whole | {"signals": {key: self.windowed(one) for key, one in whole["signals"].items()}}

    def windowed(self, samples):
        """Return what the window holds of a signal at `COMMON_HZ`."""
        if self.late_s is None:
            return samples
        return samples[round((self.excitation.start_s + self.late_s) * sensors.COMMON_HZ) :]

    def raw(self) -> sensors.RawLog:
        """Return the trial as a logger records it."""
        return self.module.recorded(self)


def draw(
    family: str, seed: int, *, load: bool = True, kind: str | None = None, longest_s: float | None = None
) -> Draw:
    """Draw a trial of a family.

    Parameters
    ----------
    family
        One of `FAMILIES`, or "strangers" or "charged", which are of their own class with the same methods.
    seed
        The same seed gives the same trial.
    load
        Whether load steps may come in, where a family has them.
    kind, longest_s
        Kind of excitation and how long it may last [s]; None: drawn, and the family's own.
    """
    if family in ("strangers", "charged"):
        kinds = {} if family == "strangers" else {"kind": family, "family": family}
        return importlib.import_module("tests.families.strangers").draw(seed, longest_s=longest_s, **kinds)
    module = importlib.import_module(f"tests.families.{family}")
    random = np.random.default_rng([FAMILIES.index(family), seed, 0])
    ranges: Ranges = module.RANGES
    for _ in range(_TRIES):
        found = _tried(family, seed, module, ranges, random, load, kind, longest_s or ranges.longest_s)
        if found is not None:
            return found
    raise RuntimeError(f"family {family}, seed {seed}: no trial in {_TRIES} tries")


def _tried(family, seed, module, ranges, random, load, kind, longest_s):
    excitation = excitations.drawn(random, kind, longest_s)
    on = {
        name: random.random() < LIKELY.get(name, 0.5) for name in (*ELEMENTS, "c_2", "water", "load", "late")
    }
    relative = module.law(random, ranges) | _elements(random, ranges, on)
    relative["tau_prop"] = relative["tau_n"] * random.uniform(0.2, 0.6)
    if on["tau_twist"]:
        relative |= _twist(random, ranges, relative)
    gains = _gains(random, relative)
    if gains is None:
        return None
    relative = {name: float(value) for name, value in (relative | gains).items()}
    if excitation.kind == "steps" and excitation.keeps_time and on["T_s"]:
        excitation = excitation.in_time(relative["T_s"], relative["T_0"] - relative.get("T_set", 0.0))
    scale = {name: float(value) for name, value in module.scale(random).items()}
    plant = physical(relative, **scale)
    water = None
    if on["water"]:
        share, memory = 10.0 ** random.uniform(-2.5, -1.7), random.uniform(0.2, 1.5)
        water = Water(share, memory, excitation.stop_s + 1.0, int(random.integers(2**31)))
    loads = (
        module.loads(random, excitation, plant) if load and on["load"] and hasattr(module, "loads") else None
    )
    found = Draw(
        family=family,
        seed=seed,
        plant=plant,
        excitation=excitation,
        place=module.place(random),
        water=water,
        loads=loads,
        torque_delay_s=float(random.uniform(0.0, module.LATEST_TORQUE_S)),
        noise=(sensors.speed_noise(random), sensors.torque_noise(random)),
        late_s=float(random.uniform(0.0, LATEST_S)) if on["late"] else None,
        noise_free=tuple(name for name in CHANNELS if random.random() < LIKELY["noise_free"]),
    )
    noise = tuple(
        sensors.Noise(()) if name in found.noise_free else one
        for name, one in zip(CHANNELS[1:], found.noise, strict=True)
    )
    return _moderate(replace(found, noise=noise), random, on)


def _elements(random, ranges, on):
    chosen = {}
    if on["T_d"]:
        chosen["T_d"] = random.uniform(0.01, 0.15)
    if on["T_set"]:
        chosen["T_set"] = random.uniform(0.02, 0.6)
    if on["T_s"]:
        chosen["T_s"] = float(np.exp(random.uniform(*np.log(ranges.T_s))))
        chosen["T_0"] = random.uniform(0.0, chosen["T_s"])
        chosen["update"] = float(random.integers(2))
    if on["tau_act"]:
        chosen["tau_act"] = random.uniform(0.02, 0.2)
    if on["c_2"]:
        chosen["c_2"] = random.uniform(-DRIFT, DRIFT)
    return chosen


def _twist(random, ranges, relative):
    """Stiffness and damping for a resonance of the two inertias on the shaft."""
    first, second = relative["tau_n"] - relative["tau_prop"], relative["tau_prop"]
    w = 2.0 * np.pi * random.uniform(*ranges.twist_hz)
    share = 1.0 / (1.0 / first + 1.0 / second)
    return {"tau_twist": 1.0 / (w**2 * share), "zeta_twist": 2.0 * random.uniform(0.02, 0.12) * w * share}


def _gains(random, relative):
    """Gains for a bandwidth of 0.3 to 3 Hz and a damping; None where no such loop keeps its margins."""
    tau, slope = relative["tau_n"], relative["p"] + relative.get("damping", 0.0) - relative["g"]
    if slope < 0.1:
        return None
    w = 2.0 * np.pi * np.exp(random.uniform(*np.log((0.3, 3.0))))
    proportional = 2.0 * random.uniform(0.5, 1.2) * w * tau - slope
    if proportional < 0.3:
        return None
    gains = {"vK_p": proportional, "vK_i": w**2 * tau}
    return gains if has_margins(relative | gains) else None


def has_margins(relative, least_phase_deg=40.0, least_gain=2.2) -> bool:
    """Whether the open loop crosses 1 with phase and gain to spare, dead times, hold, actuator and twist included."""
    f = np.geomspace(0.01, 60.0, 6000)
    loop = open_loop(relative, 2j * np.pi * f)
    size, phase = np.abs(loop), np.unwrap(np.angle(loop))
    # At low frequencies the loop is an integrator in series with a lag, or nearly so.
    phase -= 2.0 * np.pi * np.round((phase[0] + np.pi / 2.0) / (2.0 * np.pi))
    crossings = np.flatnonzero((size[:-1] >= 1.0) & (size[1:] < 1.0))
    if len(crossings) != 1:
        return False
    at = crossings[0]
    beyond = size[phase < -np.pi]
    return bool(
        phase[at] + np.pi > np.radians(least_phase_deg)
        and (phase[: at + 1] > -np.pi).all()
        and (beyond.size == 0 or beyond.max() < 1.0 / least_gain)
    )


def open_loop(relative, s):
    """Loop gain of the relative drive train about its operating point at complex frequencies."""
    slope = relative["p"] + relative.get("damping", 0.0)
    tau, g = relative["tau_n"], relative["g"]
    way = np.exp(-s * (relative.get("T_d", 0.0) + relative.get("T_s", 0.0) / 2.0)) / (
        1.0 + s * relative.get("tau_act", 0.0)
    )
    twist = relative.get("tau_twist", 0.0)
    if twist:
        first, second = tau - relative["tau_prop"], relative["tau_prop"]
        spring = 1.0 / (s * twist) + relative["zeta_twist"]
        behind = second * s + slope
        admittance = first * s - g + spring * behind / (spring + behind)
    else:
        admittance = tau * s + slope - g
    return (relative["vK_p"] + relative["vK_i"] / s) * way / admittance


def _moderate(found, random, on):
    """Return the draw, with limits that act where they are wanted; None where it leaves what an engine can do."""
    share, steep = random.uniform(0.5, 0.9), 10.0 ** random.uniform(-2.0, -0.7)
    motion = fast_motion(found)
    if not _can_be(found, motion):
        return None
    if on["rate"]:
        rate = max(float(np.quantile(np.abs(slopes(found, motion)), 1.0 - steep)), 0.05)
        at_rack = rate * found.plant.brake_torque / found.plant.rack_slope
        found = replace(found, plant=found.plant._replace(rack_rate=at_rack))
        motion = fast_motion(found)
        acts = np.mean(np.abs(slopes(found, motion)) >= rate * (1.0 - _SETTLED))
        if not (0.003 < acts < 0.4 and _can_be(found, motion)):
            return None
    if not on["M_max"]:
        return found if not on["rate"] or moved_by_gain(found) < MOST_MOVED else None
    highest = motion.brake_torque.max() / found.plant.brake_torque
    limit = float((1.0 + share * (highest - 1.0)) * found.plant.brake_torque)
    found = replace(found, plant=found.plant._replace(limit=limit))
    motion = fast_motion(found)
    acts = np.mean(motion.brake_torque >= limit * (1.0 - 1e-9))
    before = motion.brake_torque[: int(found.excitation.start_s / motion.step_s)]
    acts_well = 0.003 < acts < 0.4 and _can_be(found, motion) and before.max() < limit
    return found if acts_well and moved_by_gain(found) < MOST_MOVED else None


def moved_by_gain(found: Draw) -> float:
    """Return how far the speed moves, over its rms, by a small relative change of the governor's gain, over that change."""
    other = found.plant._replace(gain=found.plant.gain * (1.0 + GAIN_CHANGE))
    speed, moved = (
        motion.engine_speed[round(found.excitation.start_s / motion.step_s) :] / found.plant.engine_speed
        - 1.0
        for motion in (fast_motion(found), fast_motion(found, other))
    )
    return float(np.sqrt(np.mean((moved - speed) ** 2) / np.mean(speed**2)) / GAIN_CHANGE)


def _can_be(found, motion):
    """Whether an engine gives these torques, and the speed stays near its operating point."""
    torque = motion.brake_torque / found.plant.brake_torque
    speed = motion.engine_speed / found.plant.engine_speed
    return bool(torque.min() > 0.15 and torque.max() < 2.5 and speed.min() > 0.75 and speed.max() < 1.25)


def slopes(found, motion):
    """Rate of the fuel's torque over the operating torque [1/s], at constant speed; where no torque limit acts."""
    speed = motion.engine_speed / found.plant.engine_speed
    fuel = motion.brake_torque / found.plant.brake_torque - normalised(found.plant)["g"] * speed
    return np.diff(fuel) / motion.step_s


def fast_motion(found: Draw, plant: Plant | None = None, step_s: float = 1e-3):
    """Simulate a draw, or the same trial of another drive train, by small steps."""
    from tests.families.small_steps import simulate

    plant = found.plant if plant is None else plant
    return simulate(
        plant, found.excitation, found.excitation.stop_s, step_s=step_s, water=found.water, load=found.loads
    )
