"""Reproduction of the tables of the thesis (Martinus, 2020), beside the printed values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from shipfp_rs import published
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fit_statistics import nrmse_pct
from shipfp_rs.support.arrays import Array, attributes

Way = Literal["printed", "truth", "thesis", "ours"]
Progress = Callable[[int, int], None]
"""Called after each job with the number of finished jobs and the number of all jobs."""
Job = TypeVar("Job")


@dataclass(frozen=True)
class Row:
    """A row of a table; `way` is printed, truth (of a simulation), thesis (refit as in the thesis) or ours (our fit)."""

    table: str
    case: str
    way: Way
    structure: str
    parameters: Mapping[str, float | None]
    notes: str = ""
    fit: Mapping[str, float | None] = field(default_factory=dict)
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            **attributes(self, "table", "case", "way", "structure"),
            "parameters": dict(self.parameters),
            "fit": dict(self.fit),
            "notes": self.notes,
            "intervals": {name: list(interval) for name, interval in self.intervals.items()},
        }


@dataclass(frozen=True)
class Reproduction:
    """Rows of the tables, conclusions in sentences, and fingerprints of the fits."""

    title: str
    rows: tuple[Row, ...]
    verdict: tuple[str, ...]
    fingerprints: Mapping[str, Fingerprint]

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form, {"rows": [...], "verdict": [...]}."""
        return {"rows": [row.to_dict() for row in self.rows], "verdict": list(self.verdict)}


def printed_row(result: published.Result, table: str, structure: str, **others: float | None) -> Row:
    """Return the row of a printed result; `others` are fits of outputs other than speed and torque."""
    fit = {"dn": result.fit_n_pct, "dM": result.fit_m_pct, **others}
    return Row(table, result.case, "printed", structure, result.parameters, result.signal, fit)


def row_of(fingerprint: Fingerprint, table: str, case: str, way: Way, notes: str = "") -> Row:
    """Return a fingerprint's row: its determined values; for a refit as in the thesis, all values of the optimum."""
    estimates = {**fingerprint.parameters, **fingerprint.derived}
    parameters = {name: estimate.value for name, estimate in estimates.items()}
    if way == "thesis":
        values = fingerprint.settings["optimum"]
        parameters |= values
        parameters |= {f"v{gain}": values["v"] * values[gain] for gain in ("K_p", "K_i") if "v" in values}
    # NRMSE is no measure of a fit whose points are weighted by their standard deviations.
    weighted = fingerprint.settings.get("noise") == "std"
    fit = {output: None if weighted else value for output, value in fits_of(fingerprint).items()}
    intervals = {name: estimate.ci95 for name, estimate in estimates.items() if estimate.ci95 is not None}
    return Row(table, case, way, str(fingerprint.structure["name"]), parameters, notes, fit, intervals)


def fits_of(fingerprint: Fingerprint) -> dict[str, float | None]:
    """Return the fit of each output [%]."""
    return {output: fit["nrmse_pct"] for output, fit in fingerprint.fit.items() if output != "overall"}


def fits_to(experiment: Experiment, answers: Mapping[str, Array]) -> dict[str, float]:
    """Return the fit of a model's response (deviations by signal) to an experiment, by signal [%] (eq. 4.9)."""
    measured = {signal: experiment.normalised(signal) for signal in answers}
    return {signal: nrmse_pct(measured[signal], measured[signal] - answers[signal]) for signal in answers}


def counted(jobs: Sequence[Job], progress: Progress | None) -> Iterator[Job]:
    """Yield the jobs, and report progress after each."""
    for done, job in enumerate(jobs, 1):
        yield job
        if progress is not None:
            progress(done, len(jobs))
