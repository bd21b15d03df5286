"""Measured frequency responses of experiments beside the fitted model's."""

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
"""Bins over which the set point's power is averaged: as many as a point of `local_response` has at least."""
EXCITED = 1e-4
"""Least power of the set point, relative to its highest, at a frequency that it excites."""
LOST = 0.3
"""Relative standard deviation above which a point carries no information."""


def compared_responses(
    fingerprint: Fingerprint, experiments: Sequence[Experiment], structure: Structure | None = None
) -> list[tuple[FrequencyResponse, FrequencyResponse]]:
    """Return the measured response of each experiment that has one, and the model's.

    The measured one knows nothing of the model: local polynomials over the band that the set point excites.
    Points with a standard deviation above 30 % are left out, and experiments without any point. A model that is not linear
    has no response but to an excitation: its own to the experiment's set point, found in the same way.

    Parameters
    ----------
    fingerprint, structure
        As in `predict`.
    experiments
        What was fitted.

    Raises
    ------
    InputError
        As `predict`.
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
    """Return the response of a model that made an experiment, at the measured frequencies."""
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
        return None  # nothing but rest, or too short a record: there is no response to show
    known = np.all([response.amplitude_std[name] < LOST for name in signals], axis=0)
    return response.select(known) if known.any() else None


def _band(experiment: Experiment) -> tuple[float, float]:
    """Return lowest and highest frequency that the set point excites [Hz]; `InputError` where it never moves."""
    power = np.abs(np.fft.rfft(experiment.dn_set - experiment.dn_set.mean())) ** 2
    smooth = uniform_filter1d(power, SMOOTHED, mode="constant")
    excited = np.flatnonzero(smooth > EXCITED * smooth.max())
    if not excited.size:
        raise InputError(f"{experiment.name}: the set point is constant, expected one that moves")
    resolution = experiment.rate_hz / len(experiment)
    return max(float(excited[0]), 1.0) * resolution, float(excited[-1]) * resolution
