"""The whole ship when a torque meter's torque is the measured load: the fitted model then ends at the meter.

The set point moves the load behind the meter, too. The law and inertia of this load follow from speed and torque alone
(`load_side`). Both sides together give the whole ship.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.estimate import Estimate
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.input_checks import set_point_moves
from shipfp_rs.identification.load_side import load_side
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.structure import Structure


def with_far_side(fingerprint: Fingerprint, experiments: Sequence[Experiment]) -> Fingerprint:
    """Return the fingerprint with the load behind the meter, from its experiments, if the model ends at the meter."""
    if not fingerprint.ends_at_meter or not fingerprint.engine_described or not set_point_moves(experiments):
        return fingerprint
    try:
        side = load_side([_gauged(one) for one in experiments], torque="gauge")
    except InputError:  # the set point explains almost nothing of the speed
        return fingerprint
    share = float(np.mean([one.load["share"] for one in experiments]))
    known = {name: _times(side.parameters[name], share) for name in ("p", "c_2", "tau_prop")}
    return replace(fingerprint, behind_meter=known)


def _gauged(experiment: Experiment) -> Experiment:
    """Return the experiment with its load as a gauge's torque."""
    signals, point = dict(experiment.signals), dict(experiment.operating_point)
    signals["M_g"], point["M_g"] = signals.pop("M_load"), point.pop("M_load")
    told = {name: one for name, one in experiment.provenance.items() if name != "load"}
    return replace(experiment, signals=signals, operating_point=point, provenance=told)


def _times(one: Estimate, factor: float) -> Estimate:
    assert one.value is not None
    assert one.std is not None
    assert one.ci95 is not None
    ends = factor * one.ci95[0], factor * one.ci95[1]
    return replace(one, value=factor * one.value, std=factor * one.std, ci95=ends)


def whole_ship(fingerprint: Fingerprint) -> Fingerprint:
    """Return the fingerprint of the whole ship if the load behind the meter is known, else the fingerprint unchanged."""
    far = fingerprint.behind_meter
    if not far:
        return fingerprint
    stored, load = fingerprint.structure, {one.name for one in ELEMENTS["load"].parameters}
    structure = Structure.from_dict(
        {
            **stored,
            "name": "whole ship",
            "elements": [name for name in stored["elements"] if name != "load"],
            "parameters": {name: row for name, row in stored["parameters"].items() if name not in load},
        }
    )
    added = {**far, "tau_n": far["tau_prop"]}
    parameters = {
        name: _sum(one, added[name]) if name in added else one
        for name, one in fingerprint.parameters.items()
        if name in structure.names
    }
    # Without a torque gauge, tau_prop is only a guess of the share of the inertia behind a shaft that may be flexible.
    guessed = {"tau_prop": 0.0} if stored["torque"] == "brake" else {}
    parameters |= {name: far[name] for name in guessed if name in parameters}
    fixed = {
        name: one.value for name, one in parameters.items() if one.status == "fixed" and one.value is not None
    }
    every = list(fingerprint.covariance["names"])
    names = [name for name in every if name in parameters]
    places = [every.index(name) for name in names]
    matrix = np.array(fingerprint.covariance["matrix"], dtype=float).reshape(len(every), -1)[
        np.ix_(places, places)
    ]
    variances = {name: (one.std or 0.0) ** 2 for name, one in added.items()}
    matrix += np.diag([variances.get(name, 0.0) for name in names])

    def moved(values: Mapping[str, float]) -> dict[str, float]:
        own = {**values, **guessed}
        more = {name: one.value or 0.0 for name, one in added.items()}
        return {name: own[name] + more.get(name, 0.0) for name in structure.names if name in own}

    return replace(
        fingerprint,
        parameters=parameters,
        derived={},
        structure=structure.with_fixed(**fixed).to_dict(),
        covariance={"names": names, "matrix": matrix.tolist()},
        settings={
            **fingerprint.settings,
            "optimum": moved(fingerprint.optimum),
            "possible": [moved(one) for one in fingerprint.settings.get("possible", ())],
        },
        load_side={},
        behind_meter={},
    )


def _sum(near: Estimate, far: Estimate) -> Estimate:
    """Return the sum of independent estimates."""
    if near.value is None or far.value is None:
        return near
    value = near.value + far.value
    if near.ci95 is None or far.ci95 is None:
        return replace(near, value=value)
    half = np.hypot(np.subtract(near.ci95, near.value), np.subtract(far.ci95, far.value))
    std = float(np.hypot(near.std or 0.0, far.std or 0.0))
    return replace(near, value=value, std=std, ci95=(value - float(half[0]), value + float(half[1])))
