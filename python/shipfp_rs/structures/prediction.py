"""Prediction of an experiment by a structure with given parameters and a fitted initial state."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array, Values

CURVED, SETTLED = 30, 1e-9
"""Largest number of iterations for a model that is nonlinear in its initial state, and step size at which they stop."""
SHORTER = 0.3
"""Ratio of successive steps above which the derivatives are recomputed."""


def simulated_about(structure: Structure, values: Values, experiment: Experiment) -> Mapping[str, Array]:
    """Return the normalised outputs (N,) by signal, with initial state and output offsets fitted to the measurement."""
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
    # A model that is linear in its initial state needs a single least-squares solution.
    for turn in range(1 if set(state) <= set(equations.linear_in) else CURVED):
        if turn:
            try:
                # Near convergence the derivatives hardly change and are reused.
                if longest < SHORTER * before:
                    model = equations.simulate({**values, **state}, experiment)
                else:
                    model, slopes = equations.sensitivities({**values, **state}, experiment, equations.states)
            except SimulationError:  # the last step was too long: use the linear prediction
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
