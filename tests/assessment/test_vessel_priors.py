"""What a vessel's file says of inertia and shaft, as priors of a fit."""

import math
from dataclasses import replace

import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.si import parameters_of, vessel_priors


@pytest.fixture(scope="module")
def trial() -> tuple[fp.Vessel, fp.Experiment]:
    vessel = fp.Vessel.load("stan-tug-1205")
    chirp = fp.signals.chirp(0.02, 2.0, 100.0, 40.0, rate_hz=50.0)
    return vessel, fp.simulate(vessel, chirp, noise={"n_e": 0.003, "M_g": 0.02}, seed=1)


def test_priors_are_the_parameters_of_the_vessel_at_the_operating_point(trial):
    vessel, experiment = trial
    told, true = vessel_priors(vessel, [experiment], 5.0), parameters_of(vessel)
    for name, (mean, std) in told.items():
        assert mean == pytest.approx(true[name], rel=0.02), name
        assert std == pytest.approx(0.05 * mean)
    assert {"tau_n", "tau_prop"} <= set(told)
    turn = 2.0 * math.pi * experiment.operating_point["n_e"] / 60.0 / vessel.gearbox.ratio
    assert told["tau_n"][0] == pytest.approx(turn * vessel.inertia / experiment.operating_point["M_g"])


def test_without_a_word_nothing_is_a_prior(trial):
    vessel, experiment = trial
    assert vessel_priors(vessel, [experiment], None) == {}
    bare = replace(experiment, operating_point={"n_set": 1183.8, "n_e": 1183.8})
    assert vessel_priors(vessel, [bare], 5.0) == {}


def test_a_known_inertia_tells_the_gains_behind_a_gauge(trial):
    vessel, experiment = trial
    told = vessel_priors(vessel, [experiment], 1.0)
    alone, known = (
        fp.identify(experiment, torque="gauge", outputs=["dn", "dM"], priors=priors, intervals="symmetric")
        for priors in ({}, {"tau_n": told["tau_n"]})
    )
    assert known["vK_p"].std < 0.7 * alone["vK_p"].std
    low, high = known["vK_p"].ci95
    assert low <= parameters_of(vessel)["vK_p"] <= high
