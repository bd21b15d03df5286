"""The data choose the elements of the ship: trials by an independent simulation, and wrong data that are refused."""

import dataclasses

import numpy as np
import pytest
from benches import rival_ship
from benches.bench_identify import M_G, N_E, SHIP, experiment
from scipy.signal import resample_poly

import shipfp_rs as fp
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.structure import Structure

TRUTH = dict(zip(SHIP, rival_ship.TRUTH, strict=False))


@pytest.fixture(scope="module")
def record():
    return rival_ship.trial(3, 500.0)


@pytest.fixture(scope="module")
def data(record):
    return experiment(*record)


@pytest.fixture(scope="module")
def found(data):
    return fp.identify(data)


def test_the_dead_times_that_act_are_found_and_nothing_else(found):
    states = {name: row["state"] for name, row in found.elements.items()}
    assert states["dead_time_set_point"] == "on"
    # A short dead time in the loop and a lag of the actuator can look alike: then both are left open.
    assert states["dead_time_loop"] in ("on", "open")
    assert states["torque_limit"] == states["twist"] == states["late_torque"] == "off"
    assert found.structure["kind"] == "ship"


def test_every_parameter_is_told_and_near_the_truth(found):
    for name, truth in TRUTH.items():
        estimate = found[name]
        assert estimate.status == "free", name
        # Eight intervals of one draw: none is off by more than four of its deviations.
        assert abs(estimate.value - truth) < 4.0 * estimate.std, name


def test_what_does_not_act_has_a_limit(found):
    lag, torque = found.elements["actuator_lag"], found.elements["torque_limit"]
    assert 0.0 < lag["limit"]["value"] < 0.1
    assert torque["state"] == "off"
    assert torque["limit"] is None or torque["limit"]["value"] > 1.0


def test_the_first_sentence_says_what_the_fingerprint_is_usable_for(found):
    assert found.usable.startswith("Usable")
    assert found.verdict[0] == found.usable
    assert found.adequate["stands"]


def test_a_fingerprint_of_a_choice_is_read_back_as_it_was(found, tmp_path):
    read = fp.Fingerprint.load(found.save(tmp_path / "fingerprint.json"))
    assert read.elements == found.elements
    assert (read.usable, read.usability) == (found.usable, found.usability)
    assert read.adequate == found.adequate


def test_the_model_of_a_choice_is_built_again_from_its_file(found, data):
    from shipfp_rs.assessment.prediction import predict

    simulated = predict(found, data)
    rest = simulated["n_e"] - data.normalised("n_e")
    assert np.std(rest) < 0.2 * np.std(data.normalised("n_e"))


def test_an_element_forced_off_is_off_and_the_misfit_is_told(data):
    off = ("dead_time_set_point", "actuator_lag", "torque_limit", "twist", "late_torque")
    found = fp.identify(data, elements=dict.fromkeys(off, False), intervals="symmetric")
    assert "T_set" not in found.parameters
    assert not found.adequate["stands"]
    assert found.adequate["dispersion"] > 1.0


def test_a_known_value_is_held(data):
    found = fp.identify(data, fixed={"tau_n": 1.2}, elements={"torque_limit": False, "twist": False})
    assert found["tau_n"].status == "fixed"
    assert found["tau_n"].value == 1.2


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("elements", {"dead_time_lop": True}, "dead_time_lop"),
        ("torque", "brake", "torque"),
    ],
)
def test_options_of_the_choice_are_checked(data, option, value, words):
    structure = fp.Structure.ship([], torque="gauge") if option == "torque" else None
    with pytest.raises(InputError, match=words):
        fp.identify(data, structure, **{option: value})


def changed(data, **signals):
    return dataclasses.replace(data, signals={**data.signals, **signals})


def breakage_cases(data):
    random = np.random.default_rng(4)
    count = len(data)
    still = np.full(count, N_E)
    noise = N_E * (1.0 + 0.03 * random.standard_normal(count))
    return {
        "a6 constant set point": (changed(data, n_set=still), "stands still"),
        "a6 five samples": (data.window(0.0, 0.1), "samples"),
        "a7 white noise as set point": (changed(data, n_set=noise), "does not follow"),
        "a7 torque of the wrong sign": (changed(data, M_g=2.0 * M_G - data.signals["M_g"]), "sign"),
        "a7 falling set point": (changed(data, n_set=2.0 * N_E - data.signals["n_set"]), "sign"),
    }


@pytest.mark.parametrize(
    "case",
    [
        "a6 constant set point",
        "a6 five samples",
        "a7 white noise as set point",
        "a7 torque of the wrong sign",
        "a7 falling set point",
    ],
)
def test_breakage_a6_a7_wrong_data_are_refused_in_one_line(data, case):
    wrong, words = breakage_cases(data)[case]
    with pytest.raises(InputError, match=words) as caught:
        fp.identify(wrong)
    assert "\n" not in str(caught.value)


def test_breakage_a7_an_operating_point_three_times_too_low_is_refused(data):
    point = {**data.operating_point, "M_g": M_G / 2.0}
    with pytest.raises(InputError, match="operating point"):
        fp.identify(dataclasses.replace(data, operating_point=point))


def test_a_filtered_set_point_is_taken_for_a_band_limited_one():
    # Simulated ten times as fine, and sampled behind a low-pass, as a logger's channels are.
    from scipy.signal import firwin, lfilter

    fine, every = 0.002, 10
    u, _, _ = rival_ship.trial(7, 200.0, fine)
    noise = np.random.default_rng(7).normal(size=(2, len(u))) * [[5e-4], [1.5e-3]]
    y = rival_ship.ship(rival_ship.TRUTH, u, fine, 2) + noise
    taps = firwin(401, 18.0, fs=1.0 / fine)
    late = len(taps) // 2
    u, *rows = (lfilter(taps, 1.0, row)[2 * late :] for row in (u, *y))
    found = fp.identify(
        experiment(u[::every], np.array(rows)[:, ::every], fine * every), intervals="symmetric"
    )
    assert found.settings["set_point"] == "band-limited"
    assert abs(found["T_d"].value - TRUTH["T_d"]) < 0.004


def test_a_left_out_element_widens_the_side_on_which_it_would_move_the_estimate():
    from shipfp_rs.identification.automatic import _beyond
    from shipfp_rs.identification.estimate import Estimate
    from shipfp_rs.identification.promise import Neglect

    estimate = Estimate(1.0, 0.1, (0.8, 1.2))
    above = Neglect(0.0, 0.5, {"p": 1.0})
    low, high = _beyond(estimate, 1.0, above, np.inf)
    assert low == 0.0
    # Both told together: 1.96 sqrt(0.1^2 + 0.5^2) beyond the estimate, less what the interval has.
    assert high == pytest.approx(np.hypot(0.2, 1.96 * 0.5) - 0.2, rel=0.02)
    assert _beyond(estimate, 0.0, above, np.inf) == (0.0, 0.0)
    assert _beyond(estimate, 1.0, above, 0.1)[1] <= 0.1  # no stronger than that it can be
    # What the residuals speak against moves nothing far.
    assert _beyond(estimate, 1.0, Neglect(-5.0, 0.5, {}), np.inf)[1] < 0.25 * high


def test_a_parameter_on_a_bound_has_a_limit_in_place_of_a_value():
    from shipfp_rs.identification.automatic import with_limits
    from shipfp_rs.identification.estimate import Estimate

    @dataclasses.dataclass(frozen=True)
    class Holder:
        parameters: dict

    estimate = Estimate(1e-4, None, (1e-4, 1.4), "-", "at_bound", "on its lower bound")
    told = with_limits(Holder({"vK_p": estimate})).parameters["vK_p"]
    assert told.status == "unidentifiable"
    assert told.value is None
    assert "below 1.4" in told.reason


def sampled_trial(period, driven, fine, elements, torque, **truth):
    """A trial of a ship whose governor samples, recorded at 50 Hz; the raw torque told its clock."""
    structure = Structure.ship(["sampling", *elements], torque="gauge" if torque == "M_g" else "brake")
    ones = np.ones(len(driven.samples))
    point = {"n_set": 1500.0, "n_e": 1500.0, torque: 1000.0}
    asked = {"n_set": 1500.0 + driven.samples, "n_e": 1500.0 * ones, torque: 1000.0 * ones}
    values = {**dict.fromkeys(structure.equations.states, 0.0), **truth, "T_s": period, "T_0": 0.37 * period}
    answer = structure.equations.simulate(values, Experiment("fine", 50.0 * fine, asked, point))
    random = np.random.default_rng(5)
    signals = {
        "n_set": 1500.0 + resample_poly(driven.samples, 1, fine),
        "n_e": 1500.0 * (1.0 + resample_poly(answer[0], 1, fine)),
        torque: 1000.0 * (1.0 + resample_poly(answer[1], 1, fine)),
    }
    signals["n_e"] += 0.3 * random.standard_normal(len(signals["n_e"]))
    signals[torque] += 3.0 * random.standard_normal(len(signals["n_e"]))
    told = {
        "filter": "low-pass",
        "governor_clock": {"period_s": period, "std_s": 2e-5 * period, "power": 1e3},
    }
    return Experiment("trial", 50.0, signals, point, provenance=told)


@pytest.mark.parametrize("clock", [True, False])
def test_breakage_a1_a_tug_s_default_intervals_hold_the_truth(clock):
    """A lopsided slow first cycle, a bent n^p, two dead times and a governor of 50 Hz, its clock told or not."""
    truth = {"tau_n": 1.17, "g": -0.58, "vK_p": 7.0, "vK_i": 8.0, "p": 2.17, "tau_prop": 0.38}
    truth |= {"T_d": 0.06, "T_set": 0.30}
    driven = fp.signals.chirp(0.001, 2.0, 500.0, 30.0, rate_hz=400.0)
    trial = sampled_trial(0.02, driven, 8, ["dead_time_loop", "dead_time_set_point"], "M_g", **truth)
    if not clock:
        trial = dataclasses.replace(trial, provenance={"filter": "low-pass"})
    found = fp.identify(trial)
    print(found.verdict, found)
    assert found.adequate["stands"]
    for name, value in truth.items():
        low, high = found.parameters[name].ci95
        # One record of eight intervals of 95 %: three standard deviations.
        assert low - 0.25 * (high - low) <= value <= high + 0.25 * (high - low), name
    if clock:
        assert found.parameters["T_s"].value == pytest.approx(0.02, rel=0.05)


def test_breakage_a3_dead_time_and_gains_are_the_sampling_governor_s_own_where_the_torque_told_its_clock():
    """Without the clock the dead time would be half a period too long."""
    fine, period = 8, 0.03
    truth = {"tau_n": 0.9, "g": -0.4, "vK_p": 7.0, "vK_i": 10.0, "p": 2.2, "tau_prop": 0.4, "T_d": 0.045}
    driven = fp.signals.chirp(0.05, 3.0, 240.0, 30.0, rate_hz=50.0 * fine)
    found = fp.identify(sampled_trial(period, driven, fine, ["dead_time_loop"], "M_g", **truth))
    print(found.verdict, found)
    assert found.elements["sampling"]["state"] == "on"
    assert found.parameters["T_s"].value == pytest.approx(period)
    assert found.parameters["T_d"].value == pytest.approx(truth["T_d"], abs=2e-3)  # half a period is 15 ms
    for name in ("tau_n", "g", "vK_p", "vK_i", "p", "tau_prop"):
        low, high = found.parameters[name].ci95
        # One record of six intervals of 95 %: three standard deviations.
        assert low - 0.25 * (high - low) <= truth[name] <= high + 0.25 * (high - low), name
    # A governor that adds up after it acts has K_i T_s / 2 less than it seems: the interval holds both ways.
    low, high = found.parameters["vK_p"].ci95
    assert high - low >= truth["vK_i"] * period


def test_a_limit_that_cuts_off_the_stairs_of_a_sampling_governor_is_found():
    """The records are cleared of what holding does; with the limit that is less than without it."""
    truth = {"tau_n": 0.44, "g": -0.5, "vK_p": 8.0, "vK_i": 60.0, "p": 2.2, "T_d": 0.02, "M_max": 1.1}
    driven = fp.signals.chirp(0.05, 3.0, 160.0, 25.0, rate_hz=400.0)
    trial = sampled_trial(0.023, driven, 8, ["dead_time_loop", "torque_limit"], "M_b", **truth)
    found = fp.identify(trial)
    print(found.verdict, found)
    assert found.elements["torque_limit"]["state"] == "on"
    assert found.parameters["M_max"].value == pytest.approx(truth["M_max"], abs=0.01)
    for name in ("tau_n", "vK_p", "vK_i", "p"):
        low, high = found.parameters[name].ci95
        assert low - 0.25 * (high - low) <= truth[name] <= high + 0.25 * (high - low), name


def test_what_was_left_out_widens_only_as_far_as_no_delay_falls_below_nothing():
    """A dead time in the loop can take over no more of the set point's than there is."""
    launch = fp.Vessel.load("stan-launch-804")
    chirp = fp.signals.chirp(0.02, 2.0, 120.0, 40.0, rate_hz=20.0)
    trial = fp.simulate(launch, chirp, noise={"n_e": 0.05, "M_b": 0.1}, seed=2)
    found = fp.identify(trial, torque="brake", outputs=["dn", "dM"])
    low, high = found.parameters["vK_p"].ci95
    assert high - low < 0.2 * found.parameters["vK_p"].value


def test_a_twisting_shaft_of_a_light_drive_train_is_found_behind_a_brake_torque():
    """Its propeller's part of the inertia must start as a part of this ship's, not of a usual one's."""
    truth = {"tau_n": 0.4, "g": -1.0, "vK_p": 3.0, "vK_i": 30.0, "p": 2.0, "tau_prop": 0.11}
    truth |= {"tau_twist": 0.015, "zeta_twist": 0.4}
    structure = Structure.ship(["twist"], torque="brake")
    chirp = fp.signals.chirp(0.05, 5.0, 200.0, 25.0, rate_hz=50.0)
    point = {"n_set": 1500.0, "n_e": 1500.0, "M_b": 400.0}
    signals = {"n_set": 1500.0 + chirp.samples}
    signals |= dict.fromkeys(("n_e", "M_b"), np.ones(len(chirp.samples)))
    states = dict.fromkeys(structure.equations.states, 0.0)
    answer = structure.equations.simulate({**states, **truth}, Experiment("asked", 50.0, signals, point))
    noise = np.random.default_rng(6).standard_normal(answer.shape) * [[3e-4], [3e-3]]
    signals |= {"n_e": 1500.0 * (1.0 + answer[0] + noise[0]), "M_b": 400.0 * (1.0 + answer[1] + noise[1])}
    found = fp.identify(Experiment("trial", 50.0, signals, point))
    assert found.elements["twist"]["state"] == "on"
    assert found.parameters["tau_twist"].value == pytest.approx(truth["tau_twist"], rel=0.05)
    assert found.parameters["tau_prop"].value == pytest.approx(truth["tau_prop"], rel=0.05)
