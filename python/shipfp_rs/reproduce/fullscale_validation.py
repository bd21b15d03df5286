"""Tables 7.2 and 7.3 of the thesis: how each parameter set fits the experiments that it was not fitted to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from shipfp_rs import published
from shipfp_rs.assessment.prediction import structure_of
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fit_statistics import nrmse_pct
from shipfp_rs.reproduce import Row
from shipfp_rs.reproduce.fullscale_trial import simulated
from shipfp_rs.reproduce.virtual_data import model_of
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.structures.structure import Structure

COLUMNS = ("sines", "short chirp", "long chirp", "steps")
TABLES = {"n_e": "7.2", "M_g": "7.3"}
SIGNALS = {"shaft_speed": "n_e", "shaft_torque": "M_g"}


def cross_validation(structure: Structure, best: Fingerprint) -> list[Row]:
    """Return the printed fits [%] beside those of the same parameters to the trial on the simulated tug.

    Parameters
    ----------
    structure
        The thesis's.
    best
        Fingerprint of the best supported structure, fitted to the published sine fits: what it makes of the
        simulated trial comes last.
    """
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
    fits: dict[str, dict[str, float | None]] = {signal: {} for signal in TABLES}
    for column in COLUMNS:
        experiment = simulated(column)
        for signal, model in simulated_about(structure, values, experiment).items():
            measured = experiment.normalised(signal)
            fits[signal][column] = nrmse_pct(measured, measured - model)
    return [Row(TABLES[signal], case, "ours", structure.name, fits[signal], notes) for signal in TABLES]
