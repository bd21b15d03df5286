"""Propagation of a fingerprint's uncertainty to the ship's Bode and step responses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shipfp_rs.assessment.prediction import structure_of
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array

LEAD_S = 1.0
"""Time before the step."""


@dataclass(frozen=True)
class StepResponse:
    """Response to a set-point step at time 0, normalised by its size: time [s] (N,), mean and std (N,) by output."""

    time: Array
    mean: Mapping[str, Array]
    std: Mapping[str, Array]


def response_with_deviation(
    fingerprint: Fingerprint, frequency_hz: npt.ArrayLike, structure: Structure | None = None
) -> FrequencyResponse:
    """Return the fitted model's response by output, with standard deviations from the parameters' covariance.

    Parameters
    ----------
    fingerprint
        Undetermined directions do not change the response, so they need not be known.
    frequency_hz
        Frequencies in ascending order [Hz], shape (F,).
    structure
        Structure of the fingerprint; None rebuilds a linear one.

    Returns
    -------
    FrequencyResponse
        Response by output ("dn", "dM", ...), with relative `amplitude_std` and `phase_std` in rad, to first order.

    Raises
    ------
    InputError
        If the structure is not linear and not given.
    """
    structure = structure or structure_of(fingerprint)
    names, covariance = _covariance(fingerprint)
    frequency = np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
    response, slopes = structure.equations.response(fingerprint.optimum, frequency, names)
    relative = slopes / response
    return FrequencyResponse(
        structure.name,
        frequency,
        {
            name: np.asarray(row, dtype=np.complex128)
            for name, row in zip(structure.outputs, response, strict=True)
        },
        amplitude_std=dict(zip(structure.outputs, _deviation(relative.real, covariance), strict=True)),
        phase_std=dict(zip(structure.outputs, _deviation(relative.imag, covariance), strict=True)),
    )


def step_with_deviation(
    fingerprint: Fingerprint,
    duration_s: float = 20.0,
    rate_hz: float = 50.0,
    structure: Structure | None = None,
) -> StepResponse:
    """Return the fitted model's response to a step of the set point, with standard deviations.

    Parameters
    ----------
    fingerprint, structure
        See `response_with_deviation`.
    duration_s, rate_hz
        Time after the step [s] and sample rate [Hz].

    Raises
    ------
    InputError
        See `response_with_deviation`.
    """
    structure = structure or structure_of(fingerprint)
    names, covariance = _covariance(fingerprint)
    time = np.arange(-LEAD_S, duration_s, 1.0 / rate_hz)
    step = Experiment(
        "step", rate_hz, {"n_set": np.where(time >= 0.0, 2.0, 1.0)}, {"n_set": 1.0}, hold="zero"
    )
    model, slopes = structure.equations.sensitivities(fingerprint.optimum, step, names)
    return StepResponse(
        time,
        dict(zip(structure.outputs, model, strict=True)),
        dict(zip(structure.outputs, _deviation(slopes, covariance), strict=True)),
    )


def _covariance(fingerprint: Fingerprint) -> tuple[list[str], Array]:
    names = list(fingerprint.covariance["names"])
    return names, np.array(fingerprint.covariance["matrix"], dtype=np.float64).reshape(len(names), len(names))


def _deviation(slopes: Array, covariance: Array) -> Array:
    """First-order standard deviation (O, N) from derivatives (W, O, N)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("won,wv,von->on", slopes, covariance, slopes), 0.0)))
