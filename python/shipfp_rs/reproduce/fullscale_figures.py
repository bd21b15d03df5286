"""Figures 6.10 to 7.23 of the thesis, as far as published numbers allow; records are those of the simulated tug."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs import plot
from shipfp_rs.assessment.closed_loop import predict_response, structure_of
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.plot import style
from shipfp_rs.reproduce import Progress, Reproduction, fullscale_tables
from shipfp_rs.reproduce.fullscale import (
    USABLE_HZ,
    WEIGHTED,
    best_of,
    bic,
    chi_squared,
    ladder,
    measured_response,
    thesis_structure,
)
from shipfp_rs.reproduce.fullscale_tables import BEYOND_THE_GAUGE_KG_M2, printed_parameters, set_point_line
from shipfp_rs.reproduce.pictures import (
    DEVIATIONS,
    Picture,
    Stretch,
    against,
    bode_of_sets,
    dress,
    figure_of,
    record,
    save,
)
from shipfp_rs.reproduce.trial import AMPLITUDE_RPM, VESSEL, simulated
from shipfp_rs.signals import sine_sequence
from shipfp_rs.simulation.raw_log import EQUATION_6_7
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.support.arrays import DEVIATIONS_95, Array
from shipfp_rs.vessel.vessel import Vessel

if TYPE_CHECKING:
    from matplotlib.figure import Figure


BODE_HZ = np.geomspace(2e-3, 6.0, 300)
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
"""Variants of the drive train: changed keys of the vessel by name."""


class Material:
    """Data shared by several figures; each is computed once."""

    def __init__(self, found: Reproduction) -> None:
        self.rows = found.rows
        self.fingerprints = found.fingerprints
        self.measured = measured_response(USABLE_HZ)
        self.answers = cache(self._answers)
        self.best: Fingerprint = best_of(found)
        self.experiment = simulated
        self.fitted = predict_response(self.best, self.measured)

    @cached_property
    def curves(self) -> dict[str, FrequencyResponse]:
        """Responses of the printed parameter sets."""
        thesis = thesis_structure()
        curves = {}
        for case, values in printed_parameters().items():
            response, _ = thesis.equations.response(values, BODE_HZ, ())
            curves[case] = FrequencyResponse(case, BODE_HZ, dict(zip(("n_e", "M_g"), response, strict=True)))
        return curves

    def _answers(self, experiment: str) -> dict[str, Mapping[str, Array]]:
        """Responses of the printed parameter sets and our best structure to an experiment on the simulated tug."""
        record, thesis = simulated(experiment), thesis_structure()
        sets = {
            case: simulated_about(thesis, values, record) for case, values in printed_parameters().items()
        }
        return sets | {"ours": simulated_about(structure_of(self.best), self.best.optimum, record)}

    def fits(self, experiment: str) -> str:
        """Fits to an experiment as text, from Tables 7.2 and 7.3."""
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


def _set_point_line(material: Material, figure: Figure) -> str:
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    volts, speed, ours = set_point_line()
    line = np.linspace(-6.5, -2.5, 50)
    lines = ((EQUATION_6_7, style.GREY, "eq. 6.7"), (ours, style.BLUE, "least squares"))
    for calibration, color, label in lines:
        upper.plot(line, calibration(line), color=color, label=label)
        lower.plot(line, calibration(line) - ours(line), color=color)
    error = DEVIATIONS_95 * ours.standard_error(line)
    lower.fill_between(line, -error, error, color=style.BLUE, alpha=0.2, lw=0.0)
    upper.plot(volts, speed, "o", color=style.ORANGE, label="Table 6.11")
    lower.plot(volts, speed - ours(volts), "o", color=style.ORANGE)
    style.dress(upper, "engine speed [rpm]")
    dress(lower, "off the line [rpm]", "set point [V]", legend=False)
    return (
        f"{ours.scale:.2f} rpm/V and {ours.offset:.2f} rpm by least squares, with its 95 % band below; the line of eq. 6.7 "
        "lies within it."
    )


def _measured_bode(material: Material, figure: Figure, *, signal: str) -> str:
    panels = [*figure.subplots(2, 1, sharex=True)]
    whole = measured_response()
    size, phase = {signal: whole.amplitude_std[signal]}, {signal: whole.phase_std[signal]}
    points = FrequencyResponse("", whole.frequency_hz, {signal: whole.response[signal]}, size, phase)
    plot.bode(points, material.fitted, panels)
    return (
        "Points: sine fits of Tables E.1 to E.3 with two standard deviations; phases above 0.085 Hz are lost, since each "
        "channel was fitted with a frequency of its own. Line: extended structure with both dead times, fitted to "
        "the points up to 1.637 Hz."
    )


def _identified_bode(material: Material, figure: Figure, *, signal: str) -> str:
    panels = [*figure.subplots(2, 1, sharex=True)]
    bode_of_sets(figure, panels, {"ours": material.fitted, **material.curves}, signal, material.measured)
    return (
        "The thesis draws cases ii to iv on top of each other; their printed parameters are three different systems. Only "
        "phases that are known are drawn."
    )


def _step_record(material: Material, figure: Figure) -> str:
    plot.time_series(simulated("steps"), [*figure.subplots(2, 1, sharex=True)])
    return f"Steps of 1 V from -3 V to -6 V and back. {SIMULATED}"


def _lively(material: Material, figure: Figure) -> str:
    ax = figure.subplots()
    vessel = Vessel.load(VESSEL)
    for (label, changes), color in zip(PLAINER.items(), style.COMPARED, strict=False):
        ship = vessel.replace(changes) if changes else vessel
        size = [abs(_answer(ship, frequency)) for frequency in LIVELY_HZ]
        ax.plot(LIVELY_HZ, size, "o-", ms=3, color=color, label=label)
    structure = structure_of(material.best)
    response, _ = structure.equations.response(material.best.optimum, LIVELY_HZ, ())
    ax.plot(LIVELY_HZ, np.abs(response[1]), color=style.GREY, lw=3.0, zorder=0, label="linear, ours")
    ax.set_xscale("log")
    dress(ax, "torque over set point [-]", "frequency [Hz]")
    return (
        f"Gauge torque at the frequency of the sine, {AMPLITUDE_RPM:g} rpm through the simulated tug, beside the linear "
        "structure fitted to the published sine fits. The thesis sketches what ramps, sampling and single firings would do; "
        "the rise at 11 Hz is the shaft that twists."
    )


def _answer(ship: Vessel, frequency_hz: float) -> complex:
    """Ratio of the Fourier lines of gauge torque and set point at a frequency, after the transient."""
    rate = 400.0
    settling = int(np.ceil(SETTLED_S * frequency_hz))
    sines = sine_sequence([frequency_hz], settling + MEASURED_PERIODS, AMPLITUDE_RPM, rate_hz=rate)
    experiment = simulate(ship, sines)
    part = experiment.window(settling / frequency_hz, experiment.duration)
    turn = np.exp(-2j * np.pi * frequency_hz * part.time)
    return complex((part.normalised("M_g") @ turn) / (part.dn_set @ turn))


def _against(
    material: Material, figure: Figure, *, experiment: str, stretch: Stretch, cases: Sequence[str]
) -> str:
    answers = material.answers(experiment)
    models = {case: answers[case] for case in cases}
    panels = {DEVIATIONS[signal]: signal for signal in ("n_e", "M_g")}
    against(figure, simulated(experiment), models, panels, stretch, ship="tug")
    fits = material.fits(experiment)
    return f"i to iv: printed parameters. Fit of speed/torque to the whole experiment: {fits}. {SIMULATED}"


def _inertias(material: Material, figure: Figure) -> str:
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
    ax.set_xlim(0.0, 75.0)
    dress(ax, "", "inertia seen from the propeller [kg m$^2$]", legend=False)
    return (
        "What the gauge sees behind it is tau_prop M_s0 / (2 pi n_s0), with its 95 % interval. The thesis expected the "
        "whole inertia less 12 kg m2 in tau_n; its structure, fitted to gauge torque, can only find the propeller's side."
    )


def _causes(material: Material, figure: Figure) -> str:
    ax = figure.subplots()
    found = ladder(material.fingerprints)
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
    dress(ax, "", "chi-squared of S2 to S13 [-]")
    return (
        "Each cause that the thesis lists as possible, added in turn: the gauge's place, the propeller's exponent, the dead "
        "times of the loop and of the set point's path. Where chi-squared is near the degrees of freedom nothing is left "
        "to explain."
    )


_SET, _SPEED, _TORQUE = ("n_set",), ("n_set", "n_e"), ("n_set", "M_g")
_RECORDS = (
    ("7.1", "sines S2 to S13", "sines", _SET, (0.0, 2791.0)),
    ("7.2", "the same, speed", "sines", _SPEED, (0.0, 2791.0)),
    ("7.3", "from S12 to S13", "sines", _SPEED, (2640.0, 2665.0)),
    ("7.4", "the same, torque", "sines", _TORQUE, (0.0, 2791.0)),
    ("7.8", "short chirp C11", "short chirp", _SET, (0.0, 500.0)),
    ("7.9", "the same, speed", "short chirp", _SPEED, (0.0, 500.0)),
    ("7.10", "the same, torque", "short chirp", _TORQUE, (0.0, 500.0)),
    ("7.11", "long chirp C21 to C23", "long chirp", _SET, (0.0, 1500.0)),
    ("7.12", "the same, speed", "long chirp", _SPEED, (0.0, 1500.0)),
    ("7.13", "the same, torque", "long chirp", _TORQUE, (0.0, 1500.0)),
)
"""Records: number, title, experiment, signals, time range."""
_AGAINST = (
    ("7.17", "sets against steps", "steps", (0.0, 450.0), ("i", "ii", "iii", "iv", "ours")),
    ("7.18", "the third step", "steps", (170.0, 180.0), ("i", "ii", "iii", "iv", "ours")),
    ("7.19", "sets against sines, S12 and S13", "sines", (2640.0, 2665.0), ("i", "iii", "iv", "ours")),
    (
        "7.20",
        "sets against the short chirp near 1 Hz",
        "short chirp",
        (408.0, 422.0),
        ("i", "ii", "iv", "ours"),
    ),
    (
        "7.21",
        "sets against the long chirp near 1 Hz",
        "long chirp",
        (1304.0, 1318.0),
        ("i", "ii", "iii", "ours"),
    ),
)
"""Parameter sets compared with the tug: number, title, experiment, time range, sets."""
PICTURES: tuple[Picture[Material], ...] = (
    *fullscale_tables.PICTURES,
    figure_of("6.20", "speed and set-point voltage", _set_point_line),
    *(
        figure_of(number, title, record, 4.0, of=of, signals=signals, stretches=(stretch,), caption=SIMULATED)
        for number, title, of, signals, stretch in _RECORDS
    ),
    figure_of("7.5", "what elements do to the torque", _lively, 4.8),
    figure_of("7.6", "speed over set point", _measured_bode, 6.0, signal="n_e"),
    figure_of("7.7", "torque over set point", _measured_bode, 6.0, signal="M_g"),
    figure_of("7.14", "steps St1", _step_record, 5.6),
    figure_of("7.15", "speed", _identified_bode, 6.0, signal="n_e"),
    figure_of("7.16", "torque", _identified_bode, 6.0, signal="M_g"),
    *(
        figure_of(number, title, _against, 6.0, experiment=experiment, stretch=stretch, cases=cases)
        for number, title, experiment, stretch, cases in _AGAINST
    ),
    figure_of("7.22", "inertia on either side of the gauge", _inertias, 4.0),
    figure_of("7.23", "why the fits failed", _causes, 4.2),
)
FILES = tuple(picture.file for picture in PICTURES)


def draw(folder: Path, found: Reproduction, progress: Progress | None = None) -> None:
    """Write all figures to a folder as PNG; `progress` is called with (figures done, number of figures)."""
    save(PICTURES, folder, Material(found), progress)
