"""Identification from experiments in the time domain: exact data, noise, masks, outliers, several experiments, limits."""

from __future__ import annotations

import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.identify import fingerprint_of, identify, posed
from shipfp_rs.identification.question import Options
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.vessel import Vessel
from tests.launch import outputs_of

RATE = 20.0
POINT = {"n_set": 1300.0, "n_e": 1300.0, "M_b": 222.93, "M_g": 635.35}
LAUNCH = {"tau_n": 1.514, "g": -0.583, "vK_p": 15.83, "vK_i": 1.583, "p": 2.0}
TUG = {
    "tau_n": 1.17,
    "g": -0.6,
    "vK_p": 4.2,
    "vK_i": 7.9,
    "p": 2.17,
    "tau_prop": 0.43,
    "T_d": 0.123,
    "T_set": 0.241,
}


def made(
    structure: Structure,
    values: dict[str, float],
    *,
    noise: float = 0.0,
    rho: float = 0.0,
    seed: int = 0,
    f1: float = 4.0,
) -> Experiment:
    """Outputs of a structure for a chirp of 200 s, with noise relative to each output's own spread."""
    chirp = signals.chirp(0.01, f1, 200.0, 13.0, law="logarithmic", rate_hz=RATE)
    bare = Experiment("made", RATE, {"n_set": 1300.0 + chirp.samples}, POINT)
    clean = structure.equations.simulate(values, bare)
    random = np.random.default_rng(seed)
    torque = "M_g" if structure.settings["torque"] == "gauge" else "M_b"
    measured = {"n_set": bare.signals["n_set"]}
    for name, row in zip(("n_e", torque), clean, strict=True):
        shock = random.normal(size=len(row)) * np.sqrt(1 - rho**2)
        disturbance = np.empty_like(row)
        state = random.normal()
        for index, value in enumerate(shock):
            state = rho * state + value
            disturbance[index] = state
        measured[name] = POINT[name] * (1.0 + row + noise * row.std() * disturbance)
    return Experiment("made", RATE, measured, POINT, kind="chirp")


def test_exact_data_give_the_parameters_back():
    structure = Structure.linear(products=True)
    fingerprint = identify(made(structure, LAUNCH), structure, noise="white")
    for name, value in LAUNCH.items():
        assert fingerprint[name].value == pytest.approx(value, rel=1e-6)
    assert fingerprint.fit["dn"]["nrmse_pct"] > 99.999


def test_both_dead_times_and_the_gauge_side_constant_come_out_of_a_noisy_record():
    structure = Structure.linear(
        products=True, torque="gauge", free_exponent=True, dead_time_loop=True, dead_time_set_point=True
    )
    fingerprint = identify(made(structure, TUG, noise=0.02, seed=4), structure, noise="white")
    for name in ("p", "tau_prop", "T_d", "T_set"):
        estimate = fingerprint[name]
        assert abs(estimate.value - TUG[name]) < 4 * estimate.std
        assert estimate.std < 0.05 * TUG[name]
    assert fingerprint["tau_n"].value is None
    assert fingerprint["(p-g)/tau_n"].value == pytest.approx((2.17 + 0.6) / 1.17, rel=0.1)


def test_the_ship_sees_through_a_torque_limit():
    launch = Vessel.load("stan-launch-804")
    chirp = signals.chirp(0.01, 5.0, 200.0, 104.0, law="logarithmic", rate_hz=50.0)
    experiment = simulate(launch, chirp)
    assert experiment.signals["M_b"].max() > 1.9 * 222.93
    linear = fingerprint_of(
        posed([experiment], Structure.linear(products=True), Options(noise="white", at_rest=True))
    )
    ship = identify(experiment, Structure.ship(["torque_limit"]), noise="white")
    truth = {"tau_n": 1.51416, "g": -0.583, "vK_p": 15.83, "vK_i": 1.583}
    assert abs(linear["g"].value / truth["g"] - 1) > 0.02
    for name, value in truth.items():
        assert ship[name].value == pytest.approx(value, rel=2e-3)
    assert ship["M_max"].value == pytest.approx(446.0 / 222.93, rel=2e-3)  # the envelope at 1300 rpm


def test_a_joint_fit_of_two_experiments_is_sharper_than_either():
    structure = Structure.linear(products=True)
    slow = made(structure, LAUNCH, noise=0.05, seed=1, f1=0.3)
    fast = made(structure, LAUNCH, noise=0.05, seed=2)
    both = identify([slow, fast], structure, noise="white")
    alone = [identify(experiment, structure, noise="white") for experiment in (slow, fast)]
    for name in ("tau_n", "vK_p", "vK_i"):
        assert all(both[name].std < single[name].std for single in alone)
        assert abs(both[name].value - LAUNCH[name]) < 4 * both[name].std
    assert len(both.data) == 2


def test_masked_samples_do_not_count():
    structure = Structure.linear(products=True)
    experiment = made(structure, LAUNCH, noise=0.02, seed=3)
    spoiled = {name: values.copy() for name, values in experiment.signals.items()}
    spoiled["M_b"][1000:1100] = np.nan
    spoiled["n_e"][2000:2003] = np.nan
    fingerprint = identify(Experiment("x", RATE, spoiled, POINT), structure)
    assert fingerprint.data[0]["used"] == len(experiment) - 103
    for name in ("tau_n", "g", "vK_p", "vK_i"):
        assert abs(fingerprint[name].value - LAUNCH[name]) < 4 * fingerprint[name].std


def test_a_record_that_starts_in_the_middle_needs_its_initial_state_estimated():
    structure = Structure.linear(products=True)
    late = made(structure, LAUNCH).window(15.03 // 0.05 * 0.05, 150.0)
    estimated = identify(late, structure, noise="white")
    zero = fingerprint_of(posed([late], structure, Options(noise="white", at_rest=True)))
    assert estimated["tau_n"].value == pytest.approx(LAUNCH["tau_n"], rel=1e-5)
    assert abs(zero["vK_i"].value / LAUNCH["vK_i"] - 1) > 1e-3


def test_several_starts_reach_the_same_minimum():
    structure = Structure.linear(products=True)
    data = made(structure, LAUNCH, noise=0.02, seed=7)
    one = identify(data, structure, noise="white")
    many = identify(data, structure, noise="white", starts=3, seed=11)
    assert many["tau_n"].value == pytest.approx(one["tau_n"].value, rel=1e-4)
    assert len(many.settings["minima"]) == 1
    assert many.settings["criterion"] == pytest.approx(one.settings["criterion"], abs=0.1)


def test_coloured_noise_gets_wider_and_honest_intervals():
    structure = Structure.linear(products=True)
    errors, spans = {"white": [], "coloured": []}, {"white": [], "coloured": []}
    for seed in range(12):
        data = made(structure, LAUNCH, noise=0.05, rho=0.95, seed=seed)
        for noise in errors:
            estimate = identify(data, structure, noise=noise)["vK_i"]
            errors[noise].append((estimate.value - LAUNCH["vK_i"]) / estimate.std)
            spans[noise].append(estimate.std)
    # The normalised errors should have a spread near one; 12 draws tell 1 from 2.
    assert np.sqrt(np.mean(np.square(errors["coloured"]))) < 1.8
    assert np.sqrt(np.mean(np.square(errors["white"]))) > 1.8


def test_limits_and_failures_are_typed():
    structure = Structure.linear(products=True)
    data = made(structure, LAUNCH, noise=0.02)
    hasty = identify(data, structure, time_limit_s=1e-9)
    assert not hasty.settings["converged"]
    assert "did not end in a minimum" in hasty.verdict[0]
    blank = {name: values.copy() for name, values in data.signals.items()}
    blank["n_e"][:] = np.nan
    with pytest.raises(InputError, match="every sample of n_e, M_b is masked"):
        identify(Experiment("x", RATE, blank, POINT), structure)


def test_the_same_seed_gives_the_same_fingerprint(tmp_path):
    structure = Structure.linear(products=True)
    data = made(structure, LAUNCH, noise=0.05, seed=8)
    first, second = (identify(data, structure, starts=2, seed=3) for _ in range(2))
    assert first.to_dict() == second.to_dict()
    path = first.save(tmp_path / "fingerprint.json")
    assert type(first).load(path).to_dict() == first.to_dict()


def test_the_parameters_come_back_from_a_chirp_though_it_starts_off_balance_and_the_gauge_has_an_offset():
    launch = linearise(Vessel.load("stan-launch-804"))
    excitation = signals.chirp(0.01, 10.0, 60.0, 13.0)
    dn, dM = outputs_of(excitation, model=launch, initial=(0.01, 0.02))
    experiment = Experiment(
        "chirp",
        excitation.rate_hz,
        {"n_set": 1300.0 + excitation.samples, "n_e": 1300.0 * (1.0 + dn), "M_b": 220.0 * (1.05 + dM)},
        {"n_set": 1300.0, "n_e": 1300.0, "M_b": 220.0},
        hold=excitation.hold,
    )
    fingerprint = identify(experiment, Structure.linear(products=True))
    for name, truth in {
        "tau_n": launch.tau_n,
        "g": launch.g,
        "vK_p": launch.v * launch.K_p,
        "vK_i": launch.v * launch.K_i,
    }.items():
        assert fingerprint[name].value == pytest.approx(truth, rel=3e-4)


def test_dead_times_that_are_not_there_are_found_to_be_none():
    """Behind a gauge two dead times near zero are one valley; its floor is a minimum all the same."""
    from tests.assessment.test_comparison import fingerprint

    structure = Structure.linear(
        torque="gauge", products=True, free_exponent=True, dead_time_loop=True, dead_time_set_point=True
    )
    found = fingerprint(4, structure=structure, starts=2)
    assert found.settings["converged"], found.settings["message"]
    for name in ("T_d", "T_set"):
        assert found[name].value < 0.02
        assert found[name].ci95[0] < 0.002


@pytest.mark.parametrize("seed", range(2))
def test_dead_times_that_a_ship_has_not_are_bounded_from_above(seed):
    """Where both vanish, only their sum has a slope: what tells one from the other is the square of a time."""
    tug = Vessel.load("stan-tug-1205")
    both = Structure.linear(
        torque="gauge", products=True, free_exponent=True, dead_time_loop=True, dead_time_set_point=True
    )
    chirp = signals.standard("chirp", 80.0, 35.0, rate_hz=50.0)
    found = identify(simulate(tug, chirp, noise={"n_e": 0.003, "M_g": 0.02}, seed=seed), both, starts=2)
    assert found.settings["converged"], found.settings["message"]
    for name in ("T_d", "T_set"):
        assert found[name].status in ("free", "at_bound"), found[name].reason
        low, high = found[name].ci95
        assert low == 0.0
        assert 0.0 < high < 1e-3
