"""Trials with some parameters in common: fitted together they tell what they share better than each alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shipfp_rs import Experiment, Structure, identify
from shipfp_rs.assessment.closed_loop import predict_response
from shipfp_rs.assessment.validation import validate
from shipfp_rs.errors import InputError
from tests.identification.test_identifiability import (
    BAND,
    POINT,
    VALUES,
    experiment,
    response,
    started_near_truth,
)

PLAIN = Structure.linear(products=True, dead_time_loop=True, dead_time_set_point=True)
OTHER = {"tau_n": 1.1, "g": -0.4, "vK_p": 9.0, "vK_i": 2.5}
"""What another speed makes of the ship; its dead times stay."""
BOTH = Structure.joint(
    {"fast": started_near_truth(PLAIN), "slow": started_near_truth(PLAIN).with_start(**OTHER)},
    shared=["T_d", "T_set", "p"],
)
TRUTH = {
    **{f"{name} (fast)": VALUES[name] for name in OTHER},
    **{f"{name} (slow)": value for name, value in OTHER.items()},
    **{name: VALUES[name] for name in ("T_d", "T_set")},
}


@pytest.fixture(scope="module")
def trials() -> tuple[Experiment, Experiment]:
    fast = replace(experiment(PLAIN, noise=0.02), name="fast")
    bare = replace(fast, name="slow", signals={"n_set": fast.signals["n_set"]})
    clean = PLAIN.equations.simulate({name: VALUES[name] for name in PLAIN.names} | OTHER, bare)
    noisy = clean + 2e-4 * np.random.default_rng(7).normal(size=clean.shape)
    answers = {name: POINT[name] * (1.0 + row) for name, row in zip(("n_e", "M_b"), noisy, strict=True)}
    return fast, replace(bare, signals={**bare.signals, **answers})


def test_what_is_shared_is_known_better_than_from_either(trials, tmp_path):
    joint = identify(trials, BOTH, starts=1)
    alone = [identify(trial, started_near_truth(PLAIN), starts=1) for trial in trials]
    for name, truth in TRUTH.items():
        assert abs(joint[name].value - truth) < 4 * joint[name].std, name
    for name in ("T_d", "T_set"):
        assert joint[name].std < min(found[name].std for found in alone)
    for name in OTHER:
        for label, found in zip(("fast", "slow"), alone, strict=True):
            assert joint[f"{name} ({label})"].std < 1.1 * found[name].std
    assert joint.identifiability.rank == joint.identifiability.free == len(TRUTH)
    loaded = type(joint).load(joint.save(tmp_path / "fingerprint.json"))
    assert loaded.structure["shared"] == ["T_d", "T_set", "p"]
    again, given = loaded.predict(trials[0]), loaded.predict(trials[0], BOTH)
    assert again.outputs.keys() == given.outputs.keys()
    assert all(np.array_equal(again.signals[name], row) for name, row in given.outputs.items())
    for trial in trials:
        rest = loaded.predict(trial, BOTH).normalised("n_e") - trial.normalised("n_e")
        assert np.std(rest) < 3e-4
    assert validate(joint, trials[1], BOTH)["dn"] > 90.0


def test_nothing_shared_is_two_fits(trials):
    apart = Structure.joint({"fast": PLAIN, "slow": PLAIN}, shared=[])
    options = {"noise": "white", "starts": 1}
    joint = identify(trials, apart, **options)
    for trial in trials:
        alone = identify(trial, PLAIN, **options)
        for parameter in PLAIN.free:
            found = joint[f"{parameter.name} ({trial.name})"]
            assert found.value == pytest.approx(alone[parameter.name].value, rel=1e-4)


def test_ties_relate_parameters_of_two_trials(trials):
    # The same governor at both: the slow ship's gains are the fast one's by the ratio of the operating points.
    ratio = OTHER["vK_p"] / VALUES["vK_p"]
    tied = BOTH.with_tied(**{"vK_p (slow)": ("vK_p (fast)", ratio)})
    # White: the smooth errors of gauges are the same in both, and a second trial would tell little more.
    found = identify(trials, tied, starts=1, noise="white")
    assert found["vK_p (slow)"].value == pytest.approx(ratio * found["vK_p (fast)"].value)
    assert found["vK_p (slow)"].std < identify(trials, BOTH, starts=1, noise="white")["vK_p (slow)"].std
    assert abs(found["vK_p (slow)"].value - OTHER["vK_p"]) < 4 * found["vK_p (slow)"].std


def test_a_record_and_a_response_may_share(trials):
    fast, _ = trials
    sines = replace(response(PLAIN), name="slow")
    known = BOTH.with_start(**{f"{name} (slow)": 1.05 * VALUES[name] for name in OTHER})
    found = identify([fast, sines], known, starts=1)
    for name in ("T_d", "T_set", "tau_n (fast)", "tau_n (slow)"):
        assert found[name].value == pytest.approx(VALUES[name.split()[0]], rel=2e-3)
    assert len(predict_response(found, sines, 20, known)) == 20


def test_derivatives_are_those_of_finite_differences(trials):
    structure = BOTH.with_tied(**{"g (slow)": ("g (fast)", 0.7)})
    values = structure.complete({name: 1.1 * TRUTH.get(name, 2.0) for name in structure.names})
    names = [parameter.name for parameter in structure.free]
    for trial in trials:
        equations = structure.part(trial.name).equations
        _, slopes = equations.sensitivities(values, trial, names)
        _, in_frequency = equations.response(values, BAND, names)
        for place, name in enumerate(names):
            step = 1e-6 * abs(values[name])
            sides = [structure.complete(values | {name: values[name] + h}) for h in (step, -step)]
            ahead, behind = (structure.equations.simulate(side, trial) for side in sides)
            difference = (ahead - behind) / (2 * step)
            assert np.allclose(slopes[place], difference, atol=2e-5 * np.abs(difference).max()), name
            ahead, behind = (equations.response(side, BAND, ())[0] for side in sides)
            assert np.allclose(in_frequency[place], (ahead - behind) / (2 * step), rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize(
    ("parts", "shared", "says"),
    [
        ({"one": PLAIN}, [], "two or more"),
        ({"one": PLAIN, "two": Structure.linear(outputs=("dn",))}, [], "'two' explains dn"),
        ({"one": PLAIN, "two": PLAIN}, ["T_q"], "no parameter 'T_q'"),
        ({"one": PLAIN, "two": PLAIN.with_tied(T_set=("T_d", 2.0))}, [], "'two' has ties"),
    ],
)
def test_what_cannot_be_joined_is_one_line(parts, shared, says):
    with pytest.raises(InputError, match=says):
        Structure.joint(parts, shared)


def test_data_of_another_name_are_refused(trials):
    with pytest.raises(InputError, match="no part for 'made', expected one of fast, slow"):
        identify([trials[0], replace(trials[1], name="made")], BOTH)
