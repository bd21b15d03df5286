"""Operating point and inertia in rpm, Nm, kW and kg m2, shown above all normalised values."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.driven import is_loaded
from shipfp_rs.identification.estimate import Estimate, rounded_rows
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.inertia import ENGINE_SIDE, operating_point
from shipfp_rs.report.answer import interval, short_name
from shipfp_rs.report.language import Say
from shipfp_rs.support.units import unit_shown
from shipfp_rs.vessel.vessel import Vessel

Fact = tuple[str, str, str, str, str]
LARGE_NM, LARGE_KW = 1e4, 1e3
"""Torque from which kNm are used, and power from which decimals are omitted."""


def feeds_a_generator(
    fingerprint: Fingerprint, experiments: Iterable[Experiment], vessel: Vessel | None
) -> bool:
    """Whether a drive train feeds a generator or a brake: a measured load, or an engine without a propeller."""
    return is_loaded(fingerprint, experiments) or (
        vessel is not None and vessel.given("engine.cylinders") and not vessel.given("propeller")
    )


def facts(
    fingerprint: Fingerprint, experiments: Iterable[Experiment], vessel: Vessel | None, say: Say
) -> list[Fact]:
    """Rows with the operating point, and inertia or inertia constant unless another row has them."""
    point = operating_point(fingerprint)
    if point is None:
        return []
    speed_rpm, torque_Nm, signal = point
    ratio = 1.0 if signal == ENGINE_SIDE else vessel and vessel.gearbox.ratio
    torque = f"{torque_Nm / 1e3:.4g}\u00a0kNm" if abs(torque_Nm) >= LARGE_NM else f"{torque_Nm:.4g}\u00a0Nm"
    told = [f"{speed_rpm:.4g}\u00a0rpm", torque]
    if ratio:
        turning = 2.0 * math.pi * speed_rpm / 60.0 / ratio
        power_kW = abs(torque_Nm * turning) / 1e3
        told.append(f"{power_kW:.0f}\u00a0kW" if power_kW >= LARGE_KW else f"{power_kW:.3g}\u00a0kW")
    rows = [(say("operating point"), "", say.number(", ".join(told)), "", _place(signal, say))]
    if fingerprint.why_not:
        return rows
    by_vessel = any("seen_from" not in row for row in fingerprint.si.values())
    for name in ("tau_n", "tau_prop"):
        estimate = fingerprint.parameters.get(name)
        if estimate is None or estimate.value is None or not ratio or by_vessel:
            continue
        inertia = _scaled(estimate, abs(torque_Nm / turning), "kg m2")
        rows.append(_fact(short_name(name, say), inertia, say("seen from the torque's place"), say))
    whole = fingerprint.parameters.get("tau_n")
    if whole is not None and whole.value is not None and feeds_a_generator(fingerprint, experiments, vessel):
        name = say("inertia constant")
        rows.append(
            _fact(name, _scaled(whole, 0.5, "s"), say("on the power of the operating point"), say, "H")
        )
    return rows


def _place(signal: str, say: Say) -> str:
    return (
        say("engine speed and brake torque")
        if signal == ENGINE_SIDE
        else say("engine speed and gauge torque")
    )


def _scaled(estimate: Estimate, factor: float, unit: str) -> Estimate:
    assert estimate.value is not None
    ends = estimate.ci95
    return replace(
        estimate,
        value=factor * estimate.value,
        std=None if estimate.std is None else factor * estimate.std,
        ci95=None if ends is None else (factor * ends[0], factor * ends[1]),
        unit=unit,
    )


def _fact(name: str, estimate: Estimate, more: str, say: Say, symbol: str = "") -> Fact:
    (row,) = rounded_rows({"": estimate})
    value = f"{say.number(row.value)}\u00a0{unit_shown(row.unit)}"
    return name, symbol, value, interval(row, estimate, say), more
