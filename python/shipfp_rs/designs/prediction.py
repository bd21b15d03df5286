"""Prediction of the fingerprint from a record of an excitation."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shipfp_rs.designs.noise import Noise
from shipfp_rs.designs.subject import Subject
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Estimate, Identifiability
from shipfp_rs.identification.foresight import foresee
from shipfp_rs.signals import Excitation

SEED = 1
"""Seed of the noise phases in the predicted record."""


@dataclass(frozen=True)
class Prediction:
    """Expected values with predicted standard deviations, undetermined parameters, and the noise-free record."""

    parameters: Mapping[str, Estimate]
    derived: Mapping[str, Estimate]
    identifiability: Identifiability
    experiment: Experiment

    @property
    def relative_pct(self) -> dict[str, float]:
        """Relative standard deviation of all known nonzero values [%]."""
        return {
            name: 100.0 * one.std / abs(one.value)
            for name, one in {**self.parameters, **self.derived}.items()
            if one.std is not None and one.value
        }


def predict(subject: Subject, excitation: Excitation, sensors: Mapping[str, Noise]) -> Prediction:
    """Predict the result of `identify` for a record of this excitation, by the same likelihood.

    The likelihood includes transients, offsets, initial state and the accuracy of gauges.
    """
    experiment = subject.respond(excitation)
    samples, signals = len(experiment), subject.signals
    # A random draw would have a scattered spectrum, and so would the prediction. Separate phases keep outputs uncorrelated.
    phases = np.random.default_rng(SEED).random(samples // 2 + 1)
    apart = np.arange(len(phases)) / len(signals)
    noisy = {
        name: experiment.signals[name]
        + experiment.operating_point[name]
        * sensors[output].typical(phases + place * apart, samples, excitation.rate_hz)
        for place, (output, name) in enumerate(signals.items())
    }
    accuracy = {name: sensors[output].accuracy for output, name in signals.items()}
    record = dataclasses.replace(
        experiment, signals={**experiment.signals, **noisy}, provenance={"gauge_accuracy": accuracy}
    )
    expected = foresee([record], subject.fitted, values=subject.values)
    return Prediction(expected.parameters, expected.derived, expected.identifiability, experiment)
