"""The published tables of T. A. Tables of Martinus, "Ship fingerprinting", TU Delft, 2020, as typed rows.

Each loader returns a tuple of frozen rows in the order of the table; a field is None if the thesis prints no value.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import NoneType
from typing import NamedTuple, TypeVar, get_args, get_type_hints

Row = TypeVar("Row")


@dataclass(frozen=True)
class SineFit:
    """Sine fitted to one channel at one frequency of the multisine trial (Tables E.1-E.3); speeds in rpm of the engine.

    The thesis prints it as a + b sin(c t - d), but the data agree with a + b sin(c t + d).
    """

    signal: str
    unit: str
    input_frequency_hz: float
    offset: float
    amplitude: float
    fitted_frequency_hz: float
    phase_rad: float


@dataclass(frozen=True)
class SetPointCalibration:
    """Steady engine speed at a set-point voltage (Table 6.11)."""

    setpoint_v: float
    engine_speed_rpm: float


@dataclass(frozen=True)
class StaticTorque:
    """Measured and calculated shaft torque in steady running (Table 6.8)."""

    generator_v: float
    engine_speed_rpm: float
    measured_torque_nm: float
    calculated_torque_nm: float
    error_pct: float


class Quantity(NamedTuple):
    """A named number with its unit."""

    quantity: str
    value: float
    unit: str


class TorquePeak(NamedTuple):
    """A peak of the torque spectrum at 1184 rpm and its cause (Table 6.9)."""

    peak: int
    frequency_hz: float
    source: str


@dataclass(frozen=True)
class Result:
    """Estimates and fits of one case of an identification (Tables 5.2, 7.1); case i has the known parameters."""

    case: str
    signal: str
    duration_s: float | None
    tau_n_s: float
    g: float
    kp_over_ki_s: float
    v_kp: float
    fit_n_pct: float | None
    fit_m_pct: float | None
    validation_n_pct: float
    validation_m_pct: float

    @property
    def parameters(self) -> dict[str, float]:
        """The four parameters under their names in a fingerprint."""
        return {"tau_n": self.tau_n_s, "g": self.g, "K_p/K_i": self.kp_over_ki_s, "vK_p": self.v_kp}


@dataclass(frozen=True)
class CrossValidation:
    """Fits of one case's estimates to each experiment [%] (Tables 7.2, 7.3)."""

    case: str
    output: str
    multisine_pct: float | None
    short_chirp_pct: float | None
    long_chirp_pct: float | None
    steps_pct: float


@dataclass(frozen=True)
class FullScaleExperiment:
    """An experiment of the trial and its position in the logs (Table 6.7)."""

    name: str
    kind: str
    frequency_hz: float | None
    stop_frequency_hz: float | None
    peak_to_peak_v: float | None
    step_v: float | None
    min_v: float | None
    max_v: float | None
    dewesoft_file: str
    jvs_file: str
    jvs_start_s: float
    jvs_stop_s: float


class LogFaults(NamedTuple):
    """Kinds of fault in an experiment's two logs, separated by blanks (Table 6.10)."""

    experiment: str
    dewesoft: str
    jvs: str


class SinePeriods(NamedTuple):
    """Stretch of the virtual multisine with four periods of one frequency (Table 5.1)."""

    frequency_hz: float
    begin_s: float
    end_s: float


def sine_fits() -> tuple[SineFit, ...]:
    """Return the full-scale sine fits: 16 frequencies of set point, shaft speed, shaft torque."""
    return _rows("full_scale_sine_fits", SineFit)


def set_point_calibration() -> tuple[SetPointCalibration, ...]:
    """Return the four points of the set-point line, eq. 6.7."""
    return _rows("setpoint_calibration", SetPointCalibration)


def static_torque() -> tuple[StaticTorque, ...]:
    """Return the tug's static torques, measured and calculated."""
    return _rows("static_torque", StaticTorque)


def torque_conversion() -> tuple[Quantity, ...]:
    """Return the strain-gauge conversion of appendix D."""
    return _rows("torque_conversion", Quantity)


def torque_spectrum_peaks() -> tuple[TorquePeak, ...]:
    """Return the peaks of the tug's torque spectrum."""
    return _rows("torque_spectrum_peaks", TorquePeak)


def full_scale_results() -> tuple[Result, ...]:
    """Return the estimates from the tug's trial."""
    return _rows("full_scale_results", Result)


def full_scale_cross_validation() -> tuple[CrossValidation, ...]:
    """Return the fit of each case of the tug to the other experiments."""
    return _rows("full_scale_cross_validation", CrossValidation)


def full_scale_experiments() -> tuple[FullScaleExperiment, ...]:
    """Return the plan of the tug's trial."""
    return _rows("full_scale_experiments", FullScaleExperiment)


def log_faults() -> tuple[LogFaults, ...]:
    """Return the faults seen in the tug's logs."""
    return _rows("log_faults", LogFaults)


def virtual_schedule() -> tuple[SinePeriods, ...]:
    """Return the schedule of the virtual multisine."""
    return _rows("virtual_multisine_schedule", SinePeriods)


def virtual_operating_point() -> tuple[Quantity, ...]:
    """Return the launch's operating point and linear parameters (Tables 3.5, 3.6)."""
    return _rows("virtual_operating_point", Quantity)


def virtual_results() -> tuple[Result, ...]:
    """Return the estimates from the virtual launch."""
    return _rows("virtual_results", Result)


@cache
def _rows(table: str, row: type[Row]) -> tuple[Row, ...]:
    types = get_type_hints(row)
    source = resources.files("shipfp_rs") / "data" / "published" / f"{table}.csv"
    with source.open(encoding="utf-8") as lines:
        return tuple(
            row(**{key: _value(text, types[key]) for key, text in entry.items()})
            for entry in csv.DictReader(lines)
        )


def _value(text: str, kind: type) -> object:
    options = get_args(kind) or (kind,)
    if not text and NoneType in options:
        return None
    return options[0](text)
