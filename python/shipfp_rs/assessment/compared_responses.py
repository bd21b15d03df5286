"""Measured frequency responses of experiments and those of the fitted model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from shipfp_rs.assessment.prediction import predict_response, structure_of
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse, local_response
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.structures.structure import Structure

SMOOTHED = 13
"""Bins over which the set point's power is averaged, the least number in a point of `local_response`."""
EXCITED = 1e-4
"""Least power of the set point at an excited frequency, relative to its maximum."""
LOST = 0.3
"""Relative standard deviation above which a point carries no information."""


def compared_responses(
    fingerprint: Fingerprint, experiments: Sequence[Experiment], structure: Structure | None = None
) -> list[tuple[FrequencyResponse, FrequencyResponse]]:
    """Return the measured response of each experiment, and the model's.

    The measured response is independent of the model: local polynomials over the band excited by the set point. Points
    with a standard deviation above 30 % are omitted, and so are experiments without any point. The response of a nonlinear
    model depends on the excitation; it is estimated in the same way from a simulation with the experiment's set point.

    Parameters
    ----------
    fingerprint, structure
        See `predict`.
    experiments
        Experiments of the fit.

    Raises
    ------
    InputError
        See `predict`.
    """
    structure, pairs = structure or structure_of(fingerprint), []
    for experiment in experiments:
        measured = _measured(experiment, structure)
        if measured is None:
            continue
        try:
            model = predict_response(fingerprint, measured, structure=structure)
        except InputError:
            model = _simulated(fingerprint.predict(experiment, structure), measured)
        pairs.append((measured, replace(model, name=structure.name)))
    return pairs


def _simulated(model: Experiment, measured: FrequencyResponse) -> FrequencyResponse:
    """Response of the model that simulated an experiment, at the measured frequencies."""
    response = local_response(model, _band(model), signals=[*measured.response])
    return response.select(np.isin(response.frequency_hz, measured.frequency_hz))


def _measured(experiment: Experiment, structure: Structure) -> FrequencyResponse | None:
    chosen = [
        structure.signal_for(output, experiment.signals, experiment.name) for output in structure.outputs
    ]
    signals = [name for name in chosen if name in experiment.operating_point]
    try:
        response = local_response(experiment, _band(experiment), signals=signals)
    except InputError:
        return None  # only rest, or too short a record
    known = np.all([response.amplitude_std[name] < LOST for name in signals], axis=0)
    return response.select(known) if known.any() else None


def _band(experiment: Experiment) -> tuple[float, float]:
    """Lowest and highest frequency excited by the set point [Hz]; `InputError` if it is constant."""
    power = np.abs(np.fft.rfft(experiment.dn_set - experiment.dn_set.mean())) ** 2
    smooth = uniform_filter1d(power, SMOOTHED, mode="constant")
    excited = np.flatnonzero(smooth > EXCITED * smooth.max())
    if not excited.size:
        raise InputError(f"{experiment.name}: the set point is constant, expected one that moves")
    resolution = experiment.rate_hz / len(experiment)
    return max(float(excited[0]), 1.0) * resolution, float(excited[-1]) * resolution
