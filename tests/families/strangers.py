"""Drive trains that no other family has, by equations of their own: heavy tugs, electric drives, pitch, flywheels.

    t1 dN/dt = (1 + E) (1 + firing) - M,    tau_eng dE/dt = g (N - 1) + A - E
    t2 dN_p/dt = M - q N_p^p (1 + wake),  t2 = tau_prop, t1 + t2 = tau_n
    dM/dt = (N - N_p) / tau_twist, and zeta_twist (N - N_p) beside it;    without twist N_p = N
    tau_act dA/dt = C(t - T_d) - A,    C = vK_p (R - S) + vK_i int (R - S),    T_f dS/dt = N - S

Everything is over the operating point. R is the set point T_set later; where there is a ramp it moves by `set_rate` a second
at most. The governor sees the engine. The seed's remainder is the kind:

heavy_tug   elastic shaft with a strain gauge, wake, firing; pulses of the engine, or of the propeller's side in a third
vfd         electric drive with its own torque; staircase of a bus, ramp of the set point, filter of the speed, in half each
cpp_boat    steps of the pitch under a resting set point; what the pitch adds to the load is measured in half
flywheel    tau_n of 5 to 150 s and a slow loop; torque at the brake or behind the first inertia

The family "charged" has the heavy tugs with a turbocharger or fuel film, whose lag is tau_eng.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from tests.families import recording, sensors
from tests.families.excitations import Excitation

KINDS = ("heavy_tug", "vfd", "cpp_boat", "flywheel")
TUGS = ("heavy_tug", "charged")
STEP_S = 5e-4
LEAST_PHASE_DEG, LEAST_GAIN = 25.0, 1.4
"""Margins below which a loop is drawn anew."""
LEAST_GOVERNED = 0.5
"""Crossover over the corner (p - g) / tau_n below which the drive, and not the governor, makes the loop."""
SET_POINT_NOISE = 5e-5
"""Of the logged set point in experiments, over the operating point, white."""
RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "heavy_tug": {
        "tau_n": (0.4, 15.0), "T_d": (0.03, 0.2), "tau_act": (0.03, 0.15), "T_set": (0.005, 0.2), "crossover": (0.05, 2.0),
    },
    "vfd": {
        "tau_n": (0.05, 5.0), "T_d": (0.002, 0.05), "tau_act": (0.002, 0.1), "T_set": (0.002, 0.2), "crossover": (0.1, 8.0),
        "T_f": (0.005, 0.05),
    },
    "cpp_boat": {"tau_n": (0.2, 10.0), "T_d": (0.01, 0.2), "tau_act": (0.01, 0.2), "crossover": (0.05, 2.0)},
    "flywheel": {
        "tau_n": (5.0, 150.0), "T_d": (0.01, 0.4), "tau_act": (0.01, 0.5), "T_set": (0.01, 0.5), "crossover": (0.01, 0.5),
    },
}  # fmt: skip
RANGES["charged"] = RANGES["heavy_tug"] | {"tau_eng": (0.03, 0.3)}
"""What each kind draws from, log-uniformly; crossover of the open loop [Hz]."""
LOADS = {**dict.fromkeys(TUGS, (1.8, 2.4)), "vfd": (0.2, 2.2), "cpp_boat": (1.7, 2.4), "flywheel": (0.1, 2.0)}
"""Exponent p of the load, uniformly."""
WAKE = {
    **dict.fromkeys(TUGS, (0.01, 0.05)),
    "vfd": (0.001, 0.01),
    "cpp_boat": (0.003, 0.02),
    "flywheel": (5e-4, 0.005),
}
"""Share of the load that moves by itself, log-uniformly; drives and flywheels have it in half of the draws."""
WAKE_HZ = (0.05, 1.5)
ACTS = (0.005, 0.3)
"""Share of the time that the set point is steeper than a ramp lets through, log-uniformly."""
ELEMENTS = ("T_d", "T_set", "tau_act", "tau_twist", "set_rate", "T_f", "tau_eng")
_ORDER = (
    *("tau_n", "tau_prop", "p", "g", "vK_p", "vK_i", "T_d", "tau_act"),
    *("T_f", "tau_eng", "tau_twist", "zeta_twist", "firing", "firing_hz"),
)
_OFF = {"set_rate": np.inf} | dict.fromkeys(
    ("T_set", "T_f", "tau_eng", "tau_twist", "zeta_twist", "firing"), 0.0
)
_TRIES = 2000


class Size(NamedTuple):
    """What the relative numbers are relative to."""

    engine_speed: float
    """[rev/s]."""
    ratio: float
    efficiency: float
    shaft_torque: float
    """Behind the gear [Nm]."""

    @property
    def brake_torque(self) -> float:
        return self.shaft_torque / (self.ratio * self.efficiency)


class Motion(NamedTuple):
    """What happened, at every step, over the operating point but for `asked`, shape (N,) each."""

    step_s: float
    asked: np.ndarray
    """Set point that is logged [rev/s of the engine]."""
    engine: np.ndarray
    propeller: np.ndarray
    shaft: np.ndarray
    """Torque between the inertias."""
    brake: np.ndarray
    added: np.ndarray
    """What pitch adds to the load."""


@dataclass(frozen=True)
class Stranger:
    """A drive train and its trial."""

    kind: str
    seed: int
    numbers: dict[str, float]
    plant: Size
    place: str
    side: str
    """Shaft whose pulses are counted."""
    excitation: Excitation
    """Of the set point, or of the pitch."""
    wake: float
    """Standard deviation of the load's share that moves by itself."""
    bus_hz: float | None
    """Rate at which the set point is sent and held."""
    pitch_rate: float
    """Fastest change of the pitch's part of the load [1/s]."""
    has_load: bool
    telemetry: sensors.Telemetry
    noise: tuple[sensors.Noise, sensors.Noise]
    late_s: float | None = None
    family: str = "strangers"
    noise_free: tuple[str, ...] = ()

    def random(self, purpose: int) -> np.random.Generator:
        """Return a stream of its own for each purpose."""
        return np.random.default_rng([1963, self.seed, purpose])

    @property
    def on(self) -> tuple[str, ...]:
        """Elements that act, with "water" and "load"."""
        there = [name for name in ELEMENTS if 0.0 < self.numbers[name] < np.inf]
        return tuple(there + (["water"] if self.wake else []) + (["load"] if self.kind == "cpp_boat" else []))

    @property
    def torque_Nm(self) -> float:
        """At the operating point, where it is measured."""
        return self.plant.shaft_torque if self.place == "gauge" else self.plant.brake_torque

    def truth(self) -> dict[str, Any]:
        """Return the truth, as `draw.Draw.truth` does, with the figures of the open loop."""
        q = self.numbers
        names = ("tau_n", "tau_prop", "p", "g", "vK_p", "vK_i", "T_d", "T_set", "tau_act", "T_f", "tau_eng")
        values: dict[str, float | None] = {name: q[name] for name in (*names, "tau_twist", "zeta_twist")}
        values["set_rate"] = q["set_rate"] if np.isfinite(q["set_rate"]) else None
        values |= dict.fromkeys(("damping", "c_2", "T_s", "T_n"), 0.0) | dict.fromkeys(("M_max", "rate"))
        values |= {"K_p/K_i": q["vK_p"] / q["vK_i"], "T_M": self.telemetry.delay_s, "k_L": 1.0}
        return {
            "family": self.family,
            "kind": self.kind,
            "seed": self.seed,
            "place": self.place,
            "side": self.side,
            "parameters": values,
            "on": list(self.on),
            "water": {"share": self.wake, "band_hz": list(WAKE_HZ)} if self.wake else None,
            "excitation": self.excitation.described(),
            "bus_hz": self.bus_hz,
            "late_s": self.late_s,
            "noise_free": [],
            "operating_point": {"n_e_rpm": 60.0 * self.plant.engine_speed, "M_Nm": self.torque_Nm},
            "loop": loop_figures(q),
        }

    def logged_set_point(self, times):
        """Return what the bus sends at some instants, over the steady set point."""
        if self.kind == "cpp_boat":
            return np.ones(len(times))
        if self.bus_hz is not None:
            times = np.floor(times * self.bus_hz + 1e-9) / self.bus_hz
        return self.excitation(times)

    def motion(self, step_s: float = STEP_S) -> Motion:
        """Simulate the trial."""
        count = round(self.excitation.stop_s / step_s)
        halves = np.arange(2 * count + 1) * (0.5 * step_s)
        received = self.logged_set_point(halves - self.numbers["T_set"])
        received = ramped(received, 0.5 * step_s * self.numbers["set_rate"])
        pitch = np.ones(len(halves))
        if self.kind == "cpp_boat":
            pitch = ramped(self.excitation(halves), 0.5 * step_s * self.pitch_rate)
        factor = pitch * (1.0 + self.moved(halves))
        numbers = np.array([self.numbers[name] for name in _ORDER])
        engine, propeller, shaft, brake = _march(numbers, received, factor, step_s, count)
        asked = self.plant.engine_speed * self.logged_set_point(halves[: 2 * count : 2])
        added = (pitch[: 2 * count : 2] - 1.0) * propeller ** self.numbers["p"]
        return Motion(step_s, asked, engine, propeller, shaft, brake, added)

    def moved(self, times):
        """Return the wake: sines of random frequencies, amplitudes and phases in `WAKE_HZ`."""
        if not self.wake:
            return np.zeros(len(times))
        random, lines = self.random(1), 80
        frequencies = random.uniform(*WAKE_HZ, lines)
        sizes = random.standard_normal((2, lines))
        knots = np.arange(0.0, times[-1] + 0.2, 0.02)
        angles = 2.0 * np.pi * np.outer(knots, frequencies)
        total = np.cos(angles) @ sizes[0] + np.sin(angles) @ sizes[1]
        return CubicSpline(knots, self.wake / np.sqrt(lines) * total)(times)

    def met(self, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Return speed and torque where they are measured, over the operating point."""
        speed = motion.engine if self.side == "engine" else motion.propeller
        return speed, motion.shaft if self.place == "gauge" else motion.brake

    def experiment(self) -> dict[str, Any]:
        """Return the trial at 50 Hz behind one filter, with noise, in the units of a log."""
        motion, random, plant = self.motion(), self.random(2), self.plant
        speed, torque = self.met(motion)
        signals = motion.asked / plant.engine_speed, speed, self.telemetry(torque, motion.step_s)
        asked, speed, torque = (sensors.to_middle(one, motion.step_s) for one in signals)
        density = SET_POINT_NOISE * np.sqrt(sensors.MIDDLE_HZ / sensors.COMMON_HZ)
        asked = asked + density * random.standard_normal(len(asked))
        speed = speed + self.noise[0].samples(random, len(speed))
        torque = torque + self.noise[1].samples(random, len(torque))
        rpm = 60.0 * plant.engine_speed
        name = "M_g" if self.place == "gauge" else "M_b"
        made = {"n_set": rpm * asked, "n_e": rpm * speed, name: self.torque_Nm * torque}
        if self.has_load:
            made["M_load"] = plant.shaft_torque * (1.0 + sensors.to_middle(motion.added, motion.step_s))
        whole = sensors.experiment(f"{self.kind}-{self.seed}", self.excitation, made)
        first = 0 if self.late_s is None else self.excitation.start_s + self.late_s
        cut = {key: one[round(first * sensors.COMMON_HZ) :] for key, one in whole["signals"].items()}
        return whole | {"signals": cut}

    def raw(self) -> sensors.RawLog:
        """Return volts of set point and torque, and sixty teeth, at 2 kHz; 5 kHz where teeth pass faster than 400 Hz."""
        random, plant = self.random(3), self.plant
        turning = plant.engine_speed / (1.0 if self.side == "engine" else plant.ratio)
        motion = self.motion(1.0 / (2000.0 if 60.0 * turning < 400.0 else 5000.0))
        speed, torque = self.met(motion)
        passed = np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]))] * motion.step_s
        turns = turning * passed + self.random(4).random()
        teeth = sensors.Pulses(sensors.reflectors(random, 60, 0.01), width=0.5, rise_s=5e-5)
        extra = []
        if self.has_load:
            table = '[channels.load]\ncolumn = "M_load"\nunit = "Nm"\nquantity = "torque"'
            extra = [("M_load", "Nm", plant.shaft_torque * (1.0 + motion.added), table)]
        return recording.logged(
            self,
            motion,
            random,
            every=1,
            torque=self.torque_Nm * torque,
            trains={"teeth": (turns, teeth, self.side)},
            telemetry=self.telemetry,
            found=sensors.Faults(hum_V=float(random.choice([0.0, 0.005]))),
            extra=extra,
        )


@njit(cache=True)
def ramped(values, most):
    """Follow some values by at most so much from one to the next."""
    out, at = np.empty(len(values)), values[0]
    for i in range(len(values)):
        at += min(max(values[i] - at, -most), most)
        out[i] = at
    return out


@njit(cache=True)
def _rates(q, x, asked, factor, command, out):
    """Slopes of speed, propeller's speed, spring, sum of the error, fuel, filtered speed, firing's phase, torque."""
    tau, behind, p, g, _, _, _, lag, smooth, charge, twist, damping, firing, firing_hz = q
    seen = x[5] if smooth > 0.0 else x[0]
    load = factor * x[1] ** p
    fed = g * (x[0] - 1.0) + x[4]
    brake = (1.0 + (x[7] if charge > 0.0 else fed)) * (1.0 + firing * np.sin(2.0 * np.pi * x[6]))
    if twist > 0.0:
        shaft = x[2] + damping * (x[0] - x[1])
        out[0] = (brake - shaft) / (tau - behind)
        out[1] = (shaft - load) / behind
        out[2] = (x[0] - x[1]) / twist
    else:
        out[0] = out[1] = (brake - load) / tau
        out[2] = 0.0
        shaft = load + behind * out[1]
    out[3] = asked - seen
    out[4] = (command - x[4]) / lag
    out[5] = (x[0] - x[5]) / smooth if smooth > 0.0 else 0.0
    out[6] = firing_hz * x[0]
    out[7] = (fed - x[7]) / charge if charge > 0.0 else 0.0
    return shaft, brake


@njit(cache=True)
def _late(commands, at):
    if at <= 0.0:
        return 0.0
    i = int(at)
    return commands[i] + (at - i) * (commands[i + 1] - commands[i])


@njit(cache=True)
def _march(q, asked, factor, h, count):
    """Classical Runge-Kutta; set point and load's factor are given every half step, the dead time is a step at least."""
    out, commands = np.empty((4, count)), np.zeros(count + 2)
    x = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    a, b, c, d = np.empty(8), np.empty(8), np.empty(8), np.empty(8)
    back = max(q[6] / h, 1.0)
    for k in range(count):
        i = 2 * k
        seen = x[5] if q[8] > 0.0 else x[0]
        commands[k] = q[4] * (asked[i] - seen) + q[5] * x[3]
        now, middle, then = _late(commands, k - back), _late(commands, k + 0.5 - back), 0.0
        then = commands[k] if back == 1.0 else _late(commands, k + 1.0 - back)
        shaft, brake = _rates(q, x, asked[i], factor[i], now, a)
        out[0, k], out[1, k], out[2, k], out[3, k] = x[0], x[1], shaft, brake
        _rates(q, x + 0.5 * h * a, asked[i + 1], factor[i + 1], middle, b)
        _rates(q, x + 0.5 * h * b, asked[i + 1], factor[i + 1], middle, c)
        _rates(q, x + h * c, asked[i + 2], factor[i + 2], then, d)
        x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return out


def open_loop(q, s):
    """Loop gain about the operating point at complex frequencies, from the governor's error to the speed that it sees."""
    way = np.exp(-s * q["T_d"]) / ((1.0 + s * q["tau_act"]) * (1.0 + s * q["T_f"]) * (1.0 + s * q["tau_eng"]))
    return (q["vK_p"] + q["vK_i"] / s) * way / admittances(q, s)[0]


def admittances(q, s):
    """Return what the engine's torque, and the shaft's, are to the engine's speed; and the propeller's speed to that."""
    behind = q["tau_prop"] * s + q["p"]
    ratio = 1.0 / (1.0 + behind / (1.0 / (s * q["tau_twist"]) + q["zeta_twist"])) if q["tau_twist"] else 1.0
    own = q["g"] / (1.0 + s * q["tau_eng"])
    return (q["tau_n"] - q["tau_prop"]) * s - own + behind * ratio, behind * ratio, ratio


def loop_figures(q) -> dict[str, float] | None:
    """Return crossover, phase margin and gain margin; None where the loop keeps no margins, or crosses 1 again."""
    f = np.geomspace(1e-3, 200.0, 12000)
    loop = open_loop(q, 2j * np.pi * f)
    size, phase = np.abs(loop), np.unwrap(np.angle(loop))
    phase -= 2.0 * np.pi * np.round((phase[0] + np.pi / 2.0) / (2.0 * np.pi))
    crossings = np.flatnonzero(np.diff(np.sign(size - 1.0)))
    turnings = np.flatnonzero((phase[:-1] > -np.pi) & (phase[1:] <= -np.pi))
    if len(crossings) != 1 or size[0] < 1.0 or not len(turnings) or turnings[0] < crossings[0]:
        return None

    def at(hz):
        return complex(open_loop(q, 2j * np.pi * hz))

    crossover, turning = (
        brentq(of, f[k], f[k + 1], xtol=1e-12)
        for of, k in (
            (lambda hz: abs(at(hz)) - 1.0, crossings[0]),
            (lambda hz: np.angle(-at(hz)), turnings[0]),
        )
    )
    figures = {
        "crossover_hz": float(crossover),
        "phase_margin_deg": float(np.degrees(np.angle(-at(crossover)))),
        "gain_margin": float(1.0 / abs(at(turning))),
    }
    beyond = size[turnings[0] + 1 :].max()
    kept = figures["phase_margin_deg"] > LEAST_PHASE_DEG and beyond < 1.0 / LEAST_GAIN
    return figures if kept else None


def draw(
    seed: int, *, kind: str | None = None, longest_s: float | None = None, family: str = "strangers"
) -> Stranger:
    """Draw a stranger; the same seed gives the same one, and its kind by the remainder where none is asked for."""
    kind = KINDS[seed % len(KINDS)] if kind is None else kind
    random = np.random.default_rng([1963, seed, 0])
    for _ in range(_TRIES):
        numbers = _numbers(kind, random)
        if numbers is None:
            continue
        found = replace(_trial(kind, seed, numbers, random, longest_s), family=family)
        if _can_be(found):
            return found
    raise RuntimeError(f"strangers, seed {seed}: no {kind} in {_TRIES} tries")


def _log(random, low, high):
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _numbers(kind, random):
    """Draw the relative numbers; None for a loop without margins."""
    drawn = {name: _log(random, *ends) for name, ends in RANGES[kind].items()}
    crossover = 2.0 * np.pi * drawn.pop("crossover")
    for name, off in (("T_set", 0.25), ("T_f", 0.5)):
        if name in drawn and random.random() < off:
            drawn[name] = 0.0
    q = _OFF | drawn
    q["p"] = float(random.uniform(*LOADS[kind]))
    q["g"] = float(random.uniform(-1.5, 0.2)) if kind != "vfd" else float(random.uniform(-0.3, 0.05))
    q["tau_prop"] = q["tau_n"] * float(random.uniform(0.2, 0.7))
    q["firing_hz"] = float(random.uniform(30.0, 60.0))
    if kind in TUGS:
        w, share = 2.0 * np.pi * _log(random, 8.0, 60.0), q["tau_prop"] * (1.0 - q["tau_prop"] / q["tau_n"])
        q |= {
            "tau_twist": 1.0 / (w**2 * share),
            "zeta_twist": 2.0 * _log(random, 0.005, 0.05) * w * share,
        }
        q["firing"] = _log(random, 0.003, 0.05) if random.random() < 0.5 else 0.0
    slope = q["p"] - q["g"]
    if slope < 0.1 or crossover * q["tau_n"] < LEAST_GOVERNED * slope:
        return None
    corner = crossover * _log(random, 0.02, 0.8)
    q |= {"vK_p": 1.0, "vK_i": corner}
    gain = float(1.0 / abs(open_loop(q, 1j * crossover)))
    q |= {"vK_p": gain, "vK_i": gain * corner}
    return None if loop_figures(q) is None else q


def _trial(kind, seed, q, random, longest_s):
    bus = float(random.choice([10.0, 20.0])) if kind == "vfd" and random.random() < 0.5 else None
    if kind in TUGS:
        rpm, ratio, torque = (500.0, 850.0), round(float(random.uniform(2.5, 4.5)), 2), (4.0, 5.3)
    elif kind == "cpp_boat":
        rpm, ratio, torque = (500.0, 850.0), round(float(random.uniform(1.5, 4.0)), 2), (3.0, 4.7)
    else:
        rpm, ratio, torque = ((300.0, 800.0) if kind == "vfd" else (60.0, 390.0)), 1.0, (0.7, 3.5)
    size = Size(
        float(random.uniform(*rpm)) / 60.0,
        ratio,
        float(random.uniform(0.95, 0.98)) if ratio > 1.0 else 1.0,
        float(10.0 ** random.uniform(*torque)),
    )
    held = kind == "vfd" and random.random() < 0.3
    corners = random.uniform(200.0, 400.0, 2)
    excitation = _excitation(kind, q, random, longest_s)
    if kind == "vfd" and random.random() < 0.5:
        slopes = np.abs(np.diff(excitation(np.arange(excitation.start_s, excitation.stop_s, 0.01)))) / 0.01
        q["set_rate"] = np.quantile(slopes, 1.0 - _log(random, *ACTS))
    wet = kind in (*TUGS, "cpp_boat") or random.random() < 0.5
    return Stranger(
        kind=kind,
        seed=seed,
        numbers={name: float(value) for name, value in q.items()},
        plant=size,
        place="gauge" if kind in TUGS or (kind == "flywheel" and random.random() < 0.5) else "brake",
        side="propeller" if kind in TUGS and random.random() < 1.0 / 3.0 else "engine",
        excitation=excitation,
        wake=_log(random, *WAKE[kind]) if wet else 0.0,
        bus_hz=bus,
        pitch_rate=_log(random, 0.03, 1.0),
        has_load=kind == "cpp_boat" and random.random() < 0.5,
        telemetry=sensors.Telemetry(float(corners[0]), float(corners[1]), 20.0 if held else 500.0),
        noise=(sensors.speed_noise(random), sensors.torque_noise(random)),
    )


def _excitation(kind, q, random, longest_s):
    """Draw a logarithmic chirp that suits the loop, or steps of the pitch."""
    start = float(np.round(random.uniform(38.0, 42.0), 2))
    crossover = loop_figures(q)["crossover_hz"]
    ends, lasts, swing = {
        **dict.fromkeys(TUGS, ((0.03, 1.5), 160.0, random.uniform(0.02, 0.05))),
        "vfd": ((0.03, np.clip(3.0 * crossover, 1.0, 5.0)), random.uniform(120.0, 300.0), 0.0),
        "cpp_boat": ((0.0, 0.0), random.uniform(160.0, 400.0), random.uniform(0.1, 0.3)),
        "flywheel": ((crossover / 12.0, 4.0 * crossover), random.uniform(260.0, 560.0), 0.0),
    }[kind]
    lasts = min(float(lasts), longest_s or np.inf)
    if kind == "cpp_boat":
        times = np.cumsum(random.uniform(4.0, 20.0, int(lasts / 4.0)))
        times = times[times < lasts - 5.0] - 4.0
        levels = 1.0 + swing * random.choice([-1.0, -0.5, 0.0, 0.5, 1.0], len(times))
        return Excitation("steps", start, start + lasts, np.column_stack([times, levels]))
    swing = swing or _log(random, 0.003, 0.06)
    low = max(ends[0], 2.0 / lasts)
    table = np.array([[low, np.log(max(ends[1], 4.0 * low) / low) / lasts, swing]])
    return Excitation("chirp", start, start + lasts, table)


def _can_be(found: Stranger) -> bool:
    """Whether a drive gives these torques, and the speed moves, but stays near its operating point."""
    motion = found.motion(1e-3)
    torques, speeds = (motion.brake, motion.shaft), (motion.engine, motion.propeller)
    if not all(np.isfinite(one).all() and one.min() > 0.15 and one.max() < 3.0 for one in torques):
        return False
    return all(one.min() > 0.7 and one.max() < 1.3 and np.std(one) > 5e-4 for one in speeds)
