"""Parameters of the plant as it is built, in their own units: what a grey box can search for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from shipfp_rs.errors import InputError
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.structures.plant import WIDEST
from shipfp_rs.support import hints
from shipfp_rs.vessel.drive_train import OFF, drive_train
from shipfp_rs.vessel.vessel import Vessel

ELEMENTS: Mapping[str, str] = {
    "minimum_torque": "engine.minimum_torque_Nm",
    "limit": "engine.envelope",
    "rack_rate": "actuator.rate_mm_s",
    "torque_rate": "engine.torque_rate_Nm_s",
    "fuel_dead_time": "actuator.dead_time_s",
    "fuel_lag": "actuator.lag_s",
    "shaft_stiffness": "shaft.stiffness_Nm_rad",
    "shaft_damping": "shaft.stiffness_Nm_rad",
    "drag_coefficient": "gearbox.drag_Nm",
    "drag_exponent": "gearbox.drag_Nm",
    "Kd_abs": "governor.K_d",
    "derivative_filter": "governor.K_d",
    "minimum_rack": "governor.minimum_rack_mm",
    "maximum_rack": "governor.maximum_rack_mm",
    "smoke_margin": "engine.smoke_margin_mm",
    "turbocharger_lag": "engine.smoke_margin_mm",
    "shaft_ripple": "propeller.shaft_ripple",
    "blade_ripple": "propeller.blade_ripple",
}
"""Parameters of elements that a vessel need not have, with their keys in its file."""

BESIDE: Mapping[str, str] = {
    "shaft_damping": "shaft_stiffness",
    "drag_exponent": "drag_coefficient",
    "derivative_filter": "Kd_abs",
    "turbocharger_lag": "smoke_margin",
}
"""Parameters that mean nothing where another one is switched off."""


def require_modelled(vessel: Vessel) -> None:
    """Refuse a ship that moves: its speed at the start of a record is not known.

    Raises
    ------
    InputError
        Where the vessel has a `ship`.
    """
    if vessel.ship is not None:
        raise InputError(
            f"vessel {vessel.name!r} has a ship that moves, which a grey box has not; expected a vessel without: take "
            "[ship] out of its file or set it with vessel.replace(...)"
        )


def parameters(vessel: Vessel, free: Sequence[str]) -> tuple[Parameter, ...]:
    """Declare all parameters of a vessel's plant, from its own values; those not in `free` are fixed there.

    Raises
    ------
    InputError
        For an unknown name in `free`, or that of an element which the vessel does not have.
    """
    rows = {name: row for name, row in _rows(vessel).items() if math.isfinite(row[1])}
    for name in free:
        if name in ELEMENTS and name not in rows:
            raise InputError(
                f"free: {name!r} has no value to start from; give vessel {vessel.name!r} its {ELEMENTS[name]}"
            )
        if name not in rows:
            raise InputError(f"free: found {name!r}, {hints.suggestion(name, list(rows))}")
    if not free:
        raise InputError(f"free: found no name, expected some of {', '.join(rows)}")
    return tuple(Parameter(name, *row, fixed=name not in free) for name, row in rows.items())


def _rows(vessel: Vessel) -> dict[str, tuple[str, float, float, float]]:
    """Unit, start and bounds by name of what the vessel has; the start of a limit that it lacks is not finite."""
    own = drive_train(vessel).values
    torque, speed = vessel.nominal_brake_torque, vessel.nominal_engine_speed
    load = vessel.nominal_propeller_torque
    limit = 1.0 if vessel.engine.envelope else math.inf
    damping = own["shaft_damping"]

    def within(name: str, unit: str, factor: float) -> tuple[str, float, float, float]:
        return unit, own[name], own[name] / factor, own[name] * factor

    def about(name: str, unit: str, width: float) -> tuple[str, float, float, float]:
        return unit, own[name], own[name] - width, own[name] + width

    rows = {
        "inertia": within("inertia", "kg m2", 5.0),
        "propeller_inertia": ("kg m2", own["propeller_inertia"], 0.0, own["inertia"]),
        "gear_ratio": within("gear_ratio", "-", 2.0),
        "transmission_efficiency": ("-", own["transmission_efficiency"], 0.5, 1.0),
        "A1": within("A1", "Nm/mm", 5.0),
        "A2": about("A2", "Nm/(rev/s)", 10.0 * torque / speed),
        "A3": about("A3", "Nm", 10.0 * torque),
        "propeller_torque": ("Nm", load, load / 5.0, load * 5.0),
        "torque_exponent": ("-", own["torque_exponent"], 1.0, 4.0),
        "X_0": within("X_0", "mm", 5.0),
        "Kp_abs": within("Kp_abs", "mm/(rev/s)", 20.0),
        "Ki_abs": within("Ki_abs", "mm/rev", 20.0),
        "minimum_torque": about("minimum_torque", "Nm", 5.0 * torque),
        "limit": ("-", limit, 0.5, 2.0),
        "rack_rate": within("rack_rate", "mm/s", 5.0),
        "torque_rate": within("torque_rate", "Nm/s", 5.0),
        "T_set": ("s", own["set_dead_time"], 0.0, max(2.0, 2.0 * own["set_dead_time"])),
        "fuel_dead_time": within("fuel_dead_time", "s", WIDEST),
        "fuel_lag": within("fuel_lag", "s", 5.0),
        "shaft_stiffness": within("shaft_stiffness", "Nm/rad", 5.0),
        "shaft_damping": ("Nm s/rad", damping, 0.0, max(5.0 * damping, 1e-3 * own["shaft_stiffness"])),
        "drag_coefficient": within("drag_coefficient", "Nm/(rev/s)^q", 5.0),
        "drag_exponent": ("-", own["drag_exponent"], 0.0, 4.0),
        "Kd_abs": within("Kd_abs", "mm s/(rev/s)", 20.0),
        "derivative_filter": within("derivative_filter", "s", 5.0),
        "minimum_rack": about("minimum_rack", "mm", own["X_0"]),
        "maximum_rack": about("maximum_rack", "mm", own["X_0"]),
        "smoke_margin": ("mm", own["smoke_margin"], 0.0, 5.0 * own["smoke_margin"]),
        "turbocharger_lag": within("turbocharger_lag", "s", 5.0),
        "shaft_ripple": within("shaft_ripple", "-", 5.0),
        "blade_ripple": within("blade_ripple", "-", 5.0),
    }
    off = {name for name, value in OFF.items() if own[name] == value}
    return {name: row for name, row in rows.items() if BESIDE.get(name, name) not in off or name == "T_set"}
