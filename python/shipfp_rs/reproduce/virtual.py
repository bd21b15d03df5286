"""Chapters 3 to 5 of the thesis on the virtual ship: Table 5.2 refitted as it did, and with accurate data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial

from shipfp_rs import published
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.options import NoiseModel, Options
from shipfp_rs.identification.structure_answer import fitted
from shipfp_rs.reproduce import Reproduction, Row, Way, fits_of, printed_row, virtual_tables, virtual_verdict
from shipfp_rs.reproduce.virtual_data import (
    VESSEL,
    euler_bias,
    fit_pct,
    launch,
    launch_of_the_thesis,
    plant_structure,
    sampled_structure,
    searched_as_printed,
    settled_response,
    shown,
    thesis_structure,
    trial,
    validation_steps,
)
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.vessel import Vessel

SINES, EULER = "settled sines", "forward Euler, 0.01 s"
CHIRPS = {"iii": "linear chirp", "iv": "logarithmic chirp", "v": "logarithmic chirp of amplitude 0.08"}


@dataclass(frozen=True)
class _Job:
    """One fit: the data are made only when their turn comes, for they are large."""

    case: str
    way: Way
    data: Callable[[], Experiment | FrequencyResponse]
    structure: Structure
    noise: NoiseModel
    notes: str


def reproduce(progress: Callable[[int, int], None] | None = None) -> Reproduction:
    """Reproduce the tables of chapters 3 to 5 and refit Table 5.2; `progress` gets (fits done, fits in all)."""
    rows, fingerprints = virtual_tables.rows()
    for result in published.virtual_results():
        validation = _validated({"dn": result.validation_n_pct, "dM": result.validation_m_pct})
        rows.append(printed_row(result, "5.2", "linear", **validation))
    rows += _true_parameters()
    steps = {"thesis": validation_steps(launch_of_the_thesis(), "euler"), "ours": validation_steps(launch())}
    truth = shown(asdict(linearise(launch())))
    jobs = (*_thesis_jobs(), *_our_jobs())
    for done, job in enumerate(jobs, 1):
        # The trials start at rest and hold neither noise nor offset: section 5.2 has all three at zero too.
        options = Options(noise=job.noise, intervals="symmetric", at_rest=True)
        fingerprint = fitted(job.data(), job.structure, options, vessel=VESSEL)
        fingerprints[f"{job.case}, {job.way}: {job.structure.name}"] = fingerprint
        rows.append(_row(job, fingerprint, steps[job.way], truth))
        if progress is not None:
            progress(done, len(jobs))
    return Reproduction("Chapters 3 to 5, virtual ship", tuple(rows), virtual_verdict.of(rows), fingerprints)


def _thesis_jobs() -> tuple[_Job, ...]:
    vessel = launch_of_the_thesis()
    linear = searched_as_printed(Structure.linear(products=True, name="linear"))
    sines, bias = partial(settled_response, vessel, "euler"), euler_bias(linearise(vessel))
    exact = (
        f"{SINES}, {EULER}; exact model; outputs weighted by their root mean square; the closed form tau h "
        f"a/-ln(1 - h a) gives {bias:.4f} s"
    )
    same = f"{SINES}, {EULER}; a model with the same error takes the bias away"
    chirps = {case: f"{signal}, {EULER}; exact model" for case, signal in CHIRPS.items()}
    return (
        _Job("ii", "thesis", sines, sampled_structure("zoh"), "std", exact),
        *(
            _Job(case, "thesis", partial(trial, vessel, case, "euler"), linear, "white", notes)
            for case, notes in chirps.items()
        ),
        _Job("ii, Euler model", "thesis", sines, sampled_structure("euler"), "std", same),
    )


def _our_jobs() -> tuple[_Job, ...]:
    vessel = launch()
    linear = searched_as_printed(Structure.linear(products=True, name="linear"))
    plant = searched_as_printed(plant_structure(vessel))
    unlimited, notes = partial(trial, vessel, "v", limits=False), f"{CHIRPS['v']}, engine without its limit"
    sines = partial(settled_response, vessel)
    return (
        _Job("ii, settled sines", "ours", sines, thesis_structure(), "std", SINES),
        *(
            _Job(case, "ours", partial(trial, vessel, case), structure, "white", signal)
            for case, signal in {"ii": "sine sequence", **CHIRPS}.items()
            for structure in (linear, plant)
        ),
        _Job("v, no torque limit", "ours", unlimited, linear, "white", notes),
    )


def _row(job: _Job, fingerprint: Fingerprint, steps: Experiment, truth: Mapping[str, float]) -> Row:
    values = fingerprint.settings["optimum"]
    parameters = shown(values)
    fit = fits_of(fingerprint) | _validated(fit_pct(job.structure, values, steps))
    notes = job.notes
    if job.way == "ours":
        errors = {name: 100.0 * (parameters[name] / true - 1.0) for name, true in truth.items()}
        name = max(errors, key=lambda name: abs(errors[name]))
        notes += f"; farthest from its true value: {name} {errors[name]:+.2g} %"
    return Row("5.2", job.case, job.way, job.structure.name, parameters, notes, fit)


def _validated(fit: Mapping[str, float | None]) -> dict[str, float | None]:
    return {f"validation {output}": value for output, value in fit.items()}


def _true_parameters() -> tuple[Row, ...]:
    """Case i: nothing is fitted; the linear model of the true parameters against three steps."""
    thesis, ours = launch_of_the_thesis(), launch()

    def row(case: str, way: Way, vessel: Vessel, steps: Experiment, notes: str) -> Row:
        values = asdict(linearise(vessel))
        fit = {"dn": None, "dM": None, **_validated(fit_pct(thesis_structure(), values, steps))}
        return Row("5.2", case, way, "linear", shown(values), f"true parameters; {notes}", fit)

    euler, free = validation_steps(thesis, "euler"), validation_steps(ours, limits=False)
    small = validation_steps(ours, size=0.01, limits=False)
    said = "section 5.1.3 says 1 %: the printed validation can't be had with it"
    return (
        row("i", "thesis", thesis, euler, f"three steps of 5 %, {EULER}"),
        row("i", "ours", ours, free, "three steps of 5 %, unlimited engine"),
        row("i, steps of 1 %", "ours", ours, small, said),
    )
