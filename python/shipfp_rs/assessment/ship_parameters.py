"""Linear parameters of a vessel, and vessels with given parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping

from shipfp_rs.errors import InputError
from shipfp_rs.structures.combinations import true_values
from shipfp_rs.support.arguments import checked
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.steady_state import steady_state
from shipfp_rs.vessel.vessel import Vessel


@checked
def parameters_of(vessel: Vessel, n_e_rpm: float | None = None) -> dict[str, float]:
    """Return a vessel's linear parameters, with separate actuator lag and shaft twist.

    Parameters
    ----------
    vessel
        The ship.
    n_e_rpm
        Engine speed of the operating point [rpm]; None: that of the vessel.
    """
    model = dict(vars(linearise(vessel, n_e_rpm)))
    lag, stiffness = vessel.actuator.lag_s, vessel.shaft.stiffness_Nm_rad
    twist = 0.0
    if stiffness is not None:
        point = steady_state(vessel, n_e_rpm)
        twist = point.M_s / (2.0 * math.pi * point.n_s * stiffness)
    return true_values(model | {"T_d": model["T_d"] - lag}) | {"tau_act": lag, "tau_twist": twist}


@checked
def with_parameters(vessel: Vessel, values: Mapping[str, float]) -> Vessel:
    """Return a vessel with the given linear parameters at its operating point; the others are unchanged.

    If the loop's dead time is shorter than that of sampling, firing and computing, the actuator's is zero.

    Parameters
    ----------
    vessel
        The ship.
    values
        Some of tau_n, tau_prop, g, v, K_p, K_i (or vK_p, vK_i), p, T_d, T_set, tau_act, tau_twist.

    Raises
    ------
    InputError
        For another name, or an impossible ship.
    """
    if unknown := sorted(set(values) - PARAMETERS):
        raise InputError(
            f"found parameters {', '.join(unknown)}, expected some of {', '.join(sorted(PARAMETERS))}"
        )
    # Torque, drag and water inertia depend weakly on each other, so four iterations suffice.
    for _ in range(4):
        vessel = vessel.replace(_changes(vessel, values))
    return vessel


PARAMETERS = frozenset(
    ("tau_n", "tau_prop", "g", "v", "K_p", "K_i", "vK_p", "vK_i", "p", "T_d", "T_set", "tau_act", "tau_twist")
)


def _changes(vessel: Vessel, values: Mapping[str, float]) -> dict[str, float]:
    own = parameters_of(vessel)
    per_time_constant = vessel.nominal_propeller_torque / (2.0 * math.pi * vessel.nominal_shaft_speed)
    gains = {f"K_{k}": values[f"vK_{k}"] / own["v"] for k in ("p", "i") if f"vK_{k}" in values}
    wanted = {**values, **gains}
    more = {name: wanted[name] - own[name] for name in wanted if name in own}
    places = {
        "tau_n": ("shaft.inertia_kg_m2", vessel.shaft.inertia_kg_m2, per_time_constant),
        "tau_prop": (
            "shaft.propeller_side_inertia_kg_m2",
            vessel.shaft.propeller_side_inertia_kg_m2,
            per_time_constant,
        ),
        "g": ("operating_point.g", vessel.operating_point.g, 1.0),
        "v": ("operating_point.v", vessel.operating_point.v, 1.0),
        "K_p": ("governor.K_p", vessel.governor.K_p, 1.0),
        "K_i": ("governor.K_i", vessel.governor.K_i, 1.0),
        "p": ("propeller.torque_exponent", vessel.propeller.torque_exponent, 1.0),
        "T_set": ("governor.set_point_dead_time_s", vessel.governor.set_point_dead_time_s, 1.0),
        "tau_act": ("actuator.lag_s", vessel.actuator.lag_s, 1.0),
    }
    changes = {}
    for name, (key, present, unit) in places.items():
        if name in more:
            changes[key] = float(present or 0.0) + unit * more[name]
    if "T_d" in more:
        changes["actuator.dead_time_s"] = max(0.0, vessel.actuator.dead_time_s + more["T_d"])
    if "tau_twist" in more and values["tau_twist"] > 0.0:
        changes["shaft.stiffness_Nm_rad"] = per_time_constant / values["tau_twist"]
    return changes
