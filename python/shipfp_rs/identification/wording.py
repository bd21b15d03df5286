"""Words of a fingerprint, the same on the terminal and in the report."""

from __future__ import annotations

from collections.abc import Mapping

from shipfp_rs.identification.fingerprint import Identifiability
from shipfp_rs.logs.faults.record import KINDS

MEANINGS: Mapping[str, str] = {
    "tau_n": "time constant of the drive train's whole inertia, 2π I n_s0 / M_s0",
    "tau_prop": "time constant of the inertia on the propeller's side of the gauge",
    "g": "slope of engine torque with speed at a held fuel rack, normalised",
    "v": "slope of engine torque with fuel rack at a held speed, normalised",
    "K_p": "proportional gain of the governor, normalised",
    "K_i": "integral gain of the governor, normalised",
    "vK_p": "loop gain, proportional",
    "vK_i": "loop gain, integral",
    "p": "exponent of propeller torque with speed",
    "T_d": "dead time in the fuel path, inside the loop",
    "T_set": "dead time in the set-point path, before the governor",
    "K_d": "derivative gain of the governor, normalised",
    "vK_d": "loop gain, derivative",
    "tau_act": "time constant of the fuel actuator",
    "T_s": "period at which the governor samples",
    "T_0": "when the governor's first sample of a record falls",
    "misread": "share by which a governor reads the speed off its mean",
    "tau_twist": "give of the shaft, M_s0 / (2π n_s0 k)",
    "inertia": "moment of inertia of all that turns, seen from the propeller",
    "propeller_inertia": "share of it on the propeller's side of the gauge",
    "gear_ratio": "engine speed over shaft speed",
    "transmission_efficiency": "of the gearbox",
    "A1": "engine torque per fuel rack, eq. 3.5",
    "A2": "engine torque per engine speed, eq. 3.5",
    "A3": "engine torque at no rack and no speed, eq. 3.5",
    "propeller_torque": "at the vessel's operating speed",
    "torque_exponent": "exponent of propeller torque with speed",
    "X_0": "fuel rack at no speed error",
    "Kp_abs": "proportional gain of the governor",
    "Ki_abs": "integral gain of the governor",
    "minimum_torque": "lowest engine torque",
    "limit": "factor on the engine's torque envelope",
    "rack_rate": "how fast the fuel rack can move",
    "torque_rate": "how fast the engine's torque can change",
}
OUTPUTS: Mapping[str, str] = {
    "dn": "speed",
    "dM": "torque",
    "dE": "integrated speed error",
    "dX": "fuel rack",
    "overall": "all outputs",
}

FAULTS: Mapping[str, str] = {
    kind: f"{said} ({kind})" if kind[0].isupper() else said for kind, said in KINDS.items()
}
"""Faults of a log, those of Table 6.10 with their letters."""


def rank(found: Identifiability) -> str:
    """Say how many of the free parameters the data tell apart."""
    if found.rank == found.free:
        return (
            f"The data tell all {found.free} free parameters apart (condition number of the scaled "
            f"sensitivities {found.condition:.3g})."
        )
    return f"The data tell {found.rank} of {found.free} free parameters apart."
