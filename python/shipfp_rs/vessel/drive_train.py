"""Parameters of a vessel's whole drive train, the step length of its simulation, and the propeller of a moving ship."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import Array
from shipfp_rs.vessel.vessel import PLANT_KEYS, Vessel

PLANT_PARAMETERS = (
    "inertia",
    "gear_ratio",
    "transmission_efficiency",
    "A1",
    "A2",
    "A3",
    "torque_coefficient",
    "torque_exponent",
    "X_0",
    "Kp_abs",
    "Ki_abs",
    "minimum_torque",
)
"""Parameters of the plant, eq. 3.1-3.11.

Their units are kg m2, -, -, Nm/mm, Nm/(rev/s), Nm, Nm/(rev/s)^p, -, mm, mm/(rev/s), mm/rev, Nm.
M_p is torque_coefficient n_s |n_s|^(p - 1). M_b is A1 X + A2 n_e + A3, limited by minimum_torque and the envelope.
"""
SIMULATED_KEYS = (
    *PLANT_KEYS,
    "water.density_kg_m3",
    "shaft.propeller_side_inertia_kg_m2",
    "propeller.diameter_m",
    "propeller.blades",
    "engine.cylinders",
    "propeller.K_T",
)
"""Keys required for a simulation of the whole drive train."""
OFF: Mapping[str, float] = {
    "shaft_stiffness": math.inf,
    "shaft_damping": 0.0,
    "drag_coefficient": 0.0,
    "set_dead_time": 0.0,
    "Kd_abs": 0.0,
    "droop": 0.0,
    "governor_period": 0.0,
    "anti_windup": 0.0,
    "minimum_rack": -math.inf,
    "maximum_rack": math.inf,
    "smoke_margin": math.inf,
    "fuel_dead_time": 0.0,
    "fuel_lag": 0.0,
    "rack_rate": math.inf,
    "torque_rate": math.inf,
    "firing_interval": 0.0,
    "shaft_ripple": 0.0,
    "blade_ripple": 0.0,
    "ship_mass": math.inf,
}
"""Values with which the drive train is the plant of eq. 3.1-3.11."""

_LARGEST_STEP = 0.15
"""Largest product of step length and fastest pole of an element."""
_STEPS_A_RIPPLE = 16.0
"""Steps per period of the torque ripple."""
_LONGEST_STEP_S = 1e-3
"""Longest step [s]. It limits the error from commands that arrive, and limits that become active, within a step."""


@dataclass(frozen=True)
class DriveTrain:
    """Parameters of the whole drive train."""

    values: Mapping[str, float]
    """Parameters by name, in units of kg m2, rev/s, Nm, mm, s, rad, N."""
    strength: Array
    """Torque of each cylinder relative to the mean, in the order of firing, shape (C,)."""
    quadrants: Array
    """Flow angle [rad], torque and thrust relative to bollard pull, shape (3, K); (3, 0) without a diagram."""

    @property
    def extends_the_plant(self) -> bool:
        """Whether the vessel has an element in addition to the plant of eq. 3.1-3.11."""
        return self.quadrants.size > 0 or any(self.values[name] != value for name, value in OFF.items())

    def step_s(self, n_s: float) -> float:
        """Return the longest step [s] that resolves the fast elements at a shaft speed [rev/s]."""
        q = self.values
        turn = max(
            q["blades"] if q["blade_ripple"] else 0.0,
            1.0 if q["shaft_ripple"] else 0.0,
            q["gear_ratio"] / q["firing_interval"] if q["firing_interval"] else 0.0,
        )
        inertia = q["propeller_inertia"]
        reduced = inertia * (q["inertia"] - inertia) / q["inertia"]
        flexible = math.isfinite(q["shaft_stiffness"])
        poles = [
            math.sqrt(q["shaft_stiffness"] / reduced) if flexible else 0.0,
            q["shaft_damping"] / reduced if flexible else 0.0,
            1.0 / q["fuel_lag"] if q["fuel_lag"] else 0.0,
            1.0 / q["derivative_filter"] if q["Kd_abs"] else 0.0,
            1.0 / q["turbocharger_lag"] if math.isfinite(q["smoke_margin"]) else 0.0,
        ]
        ripple = 1.0 / (_STEPS_A_RIPPLE * turn * n_s) if turn else math.inf
        return min(_LONGEST_STEP_S, ripple, _LARGEST_STEP / max(poles) if max(poles) else math.inf)

    def propeller(self, n_s: float, ship_speed: float) -> tuple[float, float]:
        """Return torque [Nm] and net thrust of all propellers [N] at a shaft speed [rev/s] and a ship speed [m/s]."""
        q = self.values
        along, across = q["blade_path"] * n_s, q["inflow"] * ship_speed
        if not self.quadrants.size:
            torque = q["torque_coefficient"] * math.copysign(abs(n_s) ** q["torque_exponent"], n_s)
            return torque, q["thrust_coefficient"] * n_s * abs(n_s)
        angle, torques, thrusts = self.quadrants
        flow, at = math.hypot(along, across) / q["blade_path"], math.atan2(across, along)
        return (
            float(np.interp(at, angle, torques)) * q["torque_coefficient"] * flow ** q["torque_exponent"],
            float(np.interp(at, angle, thrusts)) * q["thrust_coefficient"] * flow**2,
        )

    def torque_exponent(self, n_s: float, ship_speed: float) -> float:
        """Return d ln(propeller torque) / d ln(shaft speed) at a shaft speed [rev/s] and a ship speed [m/s]."""
        if ship_speed == 0.0:
            return self.values["torque_exponent"]
        step = 1e-5
        ahead, behind = (self.propeller(n_s * (1.0 + side * step), ship_speed)[0] for side in (1.0, -1.0))
        return (ahead - behind) / (step * (ahead + behind))


def drive_train(vessel: Vessel) -> DriveTrain:
    """Return the whole drive train of a vessel."""
    vessel.require(*SIMULATED_KEYS)
    governor, engine, shaft = vessel.governor, vessel.engine, vessel.shaft
    propeller, ship, water = vessel.propeller, vessel.ship, vessel.water
    gearbox, firing = vessel.gearbox, vessel.engine.firing
    period = 0.0 if governor.sample_rate_hz is None else 1.0 / governor.sample_rate_hz
    values = dict(zip(PLANT_PARAMETERS, vessel.plant_parameters().tolist(), strict=True)) | {
        "propeller_inertia": vessel.propeller_side_inertia,
        "shaft_stiffness": _or(shaft.stiffness_Nm_rad, math.inf),
        "shaft_damping": shaft.damping_Nms_rad,
        "drag_coefficient": gearbox.drag_Nm / vessel.nominal_shaft_speed**gearbox.drag_exponent,
        "drag_exponent": gearbox.drag_exponent,
        "set_dead_time": governor.set_point_dead_time_s,
        "Kd_abs": governor.K_d * vessel.operating_point.X_0_mm / vessel.nominal_engine_speed,
        "derivative_filter": governor.derivative_filter_s,
        "droop": governor.droop,
        "governor_period": math.inf if governor.once_a_firing else period,
        "anti_windup": float(governor.anti_windup),
        "minimum_rack": _or(governor.minimum_rack_mm, -math.inf),
        "maximum_rack": _or(governor.maximum_rack_mm, math.inf),
        "smoke_margin": _or(engine.smoke_margin_mm, math.inf),
        "turbocharger_lag": engine.turbocharger_lag_s,
        "fuel_dead_time": vessel.actuator.dead_time_s + governor.computation_delay_s,
        "fuel_lag": vessel.actuator.lag_s,
        "rack_rate": _or(vessel.actuator.rate_mm_s, math.inf),
        "torque_rate": _or(engine.torque_rate_Nm_s, math.inf),
        "firing_interval": vessel.firing_interval if firing else 0.0,
        "firing_width": firing.stroke_deg / 360.0 if firing else 0.0,
        "blades": float(propeller.blades),
        "shaft_ripple": propeller.shaft_ripple,
        "blade_ripple": propeller.blade_ripple,
        "blade_path": 0.7 * math.pi * propeller.diameter_m,
        "inflow": 1.0 - (ship.wake_fraction if ship else 0.0),
        "thrust_coefficient": (1.0 - propeller.thrust_deduction)
        * (ship.propellers if ship else 1)
        * water.density_kg_m3
        * propeller.diameter_m**4
        * propeller.K_T,
        "ship_mass": ship.mass_kg if ship else math.inf,
        "ship_resistance": ship.resistance_N_s2_m2 if ship else 0.0,
    }
    return DriveTrain(values, _strength(vessel), _quadrants(vessel))


def _or(value: float | None, other: float) -> float:
    return other if value is None else value


def _strength(vessel: Vessel) -> Array:
    given = vessel.engine.firing.strength if vessel.engine.firing else None
    strength = np.array(given or np.ones(vessel.engine.cylinders))
    return np.asarray(strength / strength.mean())


def _quadrants(vessel: Vessel) -> Array:
    """Flow angles from that of the operating point, -pi to pi, with torque and thrust relative to the operating point."""
    table = vessel.propeller.four_quadrant
    if table is None:
        return np.empty((3, 0))
    at, rows = np.array(table.angle_deg), np.array([table.C_Q, table.C_T])
    bollard = [float(np.interp(table.bollard_deg, at, row, period=360.0)) for row in rows]
    if min(np.abs(bollard)) == 0.0:
        raise InputError(
            f"vessel {vessel.name!r}: propeller.four_quadrant: found a coefficient of 0 at bollard_deg, "
            f"{table.bollard_deg:g}, expected another number"
        )
    angle = np.unique(np.concatenate([(at - table.bollard_deg + 180.0) % 360.0 - 180.0, [-180.0, 180.0]]))
    values = [np.interp(angle + table.bollard_deg, at, row, period=360.0) for row in rows]
    # The range -pi to pi covers every angle of atan2.
    radians = np.clip(np.radians(angle), -math.pi, math.pi)
    return np.ascontiguousarray([radians, *(row / value for row, value in zip(values, bollard, strict=True))])
