"""Channels that are not what they are called, which the record itself can tell: refused, or a word in the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import shipfp_rs as fp
from shipfp_rs import _core
from shipfp_rs.assessment import si
from shipfp_rs.identification import input_checks
from tests.twins.ship import vector

LAUNCH = fp.Vessel.load("stan-launch-804")


@pytest.fixture(scope="module")
def made():
    """Return a chirp on the launch, with rack, noise on all."""
    chirp = fp.signals.chirp(0.02, 2.0, 80.0, 40.0, rate_hz=50.0)
    return fp.simulate(LAUNCH, chirp, noise={"n_e": 0.02, "M_b": 0.02, "X_f": 0.02}, seed=3)


@pytest.fixture(scope="module")
def right(made):
    """Return what is found of it."""
    return found_of(made)


def found_of(experiment):
    return fp.identify(experiment, torque="brake", outputs=["dn", "dM"], intervals="symmetric")


def with_signal(experiment, name, values, point):
    return replace(
        experiment,
        signals={**experiment.signals, name: values},
        operating_point={**experiment.operating_point, name: point},
    )


def test_a_good_trial_passes_every_gate(made):
    input_checks.require_excited([made])
    assert input_checks.doubts([made]) == []


@pytest.mark.parametrize("noise_rpm", [0.0, 0.02])
def test_a_set_point_that_is_the_measured_speed_is_refused_a13(made, noise_rpm):
    noise = noise_rpm * np.random.default_rng(0).standard_normal(len(made))
    speed = made.signals["n_e"] + noise
    with pytest.raises(fp.InputError, match="is its column that of the measured speed"):
        fp.identify(with_signal(made, "n_set", speed, made.operating_point["n_e"]))


def test_a_rack_that_is_the_torque_is_refused_a13(made):
    """In volts or per cent, it has the torque's very noise."""
    rack = 3.0 + made.signals["M_b"] / 40.0
    with pytest.raises(fp.InputError, match="X_f is a scaled copy of M_b"):
        fp.identify(with_signal(made, "X_f", rack, 3.0 + made.operating_point["M_b"] / 40.0))


def test_a_set_point_beside_the_speed_draws_a_word_a15(made, right):
    """1184 rpm asked, 1243 turned: less than the tenth from which a calibration is refused."""
    off = 1184.0 / 1243.0
    beside = with_signal(made, "n_set", off * made.signals["n_set"], off * made.operating_point["n_set"])
    found = found_of(beside)
    (word,) = [line for line in found.verdict if "differ at the operating point" in line]
    asked, speed = (beside.operating_point[name] for name in ("n_set", "n_e"))
    assert f"{asked:.4g} and {speed:.4g} rpm" in word
    assert not any("differ at the operating point" in line for line in right.verdict)


def test_a_torque_far_from_the_vessel_files_draws_a_word_a15(made, right):
    wrong = with_signal(made, "M_b", 0.1 * made.signals["M_b"], 0.1 * made.operating_point["M_b"])
    assert si.doubts(right, LAUNCH) == []
    (word,) = si.doubts(found_of(wrong), LAUNCH)
    assert f"{0.1 * made.operating_point['M_b']:.4g} Nm" in word
    assert f"{LAUNCH.nominal_brake_torque:.4g} Nm by the vessel file" in word


def test_gauge_torque_called_brake_torque_fits_as_well_and_cannot_be_known_a13():
    """L + tau_prop dN/dt is a brake torque of a ship with the inertia tau_prop: the same ratios, another tau_n.

    The record can't know; what must hold is that nothing beside tau_n's scale changes.
    """
    tug = fp.Vessel.load("stan-tug-1205")
    chirp = fp.signals.chirp(0.02, 2.0, 80.0, 40.0, rate_hz=50.0)
    trial = fp.simulate(tug, chirp, noise={"n_e": 0.02, "M_g": 0.02}, seed=5)
    kept = {name: trial.signals[name] for name in ("n_set", "n_e", "M_g")}
    named = {"n_set": kept["n_set"], "n_e": kept["n_e"], "M_b": kept["M_g"]}
    point = {name: trial.operating_point[name] for name in ("n_set", "n_e")}
    wrong = replace(
        trial, signals=named, operating_point={**point, "M_b": trial.operating_point["M_g"]}, provenance={}
    )
    true = fp.linearise(tug)
    found = fp.identify(wrong, intervals="symmetric")
    assert found["tau_n"].value == pytest.approx(true.tau_prop, rel=0.05)
    assert found["(p-g)/tau_n"].value == pytest.approx((true.p - true.g) / true.tau_n, rel=0.2)
    (word,) = si.doubts(found, tug)
    assert "look at the scale of the torque channel" in word


@pytest.fixture(scope="module")
def load_steps():
    """Return steps of a load on a stiff speed loop whose set point rests."""
    time = np.arange(0.0, 60.0, 0.02)
    levels = np.repeat([0.0, 0.3, -0.2, 0.1, 0.4, -0.3], 2)[1:-1]
    at = np.ravel([[start, start + 0.15] for start in (7.0, 16.1, 27.3, 35.9, 48.2)])
    load = np.interp(time, at, levels)
    outputs = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dM_b")]
    ship = vector(K_p=20.0, K_i=40.0, load_gain=1.0)
    dn, dM = _core.simulate_ship(ship, np.ones(len(time)), load, 0.02, 0, "first", outputs)
    random = np.random.default_rng(4)
    signals = {"n_set": np.ones(len(time)), "n_e": 1.0 + dn, "M_b": 1.0 + dM, "M_load": 1.0 + load}
    signals |= {name: signals[name] + 1e-3 * random.standard_normal(len(time)) for name in ("n_e", "M_b")}
    return fp.Experiment("load steps", 50.0, signals, dict.fromkeys(signals, 1.0))


def test_torque_that_rises_while_the_shaft_slows_under_load_is_right_c3(load_steps):
    input_checks.require_excited([load_steps])


@pytest.mark.parametrize("late_s", [0.0, 0.06, 0.3])
def test_a_load_that_is_told_late_does_not_turn_the_torque_c3(load_steps, late_s):
    late = np.roll(load_steps.signals["M_load"], round(50.0 * late_s))
    input_checks.require_excited([with_signal(load_steps, "M_load", late, 1.0)])


def test_a_torque_that_falls_as_the_load_rises_is_refused_c3(load_steps):
    turned = with_signal(load_steps, "M_b", 2.0 - load_steps.signals["M_b"], 1.0)
    with pytest.raises(fp.InputError, match="M_b falls while the load rises"):
        input_checks.require_excited([turned])


def test_a_torque_of_the_wrong_sign_is_refused_where_the_set_point_moves(made):
    """Under a load that is not measured, too, as long as the set point moves the torque by a good part."""
    kept = replace(made, signals={name: made.signals[name] for name in ("n_set", "n_e", "M_b")})
    point, torque = made.operating_point["M_b"], made.signals["M_b"]
    with pytest.raises(fp.InputError, match="M_b falls while the shaft speeds up"):
        input_checks.require_excited([with_signal(kept, "M_b", 2.0 * point - torque, point)])


def test_a_speed_that_falls_when_the_set_point_rises_names_whose_sign_to_turn(made):
    turned = 2.0 * made.operating_point["n_set"] - made.signals["n_set"]
    with pytest.raises(fp.InputError, match="reverse the sign of the set point's calibration"):
        input_checks.require_excited([replace(made, signals={**made.signals, "n_set": turned})])


def in_waves(seed, late_s=0.0):
    """Return a drive in moving water whose set point moves first, and then hardly; its clock is late."""
    random, rate_hz = np.random.default_rng(seed), 25.0
    steps = np.repeat([0.0, 0.03, 0.032, 0.031], [50, 350, 200, 150])
    steps += (late_s > 0.0) * np.repeat(random.uniform(-0.03, 0.03, 15), 50)
    late = round(late_s * rate_hz)
    water = lfilter([1.0], [1.0, -np.exp(-0.27)], random.standard_normal(len(steps)))
    answer = lfilter([0.2], [1.0, -0.8], np.r_[np.zeros(5), steps[:-5]])
    asked = np.r_[np.zeros(late), steps[: len(steps) - late]]
    signals = {"n_set": 1.0 + asked, "n_e": 1.0 + answer + 0.004 * water / np.std(water)}
    return fp.Experiment("steps", rate_hz, signals, dict.fromkeys(signals, 1.0))


@pytest.mark.parametrize("seed", range(4))
def test_moving_water_is_no_answer_that_comes_too_early(seed):
    """Beside small steps of the set point the water's own motion goes by chance with one that comes later."""
    input_checks.require_excited([in_waves(seed)])


@pytest.mark.parametrize("seed", range(3))
def test_a_late_clock_is_found_in_moving_water(seed):
    with pytest.raises(fp.InputError, match=r"n_e moves .* s before the set point"):
        input_checks.require_excited([in_waves(seed, 0.8)])


def test_a_step_early_in_its_window_is_no_answer_that_comes_too_early():
    """The check reads the whole window: a drive's step at 2 s of 30 s, with a slow end, is a clean step test."""
    rate_hz = 50.0
    for seed in range(8):
        random = np.random.default_rng(seed)
        asked = np.repeat([0.0, 0.03], [100, 1400])
        late = np.r_[np.zeros(5), asked[:-5]]
        answer = 0.67 * lfilter([0.2], [1.0, -0.8], late) + 0.33 * lfilter([0.006], [1.0, -0.994], late)
        signals = {"n_set": 1.0 + asked, "n_e": 1.0 + answer + 2e-4 * random.standard_normal(len(asked))}
        input_checks.require_excited([fp.Experiment("step", rate_hz, signals, dict.fromkeys(signals, 1.0))])
