"""The fingerprint of a given structure: estimates, fits, tests and verdict at the search's minimum."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy

from shipfp_rs._core import __version__
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fit_statistics import information_criteria
from shipfp_rs.identification.options import Options
from shipfp_rs.identification.residual_tests import residual_tests
from shipfp_rs.identification.structure_estimates import StructureEstimates
from shipfp_rs.identification.structure_fit import StructureFit, fit_structure
from shipfp_rs.identification.structure_records import Data, InBand, Response, Seen
from shipfp_rs.identification.usability import judged
from shipfp_rs.identification.verdict import structure_test, verdict
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.sentences import Sentence

UNSETTLED = Sentence("the search was ended before it settled")


def fitted(
    data: Data | Sequence[Data], structure: Structure, options: Options, *, vessel: str | None = None
) -> Fingerprint:
    """Fit a structure by its own equations, as `identify` does."""
    return of_structure(fit_structure(data, structure, options), options, vessel=vessel)


def of_structure(fit: StructureFit, options: Options, *, vessel: str | None = None) -> Fingerprint:
    """Return the fingerprint of a fitted structure."""
    structure = fit.structure
    found = StructureEstimates(fit, options.intervals)
    records, tests = fit.records, residual_tests(fit)
    by_record = _fits(fit)
    rows = _mean_fits(records, structure, by_record)
    table = {
        output: row | (tests[output].figures() if output in tests else {}) for output, row in rows.items()
    }
    overall = _overall(fit, found)
    overall |= structure_test({output: test.figures() for output, test in tests.items()})
    converged = fit.best.settled
    fingerprint = Fingerprint(
        parameters=found.parameters,
        derived=found.derived,
        covariance=found.covariances(),
        identifiability=found.identifiability,
        fit={**table, "overall": overall},
        residuals={output: test.correlograms() for output, test in tests.items()},
        structure=structure.to_dict(),
        vessel=vessel,
        data=tuple(_record(*pair, structure.outputs) for pair in zip(records, by_record, strict=True)),
        settings={
            "noise": _noise(records),
            "intervals": options.intervals,
            "starts": options.starts_for(structure),
            "time_limit_s": options.time_limit_s,
            "optimum": {name: found.values[name] for name in structure.names},
            "criterion": fit.ends[0].cost,
            "converged": converged,
            "message": "" if converged else UNSETTLED,
            "minima": _minima(fit),
        },
        seed=options.seed,
        versions={
            "shipfp_rs": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
        },
        verdict=verdict(
            found.parameters,
            found.derived,
            found.identifiability,
            {**table, "overall": overall},
            structure,
            "" if converged else UNSETTLED,
        ),
    )
    samples = next((test.samples for test in tests.values()), 0)
    return judged(fingerprint, samples)


def _minima(fit: StructureFit) -> list[dict[str, Any]]:
    c = fit.likelihood.coordinates
    return [
        {
            "criterion": float(end.cost) if np.isfinite(end.cost) else None,
            "converged": end.settled,
            "parameters": {name: c.values(end.vector)[name] for name in c.names},
        }
        for end in fit.ends
    ]


def _noise(records: Sequence[Seen]) -> str:
    kinds = [
        "coloured"
        if isinstance(one, InBand) and not one.white
        else "std"
        if isinstance(one, Response) and one.weighed
        else "white"
        for one in records
    ]
    return kinds[0]


def _fits(fit: StructureFit) -> list[list[float]]:
    """Fit of each output's simulation, for each record [%]."""
    return [record.fit_pct(fit.known(index)) for index, record in enumerate(fit.records)]


def _mean_fits(
    records: Sequence[Seen], structure: Structure, by_record: Sequence[Sequence[float]]
) -> dict[str, dict[str, float | None]]:
    weights = [record.used for record in records]
    return {
        output: {"nrmse_pct": float(np.average([row[place] for row in by_record], weights=weights))}
        for place, output in enumerate(structure.outputs)
    }


def _overall(fit: StructureFit, found: StructureEstimates) -> dict[str, float | None]:
    """Figures of the whole fit: information criteria for white noise, chi-squared for known deviations."""
    likelihood, vector = fit.likelihood, fit.best.vector
    outputs, rank = len(likelihood.accuracy), found.everything.rank
    unknown = likelihood.coordinates.size - len(likelihood.coordinates.free)
    residuals = likelihood.residuals(vector)
    rows = np.concatenate(
        [np.concatenate([one.real, one.imag], axis=1) if np.iscomplexobj(one) else one for one in residuals],
        axis=1,
    )
    samples = rows.shape[1]
    if _noise(fit.records) == "white":
        return information_criteria(rows @ rows.T / samples, samples, rank + unknown)
    figures: dict[str, float | None] = {"samples": float(samples), "deviance": fit.ends[0].cost}
    if _noise(fit.records) == "std":
        freedom = samples * outputs - rank - unknown
        figures |= {"chi_squared": likelihood.cost(vector), "degrees_of_freedom": float(freedom)}
    return figures


def _record(record: Seen, fits: Sequence[float], outputs: Sequence[str]) -> dict[str, Any]:
    data = record.data
    found: dict[str, Any] = {
        "name": data.name,
        "domain": "time" if isinstance(data, Experiment) else "frequency",
        "signals": dict(zip(outputs, record.signals, strict=True)),
        "operating_point": dict(data.operating_point),
        "fit": {output: {"nrmse_pct": value} for output, value in zip(outputs, fits, strict=True)},
        "samples": len(data),
        "used": record.used,
    }
    if isinstance(data, Experiment):
        found |= {"rate_hz": data.rate_hz, "duration_s": data.duration, "kind": data.kind}
    return found
