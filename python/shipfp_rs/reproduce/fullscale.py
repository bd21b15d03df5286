"""Chapters 6 and 7 of the thesis: its published sine fits, refitted as in the thesis, then with suitable structures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from shipfp_rs import published
from shipfp_rs.assessment.closed_loop import closed_loop, predict_response
from shipfp_rs.assessment.profile_likelihood import leverage
from shipfp_rs.frequency import FrequencyResponse, sine_response
from shipfp_rs.identification.estimate import decimals, rounded
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.identification.question import NoiseModel
from shipfp_rs.reproduce import Progress, Reproduction, Row, Way, counted, printed_row, row_of
from shipfp_rs.reproduce.fullscale_tables import (
    before_the_fit,
    cross_checks,
    cross_validation,
    printed_parameters,
)
from shipfp_rs.reproduce.pictures import Responses, files
from shipfp_rs.reproduce.virtual_data import BOUNDS
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.vessel import Vessel

VESSEL = "stan-tug-1205"
FILES = files(("6.8", "6.9", "6.11", "6.12", "7.1", "7.2", "7.3", "eq. 7.9"))
BODE_HZ = np.geomspace(2e-3, 6.0, 300)
SOUND_PHASE_HZ = 0.085
"""Frequency up to which the printed phases of set point and speed are within 0.01 rad of a smooth curve."""
SOUND_PHASE_STD = 0.01
LOST_PHASE_STD = np.pi / np.sqrt(3.0)
"""Standard deviation of an unknown, uniformly distributed phase. Each channel was fitted with a different frequency, and
the printed frequencies differ by up to 1e-4 Hz; at t = 4000 s, 1e-5 Hz already change the phase by 2 pi t 1e-5 = 0.25
rad.
"""
TORQUE_PHASE_STD = 0.2
"""Scatter of the printed torque phases about a smooth curve, at every frequency."""
AMPLITUDE_STD = 0.01
"""Scatter of the amplitude ratios about a smooth curve; the printed digits alone cause half of it."""
INCONSISTENT_HZ = (0.11, 0.1778)
"""Frequencies whose phases no structure can reproduce; a frequency error of 1e-5 Hz explains them."""
CORRECTIONS = (
    "set point 76 rpm, shaft-speed frequency 3.433 Hz and torque 320 Nm at 3.433 Hz as in section 7.3"
)
USABLE_HZ = 1.637
STEP_DELAY_S = 0.5
"""Delay at every step of the trial (section 7.3.2)."""
STARTS = 8
TORSIONAL_PRIOR = (1.17, 0.06)
"""Total tau_n of eq. 7.9 and its standard deviation [s]. The thesis gives no accuracy; 5 % is usual for such
calculations.
"""
COUNTS = "how much each point counts in the weighted fit: 0 for nothing, 1 where it alone fixes a direction; in all the rank"
WEIGHTED = "ii, weighted"
WITH_PRIOR = f"{WEIGHTED}, torsional prior"


class _Job(NamedTuple):
    case: str
    data: FrequencyResponse
    structure: Structure
    noise: NoiseModel
    way: Way
    notes: str


def measured_response(last_hz: float = 3.433) -> FrequencyResponse:
    """Return responses of engine speed and gauge torque from Tables E.1 to E.3, up to and including `last_hz`."""
    # The manual corrections of section 7.3 at 3.433 Hz are included.
    # Each point is normalised by its offsets and has the frequency fitted to the set point.
    tables: dict[str, dict[float, published.SineFit]] = {}
    for fit in published.sine_fits():
        tables.setdefault(fit.signal, {})[fit.input_frequency_hz] = fit
    nominal = [frequency for frequency in tables["setpoint"] if frequency <= last_hz]

    def sine(signal: str) -> tuple[list[float], list[float], list[float]]:
        rows = [tables[signal][frequency] for frequency in nominal]
        amplitudes = [row.amplitude for row in rows]
        if 3.433 in nominal:
            place = nominal.index(3.433)
            amplitudes[place] = {"setpoint": 76.0, "shaft_torque": 320.0}.get(signal, amplitudes[place])
        return [row.offset for row in rows], amplitudes, [row.phase_rad for row in rows]

    set_point = sine("setpoint")
    phase = np.where(np.array(nominal) <= SOUND_PHASE_HZ, SOUND_PHASE_STD, LOST_PHASE_STD)
    amplitude = np.full(len(nominal), AMPLITUDE_STD)
    return FrequencyResponse(
        name=f"appendix E, up to {last_hz:g} Hz",
        frequency_hz=np.array([tables["setpoint"][frequency].fitted_frequency_hz for frequency in nominal]),
        response={
            "n_e": sine_response(sine("shaft_speed"), set_point),
            "M_g": sine_response(sine("shaft_torque"), set_point),
        },
        amplitude_std={"n_e": amplitude, "M_g": amplitude},
        phase_std={"n_e": phase, "M_g": np.hypot(phase, TORQUE_PHASE_STD)},
        provenance={
            "source": "Tables E.1 to E.3, normalised by each sine's own offset",
            "corrections": CORRECTIONS,
        },
    )


def thesis_structure() -> Structure:
    """Return the structure of section 7.2 (exponent 2, engine torque) with start and bounds of eq. 7.3 to 7.8."""
    start = {"tau_n": 1.2, "g": -0.5, "v": 1.0, "K_p": 10.0, "K_i": 3.0}
    bounds = {name: BOUNDS[name] for name in start}
    return Structure.linear(torque="brake", name="thesis").with_start(**start).with_bounds(**bounds)


def extended_structure(*, loop: bool = True, set_point: bool = True) -> Structure:
    """Return the structure that suits the tug: gauge torque, free exponent, and optional dead times."""
    times = [name for wanted, name in ((loop, "T_d"), (set_point, "T_set")) if wanted]
    name = "extended, " + (" and ".join(times) or "no dead time")
    linear = partial(Structure.linear, torque="gauge", free_exponent=True, name=name)
    return linear(dead_time_loop=loop, dead_time_set_point=set_point)


def steps() -> tuple[Structure, ...]:
    """Return the structures from the thesis's to the largest that the sine fits may determine, in that order."""
    gauge = Structure.linear(torque="gauge", name="gauge-side torque")
    times = product((False, True), repeat=2)
    return thesis_structure(), gauge, *(extended_structure(loop=a, set_point=b) for b, a in times)


def _jobs() -> tuple[_Job, ...]:
    usable, all_usable = measured_response(USABLE_HZ), "S2-S13, determinant; 3.433 Hz is unusable"
    consistent = [round(frequency, 4) not in INCONSISTENT_HZ for frequency in usable.frequency_hz]
    sound = usable.select(consistent, name="appendix E, ten points with consistent phases")
    thesis, extended = thesis_structure(), extended_structure()
    ten = "S2-S13 less 0.11 and 0.1778 Hz, whose phases are inconsistent; determinant"
    weighted = "S2-S13, each point weighted in amplitude and phase"
    prior = "{} +- {} s by the torsional calculation".format(*TORSIONAL_PRIOR)
    held = extended.with_prior(tau_n=TORSIONAL_PRIOR)
    return (
        _Job("ii", measured_response(), thesis, "white", "thesis", f"S2-S14, determinant; {CORRECTIONS}"),
        _Job("ii", usable, extended, "white", "ours", all_usable),
        _Job("ii, ten points", sound, thesis, "white", "thesis", ten),
        _Job("ii, ten points", sound, extended, "white", "ours", ten),
        *(_Job(WEIGHTED, usable, structure, "std", "ours", weighted) for structure in steps()),
        _Job(WITH_PRIOR, usable, held, "std", "ours", f"{weighted}; tau_n held to {prior}"),
    )


def reproduce(progress: Progress | None = None) -> Reproduction:
    """Refit Table 7.1 (ii) as in the thesis, then with the extended structure; report which parameters stay undetermined."""
    vessel = Vessel.load(VESSEL)
    rows: list[Row] = before_the_fit(vessel)
    rows += [printed_row(result, "7.1", "thesis") for result in published.full_scale_results()]
    fingerprints: dict[str, Fingerprint] = {}
    for job in counted(_jobs(), progress):
        fingerprint = identify(job.data, job.structure, noise=job.noise, starts=STARTS, vessel=VESSEL)
        notes = job.notes
        if job.noise == "std":
            overall = fingerprint.fit["overall"]
            notes += f"; chi-squared {overall['chi_squared']:.1f} at {overall['degrees_of_freedom']:.0f} degrees of freedom"
        fingerprints[f"{job.case}: {job.structure.name}"] = fingerprint
        rows.append(row_of(fingerprint, "7.1", job.case, job.way, notes))
    extended = extended_structure().name
    drawn = {name: fingerprints[f"{name}: {extended}"] for name in (WEIGHTED, WITH_PRIOR)}
    rows += _counts(drawn[WEIGHTED])
    rows += cross_validation(thesis_structure(), drawn[WEIGHTED])
    rows += cross_checks(vessel, drawn)
    verdict = tuple(_verdict(rows, fingerprints, *drawn.values()))
    return Reproduction("Chapters 6 and 7, full scale", tuple(rows), verdict, fingerprints)


def best_of(found: Reproduction) -> Fingerprint:
    """Return the weighted fit of the structure that the data support, without a prior."""
    return found.fingerprints[f"{WEIGHTED}: {extended_structure().name}"]


def responses(found: Reproduction) -> Responses:
    """Return the published sine fits, and the responses of our best fit and of the printed parameters."""
    measured, thesis = measured_response(USABLE_HZ), thesis_structure()
    models = {"ours": predict_response(best_of(found), measured)}
    for case, values in printed_parameters().items():
        speed, torque = thesis.equations.response(values, BODE_HZ, ())[0]
        models[f"{case} printed"] = FrequencyResponse(case, BODE_HZ, {"n_e": speed, "M_g": torque})
    return Responses(measured, models)


def _counts(fingerprint: Fingerprint) -> list[Row]:
    """Rows with the leverage of each point of Tables E.1 to E.3 in the weighted fit."""
    usable, rows = measured_response(USABLE_HZ), []
    labels = [f"{frequency:.4g} Hz" for frequency in usable.frequency_hz]
    for signal, pair in leverage(usable, extended_structure(), fingerprint).items():
        for part, counts in zip(("amplitude", "phase"), pair, strict=True):
            columns = dict(zip(labels, (round(float(count), 3) for count in counts), strict=True))
            case = f"{'speed' if signal == 'n_e' else 'torque'}, {part}"
            rows.append(Row("E.1", case, "ours", "", columns, COUNTS))
    return rows


def ladder(fingerprints: Mapping[str, Fingerprint]) -> list[Fingerprint]:
    """Return the weighted fits of `steps`."""
    return [found for name, found in fingerprints.items() if name.startswith(f"{WEIGHTED}:")]


def _verdict(
    rows: Sequence[Row], fingerprints: Mapping[str, Fingerprint], free: Fingerprint, held: Fingerprint
) -> Iterator[str]:
    """Yield the conclusions; `free` and `held` are extended fits without and with tau_n from the torsional calculation."""
    fits, structure = ladder(fingerprints), free.structure["name"]
    parts = {
        "What the published sine fits tell of the tug:": _told(free, held),
        "Why the thesis's fits failed:": _failure(rows, *map(chi_squared, fits[:2])),
        "The thesis's structure, fitted to its own sine fits:": fingerprints["ii: thesis"].verdict,
        "The extended structure (gauge-side torque, free exponent, two dead times) on the same trial:": fingerprints[
            f"ii: {structure}"
        ].verdict,
        "The same, each point weighted by how well its amplitude and phase are known:": free.verdict,
        "The same, with tau_n from the torsional calculation:": held.verdict,
        "From the thesis's structure to that one, each point weighted; the least BIC has a star:": _steps(
            fits
        ),
    }
    for heading, lines in parts.items():
        yield heading
        yield from (f"  {line}" for line in lines)


def chi_squared(found: Fingerprint) -> float:
    """Return chi-squared of a weighted fit."""
    return float(found.fit["overall"]["chi_squared"] or 0.0)


def bic(found: Fingerprint) -> float:
    """Return Schwarz's criterion: chi-squared + rank ln N."""
    return chi_squared(found) + found.identifiability.rank * math.log(found.fit["overall"]["samples"] or 1.0)


def _steps(fits: Sequence[Fingerprint]) -> Iterator[str]:
    best = min(map(bic, fits))
    yield f"{'structure':26}  rank  chi-squared        BIC"
    for found in fits:
        star = " *" if bic(found) == best else ""
        rank, name = found.identifiability.rank, found.structure["name"]
        yield f"{name:26}  {rank:4d}  {chi_squared(found):11.4g} {bic(found):10.4g}{star}"


def _interval(name: str, estimate: Estimate, unit: str = "") -> str:
    if estimate.value is None or estimate.ci95 is None:
        return f"{name} unknown"
    value, low, high = (rounded(one, decimals(estimate.std)) for one in (estimate.value, *estimate.ci95))
    return f"{name} {value}{unit} ({low} to {high})"


def _told(found: Fingerprint, held: Fingerprint) -> tuple[str, ...]:
    open_ = [name for name, estimate in found.parameters.items() if estimate.status == "unidentifiable"]
    units = {"p": "", "tau_prop": " s", "T_d": " s", "T_set": " s", "(p-g)/(vK_i)+T_set-T_f": " s"}
    p, tau_prop, T_d, T_set, late = (_interval(name, found[name], unit) for name, unit in units.items())
    loop = closed_loop(found)
    bandwidth, phase, gain = (
        _interval(name, loop[name], unit)
        for name, unit in (("bandwidth", " Hz"), ("phase margin", " deg"), ("gain margin", ""))
    )
    return (
        f"Known with 95 % intervals: {p}, {tau_prop}, {T_d} in the loop, {T_set} in the set point's path.",
        f"A slow set point is followed {late} late, which is the delay of about {STEP_DELAY_S} s that the thesis saw at "
        "every step and could not explain.",
        f"Not known: {', '.join(open_)}. The speed loop as a whole is: {bandwidth}, {phase}, {gain}.",
        f"With the torsional calculation as prior knowledge {_interval('tau_n', held['tau_n'], ' s')} and "
        f"{_interval('vK_p', held['vK_p'])}; v stays open until a factory test or the fuel rack tells it.",
    )


def _failure(rows: Sequence[Row], thesis: float, gauge: float) -> tuple[str, ...]:
    fits = {(row.table, row.case, row.way): row.parameters for row in rows if row.table in {"7.2", "7.3"}}
    steps = [fits["7.2", case, "ours"]["steps"] or 0.0 for case in ("ii", "iii", "iv")]
    best = fits["7.2", "ii, weighted", "ours"]["short chirp"] or 0.0
    worst = fits["7.2", "ii", "ours"]["short chirp"] or 0.0
    return (
        "The gauge sits between the inertias, so its torque is not the engine's; the governor's dead time and that of the "
        "set point's path are not in the structure; phases from 0.1 Hz up are lost to each channel's own fitted frequency.",
        f"None of these alone mends it: chi-squared {thesis:.0f} with the thesis's structure, {gauge:.0f} with gauge-side "
        "torque only; the table below adds one at a time.",
        f"Tables 7.2 and 7.3 print one and the same fit for three different parameter sets (95.85 % to the steps); on the "
        f"simulated tug these sets fit its steps to {', '.join(f'{fit:.1f}' for fit in steps)} %.",
        f"There case ii fits the speed of the short chirp to {worst:.0f} %, our best structure to {best:.0f} %.",
    )
