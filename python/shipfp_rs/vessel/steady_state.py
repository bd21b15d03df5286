"""Steady states of a vessel, and static curves in bollard pull for comparison with a sea trial."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.optimize import brentq

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import checked, positive
from shipfp_rs.support.arrays import Array
from shipfp_rs.vessel.drive_train import PLANT_PARAMETERS, drive_train
from shipfp_rs.vessel.vessel import Vessel

_FASTEST_SHIP = 100.0
"""Highest ship speed in the search for a steady state [m/s]."""

SLOWEST = 1e-3
"""Lowest permitted engine speed, relative to the rated speed."""


@dataclass(frozen=True)
class OperatingPoint:
    """A steady state (Table 3.5).

    Parameters
    ----------
    n_e, n_s
        Engine and shaft speed [rev/s].
    X_f
        Fuel rack [mm].
    M_b, M_s, M_p
        Brake, shaft and propeller torque [Nm]; M_s equals M_p without acceleration.
    thrust
        Propeller thrust [N] (eq. 3.9).
    ship_speed
        Ship speed [m/s]; zero in bollard pull.
    """

    n_e: float
    n_s: float
    X_f: float
    M_b: float
    M_s: float
    M_p: float
    thrust: float
    ship_speed: float = 0.0

    @property
    def n_e_rpm(self) -> float:
        """Engine speed [rpm]."""
        return 60.0 * self.n_e

    @property
    def levels(self) -> dict[str, float]:
        """Operating-point values of an `Experiment`'s signals, in its units; the set point equals the engine speed."""
        return {
            "n_set": self.n_e_rpm,
            "n_e": self.n_e_rpm,
            "n_s": self.n_s,
            "M_b": self.M_b,
            "M_s": self.M_s,
            "M_g": self.M_s,
            "X_f": self.X_f,
            "E_n": self.n_e,
        }

    @property
    def brake_power(self) -> float:
        """Engine power [W]."""
        return 2.0 * math.pi * self.n_e * self.M_b


@checked
def steady_state(vessel: Vessel, n_e_rpm: float | None = None) -> OperatingPoint:
    """Solve the plant's steady state at a set point of the engine speed.

    Parameters
    ----------
    vessel
        The ship.
    n_e_rpm
        Set point [rpm]; with an integrating governor it is the steady engine speed. None: the ship's operating point.

    Raises
    ------
    InputError
        If the engine can't hold the set point within the limits of torque and rack.

    Examples
    --------
    >>> point = steady_state(Vessel.load("stan-launch-804"), 1300.0)
    >>> round(point.M_s, 2), round(point.brake_power / 1e3, 1)
    (635.35, 30.3)
    """
    set_point = vessel.operating_point.n_e_rpm if n_e_rpm is None else n_e_rpm
    positive(f"vessel {vessel.name!r}: set point [rpm]", set_point)
    rated = vessel.engine.rated_speed_rpm
    hint = hints.likely(set_point, 0.1 * rated, 1.5 * rated, hints.SPEED_RPM, "rpm")
    if hint or set_point < SLOWEST * rated:
        raise InputError(
            f"vessel {vessel.name!r}: set point is {set_point:g} rpm, expected a speed near {rated:g} rpm{hint}"
        )
    speed, limit = vessel.envelope()
    n_e = set_point / 60.0
    n_s = n_e / vessel.gearbox.ratio
    ship_speed = _ship_speed(vessel, n_s)
    propeller_torque, pull = drive_train(vessel).propeller(n_s, ship_speed)
    needed = (propeller_torque + vessel.drag_torque(n_s)) / (vessel.gearbox.ratio * vessel.gearbox.efficiency)
    if limit.size and needed > (available := float(np.interp(n_e, speed, limit))):
        raise InputError(
            f"vessel {vessel.name!r}: {set_point:g} rpm needs {needed:.4g} Nm of engine torque, "
            f"{available:.4g} Nm are available; lower the set point"
        )
    *_, A1, A2, A3 = vessel.plant_parameters()[:6]
    rack = float((needed - A2 * n_e - A3) / A1)
    if rack <= (lowest := max(0.0, vessel.governor.minimum_rack_mm or 0.0)):
        expected = f"more than {lowest:g} mm" if lowest else "a positive one"
        raise InputError(
            f"vessel {vessel.name!r}: {set_point:g} rpm needs a fuel rack of {rack:.3g} mm, "
            f"expected {expected}; raise the set point"
        )
    highest = vessel.governor.maximum_rack_mm
    if highest is not None and rack >= highest:
        raise InputError(
            f"vessel {vessel.name!r}: {set_point:g} rpm needs a fuel rack of {rack:.3g} mm, "
            f"expected less than maximum_rack_mm, {highest:g}; lower the set point"
        )
    return OperatingPoint(
        n_e=n_e,
        n_s=n_s,
        X_f=rack,
        M_b=needed,
        M_s=propeller_torque,
        M_p=propeller_torque,
        thrust=pull
        / ((1.0 - vessel.propeller.thrust_deduction) * (vessel.ship.propellers if vessel.ship else 1)),
        ship_speed=ship_speed,
    )


def _ship_speed(vessel: Vessel, n_s: float) -> float:
    """Ship speed at which the propellers' thrust equals the resistance [m/s]; zero in bollard pull."""
    if vessel.ship is None:
        return 0.0
    train, resistance = drive_train(vessel), vessel.ship.resistance_N_s2_m2

    def surplus(speed: float) -> float:
        return train.propeller(n_s, speed)[1] - resistance * speed * abs(speed)

    pull = surplus(0.0)
    highest = math.copysign(_FASTEST_SHIP, pull)
    if surplus(highest) * pull > 0.0:
        raise InputError(
            f"vessel {vessel.name!r}: ship.resistance_N_s2_m2: found {resistance:g}, with which the thrust drives the "
            f"ship faster than {_FASTEST_SHIP:g} m/s, expected a larger resistance"
        )
    return float(brentq(surplus, 0.0, highest, xtol=1e-14, rtol=1e-15)) if pull else 0.0


def ship_about(
    vessel: Vessel, point: OperatingPoint, more: Mapping[str, float] = MappingProxyType({})
) -> Array:
    """Return the kernel's parameters of the plant (eq. 3.1-3.11) relative to `point`, without torque limit, plus `more`."""
    # Shaft torques are relative to the shaft torque at `point`, including the drag.
    plant = dict(zip(PLANT_PARAMETERS, vessel.plant_parameters().tolist(), strict=True))
    time_per_inertia = 2.0 * math.pi * point.n_s / (point.M_s + vessel.drag_torque(point.n_s))
    values = dict(zip(_core.SHIP_PARAMETERS, _core.SHIP_OFF, strict=True)) | {
        "tau_n": time_per_inertia * vessel.inertia,
        "tau_prop": time_per_inertia * vessel.propeller_side_inertia,
        "g": plant["A2"] * point.n_e / point.M_b,
        "v": plant["A1"] * point.X_f / point.M_b,
        "K_p": plant["Kp_abs"] * point.n_e / point.X_f,
        "K_i": plant["Ki_abs"] * point.n_e / point.X_f,
        "p": plant["torque_exponent"],
        "M_min": plant["minimum_torque"] / point.M_b,
        **more,
    }
    return np.array([values[name] for name in _core.SHIP_PARAMETERS])


def droop_about(vessel: Vessel, point: OperatingPoint) -> float:
    """Return the droop, normalised by the speed and the engine torque at `point`."""
    speed = vessel.nominal_engine_speed / point.n_e
    return vessel.governor.droop * speed * point.M_b / vessel.nominal_brake_torque


def whole_about(vessel: Vessel, point: OperatingPoint) -> tuple[Array, Array]:
    """Return the kernel's parameter vectors "ship" and "detail" of the whole drive train, relative to `point`."""
    train = drive_train(vessel)
    q, unit = train.values, point.M_s + vessel.drag_torque(point.n_s)
    once_a_firing = math.isinf(q["governor_period"])
    T_s = q["firing_interval"] / point.n_e if once_a_firing else q["governor_period"]
    flexible = math.isfinite(q["shaft_stiffness"])
    ship = {
        # The rectangle rule minus half the last error is the trapezoidal rule, which adds no delay.
        "K_p": (q["Kp_abs"] - 0.5 * T_s * q["Ki_abs"]) * point.n_e / point.X_f,
        "K_d": q["Kd_abs"] * point.n_e / point.X_f,
        "droop": droop_about(vessel, point),
        "T_d": q["fuel_dead_time"],
        "T_set": q["set_dead_time"],
        "T_s": T_s,
        "update": 1.0,
        "tau_act": q["fuel_lag"],
        "rate_up": q["rack_rate"] / point.X_f,
        "rate_down": q["rack_rate"] / point.X_f,
        "X_max": q["maximum_rack"] / point.X_f - 1.0,
        "X_min": q["minimum_rack"] / point.X_f - 1.0,
        "anti_windup": q["anti_windup"],
        "tau_twist": unit / (2.0 * math.pi * q["shaft_stiffness"] * point.n_s) if flexible else 0.0,
        "zeta_twist": 2.0 * math.pi * q["shaft_damping"] * point.n_s / unit if flexible else 0.0,
    }
    blades_speed = q["blade_path"] * point.n_s / q["inflow"]
    detail = {
        "T_f": q["derivative_filter"],
        "margin": q["smoke_margin"] / point.X_f,
        "tau_air": q["turbocharger_lag"],
        "torque_rate": q["torque_rate"] / point.M_b,
        "interval": q["firing_interval"],
        "width": q["firing_width"],
        "engine_hz": point.n_e,
        "once_a_firing": float(once_a_firing),
        "drag": 1.0 - point.M_s / unit,
        "drag_exponent": q["drag_exponent"],
        "bollard": q["torque_coefficient"] * point.n_s ** q["torque_exponent"] / unit,
        "shaft_hz": point.n_s,
        "blades": q["blades"],
        "shaft_ripple": q["shaft_ripple"],
        "blade_ripple": q["blade_ripple"],
        "water": point.ship_speed / blades_speed,
        "push": q["thrust_coefficient"] * point.n_s**2 / (q["ship_mass"] * blades_speed),
        "resistance": q["ship_resistance"] * blades_speed / q["ship_mass"],
    }
    return ship_about(vessel, point, ship), np.array([detail[name] for name in _core.SHIP_DETAIL])
