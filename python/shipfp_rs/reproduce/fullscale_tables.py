"""Tables 6.8 to 7.3 and eq. 7.9 of the thesis, recomputed: results of steady speeds, drawings and further experiments.

Also here:

- Figures of section 6.3: the loggers' channels and their faults, on the simulated tug.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import curve_fit

from shipfp_rs import published
from shipfp_rs.assessment.closed_loop import structure_of
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.inspection.checks import amplitude_spectrum, rates_of, static_torque
from shipfp_rs.logs.log import Log
from shipfp_rs.plot import style
from shipfp_rs.reproduce import Row, Way, fits_to
from shipfp_rs.reproduce.pictures import Picture, Stretch, dress, figure_of, line
from shipfp_rs.reproduce.trial import VESSEL, excitation, simulated
from shipfp_rs.reproduce.virtual_data import model_of
from shipfp_rs.signals import steps
from shipfp_rs.simulation.raw_log import EQUATION_6_7, TABLE_6_6, Kind, Sensors, Truth, simulate_raw_log
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import DEVIATIONS_95, Array
from shipfp_rs.support.units import Calibration
from shipfp_rs.tacho import pulse_times, reflector_angles, speed_from_pulses
from shipfp_rs.vessel.vessel import Vessel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


THRESHOLD_V = 2.0
"""Voltage level at which the thesis measured pulse periods (section 6.3.2)."""
STEADY_S = 60.0
FAST_RPM = 1684.0
"""Highest steady speed of the trial (Table 6.8)."""
_DOUBLE = (
    "A sample that falls back below 2 V makes a second crossing and a peak of the speed; with one threshold to arm and "
    "another to fire there is none."
)
_BROKEN = "A pulse that fails doubles an interval; it is put back and flagged."
SENSED = "Simulated tug (stan-tug-1205-full) and sensors; the logs were never published."


@lru_cache(maxsize=2)
def _log(faults: tuple[Kind, ...], what: str = "steady") -> tuple[Log, Truth]:
    vessel = Vessel.load(VESSEL)
    moves = steps([0.0], 5.0, rate_hz=100.0, name="rest") if what == "steady" else excitation(what)
    speed = FAST_RPM if what == "steady" and "B" in faults else None
    sensors = Sensors(faults_per_minute={**Sensors().faults_per_minute, "B": 20.0})
    return simulate_raw_log(
        vessel, moves, sensors=sensors, faults=faults, n_e_rpm=speed, steady_s=STEADY_S, pause_s=1.0
    )


def _volts(log: Log, channel: str, scale: Callable[[Array], Array] = np.asarray) -> tuple[Array, Array]:
    volts = np.asarray(log.read(channel), dtype=np.float64)
    return np.arange(len(volts)) / Sensors().rate_hz, scale(volts)


def _simple_speed(log: Log, channel: str, pulses: int) -> tuple[Array, Array]:
    """Engine speed [rpm] from the periods between all rises through 2 V, as in section 6.1 (eq. 6.8)."""
    time, volts = _volts(log, channel)
    rises = np.flatnonzero((volts[:-1] < THRESHOLD_V) & (volts[1:] >= THRESHOLD_V))
    share = (THRESHOLD_V - volts[rises]) / (volts[rises + 1] - volts[rises])
    at = time[rises] + share * (time[1] - time[0])
    return at[1:], 60.0 * Vessel.load(VESSEL).gearbox.ratio / pulses / np.diff(at)


def _repaired_speed(log: Log) -> tuple[Array, Array]:
    times = pulse_times(np.asarray(log.read("PTM_4")), Sensors().rate_hz)
    angles = reflector_angles(times.times_s, 4)
    found = speed_from_pulses(times.times_s, 4, angles=angles if angles.ok else None)
    return found.time_s, 60.0 * Vessel.load(VESSEL).gearbox.ratio * found.speed_rps


def _shown(
    ax: Axes, samples: tuple[Array, Array], stretch: Stretch, ylabel: str, color: str = style.BLUE, **how: Any
) -> None:
    """Draw a stretch of a channel or of a speed without a legend."""
    time, values = samples
    inside = (time > stretch[0]) & (time < stretch[1])
    line(ax, time[inside], values[inside], color, **how)
    dress(ax, ylabel, "time [s]", legend=False)


def _two_trains(material: Any, figure: Figure) -> str:
    ax, (log, _), stretch = figure.subplots(), _log(()), (20.0, 22.0)
    for channel, pulses, color, ls in (("PTM_1", 1, style.BLUE, "-"), ("PTM_4", 4, style.ORANGE, "--")):
        how: dict[str, Any] = {"ls": ls, "label": f"{pulses} a turn", "drawstyle": "steps-pre"}
        _shown(ax, _simple_speed(log, channel, pulses), stretch, "", color, **how)
    label = "4 a turn, reflectors' angles divided out"
    _shown(ax, _repaired_speed(log), stretch, "", style.GREEN, marker=".", label=label)
    style.dress(ax, "engine speed [rpm]")
    return (
        "Misplaced reflectors make every fourth interval differ by the same share; their angles, found from steady running, "
        f"take that away. {SENSED}"
    )


def _steady_torque(material: Any, figure: Figure) -> str:
    torque = _volts(_log(())[0], "U_torque", TABLE_6_6)
    _shown(figure.subplots(), torque, (20.0, 21.5), "shaft torque [Nm]", style.GREEN, lw=0.8)
    return f"Constant set point. {SENSED}"


def _spectrum(material: Any, figure: Figure) -> str:
    ax = figure.subplots()
    time, torque = _volts(_log(())[0], "U_torque", TABLE_6_6)
    frequency, amplitude = amplitude_spectrum(torque[time < STEADY_S], Sensors().rate_hz)
    shown = (frequency > 1.0) & (frequency < 100.0)
    ax.loglog(frequency[shown], amplitude[shown], color=style.GREEN, lw=0.8, label="simulated")
    for peak in published.torque_spectrum_peaks():
        ax.axvline(peak.frequency_hz, color=style.RED, lw=0.8, ls="--")
        at = (peak.frequency_hz, 1.0)
        how: dict[str, Any] = {"color": style.RED, "fontsize": "small", "rotation": 90, "va": "top"}
        place: dict[str, Any] = {
            "xycoords": ("data", "axes fraction"),
            "xytext": (2, -4),
            "textcoords": "offset points",
        }
        ax.annotate(f"{peak.frequency_hz:g} Hz, {peak.source}", at, **place, **how)
    dress(ax, "amplitude of the torque [Nm]", "frequency [Hz]", legend=False)
    return (
        f"Dashed: the peaks of Table 6.9, measured on board. Heights were printed in a figure only. {SENSED}"
    )


def _fault_on_pulses(material: Any, figure: Figure, *, kind: Kind, caption: str) -> str:
    upper, lower = figure.subplots(2, 1, sharex=True)
    log, truth = _log((kind,))
    at = float(truth.faults[kind]["PTM_4"][1, 0])
    stretch = (at - 0.25, at + 0.25)
    for speed, color, label in (
        (_simple_speed(log, "PTM_4", 4), style.RED, "every rise through 2 V"),
        (_repaired_speed(log), style.GREEN, "hysteresis and repair"),
    ):
        _shown(upper, speed, stretch, "", color, label=label, marker="o", ms=3)
    _shown(lower, _volts(log, "PTM_4"), stretch, "pulses PTM_4 [V]", marker=".", ms=3, lw=0.8)
    lower.axhline(THRESHOLD_V, color=style.GREY, lw=0.8, ls="--")
    upper.set_yscale("log")
    dress(upper, "engine speed [rpm]")
    return f"{caption} {SENSED}"


def _radio(material: Any, figure: Figure) -> str:
    panels = figure.subplots(1, 2, width_ratios=(2, 1))
    log, truth = _log(("C",))
    start, stop = truth.faults["C"]["U_torque"][1]
    for ax, first, last, ylabel in (
        (panels[0], start - 20.0, start + 20.0, "shaft torque [Nm]"),
        (panels[1], start - 0.05, stop + 0.05, ""),
    ):
        _shown(ax, _volts(log, "U_torque", TABLE_6_6), (first, last), ylabel, style.GREEN, lw=0.8)
    return f"Radio saturates the receiver for some hundredths of a second. {SENSED}"


def _set_point_faults(material: Any, figure: Figure) -> str:
    upper, lower = figure.subplots(2, 1)
    log, truth = _log(("D1", "D2"), "C23")
    volts = _volts(log, "U_setpoint")
    start, stop = truth.faults["D1"]["U_setpoint"][0]
    begin = truth.faults["D2"]["U_setpoint"][0, 0]
    _shown(upper, volts, (start - 0.2, stop + 0.2), "set point [V]", lw=0.9)
    _shown(lower, volts, (begin - 0.1, begin + 0.2), "set point [V]", lw=0.9)
    upper.set_xlabel("")
    return (
        "Above a jump of the generator's relay (D1), below the mains' 50 Hz that begins with the sweep mode (D2): five "
        f"periods in 0.1 s. {SENSED}"
    )


def _even_chirp(material: Any, figure: Figure) -> str:
    ax = figure.subplots()
    log, truth = _log(("D3",), "C21")
    time, recorded = _volts(log, "U_setpoint", EQUATION_6_7)
    start, meant = truth.windows[0].start_s, excitation("C21")
    line(ax, time, recorded, style.BLUE, "recorded", lw=0.8)
    planned = float(np.median(recorded)) + meant.samples
    line(ax, start + meant.time, planned, style.GREY, "as planned", ls="--")
    dress(ax, "set point [rpm]", "time [s]")
    return f"Planned from 0.001 to 0.02 Hz, the generator kept one frequency. {SENSED}"


PICTURES: tuple[Picture[Any], ...] = (
    figure_of("6.11", "one pulse and four pulses a turn", _two_trains),
    figure_of("6.13", "torque at a constant set point", _steady_torque, 4.0),
    figure_of("6.14", "its spectrum", _spectrum, 4.6),
    figure_of("6.15", "fault A, double crossings", _fault_on_pulses, kind="A", caption=_DOUBLE),
    figure_of("6.16", "fault B, broken pulses at high speed", _fault_on_pulses, kind="B", caption=_BROKEN),
    figure_of("6.17", "fault C, radio on the torque", _radio, 4.4),
    figure_of("6.18", "faults D1 and D2 on the set point", _set_point_faults),
    figure_of("6.19", "fault D3, a chirp that stays", _even_chirp, 4.0),
)


TORQUE_COEFFICIENT = 0.02709
"""C_Q* at beta = 180 degrees, common to all five calculated torques of Table 6.8, but not printed."""
SPECTRUM_RPM = 1184.0
"""Engine speed at which the torque's spectrum was taken (section 6.3.1)."""
TORQUE_STD_NM = 25.0
"""Half the last digit of a measured torque in Table 6.8."""
BEYOND_THE_GAUGE_KG_M2 = 12.0
"""Inertia on the propeller's side of the gauge, as read from a drawing in the thesis (Figure 7.22)."""

EQUATION = "eq. 7.9"
COLUMNS = ("sines", "short chirp", "long chirp", "steps")
TABLES = {"n_e": "7.2", "M_g": "7.3"}
SIGNALS = {"shaft_speed": "n_e", "shaft_torque": "M_g"}


def before_the_fit(vessel: Vessel) -> list[Row]:
    """Return the rows of Tables 6.8, 6.9, 6.11 and 6.12."""
    return [*_static_torque(vessel), *_peaks(vessel), *_set_point_line(), *_normalisation_points()]


def cross_checks(vessel: Vessel, fingerprints: Mapping[str, Fingerprint]) -> list[Row]:
    """Return the rows of eq. 7.9: time constants and inertias from drawings, and those identified from sine fits.

    The total inertia is from the torsional vibration calculation; that of the propeller's side is J_2 = tau_prop M_s0 /
    (2 pi n_s0).
    """
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
    """Return a law's last parameter, half its 95 % interval, and the root mean square of the residuals [Nm]."""
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


def set_point_line() -> tuple[Array, Array, Calibration]:
    """Return the voltages and speeds [rpm] of Table 6.11, and the line through them."""
    points = published.set_point_calibration()
    volts = np.array([point.setpoint_v for point in points])
    speed = np.array([point.engine_speed_rpm for point in points])
    return volts, speed, Calibration.from_table(volts, speed, "rpm")


def _set_point_line() -> list[Row]:
    """Table 6.11 and eq. 6.7: the line through four steady points."""
    volts, speed, line = set_point_line()
    slope_std = 0.0 if line.covariance is None else math.sqrt(line.covariance[0][0])

    def row(case: str, way: Way, line: Calibration, notes: str = "") -> Row:
        left = {f"{at:g} V": off for at, off in zip(volts, (line(volts) - speed).tolist(), strict=True)}
        return Row("6.11", case, way, "", {"rpm/V": line.scale, "rpm at 0 V": line.offset, **left}, notes)

    told = f"line less measured speed [rpm]; slope +- {DEVIATIONS_95 * slope_std:.2f} rpm/V"
    return [row("eq. 6.7", "printed", EQUATION_6_7), row("least squares", "ours", line, told)]


def _normalisation_points() -> list[Row]:
    """Table 6.12 and the offsets of the sine fits, which are means over minutes."""
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
    """Return the printed fits [%], and fits of printed and best parameters to the trial on the simulated tug."""
    rows = []
    for printed in published.full_scale_cross_validation():
        fits = (printed.multisine_pct, printed.short_chirp_pct, printed.long_chirp_pct, printed.steps_pct)
        table, values = TABLES[SIGNALS[printed.output]], dict(zip(COLUMNS, fits, strict=True))
        rows.append(Row(table, printed.case, "printed", "thesis", values))
    for case, parameters in printed_parameters().items():
        rows += _rows(case, structure, parameters, "the printed parameters on the simulated tug")
    return rows + _rows("ii, weighted", structure_of(best), best.optimum, "the same experiments")


def printed_parameters() -> dict[str, dict[str, float]]:
    """Return the parameters of Table 7.1, case to values of the thesis's structure; v is 1, only products matter."""
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
