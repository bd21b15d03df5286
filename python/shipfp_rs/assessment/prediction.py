"""Structure and frequency response of a fingerprint's model."""

from __future__ import annotations

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import checked


@checked
def predict_response(
    fingerprint: Fingerprint,
    measured: FrequencyResponse,
    points: int = 200,
    structure: Structure | None = None,
) -> FrequencyResponse:
    """Return the fitted model's response at `points` frequencies over the measured range.

    Raises
    ------
    InputError
        See `predict`.
    """
    structure = structure or structure_of(fingerprint)
    signals = tuple(
        structure.signal_for(output, measured.response, measured.name) for output in structure.outputs
    )
    frequency = np.geomspace(0.8 * measured.frequency_hz.min(), 1.25 * measured.frequency_hz.max(), points)
    own = structure.part(measured.name).equations
    response, _ = own.response(fingerprint.optimum, frequency, ())
    return FrequencyResponse(structure.name, frequency, dict(zip(signals, response, strict=True)))


def structure_of(fingerprint: Fingerprint) -> Structure:
    """Rebuild the structure of a fingerprint.

    Raises
    ------
    InputError
        If its equations are the user's, which a file can't contain.
    """
    try:
        return Structure.from_dict(fingerprint.structure)
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        name = fingerprint.structure.get("name")
        raise InputError(
            f"structure {name!r} of the fingerprint can't be rebuilt, {type(error).__name__.removesuffix('Error').lower()} "
            f"at {error}; expected the file as `shipfp run` wrote it"
        ) from error
