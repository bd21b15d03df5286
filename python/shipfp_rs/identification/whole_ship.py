"""The whole ship when a torque meter's torque is the measured load: the fitted model then ends at the meter.

The set point moves the load behind the meter, too. The law and inertia of this load follow from speed and torque alone
(`load_side`). Both sides together are the ship.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.estimate import Estimate
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.input_checks import set_point_moves
from shipfp_rs.identification.load_side import load_side
from shipfp_rs.identification.usability import TO_THE_METER, Case, usability
from shipfp_rs.identification.verdict import AT_THE_METER, BEHIND_THE_METER, shown
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.sentences import Sentence, joined


def with_far_side(fingerprint: Fingerprint) -> Fingerprint:
    """Return the fingerprint with the load behind the meter, from the same experiments, if the model ends at the meter."""
    experiments = fingerprint.experiments
    if not fingerprint.ends_at_meter or not fingerprint.engine_described or not set_point_moves(experiments):
        return fingerprint
    try:
        side = load_side([_gauged(one) for one in experiments], torque="gauge")
    except InputError:  # the set point explains next to nothing of the speed
        return fingerprint
    share = float(np.mean([one.load["share"] for one in experiments]))
    known = {name: _times(side.parameters[name], share) for name in ("p", "c_2", "tau_prop")}
    told = Sentence(
        BEHIND_THE_METER, load=joined([shown(name, known[name]) for name in ("p", "tau_prop")], " and ")
    )
    lines = [told if line == AT_THE_METER else line for line in fingerprint.verdict]
    found = replace(fingerprint, behind_meter=known, verdict=tuple(lines))
    if found.usable != TO_THE_METER:
        return found
    judged = usability(Case(found))
    return replace(
        found,
        usable=judged.sentence,
        usability=judged.state,
        verdict=(judged.sentence, *found.verdict[1:]),
    )


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
    """Return the fingerprint of the whole ship; itself unless its model ends at a meter and the load behind it is known."""
    far = fingerprint.behind_meter
    if not far:
        return fingerprint
    metered = Structure.from_dict(fingerprint.structure)
    settings = metered.settings
    structure = Structure.ship(
        [name for name in settings["elements"] if name != "load"],
        torque=settings["torque"],
        outputs=metered.outputs,
        products=settings["products"],
        propeller_speed=settings["propeller_speed"],
        mean_sampling=settings["mean_sampling"],
        name="whole ship",
    )
    added = {**far, "tau_n": far["tau_prop"]}
    parameters = {
        name: _sum(one, added[name]) if name in added else one
        for name, one in fingerprint.parameters.items()
        if name in structure.names
    }
    # Without a gauge, tau_prop is a mere guess of the share behind a shaft that may twist.
    guessed = {"tau_prop": 0.0} if settings["torque"] == "brake" else {}
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
