"""Checks that reject implausible units, calibrations and signals before a fit."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.channel_names import named
from shipfp_rs.processing.trial_channels import Channels, Level, Load, Tacho, Torque
from shipfp_rs.support import hints
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.calibration import Calibration
from shipfp_rs.support.units import FREQUENCIES, QUANTITIES, told
from shipfp_rs.vessel.vessel import Vessel

CALIBRATED_WITHIN = 0.1
"""Largest relative difference between the means of set point and speed with a correct calibration."""
CHECK = "; check unit and calibration"
LEAST_TORQUE, MOST_TORQUE = 0.002, 2.0
"""Range of a plausible mean torque, relative to the rated torque."""


def require_size(
    label: str,
    key: str,
    sensor: Torque | Load | Tacho,
    samples: Array,
    calibration: Calibration | None = None,
) -> None:
    """Reject an implausible mean of a channel; warn of an unusual one.

    Parameters
    ----------
    label, key
        Stretch of the log, and the channel's table in TRIAL.toml.
    sensor
        The table. An unusual mean that is usual with the factor of the unit alone comes from the calibration.
    samples
        Calibrated samples, shape (N,), of a source of speed in rpm.
    calibration
        Calibration of the samples.
    """
    known = QUANTITIES["speed" if isinstance(sensor, Tacho) else getattr(sensor, "quantity", "torque")]
    size = abs(float(np.nanmean(samples))) if np.isfinite(samples).any() else 0.0
    found = f"channels.{key}: {size:.4g} {known.unit} on average in {label}"
    least, most = known.usual
    if size == 0.0 or least <= size <= most:
        return
    factor = known.factors.get(told(sensor.unit), 0.0)
    alone = 0.0 if calibration is None else factor * abs(float(np.nanmean(calibration.inverse(samples))))
    if least <= alone <= most:
        raise InputError(
            f"{found}, where its unit {sensor.unit!r} alone makes {alone:.4g} {known.unit}; leave "
            f"channels.{key}.calibration out, or let it lead from {sensor.unit} to {known.unit}"
        )
    if isinstance(sensor, Load) and size < least:
        return  # it may be switched off
    least, most = known.possible
    if not least <= size <= most:
        raise InputError(
            f"{found}, where no drive train has more than {most:g} or less than {least:g}{CHECK}"
        )
    # Without the stretch, so that all windows of a trial give the same warning.
    warnings.warn(
        f"channels.{key}: some {size:.2g} {known.unit} are odd for a drive train{CHECK}",
        LogWarning,
        stacklevel=2,
    )


def require_columns(log: Log, channels: Channels) -> None:
    """Reject a column that is not in the log, by its key."""
    tables = {key: getattr(channels, key) for key in type(channels).model_fields}
    columns = {f"{key}.column": table.column for key, table in tables.items() if table is not None}
    for name, tacho in (channels.__pydantic_extra__ or {}).items():
        if tacho.kind != "edges":
            columns[f"{name}.column"] = tacho.column
        if tacho.quadrature is not None:
            columns[f"{name}.quadrature"] = tacho.quadrature
    for key, column in columns.items():
        try:
            log.channel(column)
        except InputError as error:
            raise InputError(f"channels.{key}: {error}") from error


def require_unit(log: Log, key: str, sensor: Level) -> None:
    """Reject a calibration for another unit than the log's."""
    channel, given = log.channel(sensor.column), told(sensor.unit)
    by_name = named(channel).unit
    # A unit at the end of a name only counts if the trial has another unit of the same quantity.
    same = any({by_name, given} <= known.factors.keys() for known in QUANTITIES.values())
    recorded = channel.unit or (by_name if same else "")
    if recorded and recorded != given:
        raise InputError(
            f"{log.name}: channel {sensor.column!r} is in {recorded!r}, channels.{key}.unit says {sensor.unit!r}; "
            "give the log's unit and a calibration for it"
        )


def require_sense(
    label: str,
    signals: Mapping[str, Array],
    vessel: Vessel,
    source: tuple[str, Tacho] | None = None,
) -> None:
    """Reject signals without samples, and calibrations wrong by a factor such as 1000 between V and mV.

    `source` is the name and the table of the source of speed.
    """
    mean = {}
    for name, values in signals.items():
        if np.isnan(values).all():
            raise InputError(f"{label}: nothing usable is left of {name!r}; choose another stretch")
        mean[name] = float(np.nanmean(values))
    if "n_set" in mean and abs(mean["n_set"] / mean["n_e"] - 1.0) > CALIBRATED_WITHIN:
        raise InputError(
            f"channels.set_point: {mean['n_set']:.4g} rpm on average in {label}, where the engine turns "
            f"{mean['n_e']:.4g} rpm{_slip_of_speed(mean['n_set'] / mean['n_e'], vessel.gearbox.ratio, source)}"
        )
    for name in mean.keys() & {"M_b", "M_s", "M_g"}:
        _require_rating("torque", f"on average in {label}", mean[name], vessel, by_engine=name == "M_b")


def require_load(windows: Sequence[Mapping[str, Array]], vessel: Vessel) -> None:
    """Reject a load that is not near the engine's rating in any window; it may be switched off in some."""
    loads = [np.abs(one["M_load"]) for one in windows if "M_load" in one]
    if largest := max((float(np.nanmax(load)) for load in loads if np.isfinite(load).any()), default=0.0):
        _require_rating("load", "at most", largest, vessel)


def _require_rating(
    key: str, where: str, torque_Nm: float, vessel: Vessel, *, by_engine: bool = False
) -> None:
    """Reject a torque far from the engine's rating, at the engine or at the shaft behind a gearbox."""
    if not vessel.given("engine.rated_power_kW", "engine.rated_speed_rpm"):
        return
    rated = vessel.engine.rated_power_kW * 1e3 / (2.0 * math.pi * vessel.engine.rated_speed_rpm / 60.0)
    limit = rated if by_engine else rated * vessel.gearbox.ratio
    least, most = LEAST_TORQUE * limit, MOST_TORQUE * limit
    if not least < abs(torque_Nm) < most:
        hint = hints.likely(abs(torque_Nm), least, most, hints.TORQUE)
        raise InputError(
            f"channels.{key}: {torque_Nm:.4g} Nm {where}, where the engine's rating makes {limit:.4g} Nm{hint}{CHECK}"
        )


def _slip_of_speed(ratio: float, gear_ratio: float, source: tuple[str, Tacho] | None) -> str:
    """Likely cause if the set point is `ratio` times the engine speed, where 1 is expected."""
    name, kind = ("", "pulses") if source is None else (source[0], source[1].kind)
    count = (
        f"channels.{name}.pole_pairs" if source is not None and told(source[1].unit) in FREQUENCIES else ""
    )
    if count and ratio < 1.0 and abs(ratio * (times := round(1.0 / ratio)) - 1.0) < CALIBRATED_WITHIN:
        return f"; a machine of {times} times as many pairs of poles? check {count}"
    if hint := hints.likely_ratio(ratio, hints.SPEED_RPM):
        return f"{hint} check channels.set_point.calibration"
    # A wrong number of pulses is whole; a gear ratio may be near one.
    wrong = {"the propeller's shaft for the engine's, or the other way round? check shaft": gear_ratio}
    if kind in ("pulses", "edges"):
        wrong |= {f"a number of pulses wrong by {k}? check pulses_per_rev": float(k) for k in range(2, 9)}
    off = {what: abs(max(ratio, 1.0 / ratio) / factor - 1.0) for what, factor in wrong.items()}
    nearest = min(off, key=off.__getitem__)
    if off[nearest] < CALIBRATED_WITHIN:
        return f"; {nearest} of the {'pulse trains' if kind in ('pulses', 'edges') else 'source of speed'}"
    return (
        CHECK
        if source is None
        else f"; check unit and calibration of both, channels.set_point and channels.{name}"
    )
