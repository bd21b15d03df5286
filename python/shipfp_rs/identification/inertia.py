"""Inertias in kg m2 without a vessel's file, from operating points of torque and speed on the same shaft."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from shipfp_rs.identification.estimate import Estimate
from shipfp_rs.identification.fingerprint import Fingerprint

ENGINE_SIDE = "M_b"
LEAST_RPM = 5.0
"""Least operating speed in rpm; lower ones are normalised speeds."""
INERTIAS: Mapping[str, str] = {"tau_n": "inertia", "tau_prop": "propeller_inertia"}


def inertias(fingerprint: Fingerprint) -> dict[str, dict[str, Any]]:
    """Return inertias with intervals and their reference shaft; empty where the gear ratio would be needed.

    Eq. 3.23 of the thesis: tau_n = 2 pi I n_0 / M_0 with n_0 in rev/s.
    """
    for speed, place in (("n_e", "engine"), ("n_s", "propeller shaft")):
        point = operating_point(fingerprint, speed)
        if point is None or abs(point[0]) < LEAST_RPM or (point[2] == ENGINE_SIDE) != (speed == "n_e"):
            continue
        factor = abs(point[1] / (2.0 * math.pi * point[0] / 60.0))
        known = {quantity: fingerprint.parameters.get(name) for name, quantity in INERTIAS.items()}
        return {
            quantity: scaled(estimate, factor, "kg m2") | {"seen_from": place}
            for quantity, estimate in known.items()
            if estimate is not None and estimate.value is not None
        }
    return {}


def scaled(estimate: Estimate, factor: float, unit: str) -> dict[str, Any]:
    """Return an estimate in another unit, in the form of `Fingerprint.si`."""
    assert estimate.value is not None
    interval = None if estimate.ci95 is None else [factor * end for end in estimate.ci95]
    return {
        "value": factor * estimate.value,
        "std": None if estimate.std is None else factor * estimate.std,
        "ci95": interval,
        "unit": unit,
    }


def operating_point(fingerprint: Fingerprint, speed: str = "n_e") -> tuple[float, float, str] | None:
    """Return speed [rpm], torque [Nm] and the torque's signal, means over experiments; None where either is missing."""
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
