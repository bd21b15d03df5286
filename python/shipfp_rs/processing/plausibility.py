"""Units, calibrations and signals that can't be right, refused in one line before anything is fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.trial_channels import Level
from shipfp_rs.support import hints
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.units import told
from shipfp_rs.vessel.vessel import Vessel

CALIBRATED_WITHIN = 0.1
"""A calibration is wrong where the means of set point and speed differ by more than this, relative."""
CHECK = "; check unit and calibration"
LEAST_TORQUE, MOST_TORQUE = 0.002, 2.0
"""Shares of the rated torque between which a mean torque makes sense."""


def require_unit(log: Log, key: str, sensor: Level) -> None:
    """Refuse a calibration for another unit than the log's."""
    recorded = log.channel(sensor.column).unit
    if recorded and recorded != told(sensor.unit):
        raise InputError(
            f"{log.name}: channel {sensor.column!r} is in {recorded!r}, channels.{key}.unit says {sensor.unit!r}; "
            "give the log's unit and a calibration for it"
        )


def require_sense(label: str, signals: Mapping[str, Array], vessel: Vessel) -> None:
    """Catch signals without samples, and calibrations wrong by a factor such as the thousand between V and mV."""
    rated_torque: dict[str, float] = {}
    if vessel.given("engine.rated_power_kW", "engine.rated_speed_rpm"):
        rated = vessel.engine.rated_power_kW * 1e3 / (2.0 * math.pi * vessel.engine.rated_speed_rpm / 60.0)
        rated_torque = {
            "M_b": rated,
            "M_s": rated * vessel.gearbox.ratio,
            "M_g": rated * vessel.gearbox.ratio,
        }
    mean = {}
    for name, values in signals.items():
        if np.isnan(values).all():
            raise InputError(f"{label}: nothing usable is left of {name!r}; choose another stretch")
        mean[name] = float(np.nanmean(values))
    if "n_set" in mean and abs(mean["n_set"] / mean["n_e"] - 1.0) > CALIBRATED_WITHIN:
        raise InputError(
            f"channels.set_point: {mean['n_set']:.4g} rpm on average in {label}, where the engine turns "
            f"{mean['n_e']:.4g} rpm{_slip_of_speed(mean['n_set'] / mean['n_e'], vessel.gearbox.ratio)}"
        )
    for name, limit in rated_torque.items():
        if name in mean and not LEAST_TORQUE * limit < abs(mean[name]) < MOST_TORQUE * limit:
            hint = hints.likely(abs(mean[name]), LEAST_TORQUE * limit, MOST_TORQUE * limit, hints.TORQUE)
            raise InputError(
                f"channels.torque: {mean[name]:.4g} Nm on average in {label}, where the engine's rating makes "
                f"{limit:.4g} Nm{hint}{CHECK}"
            )


def _slip_of_speed(ratio: float, gear_ratio: float) -> str:
    """What is likely wrong where the set point is `ratio` times the engine's speed, and not once."""
    if hint := hints.likely_ratio(ratio, hints.SPEED_RPM):
        return f"{hint} check channels.set_point.calibration"
    # A wrong count of pulses is a whole number; a gear ratio may be near one.
    wrong = {"the propeller's shaft for the engine's, or the other way round? check shaft": gear_ratio}
    wrong |= {f"a number of pulses wrong by {k}? check pulses_per_rev": float(k) for k in range(2, 9)}
    off = {what: abs(max(ratio, 1.0 / ratio) / factor - 1.0) for what, factor in wrong.items()}
    nearest = min(off, key=off.__getitem__)
    return f"; {nearest} of the pulse trains" if off[nearest] < CALIBRATED_WITHIN else CHECK
