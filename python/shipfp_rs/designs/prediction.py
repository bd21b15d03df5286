"""What an excitation will tell: the fingerprint to expect of the record that it will make."""

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
"""Of the phases of the noise in the record that is looked at."""


@dataclass(frozen=True)
class Prediction:
    """Expected values with predicted standard deviations, what will stay unknown, and the noise-free record."""

    parameters: Mapping[str, Estimate]
    derived: Mapping[str, Estimate]
    identifiability: Identifiability
    experiment: Experiment

    @property
    def relative_pct(self) -> dict[str, float]:
        """Standard deviation over the expected value of all that is known and not zero [%]."""
        return {
            name: 100.0 * one.std / abs(one.value)
            for name, one in {**self.parameters, **self.derived}.items()
            if one.std is not None and one.value
        }


def predict(subject: Subject, excitation: Excitation, sensors: Mapping[str, Noise]) -> Prediction:
    """Predict what `identify` will make of a record of this excitation, by the likelihood that it uses.

    Transients, offsets, initial state and what gauges leave open count, since they are in that likelihood.
    """
    experiment = subject.respond(excitation)
    samples, signals = len(experiment), subject.signals
    # The spectrum of a draw would scatter, and all that is predicted with it. Phases apart keep the outputs uncorrelated.
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
