"""Leverage of each point of a frequency response in a fit weighted by standard deviations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identifiability import Sensitivity
from shipfp_rs.identification.likelihood import real_rows
from shipfp_rs.identification.structure_likelihood import seen
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array


@checked
def leverage(
    data: FrequencyResponse, structure: Structure, fingerprint: Fingerprint
) -> Mapping[str, tuple[Array, Array]]:
    """Return the leverage of each point's amplitude and phase.

    The diagonal of the hat matrix: 0 if the fit would be the same without the point, 1 if the point alone determines a
    direction of the parameters. The sum is the number of identifiable directions, less the information from priors.

    Parameters
    ----------
    data
        Response of the fit, with standard deviations.
    structure
        Structure of the fit.
    fingerprint
        Result of `identify(data, structure, noise="std")`.

    Returns
    -------
    dict
        For each signal name the leverage of amplitudes and of phases, shape (F,) each; zero where a point is missing.

    Raises
    ------
    InputError
        If the fit was not weighted by the points' standard deviations.

    Notes
    -----
    D. C. Hoaglin and R. E. Welsch, "The hat matrix in regression and ANOVA", 10.1080/00031305.1978.10479237.
    """
    if (noise := fingerprint.settings.get("noise")) != "std":
        raise InputError(f"leverage: the fit's noise is {noise!r}, expected 'std'")
    record = seen(data, structure, "std")
    values = dict(fingerprint.optimum)
    free = structure.free
    _, slopes = record.evaluate(values, [parameter.name for parameter in free])
    rows = real_rows(slopes).T
    scale = np.array([max(abs(values[parameter.name]), parameter.scale) for parameter in free])
    priors = [
        row / parameter.prior[1]
        for row, parameter in zip(np.eye(len(free)), free, strict=True)
        if parameter.prior is not None
    ]
    told = Sensitivity.of(np.vstack([rows, *priors]), [parameter.name for parameter in free], scale)
    share = np.einsum("ri,ij,rj->r", rows, told.covariance(), rows).reshape(2, len(structure.outputs), -1)
    whole = np.zeros((*share.shape[:2], len(data)))
    whole[..., record.valid] = share
    return {signal: (whole[0, place], whole[1, place]) for place, signal in enumerate(record.signals)}
