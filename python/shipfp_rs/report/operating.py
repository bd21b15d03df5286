"""Operating point, inertia, and separate results for load and engine, in rpm, Nm, kW and kg m2."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.estimate import Estimate, Row, rounded_rows
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fingerprint_tables import agreement, beside_the_whole
from shipfp_rs.identification.inertias import ENGINE_SIDE, operating_point
from shipfp_rs.identification.whole_ship import whole_ship
from shipfp_rs.plot.style import BLUE, GREY, ORANGE, dress
from shipfp_rs.report.answer import interval, short_name
from shipfp_rs.report.loop import scaled
from shipfp_rs.report.markup import Cell, Say, number, paragraph, piece, table
from shipfp_rs.report.pictures import NARROW, Pictures
from shipfp_rs.support.units import unit_shown
from shipfp_rs.vessel.vessel import Vessel

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Fact = tuple[str, str, str, str, str]
LARGE_NM, LARGE_KW = 1e4, 1e3
"""Torque [Nm] from which kNm are used, and power [kW] from which decimals are omitted."""


def feeds_a_generator(
    fingerprint: Fingerprint, experiments: Iterable[Experiment], vessel: Vessel | None
) -> bool:
    """Whether a drive train feeds a generator or a brake: it has a measured load, or an engine and no propeller."""
    if fingerprint.ends_at_meter or any(
        row.get("load", {}).get("quantity") == "other" for row in fingerprint.data
    ):
        return False
    measured = any("M_load" in one.signals for one in experiments)
    return (
        measured
        or "load" in fingerprint.structure.get("elements", ())
        or (vessel is not None and vessel.given("engine.cylinders") and not vessel.given("propeller"))
    )


def facts(
    fingerprint: Fingerprint, experiments: Iterable[Experiment], vessel: Vessel | None, say: Say
) -> list[Fact]:
    """Rows with the operating point, and the inertia or inertia constant unless the ship's rows already have it."""
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
    place = say("speed and brake torque" if signal == ENGINE_SIDE else "speed and gauge torque")
    rows = [(say("operating point"), "", say.number(", ".join(told)), "", place)]
    if fingerprint.why_not:
        return rows
    by_vessel = any("seen_from" not in row for row in fingerprint.si.values())
    known = whole_ship(fingerprint).parameters
    for name in ("tau_n", "tau_prop"):
        estimate = known.get(name)
        if estimate is None or estimate.value is None or not ratio or by_vessel:
            continue
        inertia = scaled(estimate, abs(torque_Nm / turning), "kg m2")
        rows.append(_fact(short_name(name, say), inertia, say("seen from the torque's place"), say))
    whole = known.get("tau_n")
    if whole is not None and whole.value is not None and feeds_a_generator(fingerprint, experiments, vessel):
        name = say("inertia constant")
        rows.append(
            _fact(name, scaled(whole, 0.5, "s"), say("on the power of the operating point"), say, "H")
        )
    return rows


def _fact(name: str, estimate: Estimate, more: str, say: Say, symbol: str = "") -> Fact:
    (row,) = rounded_rows({"": estimate})
    value = f"{say.number(row.value)}\u00a0{unit_shown(row.unit)}"
    return name, symbol, value, interval(row, estimate, say), more


LARGE_IN, SMALL_IN = 1.9, 1.1
"""Height of a panel [in]: large if the model does not describe the engine's side, else small."""
BARS = 2.0
"""Half-length of an error bar, in standard errors."""


def section(fingerprint: Fingerprint, pictures: Pictures, say: Say) -> Iterable[str]:
    """Yield the table of the load's side, and the picture of the engine torque's residual."""
    if fingerprint.load_side:
        yield piece(
            "heading", say("The load's side by itself (speed and torque alone, no model of the drive)")
        )
        pairs = [*beside_the_whole(fingerprint)]
        known = any(whole.low for _, whole in pairs)
        rows: list[Sequence[Cell | str]] = []
        for alone, whole in pairs:
            own = (Cell(alone.name, code=True), say.name(alone.name), number(alone.value))
            others = (number(ends(alone, say)), number(whole.value), *[number(ends(whole, say))] * known)
            rows.append([*own, *others, unit_shown(alone.unit)])
        head = say.each("symbol", "name", "by itself", "95 % interval", "whole model")
        head += [*[say("95 % interval")] * known, say("unit")]
        yield table(say("the load's side by itself and by the whole model"), head, rows)
        yield paragraph(say(agreement(fingerprint)))
    if fingerprint.engine_described and (drawn := beyond(fingerprint, pictures, say)):
        yield drawn


def beyond(fingerprint: Fingerprint, pictures: Pictures, say: Say) -> str:
    """Heading, and picture of the residual of the drive's torque; empty if the residual was not determined."""
    curves = fingerprint.adequate.get("engine_curves")
    if not curves or not all(curve["at"] for curve in curves.values()):
        return ""
    heading = piece("heading", say("What the drive's torque has beyond the model"))
    return heading + pictures.draw(
        len(curves),
        lambda axes: _draw(axes, curves),
        say(
            "Mean of it against the speed error that the governor sees, and against the rate at which the actuator moves; "
            "bars of two standard errors. It is zero where the model describes drive and governor. A dead band, or a gain "
            "that grows in steps, makes an S through zero error. A torque limit bends both ends of a curve to the same "
            "side. A limit of the actuator's rate makes a step at zero rate, a slower way down bends one end only."
        ),
        height=SMALL_IN if fingerprint.engine_described else LARGE_IN,
        width=NARROW,
        sharex=False,
    )


def ends(row: Row, say: Say) -> str:
    """Format the interval of a row; empty if it has none."""
    return say("{low} to {high}", low=row.low, high=row.high) if row.low else ""


def _draw(axes: Sequence[Axes], curves: Mapping[str, Mapping[str, Sequence[float]]]) -> None:
    labels = {"error": "governor's speed error [%]", "slope": "rate of the actuator [%/s]"}
    for ax, (name, curve), colour in zip(axes, curves.items(), (BLUE, ORANGE), strict=True):
        at, torque, std = (100.0 * np.asarray(curve[key]) for key in ("at", "torque", "std"))
        ax.axhline(0.0, color=GREY, lw=1.0)
        ax.errorbar(at, torque, BARS * std, fmt="o-", color=colour, ms=4, lw=1.0, capsize=2)
        dress(ax, "torque [%]", legend=False)
        ax.set_xlabel(labels[name])
