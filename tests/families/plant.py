"""A drive train in physical units, and what its numbers are in the names of a fingerprint.

Everything is seen from the shaft behind the gearbox, apart from speeds and torques that are called the engine's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

KNOT_S = 0.05


@njit(cache=True)
def changed(coefficients, t):
    """Value of the spline with knots every `KNOT_S` from zero on."""
    i = min(max(int(t / KNOT_S), 0), coefficients.shape[1] - 1)
    x = t - i * KNOT_S
    c = coefficients
    return ((c[0, i] * x + c[1, i]) * x + c[2, i]) * x + c[3, i]


@njit(cache=True)
def _changed_at(coefficients, times):
    out = np.empty(len(times))
    for i in range(len(times)):
        out[i] = changed(coefficients, times[i])
    return out


@dataclass(frozen=True)
class Water:
    """Noise with two equal poles: `share` its standard deviation over the load, `memory_s` the poles' time constant."""

    share: float
    memory_s: float
    seconds: float
    seed: int

    @cached_property
    def coefficients(self) -> np.ndarray:
        count, settle = int(self.seconds / KNOT_S) + 3, int(20.0 * self.memory_s / KNOT_S)
        pole = np.exp(-KNOT_S / self.memory_s)
        raw = np.random.default_rng(self.seed).standard_normal(count + settle)
        smooth = lfilter([1.0], np.convolve([1.0, -pole], [1.0, -pole]), raw)[settle:]
        # Variance of the filter's output by its poles, not of this one record.
        variance = (1.0 + pole**2) / ((1.0 - pole**2) ** 3)
        return np.ascontiguousarray(
            CubicSpline(np.arange(count) * KNOT_S, self.share * smooth / np.sqrt(variance)).c
        )

    def __call__(self, times):
        return _changed_at(self.coefficients, np.asarray(times, dtype=float))


INFINITE = math.inf


class Plant(NamedTuple):
    """Numbers of one drive train at its operating point; a field at its default is an element that is off."""

    engine_speed: float
    """At the operating point [rev/s]."""
    ratio: float
    efficiency: float
    shaft_torque: float
    """At the operating point [Nm]."""
    engine_inertia: float
    """Engine's side of the torque gauge [kg m2]."""
    load_inertia: float
    """Load's side: propeller, entrained water, fan, alternator [kg m2]."""
    exponent: float
    """Load torque goes with speed to this power, at the operating point."""
    load_damping: float
    """And rises by this beside [Nm/(rev/s) of the shaft]."""
    engine_slope: float
    """Brake torque over engine speed at constant rack [Nm/(rev/s)]."""
    rack: float
    """At the operating point [mm]."""
    rack_slope: float
    """Brake torque over rack at constant speed [Nm/mm]."""
    gain: float
    """Of the governor [mm/(rev/s)]."""
    integral_gain: float
    """Of the governor [mm/rev]."""
    dead_time: float = 0.0
    """Between command and rack [s]."""
    set_point_dead_time: float = 0.0
    """[s]."""
    period: float = 0.0
    """At which the governor samples [s]; 0: it does not."""
    phase: float = 0.0
    """First sample [s]."""
    sums_first: float = 0.0
    """1: the governor's sum takes the new error before it is used; 0: after."""
    lag: float = 0.0
    """Time constant of the actuator [s]."""
    limit: float = INFINITE
    """Highest brake torque [Nm]."""
    rack_rate: float = INFINITE
    """Fastest motion of the rack, up and down [mm/s]."""
    exponent_drift: float = 0.0
    """Rise of the load's exponent with speed over the operating point's [per unit]."""
    stiffness: float = 0.0
    """Of the shaft [Nm/rad]; 0: rigid."""
    shaft_damping: float = 0.0
    """[Nm/(rad/s)]."""

    @property
    def shaft_speed(self) -> float:
        """At the operating point [rev/s]."""
        return self.engine_speed / self.ratio

    @property
    def brake_torque(self) -> float:
        """At the operating point [Nm]."""
        return self.shaft_torque / (self.ratio * self.efficiency)


ELEMENTS = ("T_d", "T_set", "T_s", "tau_act", "M_max", "rate", "tau_twist")
"""Elements that a fingerprint can find, by the parameter that says how large they are."""
LIMITS = ("M_max", "rate")
"""Those of them that are off where they are infinite; the others are off at zero."""


def normalised(plant: Plant) -> dict[str, float]:
    """Return the parameters in a fingerprint's names, relative to the operating point.

    tau_n = 2 pi I n_s0 / M_s0 (eq. 3.23 of the thesis), g and v the relative slopes of the brake torque (eq. 3.24, 3.25).
    With N, A, M_b, M_t over their operating values: tau_n dN/dt = M_b - L, M_b = 1 + g (N - 1) + vA,
    L = N^p + damping (N - 1) + w, dM_t/dt = (N_e - N_p) / tau_twist, and zeta_twist (N_e - N_p) beside M_t. vA moves by
    `rate` a second at most. Where the exponent is p + c_2 (N - 1), p is still the slope at the operating point, and c_2
    the load's second-order coefficient beside N^p.
    """
    n, torque = plant.shaft_speed, plant.shaft_torque
    turning = 2.0 * math.pi * n / torque
    per_command = plant.rack_slope * plant.engine_speed / plant.brake_torque
    return {
        "tau_n": turning * (plant.engine_inertia + plant.load_inertia),
        "tau_prop": turning * plant.load_inertia,
        "g": plant.engine_slope * plant.engine_speed / plant.brake_torque,
        "vK_p": plant.gain * per_command,
        "vK_i": plant.integral_gain * per_command,
        "p": plant.exponent,
        "damping": plant.load_damping * n / torque,
        "T_d": plant.dead_time,
        "T_set": plant.set_point_dead_time,
        "T_s": plant.period,
        "T_0": plant.phase,
        "update": plant.sums_first,
        "tau_act": plant.lag,
        "M_max": plant.limit / plant.brake_torque,
        "rate": plant.rack_rate * plant.rack_slope / plant.brake_torque,
        "c_2": plant.exponent_drift,
        "tau_twist": 1.0 / (turning * plant.stiffness) if plant.stiffness else 0.0,
        "zeta_twist": turning * plant.shaft_damping,
    }


def physical(
    relative: dict[str, float],
    *,
    engine_speed: float,
    ratio: float = 1.0,
    efficiency: float = 1.0,
    shaft_torque: float,
    rack: float = 10.0,
    v: float = 1.2,
) -> Plant:
    """Return the drive train whose relative numbers are given, the inverse of `normalised`; what is absent is off."""
    n, turning = engine_speed / ratio, 2.0 * math.pi * (engine_speed / ratio) / shaft_torque
    brake = shaft_torque / (ratio * efficiency)
    share = relative.get("tau_prop", 0.4 * relative["tau_n"])
    rack_slope = v * brake / rack
    command = brake / (rack_slope * engine_speed)
    twist = relative.get("tau_twist", 0.0)
    return Plant(
        engine_speed=engine_speed,
        ratio=ratio,
        efficiency=efficiency,
        shaft_torque=shaft_torque,
        engine_inertia=(relative["tau_n"] - share) / turning,
        load_inertia=share / turning,
        exponent=relative["p"],
        load_damping=relative.get("damping", 0.0) * shaft_torque / n,
        engine_slope=relative["g"] * brake / engine_speed,
        rack=rack,
        rack_slope=rack_slope,
        gain=relative["vK_p"] * command,
        integral_gain=relative["vK_i"] * command,
        dead_time=relative.get("T_d", 0.0),
        set_point_dead_time=relative.get("T_set", 0.0),
        period=relative.get("T_s", 0.0),
        phase=relative.get("T_0", 0.0),
        sums_first=relative.get("update", 0.0),
        lag=relative.get("tau_act", 0.0),
        limit=relative.get("M_max", INFINITE) * brake,
        rack_rate=relative.get("rate", INFINITE) * brake / rack_slope,
        exponent_drift=relative.get("c_2", 0.0),
        stiffness=1.0 / (turning * twist) if twist else 0.0,
        shaft_damping=relative.get("zeta_twist", 0.0) / turning,
    )


def without(plant: Plant, element: str) -> Plant:
    """Return the drive train with one of `ELEMENTS`, or the drift "c_2", switched off and everything else as it is."""
    off = {
        "T_d": {"dead_time": 0.0},
        "T_set": {"set_point_dead_time": 0.0},
        "T_s": {"period": 0.0, "phase": 0.0, "sums_first": 0.0},
        "tau_act": {"lag": 0.0},
        "M_max": {"limit": INFINITE},
        "rate": {"rack_rate": INFINITE},
        "c_2": {"exponent_drift": 0.0},
        "tau_twist": {"stiffness": 0.0, "shaft_damping": 0.0},
    }
    return plant._replace(**off[element])
