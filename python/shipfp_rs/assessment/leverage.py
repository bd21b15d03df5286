"""How much each point of a frequency response counts in a fit that weighs it by its deviations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.blocks import Block
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identifiability import Sensitivity
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array


@checked
def leverage(
    data: FrequencyResponse, structure: Structure, fingerprint: Fingerprint
) -> Mapping[str, tuple[Array, Array]]:
    """Return how far each point's amplitude and phase decide the fit to themselves.

    The diagonal of the hat matrix: 0 where the fit would be the same without the point, 1 where the point alone fixes a
    direction of the parameters. All together they make the number of directions that the data tell, less what priors
    tell of them.

    Parameters
    ----------
    data
        What was fitted, with its deviations.
    structure
        The structure that was fitted.
    fingerprint
        Of `identify(data, structure, weighting="std")`.

    Returns
    -------
    dict
        Signal name to (of amplitudes, of phases), shape (F,) each; zero where a point is missing.

    Raises
    ------
    InputError
        Where the fit was not weighed by the points' deviations.

    Notes
    -----
    D. C. Hoaglin and R. E. Welsch, "The hat matrix in regression and ANOVA", 10.1080/00031305.1978.10479237.
    """
    if (weighting := fingerprint.settings.get("weighting")) != "std":
        raise InputError(f"leverage: the fit's weighting is {weighting!r}, expected 'std'")
    block = Block.build(data, structure, weigh=True)
    values = dict(fingerprint.optimum)
    free = structure.free
    evaluation = block.evaluate(values, [parameter.name for parameter in free])
    rows = evaluation.jacobian.reshape(len(free), -1).T
    scale = np.array([max(abs(values[parameter.name]), parameter.scale) for parameter in free])
    priors = [
        row / parameter.prior[1]
        for row, parameter in zip(np.eye(len(free)), free, strict=True)
        if parameter.prior is not None
    ]
    told = Sensitivity.of(np.vstack([rows, *priors]), [parameter.name for parameter in free], scale)
    share = np.einsum("ri,ij,rj->r", rows, told.covariance(), rows).reshape(len(structure.outputs), 2, -1)
    return {signal: (own[0], own[1]) for signal, own in zip(block.signals, share, strict=True)}
