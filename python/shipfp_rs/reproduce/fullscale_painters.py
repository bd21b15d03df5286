"""Painters of the figures of chapters 6 and 7: each draws on a figure and returns its caption."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs import plot, published
from shipfp_rs.assessment.prediction import predict_response, structure_of
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.plot import style
from shipfp_rs.reproduce import Reproduction
from shipfp_rs.reproduce.fullscale import WEIGHTED, best_of, measured_response, thesis_structure
from shipfp_rs.reproduce.fullscale_tables import BEYOND_THE_GAUGE_KG_M2
from shipfp_rs.reproduce.fullscale_trial import AMPLITUDE_RPM, VESSEL, simulated
from shipfp_rs.reproduce.fullscale_validation import printed_parameters
from shipfp_rs.reproduce.fullscale_verdict import bic, chi_squared
from shipfp_rs.reproduce.pictures import Stretch, legend_above, stretches_of
from shipfp_rs.signals import sine_sequence
from shipfp_rs.simulation.sensors import EQUATION_6_7
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.calibration import Calibration
from shipfp_rs.support.quantiles import DEVIATIONS_95
from shipfp_rs.vessel.vessel import Vessel

if TYPE_CHECKING:
    from matplotlib.figure import Figure


BODE_HZ = np.geomspace(2e-3, 6.0, 300)
DEVIATIONS = {"n_e": r"$\delta n^*$ [-]", "M_g": r"$\delta M^*$ [-]"}
SIMULATED = (
    "The logs were never published: this is the plan of Table 6.7 on the simulated tug (stan-tug-1205-full), seen by "
    "perfect sensors."
)
LIVELY_HZ = np.geomspace(0.2, 20.0, 16)
"""Sines of Figure 7.5."""
SETTLED_S, MEASURED_PERIODS = 15.0, 10
PLAINER: Mapping[str, Mapping[str, object]] = {
    "all elements": {},
    "no torque ramp": {"engine.torque_rate_Nm_s": None},
    "no ramp, governor not once a firing": {"engine.torque_rate_Nm_s": None, "governor.once_a_firing": False},
}
"""Variants of the drive train: names of elements and what they are set to."""


class Material:
    """What several figures draw, each made once."""

    def __init__(self, found: Reproduction) -> None:
        self.rows = found.rows
        self.fingerprints = found.fingerprints
        self.measured = measured_response(1.637)
        self._answers: dict[str, dict[str, Mapping[str, Array]]] = {}
        self.best: Fingerprint = best_of(found)

    @cached_property
    def curves(self) -> dict[str, FrequencyResponse]:
        """Responses of the printed parameter sets."""
        thesis = thesis_structure()
        curves = {}
        for case, values in printed_parameters().items():
            response, _ = thesis.equations.response(values, BODE_HZ, ())
            curves[case] = FrequencyResponse(case, BODE_HZ, dict(zip(("n_e", "M_g"), response, strict=True)))
        return curves

    def answers(self, experiment: str) -> dict[str, Mapping[str, Array]]:
        """What the printed sets and our best structure make of an experiment on the simulated tug."""
        if experiment not in self._answers:
            record, thesis = simulated(experiment), thesis_structure()
            sets = {
                case: simulated_about(thesis, values, record) for case, values in printed_parameters().items()
            }
            ours = simulated_about(structure_of(self.best), self.best.settings["optimum"], record)
            self._answers[experiment] = sets | {"ours": ours}
        return self._answers[experiment]

    def fits(self, experiment: str) -> str:
        """Fits to an experiment in words, from Tables 7.2 and 7.3."""
        fits = {
            (row.table, row.case): row.parameters[experiment]
            for row in self.rows
            if row.table in {"7.2", "7.3"} and row.way == "ours"
        }
        cases = [case for table, case in fits if table == "7.2"]
        return ", ".join(
            f"{fits['7.2', case]:.1f}/{fits['7.3', case]:.1f} % ({'ours' if case == WEIGHTED else case})"
            for case in cases
        )


def set_point_line(material: Material, figure: Figure) -> str:
    """Figure 6.20."""
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    points = published.set_point_calibration()
    volts = np.array([point.setpoint_v for point in points])
    speed = np.array([point.engine_speed_rpm for point in points])
    ours = Calibration.from_table(volts, speed, "rpm")
    line = np.linspace(-6.5, -2.5, 50)
    for calibration, color, label in (
        (EQUATION_6_7, style.GREY, "eq. 6.7"),
        (ours, style.BLUE, "least squares"),
    ):
        upper.plot(line, calibration(line), color=color, label=label)
        lower.plot(line, calibration(line) - ours(line), color=color)
    error = DEVIATIONS_95 * ours.standard_error(line)
    lower.fill_between(line, -error, error, color=style.BLUE, alpha=0.2, lw=0.0)
    upper.plot(volts, speed, "o", color=style.ORANGE, label="Table 6.11")
    lower.plot(volts, speed - ours(volts), "o", color=style.ORANGE)
    style.dress(upper, "engine speed [rpm]")
    style.dress(lower, "off the line [rpm]", legend=False)
    lower.set_xlabel("set point [V]")
    return (
        f"{ours.scale:.2f} rpm/V and {ours.offset:.2f} rpm by least squares, with its 95 % band below; the line of eq. 6.7 "
        "lies within it."
    )


def measured_bode(material: Material, figure: Figure, *, signal: str) -> str:
    """Figures 7.6 and 7.7."""
    panels = [*figure.subplots(2, 1, sharex=True)]
    whole = measured_response()
    points = FrequencyResponse(
        "",
        whole.frequency_hz,
        {signal: whole.response[signal]},
        {signal: whole.amplitude_std[signal]},
        {signal: whole.phase_std[signal]},
    )
    model = predict_response(material.best, material.measured)
    plot.bode(points, FrequencyResponse("", model.frequency_hz, {signal: model.response[signal]}), panels)
    return (
        "Points: sine fits of Tables E.1 to E.3 with two standard deviations; phases above 0.085 Hz are void, since each "
        "channel was fitted with a frequency of its own. Line: extended structure with both dead times, fitted to "
        "the points up to 1.637 Hz."
    )


def identified_bode(material: Material, figure: Figure, *, signal: str) -> str:
    """Figures 7.15 and 7.16."""
    panels = [*figure.subplots(2, 1, sharex=True)]
    model = predict_response(material.best, material.measured)
    plot.responses({"ours": model, **material.curves}, signal, panels)
    measured = material.measured
    panels[0].plot(measured.frequency_hz, np.abs(measured.response[signal]), "k.", ms=6, label="sine fits")
    sound = measured.phase_std[signal] < 1.0
    expected = np.interp(
        measured.frequency_hz, model.frequency_hz, np.degrees(np.unwrap(np.angle(model.response[signal])))
    )
    angle = np.degrees(np.angle(measured.response[signal]))
    angle += 360.0 * np.round((expected - angle) / 360.0)
    panels[1].plot(measured.frequency_hz[sound], angle[sound], "k.", ms=6)
    panels[0].get_legend().remove()
    legend_above(figure, panels[0])
    return (
        "The thesis draws cases ii to iv on top of each other; their printed parameters are three different systems. Only "
        "phases that are known are drawn."
    )


def record(
    material: Material,
    figure: Figure,
    *,
    experiment: str,
    signals: Sequence[str],
    stretches: Sequence[Stretch],
    caption: str = "",
) -> str:
    """Figures 7.1 to 7.4 and 7.8 to 7.13."""
    stretches_of(simulated(experiment), figure, signals, stretches)
    return f"{caption} {SIMULATED}".strip()


def step_record(material: Material, figure: Figure) -> str:
    """Figure 7.14."""
    plot.time_series(simulated("steps"), [*figure.subplots(2, 1, sharex=True)])
    return f"Steps of 1 V from -3 V to -6 V and back. {SIMULATED}"


def lively(material: Material, figure: Figure) -> str:
    """Figure 7.5, simulated in place of drawn by hand."""
    ax = figure.subplots()
    vessel = Vessel.load(VESSEL)
    for (label, changes), color in zip(PLAINER.items(), style.COMPARED, strict=False):
        ship = vessel.replace(changes) if changes else vessel
        size = [abs(_answer(ship, frequency)) for frequency in LIVELY_HZ]
        ax.plot(LIVELY_HZ, size, "o-", ms=3, color=color, label=label)
    structure = structure_of(material.best)
    response, _ = structure.equations.response(material.best.settings["optimum"], LIVELY_HZ, ())
    ax.plot(LIVELY_HZ, np.abs(response[1]), color=style.GREY, lw=3.0, zorder=0, label="linear, ours")
    ax.set_xscale("log")
    ax.set_xlabel("frequency [Hz]")
    style.dress(ax, "torque over set point [-]")
    return (
        f"Gauge torque at the frequency of the sine, {AMPLITUDE_RPM:g} rpm through the simulated tug, beside the linear "
        "structure fitted to the published sine fits. The thesis sketches what ramps, sampling and single firings would do; "
        "the rise at 11 Hz is the shaft that twists."
    )


def _answer(ship: Vessel, frequency_hz: float) -> complex:
    """Ratio of the gauge torque's line at a frequency to the set point's, after settling."""
    rate = 400.0
    settling = int(np.ceil(SETTLED_S * frequency_hz))
    sines = sine_sequence([frequency_hz], settling + MEASURED_PERIODS, AMPLITUDE_RPM, rate_hz=rate)
    experiment = simulate(ship, sines)
    part = experiment.window(settling / frequency_hz, experiment.duration)
    turn = np.exp(-2j * np.pi * frequency_hz * part.time)
    return complex((part.normalised("M_g") @ turn) / (part.dn_set @ turn))


def against(
    material: Material,
    figure: Figure,
    *,
    experiment: str,
    stretch: Stretch,
    cases: Sequence[str],
) -> str:
    """Figures 7.17 to 7.21."""
    panels = figure.subplots(2, 1, sharex=True)
    data, answers = simulated(experiment), material.answers(experiment)
    inside = (data.time >= stretch.start_s) & (data.time < stretch.stop_s)
    for ax, signal in zip(panels, DEVIATIONS, strict=True):
        time = data.time[inside]
        measured = data.normalised(signal)[inside]
        ax.plot(*style.envelope(time, measured), color=style.GREY, lw=3.0, label="tug")
        for label, color in zip(cases, style.COMPARED, strict=False):
            ax.plot(*style.envelope(time, answers[label][signal][inside]), color=color, lw=1.0, label=label)
        style.dress(ax, DEVIATIONS[signal], legend=False)
    panels[-1].set_xlabel("time [s]")
    legend_above(figure, panels[0])
    fits = material.fits(experiment)
    return f"i to iv: printed parameters. Fit of speed/torque to the whole experiment: {fits}. {SIMULATED}"


def inertias(material: Material, figure: Figure) -> str:
    """Figure 7.22."""
    ax = figure.subplots()
    vessel = Vessel.load("stan-tug-1205")
    rows = {row.case: row for row in material.rows if row.table == "eq. 7.9" and row.way == "ours"}
    fitted = rows[WEIGHTED]
    found, tau_prop = fitted.parameters["J_2 [kg m2]"] or 0.0, fitted.parameters["tau_prop [s]"] or 1.0
    low, high = (bound / tau_prop * found for bound in fitted.intervals["tau_prop [s]"])
    bars = (
        ("all, torsional calculation", vessel.shaft.inertia_kg_m2, style.GREY),
        ("propeller's side of the gauge, sine fits", found, style.BLUE),
        ("entrained water of it, Schwanecke", vessel.entrained_water_inertia(), style.GREEN),
        ("beyond the gauge, read off by the thesis", BEYOND_THE_GAUGE_KG_M2, style.ORANGE),
    )
    for place, (label, value, color) in enumerate(reversed(bars)):
        ax.barh(place, value, color=color, height=0.55)
        ax.text(value + 1.0, place, f"{value:.1f} kg m$^2$", va="center")
        ax.text(0.5, place + 0.4, label, va="center", fontsize="small")
    ax.errorbar(found, 2, xerr=[[found - low], [high - found]], color="k", capsize=3)
    ax.set_yticks([])
    ax.set_xlabel("inertia seen from the propeller [kg m$^2$]")
    ax.set_xlim(0.0, 75.0)
    style.dress(ax, "", legend=False)
    return (
        "What the gauge sees behind it is tau_prop M_s0 / (2 pi n_s0), with its 95 % interval. The thesis expected the "
        "whole inertia less 12 kg m2 in tau_n; its structure, fitted to gauge torque, can only find the propeller's side."
    )


def causes(material: Material, figure: Figure) -> str:
    """Figure 7.23: in place of a list of possible causes, how much each accounts for."""
    ax = figure.subplots()
    found = [value for name, value in material.fingerprints.items() if name.startswith(f"{WEIGHTED}:")]
    best = min(map(bic, found))
    for place, fit in enumerate(reversed(found)):
        left = chi_squared(fit)
        ax.barh(place, left, color=style.BLUE if bic(fit) == best else style.GREY, height=0.6)
        ax.text(left * 1.05, place, f"{left:.0f}", va="center")
    ax.set_yticks(range(len(found)), [fit.structure["name"] for fit in reversed(found)])
    ax.set_xscale("log")
    ax.set_xlim(10.0, 3000.0)
    freedom = found[-1].fit["overall"]["degrees_of_freedom"] or 0.0
    ax.axvline(freedom, color=style.RED, lw=1.0, ls="--", label=f"{freedom:.0f} degrees of freedom")
    ax.set_xlabel("chi-squared of S2 to S13 [-]")
    style.dress(ax, "")
    return (
        "Each cause that the thesis lists as possible, added in turn: the gauge's place, the propeller's exponent, the dead "
        "times of the loop and of the set point's path. Where chi-squared is near the degrees of freedom nothing is left "
        "to explain."
    )
