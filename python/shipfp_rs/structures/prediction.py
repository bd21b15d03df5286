"""What a structure with given parameters makes of an experiment, its unknown beginning fitted."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array, Values

CURVED, SETTLED = 30, 1e-9
"""Most steps towards the initial state of a model that is nonlinear in it, and the step size at which they end."""
SHORTER = 0.3
"""Ratio of a step to the one before it; above this ratio the derivatives are computed anew."""


def simulated_about(structure: Structure, values: Values, experiment: Experiment) -> Mapping[str, Array]:
    """Return the normalised outputs by signal; the initial state and each output's offset are fitted to the measurement.

    Parameters
    ----------
    structure
        The model.
    values
        Parameters by name.
    experiment
        Set point and measured outputs.

    Returns
    -------
    dict
        Signal name to normalised deviation, shape (N,).
    """
    signals = tuple(
        structure.signal_for(output, experiment.signals, experiment.name) for output in structure.outputs
    )
    measured = structure.measured(experiment)
    equations = structure.equations
    offsets = np.eye(len(signals))[:, :, None] * np.ones(len(experiment))
    valid = np.isfinite(measured).all(axis=0)
    state = dict.fromkeys(equations.states, 0.0)
    model, slopes = equations.sensitivities({**values, **state}, experiment, equations.states)
    before = longest = np.inf
    # A linear model is linear in its initial state, too: one least-squares solution is exact.
    for turn in range(1 if set(state) <= set(equations.linear_in) else CURVED):
        if turn:
            try:
                # Near its end the slopes hardly change.
                if longest < SHORTER * before:
                    model = equations.simulate({**values, **state}, experiment)
                else:
                    model, slopes = equations.sensitivities({**values, **state}, experiment, equations.states)
            except SimulationError:  # a step too far: the straight line to it is what is known
                break
        basis = np.concatenate([slopes.reshape(len(state), *model.shape), offsets])
        error = (measured - model)[:, valid]
        weight = 1.0 / np.maximum(error.std(axis=1, keepdims=True), np.finfo(float).tiny)
        left = (basis[:, :, valid] * weight).reshape(len(basis), -1).T
        fitted, *_ = np.linalg.lstsq(left, (error * weight).ravel(), rcond=None)
        before, longest = longest, float(np.abs(fitted[: len(state)]).max(initial=0.0))
        if longest <= SETTLED:
            break
        state = {
            name: value + float(step) for (name, value), step in zip(state.items(), fitted, strict=False)
        }
    return dict(zip(signals, model + np.tensordot(fitted, basis, axes=1), strict=True))
