"""Tables 6.8 to 7.3 and eq. 7.9 of the thesis, recomputed from steady speeds, drawings and simulated experiments."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict

import numpy as np
from scipy.optimize import curve_fit

from shipfp_rs import published
from shipfp_rs.assessment.closed_loop import structure_of
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.inspection.checks import rates_of, static_torque
from shipfp_rs.reproduce import Row, Way, fits_to
from shipfp_rs.reproduce.trial import simulated
from shipfp_rs.reproduce.virtual_data import model_of
from shipfp_rs.simulation.raw_log import EQUATION_6_7
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import DEVIATIONS_95, Array
from shipfp_rs.support.units import Calibration
from shipfp_rs.vessel.vessel import Vessel

TORQUE_COEFFICIENT = 0.02709
"""C_Q* at beta = 180 degrees; the thesis does not print it, but all five calculated torques of Table 6.8 imply it."""
SPECTRUM_RPM = 1184.0
"""Engine speed of the measured torque spectrum (section 6.3.1)."""
TORQUE_STD_NM = 25.0
"""Half a unit of the last digit that Table 6.8 gives of measured torques."""
BEYOND_THE_GAUGE_KG_M2 = 12.0
"""Inertia on the propeller's side of the gauge, read from a drawing in the thesis (Figure 7.22)."""

EQUATION = "eq. 7.9"
COLUMNS = ("sines", "short chirp", "long chirp", "steps")
TABLES = {"n_e": "7.2", "M_g": "7.3"}
SIGNALS = {"shaft_speed": "n_e", "shaft_torque": "M_g"}


def before_the_fit(vessel: Vessel) -> list[Row]:
    """Return the rows of Tables 6.8, 6.9, 6.11 and 6.12."""
    return [*_static_torque(vessel), *_peaks(vessel), *_set_point_line(), *_normalisation_points()]


def cross_checks(vessel: Vessel, fingerprints: Mapping[str, Fingerprint]) -> list[Row]:
    """Return the rows of eq. 7.9: time constants and inertias from drawings, and those identified from sine fits."""
    # The total inertia is from the torsional vibration calculation.
    # The inertia of the propeller's side is J_2 = tau_prop M_s0 / (2 pi n_s0).
    per_inertia = 2.0 * math.pi * vessel.nominal_shaft_speed / float(vessel.operating_point.M_s_Nm or 0.0)
    total, water = vessel.shaft.inertia_kg_m2, vessel.entrained_water_inertia()
    beyond = BEYOND_THE_GAUGE_KG_M2
    drawings = {"tau_n [s]": total * per_inertia, "I_p [kg m2]": total}
    left = f"{(total - beyond) * per_inertia:.2f} s; it expects about 1 s"
    less = f"less the {beyond:g} kg m2 that the thesis puts beyond the gauge {left}"
    rows = [
        Row(EQUATION, "torsional calculation", "printed", "", {"tau_n [s]": 1.17, "I_p [kg m2]": 62.3}),
        Row(EQUATION, "torsional calculation", "ours", "", drawings, less),
    ]
    for name, fingerprint in fingerprints.items():
        times = {key: fingerprint[key] for key in ("tau_n", "tau_prop")}
        values = {f"{key} [s]": estimate.value for key, estimate in times.items()}
        intervals = {f"{key} [s]": estimate.ci95 for key, estimate in times.items() if estimate.ci95}
        tau_prop = times["tau_prop"].value
        values["J_2 [kg m2]"] = None if tau_prop is None else tau_prop / per_inertia
        low, high = (bound / per_inertia for bound in times["tau_prop"].ci95 or (math.nan, math.nan))
        notes = (
            f"J_2, the propeller's side, {low:.1f} to {high:.1f} kg m2 (95 %), {100 * low / total:.0f} to "
            f"{100 * high / total:.0f} % of the torsional total; {water:.2f} kg m2 of it are entrained water by "
            "Schwanecke's formula"
        ) + ("" if times["tau_n"].value is not None else "; these data do not determine tau_n itself")
        structure = str(fingerprint.structure["name"])
        rows.append(Row(EQUATION, name, "ours", structure, values, notes, intervals=intervals))
    return rows


def _fitted(
    law: Callable[..., Array], speed: Array, torque: Array, start: Sequence[float]
) -> tuple[float, float, float]:
    """Fit a torque law; return its last parameter, half its 95 % interval, and the residuals' root mean square [Nm]."""
    relative, sigma = speed / speed.mean(), np.full(len(speed), TORQUE_STD_NM)
    values, covariance = curve_fit(law, relative, torque, start, sigma=sigma, absolute_sigma=True)
    left = law(relative, *values) - torque
    return float(values[-1]), DEVIATIONS_95 * math.sqrt(covariance[-1, -1]), float(np.sqrt(np.mean(left**2)))


def _static_torque(vessel: Vessel) -> list[Row]:
    """Table 6.8 by eq. 6.3 with V_a = 0."""
    points = published.static_torque()
    speed, measured, printed = np.array(
        [(point.engine_speed_rpm, point.measured_torque_nm, point.calculated_torque_nm) for point in points]
    ).T
    calculated = static_torque(vessel, speed, TORQUE_COEFFICIENT)
    error = 100.0 * (calculated - measured) / calculated
    power = _fitted(lambda n, c, p: c * n**p, speed, measured, (1700.0, 2.0))
    square = _fitted(lambda n, c, zero: c * n**2 + zero, speed, measured, (1700.0, 0.0))
    K_Q = TORQUE_COEFFICIENT * (0.7 * math.pi) ** 2 * math.pi / 8.0

    def row(case: str, way: Way, values: Iterable[float], notes: str = "") -> Row:
        columns = {f"{rpm:g} rpm": float(value) for rpm, value in zip(speed, values, strict=True)}
        return Row("6.8", case, way, "eq. 6.3" if way == "ours" else "", columns, notes)

    one = f"one C_Q* = {TORQUE_COEFFICIENT} (K_Q = {K_Q:.4f}) gives all five to {np.abs(calculated - printed).max():.1f} Nm"
    slip = (
        f"of the calculated torque; at 1184 rpm {error[2]:.2f}, printed 0.99. Measured torque goes with n^p, p = "
        "{:.3f} +- {:.3f} ({:.0f} Nm left); ".format(*power)
        + "the square alone needs a gauge zero of {:.0f} +- {:.0f} Nm ({:.0f} Nm left)".format(*square)
    )
    return [
        row("measured [Nm]", "printed", measured),
        row("calculated [Nm]", "printed", printed),
        row("calculated [Nm]", "ours", calculated, one),
        row("error [%]", "printed", (point.error_pct for point in points)),
        row("error [%]", "ours", error, slip),
    ]


def _peaks(vessel: Vessel) -> list[Row]:
    """Table 6.9 by eq. 6.4 to 6.6."""
    rates = rates_of(vessel, SPECTRUM_RPM)
    peaks = (peak.frequency_hz for peak in published.torque_spectrum_peaks())
    printed = dict(zip(rates, peaks, strict=True))
    told = [SPECTRUM_RPM * printed[name] / rate for name, rate in rates.items()]
    notes = (
        f"at {SPECTRUM_RPM:g} rpm; the peaks tell {np.mean(told):.1f} rpm, {min(told):.1f} to {max(told):.1f}"
    )
    return [
        Row("6.9", "peak [Hz]", "printed", "", printed),
        Row("6.9", "rate [Hz]", "ours", "eq. 6.4 to 6.6", rates, notes),
    ]


def _set_point_line() -> list[Row]:
    """Rows of Table 6.11 and eq. 6.7: the line through four steady points."""
    points = published.set_point_calibration()
    volts = np.array([point.setpoint_v for point in points])
    speed = np.array([point.engine_speed_rpm for point in points])
    line = Calibration.from_table(volts, speed, "rpm")
    slope_std = 0.0 if line.covariance is None else math.sqrt(line.covariance[0][0])

    def row(case: str, way: Way, line: Calibration, notes: str = "") -> Row:
        left = {f"{at:g} V": off for at, off in zip(volts, (line(volts) - speed).tolist(), strict=True)}
        return Row("6.11", case, way, "", {"rpm/V": line.scale, "rpm at 0 V": line.offset, **left}, notes)

    told = f"line less measured speed [rpm]; slope +- {DEVIATIONS_95 * slope_std:.2f} rpm/V"
    return [row("eq. 6.7", "printed", EQUATION_6_7), row("least squares", "ours", line, told)]


def _normalisation_points() -> list[Row]:
    """Rows of Table 6.12, and the offsets of the sine fits, which are means over minutes."""
    fits = [fit for fit in published.sine_fits() if fit.input_frequency_hz < 3.0]
    speed, torque = (
        np.array([fit.offset for fit in fits if fit.signal == signal])
        for signal in ("shaft_speed", "shaft_torque")
    )
    notes = f"rpm, Nm; the torque's run from {torque.min():.0f} to {torque.max():.0f} Nm: normalise each record by its own"
    means = {"n_0": float(speed.mean()), "M_s0": float(torque.mean())}
    return [
        Row("6.12", "steady at -5 V", "printed", "", {"n_0": 1183.8, "M_s0": 1725.0}, "rpm, Nm"),
        Row("6.12", "means of S2 to S13", "ours", "", means, notes),
    ]


def cross_validation(structure: Structure, best: Fingerprint) -> list[Row]:
    """Return the printed fits [%], and the fits of printed and best parameters to the trial of the simulated tug."""
    rows = []
    for printed in published.full_scale_cross_validation():
        fits = (printed.multisine_pct, printed.short_chirp_pct, printed.long_chirp_pct, printed.steps_pct)
        table, values = TABLES[SIGNALS[printed.output]], dict(zip(COLUMNS, fits, strict=True))
        rows.append(Row(table, printed.case, "printed", "thesis", values))
    for case, parameters in printed_parameters().items():
        rows += _rows(case, structure, parameters, "the printed parameters on the simulated tug")
    return rows + _rows("ii, weighted", structure_of(best), best.optimum, "the same experiments")


def printed_parameters() -> dict[str, dict[str, float]]:
    """Return the parameters of Table 7.1 in the thesis's structure, by case; v is 1, since only its products matter."""
    return {result.case: asdict(model_of(result.parameters)) for result in published.full_scale_results()}


def _rows(case: str, structure: Structure, values: Mapping[str, float], notes: str) -> list[Row]:
    found = {}
    for column in COLUMNS:
        experiment = simulated(column)
        found[column] = fits_to(experiment, simulated_about(structure, values, experiment))
    return [
        Row(table, case, "ours", structure.name, {column: found[column][signal] for column in COLUMNS}, notes)
        for signal, table in TABLES.items()
    ]
