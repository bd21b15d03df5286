"""Units, calibrations and signals that can't be right, told in one line before anything is fitted to them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.log import Log
from shipfp_rs.trial import SetPoint, Torque
from shipfp_rs.vessel import Vessel

Array = npt.NDArray[np.float64]

CALIBRATED_WITHIN = 0.1
"""Relative difference between the means of set point and speed above which a calibration is wrong."""
LEAST_TORQUE, MOST_TORQUE = 0.002, 2.0
"""Shares of the rated torque between which a mean torque makes sense."""


def require_unit(log: Log, key: str, sensor: SetPoint | Torque) -> None:
    """Refuse a calibration for another unit than the log's."""
    recorded = log.channel(sensor.column).unit
    if recorded and recorded != sensor.unit:
        raise InputError(
            f"{log.name}: channel {sensor.column!r} is in {recorded!r}, channels.{key}.unit says {sensor.unit!r}; "
            "give the log's unit and a calibration for it"
        )


def require_sense(label: str, signals: Mapping[str, Array], vessel: Vessel) -> None:
    """Catch signals without samples, and calibrations wrong by a factor such as the thousand between V and mV."""
    rated = vessel.engine.rated_power_kW * 1e3 / (2.0 * math.pi * vessel.engine.rated_speed_rpm / 60.0)
    rated_torque = {"M_b": rated, "M_s": rated * vessel.gearbox.ratio, "M_g": rated * vessel.gearbox.ratio}
    mean = {}
    for name, values in signals.items():
        if np.isnan(values).all():
            raise InputError(f"{label}: nothing usable is left of {name!r}; choose another stretch")
        mean[name] = float(np.nanmean(values))
    if abs(mean["n_set"] / mean["n_e"] - 1.0) > CALIBRATED_WITHIN:
        raise InputError(
            f"channels.set_point: {mean['n_set']:.4g} rpm on average in {label}, where the engine turns "
            f"{mean['n_e']:.4g} rpm; check unit and calibration"
        )
    for name, limit in rated_torque.items():
        if name in mean and not LEAST_TORQUE * limit < abs(mean[name]) < MOST_TORQUE * limit:
            raise InputError(
                f"channels.torque: {mean[name]:.4g} Nm on average in {label}, where the engine's rating makes "
                f"{limit:.4g} Nm; check unit and calibration"
            )
