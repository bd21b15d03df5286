"""Chapters 6 and 7 of the thesis from its published numbers: refitted as it did, then with structures that suit the ship."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from shipfp_rs import published
from shipfp_rs.assessment.leverage import leverage
from shipfp_rs.frequency import FrequencyResponse, sine_response
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.identification.options import NoiseModel
from shipfp_rs.reproduce import Reproduction, Row, Way, fullscale_verdict, printed_row, row_of
from shipfp_rs.reproduce.fullscale_tables import before_the_fit, cross_checks, cross_validation
from shipfp_rs.reproduce.virtual_data import BOUNDS
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.vessel import Vessel

VESSEL = "stan-tug-1205"
SOUND_PHASE_HZ = 0.085
"""Up to here the printed phases of set point and speed lie on one smooth curve within 0.01 rad."""
SOUND_PHASE_STD = 0.01
LOST_PHASE_STD = np.pi / np.sqrt(3.0)
"""Above it any phase is as likely as another. Every channel was fitted with a frequency of its own, and the printed ones
differ by up to 1e-4 Hz; at t = 4000 s into the record 1e-5 Hz already turns the phase by 2 pi t 1e-5 = 0.25 rad."""
TORQUE_PHASE_STD = 0.2
"""Scatter of the printed torque phases about a smooth curve, at every frequency."""
AMPLITUDE_STD = 0.01
"""Scatter of the amplitude ratios about a smooth curve; the printed digits alone give half of it."""
INCONSISTENT_HZ = (0.11, 0.1778)
"""Phases that no structure can follow: a frequency error of 1e-5 Hz explains them."""
CORRECTIONS = (
    "set point 76 rpm, shaft-speed frequency 3.433 Hz and torque 320 Nm at 3.433 Hz as in section 7.3"
)
STARTS = 8
TORSIONAL_PRIOR = (1.17, 0.06)
"""Total tau_n of eq. 7.9 [s]; its deviation, 5 %, is what such calculations claim, none was printed."""


COUNTS = "how much each point counts in the weighted fit: 0 for nothing, 1 where it alone fixes a direction; in all the rank"
WEIGHTED = "ii, weighted"
WITH_PRIOR = f"{WEIGHTED}, torsional prior"


@dataclass(frozen=True)
class _Job:
    case: str
    data: FrequencyResponse
    structure: Structure
    noise: NoiseModel
    way: Way
    notes: str


def measured_response(last_hz: float = 3.433) -> FrequencyResponse:
    """Responses of engine speed and gauge torque from Tables E.1 to E.3, up to and including `last_hz`.

    The hand corrections of section 7.3 at 3.433 Hz are made. Each point is normalised by its own offsets, its
    frequency is the one fitted to the set point, and it carries the standard deviations that the way these
    tables were made implies.
    """
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
    """Return the structure of section 7.2: exponent 2, torque of the engine; start and bounds of eq. 7.3 to 7.8."""
    start = {"tau_n": 1.2, "g": -0.5, "v": 1.0, "K_p": 10.0, "K_i": 3.0}
    bounds = {name: BOUNDS[name] for name in start}
    return Structure.linear(torque="brake", name="thesis").with_start(**start).with_bounds(**bounds)


def extended_structure(*, loop: bool = True, set_point: bool = True) -> Structure:
    """Return the structure that suits the tug: gauge torque, free exponent, and the dead times asked for."""
    times = [name for wanted, name in ((loop, "T_d"), (set_point, "T_set")) if wanted]
    return Structure.linear(
        torque="gauge",
        free_exponent=True,
        dead_time_loop=loop,
        dead_time_set_point=set_point,
        name="extended, " + (" and ".join(times) or "no dead time"),
    )


def steps() -> tuple[Structure, ...]:
    """Return structures from the thesis's to the richest that the sine fits may carry."""
    gauge = Structure.linear(torque="gauge", name="gauge-side torque")
    times = product((False, True), repeat=2)
    return thesis_structure(), gauge, *(extended_structure(loop=a, set_point=b) for b, a in times)


def _jobs() -> tuple[_Job, ...]:
    usable = measured_response(1.637)
    consistent = [round(frequency, 4) not in INCONSISTENT_HZ for frequency in usable.frequency_hz]
    sound = usable.select(consistent, name="appendix E, ten points with consistent phases")
    thesis, extended = thesis_structure(), extended_structure()
    ten = "S2-S13 less 0.11 and 0.1778 Hz, whose phases are inconsistent; determinant"
    weighted = "S2-S13, each point weighted in amplitude and phase"
    prior = "{} +- {} s by the torsional calculation".format(*TORSIONAL_PRIOR)
    all_points, all_usable = (
        f"S2-S14, determinant; {CORRECTIONS}",
        "S2-S13, determinant; 3.433 Hz is unusable",
    )
    held = extended.with_prior(tau_n=TORSIONAL_PRIOR)
    return (
        _Job("ii", measured_response(), thesis, "white", "thesis", all_points),
        _Job("ii", usable, extended, "white", "ours", all_usable),
        _Job("ii, ten points", sound, thesis, "white", "thesis", ten),
        _Job("ii, ten points", sound, extended, "white", "ours", ten),
        *(_Job(WEIGHTED, usable, structure, "std", "ours", weighted) for structure in steps()),
        _Job(WITH_PRIOR, usable, held, "std", "ours", f"{weighted}; tau_n held to {prior}"),
    )


def reproduce(progress: Callable[[int, int], None] | None = None) -> Reproduction:
    """Refit Table 7.1 (ii) the thesis's way, then with the extended structure, and say what can't be known."""
    vessel = Vessel.load(VESSEL)
    rows: list[Row] = before_the_fit(vessel)
    rows += [printed_row(result, "7.1", "thesis") for result in published.full_scale_results()]
    fingerprints: dict[str, Fingerprint] = {}
    jobs = _jobs()
    for done, job in enumerate(jobs, 1):
        fingerprint = identify(job.data, job.structure, noise=job.noise, starts=STARTS, vessel=VESSEL)
        notes = job.notes
        if job.noise == "std":
            overall = fingerprint.fit["overall"]
            notes += f"; chi-squared {overall['chi_squared']:.1f} at {overall['degrees_of_freedom']:.0f} degrees of freedom"
        fingerprints[f"{job.case}: {job.structure.name}"] = fingerprint
        rows.append(row_of(fingerprint, "7.1", job.case, job.way, notes))
        if progress is not None:
            progress(done, len(jobs))
    extended = extended_structure().name
    drawn = {name: fingerprints[f"{name}: {extended}"] for name in (WEIGHTED, WITH_PRIOR)}
    rows += _counts(drawn[WEIGHTED])
    rows += cross_validation(thesis_structure(), drawn[WEIGHTED])
    rows += cross_checks(vessel, drawn)
    verdict = fullscale_verdict.of(rows, fingerprints, drawn)
    return Reproduction("Chapters 6 and 7, full scale", tuple(rows), verdict, fingerprints)


def best_of(found: Reproduction) -> Fingerprint:
    """Return the fit of the structure that the data support, each point weighted, with nothing known from elsewhere."""
    return found.fingerprints[f"{WEIGHTED}: {extended_structure().name}"]


def _counts(fingerprint: Fingerprint) -> list[Row]:
    """How much each point of Tables E.1 to E.3 counts in the weighted fit."""
    usable = measured_response(1.637)
    rows = []
    for signal, pair in leverage(usable, extended_structure(), fingerprint).items():
        for part, counts in zip(("amplitude", "phase"), pair, strict=True):
            columns = {
                f"{frequency:.4g} Hz": round(float(count), 3)
                for frequency, count in zip(usable.frequency_hz, counts, strict=True)
            }
            case = f"{'speed' if signal == 'n_e' else 'torque'}, {part}"
            rows.append(Row("E.1", case, "ours", "", columns, COUNTS))
    return rows
