"""What an excitation will tell: standard deviations from the Fisher information of the record that it will make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shipfp_rs.designs.noise import Noise
from shipfp_rs.designs.quantities import quantities
from shipfp_rs.designs.subject import Subject
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Estimate, Identifiability
from shipfp_rs.identification.identifiability import Sensitivity, describe, why_unknown, without_nuisance
from shipfp_rs.identification.structure_estimates import with_tied
from shipfp_rs.identification.structure_records import seen
from shipfp_rs.signals import Excitation
from shipfp_rs.support.quantiles import DEVIATIONS_95


@dataclass(frozen=True)
class Prediction:
    """Expected values with predicted standard deviations, what will stay unknown, and the noise-free record."""

    parameters: Mapping[str, Estimate]
    derived: Mapping[str, Estimate]
    identifiability: Identifiability
    experiment: Experiment

    relative_pct: Mapping[str, float]
    """Standard deviation of everything identifiable over its expected value [%]."""


def predict(subject: Subject, excitation: Excitation, sensors: Mapping[str, Noise]) -> Prediction:
    """Predict what `identify` will make of a record of this excitation.

    The sensitivities are in units of the noise, by its own autoregression, and what an
    initial state and an offset of each output imitate is taken off: the record's transients and the price of its own
    unknowns count.
    """
    experiment = subject.respond(excitation)
    structure, rate = subject.structure, excitation.rate_hz
    record = seen(experiment, structure, "white")
    noises = [sensors[output] for output in structure.outputs]
    values = dict(subject.values) | dict.fromkeys(record.unknowns, 0.0)
    _, slopes = record.evaluate(values, subject.free)
    white = [
        noise.whitened(rows, rate) for noise, rows in zip(noises, np.moveaxis(slopes, 1, 0), strict=True)
    ]
    jacobian = np.concatenate(white, axis=1).T
    own = without_nuisance(jacobian, len(subject.free))
    priors = [
        row / parameter.prior[1]
        for row, parameter in zip(np.eye(len(subject.free)), structure.free, strict=True)
        if parameter.prior is not None
    ]
    sensitivity = Sensitivity.of(np.vstack([own, *priors]), subject.free, subject.scale)
    covariance = sensitivity.covariance()
    parameters: dict[str, Estimate] = {}
    derived: dict[str, Estimate] = {}
    relative: dict[str, float] = {}
    for parameter in structure.parameters:
        value = subject.values[parameter.name]
        if parameter.fixed:
            parameters[parameter.name] = Estimate(value, unit=parameter.unit, status="fixed", reason="given")
        elif parameter.tied is None:
            reason = why_unknown(sensitivity, sensitivity.names.index(parameter.name))
            parameters[parameter.name] = Estimate(
                None, unit=parameter.unit, status="unidentifiable", reason=reason
            )
    for name, quantity in quantities(subject, sensitivity).items():
        std = float(np.sqrt(quantity.gradient @ covariance @ quantity.gradient))
        interval = quantity.value - DEVIATIONS_95 * std, quantity.value + DEVIATIONS_95 * std
        estimate = Estimate(quantity.value, std, interval, quantity.unit, quantity.status)
        (parameters if name in parameters else derived)[name] = estimate
        relative[name] = 100.0 * std / (abs(quantity.value) or 1.0)
    return Prediction(with_tied(parameters, structure), derived, describe(sensitivity), experiment, relative)
