"""What a fingerprint's model makes of an experiment, its own or another one (cross-validation)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.structures.structure import LINEAR_OPTIONS, SHIP_OPTIONS, Structure
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.toml import validated
from shipfp_rs.vessel.vessel import Vessel

CURVED, SETTLED = 30, 1e-9
"""Steps at most to the initial state of a model that is not linear in it, and a step that is the last."""


def predict(
    fingerprint: Fingerprint, experiment: Experiment, structure: Structure | None = None
) -> Mapping[str, Array]:
    """Simulate the fitted model with an experiment's set point.

    Parameters
    ----------
    fingerprint
        Its parameters are taken as the search left them; where the data leave some open, any choice along the
        open directions gives the same outputs.
    experiment
        Set point and measured outputs; the initial state and a constant offset of each output are fitted to them
        by least squares.
    structure
        The fingerprint's; None rebuilds a linear one or a grey box.

    Returns
    -------
    dict
        Signal name to normalised deviation, shape (N,).

    Raises
    ------
    InputError
        Where the structure is neither linear nor a grey box and not given, or the experiment lacks an output.
    """
    structure = structure or structure_of(fingerprint)
    return simulated_about(structure, fingerprint.settings["optimum"], experiment)


def simulated_about(
    structure: Structure, values: Mapping[str, float], experiment: Experiment
) -> Mapping[str, Array]:
    """Simulate a structure with given parameters; as `predict`, for parameters from anywhere."""
    signals = tuple(
        structure.signal_for(output, experiment.signals, experiment.name) for output in structure.outputs
    )
    measured = structure.measured(experiment)
    equations = structure.equations
    offsets = np.eye(len(signals))[:, :, None] * np.ones(len(experiment))
    valid = np.isfinite(measured).all(axis=0)
    state = dict.fromkeys(equations.states, 0.0)
    # A linear model is linear in its initial state, too: one least-squares solution is exact.
    for _ in range(1 if set(state) <= set(equations.linear_in) else CURVED):
        model, slopes = equations.sensitivities({**values, **state}, experiment, equations.states)
        basis = np.concatenate([slopes, offsets])
        error = (measured - model)[:, valid]
        weight = 1.0 / np.maximum(error.std(axis=1, keepdims=True), np.finfo(float).tiny)
        left = (basis[:, :, valid] * weight).reshape(len(basis), -1).T
        fitted, *_ = np.linalg.lstsq(left, (error * weight).ravel(), rcond=None)
        if not (np.abs(fitted[: len(state)]) > SETTLED).any():
            break
        state = {
            name: value + float(step) for (name, value), step in zip(state.items(), fitted, strict=False)
        }
    return dict(zip(signals, model + np.tensordot(fitted, basis, axes=1), strict=True))


def predict_response(
    fingerprint: Fingerprint,
    measured: FrequencyResponse,
    points: int = 200,
    structure: Structure | None = None,
) -> FrequencyResponse:
    """Return the fitted model's response over the range of measured frequencies, at `points` of them.

    Raises
    ------
    InputError
        As `predict`.
    """
    structure = structure or structure_of(fingerprint)
    signals = tuple(
        structure.signal_for(output, measured.response, measured.name) for output in structure.outputs
    )
    frequency = np.geomspace(0.8 * measured.frequency_hz.min(), 1.25 * measured.frequency_hz.max(), points)
    own = structure.part(measured.name).equations
    response, _ = own.response(fingerprint.settings["optimum"], frequency, ())
    return FrequencyResponse(structure.name, frequency, dict(zip(signals, response, strict=True)))


def structure_of(fingerprint: Fingerprint) -> Structure:
    """Rebuild the structure that a fingerprint was fitted with, with its equations but with default bounds.

    Raises
    ------
    InputError
        Where it is neither a linear one nor a grey box: a file can't hold the equations of others.
    """
    declared = dict(fingerprint.structure)
    kind, rows = declared.get("kind"), declared.get("parameters", {})
    if kind == "linear":
        options = {key: declared[key] for key in (*LINEAR_OPTIONS, "outputs", "name") if key in declared}
        structure = Structure.linear(**options)
    elif kind == "ship":
        options = {key: declared[key] for key in (*SHIP_OPTIONS, "outputs", "name") if key in declared}
        structure = Structure.ship(**options)
    elif kind == "grey box" and isinstance(declared["vessel"], dict):
        vessel = validated(declared["vessel"], Vessel, "the fingerprint's vessel")
        given = {name: row["start"] for name, row in rows.items() if row["fixed"]}
        options = {key: declared[key] for key in ("torque", "outputs", "name", "pass_hz") if key in declared}
        structure = Structure.grey_box(vessel, [name for name in rows if name not in given], **options)
        structure = structure.with_fixed(**given)
    else:
        raise InputError(
            f"structure {declared.get('name')!r} of the fingerprint is not linear, and a file can't hold its "
            "equations; give structure=..."
        )
    if kind == "ship":
        structure = structure.with_fixed(
            **{name: row["start"] for name, row in rows.items() if row["fixed"] and not structure[name].fixed}
        )
    tied = {name: row["tied"] for name, row in rows.items() if row.get("tied")}
    return structure.with_tied(
        **{name: (str(tie["to"]), float(tie["factor"]), float(tie["offset"])) for name, tie in tied.items()}
    )
