"""What a search found as a fingerprint: estimates, fits, residual tests, verdict, and what it was made from."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from shipfp_rs._core import __version__
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.blocks import Block
from shipfp_rs.identification.estimates import estimates
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fit_statistics import fit_pct, information_criteria, nrmse_pct
from shipfp_rs.identification.minima import Found
from shipfp_rs.identification.residual_tests import residual_tests
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.verdict import structure_test, verdict
from shipfp_rs.identification.weighted_problem import Minimum, mean_scatter

Array = npt.NDArray[np.float64]


def fingerprint_of(ended: Found, *, vessel: str | None) -> Fingerprint:
    """Return what a search found as `identify` does: with intervals, residual tests and a verdict."""
    search, best = ended.search, ended.best
    structure, count = search.structure, len(search.free)
    found = estimates(search, best)
    parameters, derived, identifiability = found.parameters, found.derived, found.identifiability
    tests = residual_tests(search, best)
    by_block = _fit_by_block(search, best.vector)
    fit = {
        output: row | (tests[output].figures() if output in tests else {})
        for output, row in _fit(search, by_block).items()
    }
    data = tuple(_record(block, figures) for block, figures in zip(search.blocks, by_block, strict=True))
    unknown = (search.size - count) + found.rank
    overall = information_criteria(mean_scatter(best.sums)[1], found.samples, unknown)
    overall |= structure_test({output: test.figures() for output, test in tests.items()})
    if search.weighting == "std":
        overall |= {"chi_squared": best.criterion, "degrees_of_freedom": float(found.freedom)}
    return Fingerprint(
        parameters=parameters,
        derived=derived,
        covariance=found.covariance,
        identifiability=identifiability,
        fit={**fit, "overall": overall},
        residuals={output: test.correlograms() for output, test in tests.items()},
        structure=structure.to_dict(),
        vessel=vessel,
        data=data,
        settings=dict(ended.settings)
        | {
            "optimum": {name: found.values[name] for name in structure.names},
            "criterion": best.criterion,
            "converged": best.converged,
            "message": best.message,
            "minima": [_minimum_row(search, minimum) for minimum in ended.minima],
        },
        seed=ended.seed,
        versions={
            "shipfp_rs": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
        },
        verdict=verdict(
            parameters,
            derived,
            identifiability,
            {**fit, "overall": overall},
            structure,
            "" if best.converged else best.message,
        ),
    )


def _fit_by_block(search: Search, vector: Array) -> list[dict[str, dict[str, float]]]:
    """Figures of fit of the plain simulation."""
    plain = replace(
        search, blocks=tuple(replace(block, weigh=False) if block.weigh else block for block in search.blocks)
    )
    outputs = search.structure.outputs
    rows = []
    for block, values in plain.each(vector):
        if isinstance(block.data, Experiment):
            squares = np.diag(block.products(values, None, None).scatter)
            fits = [
                fit_pct(*pair) for pair in zip(squares, np.diag(block.scatter) * block.count, strict=True)
            ]
        else:
            evaluation = block.evaluate(values, ())
            measured = _complex(np.where(evaluation.valid, block.measured, np.nan))
            fits = [nrmse_pct(*pair) for pair in zip(measured, _complex(evaluation.residual), strict=True)]
        rows.append({output: {"nrmse_pct": fit} for output, fit in zip(outputs, fits, strict=True)})
    return rows


def _complex(parts: Array) -> npt.NDArray[np.complex128]:
    half = parts.shape[1] // 2
    return np.asarray(parts[:, :half] + 1j * parts[:, half:])


def _fit(
    search: Search, by_block: Sequence[Mapping[str, Mapping[str, float]]]
) -> dict[str, dict[str, float | None]]:
    weights = [block.count for block in search.blocks]
    return {
        output: {
            "nrmse_pct": float(np.average([rows[output]["nrmse_pct"] for rows in by_block], weights=weights)),
        }
        for output in search.structure.outputs
    }


def _record(block: Block, figures: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    data = block.data
    record: dict[str, Any] = {
        "name": data.name,
        "domain": "time" if isinstance(data, Experiment) else "frequency",
        "signals": dict(zip(block.structure.outputs, block.signals, strict=True)),
        "operating_point": dict(data.operating_point),
        "fit": {output: dict(row) for output, row in figures.items()},
        "samples": len(data),
        "used": block.count // (1 if isinstance(data, Experiment) else 2),
    }
    if isinstance(data, Experiment):
        record |= {"rate_hz": data.rate_hz, "duration_s": data.duration, "kind": data.kind}
    return record


def _minimum_row(search: Search, minimum: Minimum) -> dict[str, Any]:
    return {
        "criterion": minimum.criterion,
        "converged": minimum.converged,
        "parameters": dict(zip(search.names, map(float, minimum.vector), strict=False)),
    }
