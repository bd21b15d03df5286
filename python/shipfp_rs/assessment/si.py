"""Conversion of a fingerprint to SI units: inertias, slopes and gains, by the gear ratio and the operating point."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.inertia import ENGINE_SIDE, operating_point, scaled
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.vessel.vessel import Vessel

FAR_OFF = 2.0
"""Ratio of the torque to the vessel file's, or its inverse, above which a doubt is reported."""
QUANTITIES: Mapping[str, str] = {
    "tau_n": "inertia",
    "tau_prop": "propeller_inertia",
    "g": "engine_slope",
    "vK_p": "proportional_gain",
    "vK_i": "integral_gain",
    "p": "propeller_exponent",
    "T_d": "dead_time_loop",
    "T_set": "dead_time_set_point",
    "tau_act": "actuator_lag",
    "M_max": "torque_limit",
}
"""Quantity in SI units for each parameter."""


def in_si(fingerprint: Fingerprint, vessel: Vessel) -> dict[str, dict[str, Any]]:
    """Convert the parameters to SI units, with intervals, for the mean operating point of the data.

    Parameters
    ----------
    fingerprint
        Normalised estimates; the operating points are in its data.
    vessel
        Source of the gear ratio and efficiency between engine and shaft; without an efficiency the gearbox is lossless.

    Returns
    -------
    dict
        {"value", "std", "ci95", "unit"} of each quantity; undetermined parameters have none. Inertias are referred to the
        propeller shaft, gains act on the engine's speed in rpm, the torque limit is that of the engine.

    Notes
    -----
    Eq. 3.23 of the thesis: tau_n = 2 pi I_p n_s0 / M_s0 with n_s0 in rev/s of the shaft; dM/dn = g M_0 / n_0.
    """
    point = operating_point(fingerprint)
    if point is None:
        return {}
    engine_rpm, torque, signal = point
    shaft_torque = torque * vessel.torque_ratio if signal == ENGINE_SIDE else torque
    shaft_speed = engine_rpm / 60.0 / vessel.gearbox.ratio
    inertia = abs(shaft_torque) / (2.0 * math.pi * abs(shaft_speed))
    slope = abs(shaft_torque) / (abs(engine_rpm) * vessel.torque_ratio)
    factors = {
        "tau_n": (inertia, "kg m2"),
        "tau_prop": (inertia, "kg m2"),
        "g": (slope, "Nm/rpm"),
        "vK_p": (slope, "Nm/rpm"),
        "vK_i": (slope, "Nm/(rpm s)"),
        "p": (1.0, "-"),
        "T_d": (1.0, "s"),
        "T_set": (1.0, "s"),
        "tau_act": (1.0, "s"),
        "M_max": (abs(shaft_torque) / vessel.torque_ratio, "Nm"),
    }
    rows = {}
    for name, (factor, unit) in factors.items():
        estimate = fingerprint.parameters.get(name)
        if estimate is not None and estimate.value is not None:
            rows[QUANTITIES[name]] = scaled(estimate, factor, unit)
    return rows


def doubts(fingerprint: Fingerprint, vessel: Vessel) -> list[str]:
    """Sentences on a gear of unknown losses, or a torque far from that of the vessel file."""
    point = operating_point(fingerprint)
    if point is None:
        return []
    lossless = vessel.gearbox.ratio != 1.0 and not vessel.given("gearbox.efficiency")
    found: list[str] = []
    if lossless:
        found.append(
            Sentence("The vessel file lacks gearbox.efficiency: in SI units the gearbox loses nothing.")
        )
    known = vessel.given("operating_point.n_e_rpm", "propeller.torque_exponent")
    if not known or not any(vessel.given(f"operating_point.{name}") for name in ("M_b_Nm", "M_s_Nm")):
        return found
    engine_rpm, torque, signal = point
    expected = vessel.nominal_brake_torque * (1.0 if signal == ENGINE_SIDE else vessel.torque_ratio)
    expected *= (abs(engine_rpm) / vessel.operating_point.n_e_rpm) ** vessel.propeller.torque_exponent
    if not 1.0 / FAR_OFF < abs(torque) / expected < FAR_OFF:
        found.append(
            Sentence(
                "The torque {signal} is {torque} Nm at {speed} rpm, but {expected} Nm by the vessel file: look at the"
                " scale of the torque channel. Inertias and gains in SI units are wrong by the same factor.",
                signal=signal,
                torque=f"{abs(torque):.4g}",
                speed=f"{abs(engine_rpm):.4g}",
                expected=f"{expected:.4g}",
            )
        )
    return found
