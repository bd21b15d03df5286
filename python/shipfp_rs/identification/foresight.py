"""Expected fingerprints before a fit: intervals from the likelihood's curvature, without profiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.automatic import answered
from shipfp_rs.identification.basins import Basin
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.input_checks import require_excited
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.open_loop import in_open_loop, structure_in_open_loop
from shipfp_rs.identification.options import Options
from shipfp_rs.identification.question import Question, question_of, question_of_ship
from shipfp_rs.identification.ship_fit import first_look
from shipfp_rs.identification.ship_found import DEFAULTS, ShipFit
from shipfp_rs.identification.structure_answer import fitted, of_structure
from shipfp_rs.identification.structure_fit import StructureFit, likelihood_of
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.threads import with_one_blas_thread

ABSENT = {"T_d": 0.0, "T_set": 0.0, "tau_act": 0.0, "c_2": 0.0}
"""Values without effect of the elements that the full ship always has."""


@with_one_blas_thread
def foresee(
    experiments: Sequence[Experiment],
    structure: Structure | None = None,
    *,
    values: Mapping[str, float] | None = None,
    **choice: Any,
) -> Fingerprint:
    """Return the expected fingerprint of data, much faster than `identify`.

    Parameters
    ----------
    experiments
        The data.
    structure
        Structure to fit; None: the full ship.
    values
        Assumed parameters of the ship; None: those of a first fit, without the elements that are tried.
    **choice
        As of `question_of`, without a structure.

    Returns
    -------
    Fingerprint
        Intervals are symmetric, cut by the bounds.

    Raises
    ------
    InputError, IdentificationError
        If `identify` would refuse the data.
    """
    require_excited(experiments)
    if structure is None and in_open_loop(experiments):
        return _of_structure(experiments, structure_in_open_loop(experiments, **choice), values)
    if structure is None:
        question = question_of(experiments, **choice)
    else:
        given = question_of_ship(experiments, structure) if structure.free and not structure.ties else None
        if given is None:
            return _of_structure(experiments, structure, values)
        question = given
    return answered(first_look(question) if values is None else _at(question, values), "symmetric")


def _at(question: Question, values: Mapping[str, float]) -> ShipFit:
    """Return the fit with its minimum at the values, under the noise of their residuals."""
    likelihood = question.likelihood(None)
    vector = likelihood.coordinates.vector({**DEFAULTS, **ABSENT, **values})
    likelihood = likelihood.settled_at(vector)
    return ShipFit(question, likelihood, (_end(likelihood, vector),), (), {}, None)


def _of_structure(
    experiments: Sequence[Experiment], structure: Structure, values: Mapping[str, float] | None
) -> Fingerprint:
    """Return the expected fingerprint of a structure with its own equations."""
    options = Options(intervals="symmetric", starts=1)
    if values is None:
        return fitted(experiments, structure, options)
    records, likelihood = likelihood_of(experiments, structure, options)
    vector = likelihood.coordinates.vector(values)
    likelihood = likelihood.settled_at(vector)
    end = _end(likelihood, vector)
    return of_structure(StructureFit(structure, records, likelihood, (end,), (end,)), options)


def _end(likelihood: Likelihood, vector: Array) -> Basin:
    """Return the expected minimum at the true parameters: its gradient is zero, unlike that of a draw of the noise."""
    found = likelihood.products(vector)
    return Basin(found.cost, vector, products=found._replace(downhill=np.zeros_like(found.downhill)))
