"""Governors that no structure of the package has, on tugs with a gauge and launches measured at the brake.

    tau_n dN/dt = 1 + g (N - 1) + F - N^p (1 + w)

F is what the fuel gives at the operating speed. It comes from a governor of proportional and integral part behind a lag,
each of another kind: "gain" counts what is beyond 1 % of error 1.5 to 2 times, "dead_band" does not see 0.5 to 1 % of error,
"way_down" moves its fuel 1.4 to 2.5 times slower down than up, at rates that act, "second_lag" has 0.2 to 0.3 s more. A
"cascade" has an inner loop of the rack that overshoots, 2.5 to 5 times as quick as the loop of the speed. In a "schedule"
both gains rise or fall by 4 to 8 % for each per cent of speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from tests.families import excitations, sensors
from tests.families.plant import Water

KINDS = ("gain", "dead_band", "way_down", "second_lag", "cascade", "schedule")
STEP_S = 1e-3
LATER = ("inner", "overshoot", "schedule")
"""Bandwidth [rad/s] and damping of an inner loop, and the relative change of the gains by the speed's."""
BEYOND = 0.01
"""Error over the operating speed beyond which a gain is another one."""
_TRIES = 200


@dataclass(frozen=True)
class OtherGovernor:
    """A ship with such a governor, and its trial."""

    kind: str
    seed: int
    place: str
    parameters: dict[str, float]
    excitation: excitations.Excitation
    water: Water | None
    torque_delay_s: float
    noise: tuple[sensors.Noise, sensors.Noise]

    def motion(self, step_s: float = STEP_S) -> np.ndarray:
        """Return speed and torque over the operating point at every step, shape (2, N)."""
        count = round(self.excitation.stop_s / step_s)
        halves = np.arange(2 * count + 1) * (0.5 * step_s)
        water = np.zeros(len(halves)) if self.water is None else self.water(halves)
        inertia = self.parameters["tau_prop" if self.place == "gauge" else "tau_n"]
        names = ("tau_n", "p", "g", "vK_p", "vK_i", "lag", "beyond", "band", "up", "down", "second", *LATER)
        numbers = np.array([self.parameters[name] for name in names])
        return _march(numbers, inertia, self.excitation.mean(halves, step_s), water, step_s, count)

    def truth(self) -> dict[str, Any]:
        """Return the truth, as `draw.Draw.truth` does."""
        values = self.parameters | {"damping": 0.0, "c_2": 0.0, "T_M": self.torque_delay_s}
        on = ("rate",) if self.kind == "way_down" else ()
        return {"place": self.place, "parameters": values, "on": [*on, *(["water"] if self.water else [])]}

    def experiment(self) -> dict[str, Any]:
        """Return the trial at 50 Hz behind one filter, with noise, in the units of a log."""
        random = np.random.default_rng([KINDS.index(self.kind), self.seed, 2])
        speed, torque = self.motion()
        torque = sensors.delayed(torque, STEP_S, self.torque_delay_s)
        asked = self.excitation.mean(np.arange(len(speed)) * STEP_S, STEP_S)
        asked, speed, torque = (sensors.to_middle(one, STEP_S) for one in (asked, speed, torque))
        speed = speed + self.noise[0].samples(random, len(speed))
        torque = torque + self.noise[1].samples(random, len(torque))
        name = "M_g" if self.place == "gauge" else "M_b"
        signals = {"n_set": 1200.0 * asked, "n_e": 1200.0 * speed, name: 2500.0 * torque}
        return sensors.experiment(f"{self.kind}-{self.seed}", self.excitation, signals)


def draw(kind: str, seed: int, *, kind_of_excitation: str | None = None) -> OtherGovernor:
    """Draw a ship; the same seed gives the same one."""
    random = np.random.default_rng([KINDS.index(kind), seed, 0])
    for _ in range(_TRIES):
        found = _tried(kind, seed, random, kind_of_excitation)
        speed, torque = found.motion(4e-3)
        if np.abs(speed - 1.0).max() < 0.2 and 0.1 < torque.min() < torque.max() < 3.0:
            return found
    raise RuntimeError(f"{kind}, seed {seed}: no trial in {_TRIES} tries")


def _tried(kind, seed, random, kind_of_excitation):
    tau, p, g = (
        float(np.exp(random.uniform(*np.log((0.5, 2.5))))),
        random.uniform(1.7, 2.4),
        random.uniform(-1.5, 0.2),
    )
    slow = kind in ("second_lag", "cascade")
    bandwidth = random.uniform(1.0, 2.0) if slow else random.uniform(1.5, 6.0)
    rate = random.uniform(0.3, 1.0)
    parameters = {
        "tau_n": tau,
        "tau_prop": tau * random.uniform(0.2, 0.6),
        "p": p,
        "g": g,
        "vK_p": max(2.0 * random.uniform(0.7, 1.2) * bandwidth * tau - (p - g), 0.3),
        "vK_i": bandwidth**2 * tau,
        "lag": random.uniform(0.02, 0.1),
        "beyond": random.uniform(1.5, 2.0) if kind == "gain" else 1.0,
        "band": random.uniform(0.005, 0.01) if kind == "dead_band" else 0.0,
        "up": rate if kind == "way_down" else np.inf,
        "down": rate / random.uniform(1.4, 2.5) if kind == "way_down" else np.inf,
        "second": random.uniform(0.2, 0.3) if kind == "second_lag" else 0.0,
        "inner": bandwidth * random.uniform(2.5, 5.0) if kind == "cascade" else 0.0,
        "overshoot": random.uniform(0.3, 0.6) if kind == "cascade" else 0.0,
        "schedule": random.choice((-1.0, 1.0)) * random.uniform(4.0, 8.0) if kind == "schedule" else 0.0,
    }
    excitation = excitations.drawn(random, kind_of_excitation)
    share, memory = 10.0 ** random.uniform(-2.5, -1.7), random.uniform(0.2, 1.5)
    wet = random.random() < 0.7
    return OtherGovernor(
        kind,
        seed,
        "gauge" if random.random() < 0.5 else "brake",
        {name: float(value) for name, value in parameters.items()},
        excitation,
        Water(share, memory, excitation.stop_s + 1.0, int(random.integers(2**31))) if wet else None,
        float(random.uniform(0.0, 0.005)),
        (sensors.speed_noise(random), sensors.torque_noise(random)),
    )


@njit(cache=True)
def _slopes(q, state, asked, water):
    """Time derivatives of speed, sum of the error, and the two lags' fuel."""
    tau, p, g, gain, integral, lag, beyond, band, up, down, second, inner, overshoot, schedule = q
    error = asked - state[0]
    changed = max(1.0 + schedule * (state[0] - 1.0), 0.2)
    if band > 0.0:
        error = np.sign(error) * max(abs(error) - band, 0.0)
    if abs(error) > BEYOND:
        error += np.sign(error) * (beyond - 1.0) * (abs(error) - BEYOND)
    fuel = state[3] if second > 0.0 else state[2]
    command = changed * gain * error + integral * state[1]
    if inner > 0.0:
        slope = 2.0 * overshoot * inner * (command - state[2]) + state[3]
        return np.array(
            [
                (1.0 + g * (state[0] - 1.0) + state[2] - state[0] ** p * (1.0 + water)) / tau,
                error,
                slope,
                inner**2 * (command - state[2]),
            ]
        )
    return np.array(
        [
            (1.0 + g * (state[0] - 1.0) + fuel - state[0] ** p * (1.0 + water)) / tau,
            error * changed,
            min(max((command - state[2]) / lag, -down), up),
            (state[2] - state[3]) / second if second > 0.0 else 0.0,
        ]
    )


@njit(cache=True)
def _march(q, inertia, asked, water, h, count):
    """Classical Runge-Kutta; set point and water are given every half step."""
    out, state = np.empty((2, count)), np.array([1.0, 0.0, 0.0, 0.0])
    for k in range(count):
        i = 2 * k
        first = _slopes(q, state, asked[i], water[i])
        out[0, k] = state[0]
        out[1, k] = state[0] ** q[1] * (1.0 + water[i]) + inertia * first[0]
        middle = _slopes(q, state + 0.5 * h * first, asked[i + 1], water[i + 1])
        again = _slopes(q, state + 0.5 * h * middle, asked[i + 1], water[i + 1])
        last = _slopes(q, state + h * again, asked[i + 2], water[i + 2])
        state = state + h / 6.0 * (first + 2.0 * middle + 2.0 * again + last)
    return out
