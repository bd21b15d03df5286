"""Inertias of a fingerprint in kg m2, and the mean operating point of its data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from shipfp_rs.identification.estimate import scaled
from shipfp_rs.identification.fingerprint import Fingerprint

ENGINE_SIDE = "M_b"
LEAST_RPM = 5.0
"""Least operating speed in rpm; a lower value is a normalised speed."""
INERTIAS: Mapping[str, str] = {"tau_n": "inertia", "tau_prop": "propeller_inertia"}
BEFORE_METER: Mapping[str, str] = {"tau_n": "inertia_before_meter"}
"""Names of the inertias in SI units; `BEFORE_METER` is for a model that ends at a torque meter."""


def inertias(fingerprint: Fingerprint) -> dict[str, dict[str, Any]]:
    """Return inertias with intervals and their reference shaft; empty where the gear ratio would be needed."""
    for speed, place in (("n_e", "engine"), ("n_s", "propeller shaft")):
        point = operating_point(fingerprint, speed)
        if point is None or abs(point[0]) < LEAST_RPM or (point[2] == ENGINE_SIDE) != (speed == "n_e"):
            continue
        # Eq. 3.23 of the thesis: tau_n = 2 pi I n_0 / M_0 with n_0 in rev/s.
        factor = abs(point[1] / (2.0 * math.pi * point[0] / 60.0))
        names = BEFORE_METER if fingerprint.ends_at_meter else INERTIAS
        known = {quantity: fingerprint.parameters.get(name) for name, quantity in names.items()}
        return {
            quantity: scaled(estimate, factor, "kg m2") | {"seen_from": place}
            for quantity, estimate in known.items()
            if estimate is not None and estimate.value is not None
        }
    return {}


def operating_point(fingerprint: Fingerprint, speed: str = "n_e") -> tuple[float, float, str] | None:
    """Return mean speed [rpm], mean torque [Nm] and the torque's signal; None if speed or torque is missing."""
    speeds, torques, signal = [], [], ""
    for record in fingerprint.data:
        point: Mapping[str, float] = record.get("operating_point", {})
        # Where only a torque command was recorded, the operating point has that command as engine torque.
        signal = str(record.get("signals", {}).get("dM", ENGINE_SIDE))
        if speed in point and signal in point:
            speeds.append(float(point[speed]))
            torques.append(float(point[signal]))
    if not speeds:
        return None
    return sum(speeds) / len(speeds), sum(torques) / len(torques), signal
