"""The full model of the ship fitted by one likelihood: what it must find, and what it must not invent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.identification.basins import descend
from shipfp_rs.identification.estimate import Estimate
from shipfp_rs.identification.profiles import Profiles, figures_of
from shipfp_rs.identification.question import question_of
from shipfp_rs.identification.ship_estimates import _of_a_stiff_shaft
from shipfp_rs.identification.ship_fit import fit_ship, smooth_ship
from shipfp_rs.identification.ship_found import DEFAULTS
from shipfp_rs.structures.elements import ELEMENTS
from tests.families.draw import draw

LAUNCH = fp.Vessel.load("stan-launch-804")
TRUE = fp.linearise(LAUNCH)


def trial(noise=None, seconds=120.0, **options):
    """Return a chirp on the launch, with noise on what is named."""
    chirp = fp.signals.chirp(0.02, 2.0, seconds, 40.0, rate_hz=50.0)
    return fp.simulate(
        LAUNCH, chirp, noise={"n_e": 0.3, "M_b": 0.5} if noise is None else noise, seed=3, **options
    )


@pytest.fixture(scope="module")
def drawn():
    """Return a ship with water, both dead times and a lag, and what was measured of it."""
    found = draw("launch", 31372, load=False)
    return found, fp.Experiment(**found.experiment())


def holds(found, name, truth, wider=1.0):
    low, high = (found[name].value + wider * (end - found[name].value) for end in found[name].ci95)
    return low <= truth <= high


@pytest.mark.parametrize(("hold", "late_s"), [("zero", 0.05), ("first", 0.1)])
def test_what_an_experiment_says_of_its_set_point_decides_half_a_sample_of_dead_time(hold, late_s):
    late = LAUNCH.replace({"governor.set_point_dead_time_s": 0.05, "actuator.lag_s": 0.05})
    steps = fp.signals.steps([40.0, -60.0, 30.0, -30.0, 50.0], 10.0, lead_s=5.0, rate_hz=10.0)
    held = fp.simulate(late, replace(steps, hold="zero"), noise={"n_e": 0.1, "M_b": 0.2}, seed=2)
    recorded = replace(held, hold=hold, provenance={})
    fit = smooth_ship(question_of([recorded], torque="brake", outputs=["dn", "dM"]))
    assert fit.values["T_set"] + fit.values["T_d"] == pytest.approx(late_s, abs=0.015)


def test_the_gradient_of_the_deviance_is_that_of_its_differences(drawn):
    question = question_of([drawn[1]])
    likelihood = question.likelihood("band-limited")
    c = likelihood.coordinates
    values = {
        "tau_n": 0.4,
        "g": -0.3,
        "vK_p": 0.9,
        "vK_i": 3.0,
        "p": 1.9,
        "T_d": 0.053,
        "T_s": 0.04,
        "T_set": 0.311,
        "tau_act": 0.07,
        "tau_eng": 0.02,
    }
    vector = c.vector(
        {**values, "c_2": 0.1, "T_M": 0.0031}, [{"set point offset": 1e-3, "torque scale": 1e-3}]
    )
    likelihood = likelihood.with_noise(vector)
    products = likelihood.products(vector)
    for place, name in enumerate([*c.names, *range(c.size - len(c.names))]):
        step = 1e-5 * max(abs(vector[place]), 1e-2)
        ahead, behind = (vector + sign * step * np.eye(c.size)[place] for sign in (1.0, -1.0))
        slope = (likelihood.cost(ahead) - likelihood.cost(behind)) / (2.0 * step)
        assert -2.0 * products.downhill[place] == pytest.approx(
            slope, rel=2e-3, abs=1e-4 * abs(slope) + 1e-3
        ), name


@pytest.mark.parametrize("structure", [None, fp.Structure.ship()])
def test_an_output_of_which_nothing_was_measured_is_refused_in_one_line(structure):
    made = trial()
    gone = replace(made, signals={**made.signals, "M_b": np.full(len(made), np.nan)})
    with pytest.raises(fp.InputError, match="every sample of M_b is masked"):
        fp.identify(gone, structure)


def test_a_short_record_is_refused_in_one_line():
    with pytest.raises(fp.InputError, match=r"6 s, expected .* s or more of a drive of this pace"):
        fp.identify(trial(seconds=6.0))


def test_a_set_point_that_comes_after_the_answer_is_refused_before_any_fit_a8():
    made = trial()
    behind = round(0.5 * made.rate_hz)
    asked = np.r_[np.full(behind, made.signals["n_set"][0]), made.signals["n_set"][:-behind]]
    with pytest.raises(fp.InputError, match=r"n_e moves .* s before the set point"):
        fp.identify(replace(made, signals={**made.signals, "n_set": asked}))


def test_a_torque_that_stands_still_is_refused_before_any_fit_a8():
    made = trial()
    still = np.full(len(made), made.operating_point["M_b"])
    with pytest.raises(fp.InputError, match="M_b stands still"):
        fp.identify(replace(made, signals={**made.signals, "M_b": still}))


def test_both_dead_times_and_the_lag_of_a_ship_in_moving_water_are_told(drawn):
    ship, experiment = drawn
    found, truth = fp.identify(experiment), ship.truth()["parameters"]
    for name in ("tau_n", "g", "vK_p", "vK_i", "p", "T_d", "T_set", "tau_act"):
        # Of eight intervals of 95 per cent one in three ships has one that does not hold.
        assert holds(found, name, truth[name], wider=1.5), name
    assert found.usability != "not usable"
    assert {name: row["state"] for name, row in found.elements.items()}["dead_time_set_point"] == "on"


def test_a_fit_begun_at_the_truth_does_not_end_lower(drawn):
    ship, experiment = drawn
    fit = fit_ship(question_of([experiment]))
    c = fit.likelihood.coordinates
    truth = ship.truth()["parameters"]
    states = c.states_at(fit.best.vector)
    begun = c.vector({**truth, "T_s": 0.0, "c_2": 0.0, "M_max": 4.0}, states)
    assert descend(fit.likelihood, begun).cost > fit.best.cost - 4.0


@pytest.mark.parametrize(("lowest", "told"), [(0.0, False), (2e-3, True), (None, False)])
def test_a_part_of_the_inertia_that_only_a_twist_tells_is_open_where_a_stiff_shaft_fits(lowest, told):
    """At the brake tau_prop acts through the twist alone (genset 190062: 0.09 s for 0.54)."""
    question = question_of([trial()], torque="brake", outputs=["dn", "dM"])
    twist = (
        Estimate(None, status="unidentifiable") if lowest is None else Estimate(4e-3, 1e-3, (lowest, 6e-3))
    )
    parameters = {"tau_prop": Estimate(0.09, 0.02, (0.05, 0.13), "s"), "tau_twist": twist}
    found = parameters | _of_a_stiff_shaft(parameters, question)
    assert (found["tau_prop"].status != "fixed") == told
    behind = replace(question, gauge=True)
    assert not _of_a_stiff_shaft(parameters, behind)


def test_a_drive_without_elements_is_given_none():
    found = fp.identify(trial(), torque="brake", outputs=["dn", "dM"])
    for name in ("T_d", "T_set", "tau_act"):
        assert found[name].ci95[0] < 1e-3, name
        assert found[name].ci95[1] < 0.01, name
    states = {name: row["state"] for name, row in found.elements.items()}
    assert {states[name] for name in ("torque_limit", "rack_rate", "twist")} == {"off"}
    for name, truth in {"tau_n": TRUE.tau_n, "g": TRUE.g, "vK_p": TRUE.v * TRUE.K_p, "p": 2.0}.items():
        assert holds(found, name, truth, wider=1.5), name


def test_channels_free_of_noise_weigh_no_more_than_their_accuracy_a10():
    # Noise on speed and brake torque alone: the rack and the gauge torque beside are exact.
    noisy = trial(noise={"n_e": 0.02 * 13.0, "M_b": 0.02 * 45.0})
    found = fp.identify(noisy)
    assert found.data[0]["signals"]["dM"] == "M_b"
    assert found.usability != "not usable"
    for name, truth in {"tau_n": TRUE.tau_n, "g": TRUE.g, "p": 2.0}.items():
        assert holds(found, name, truth, wider=1.5), name  # one draw


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [7.1, 1.3])
def test_a_window_that_begins_in_the_middle_of_the_excitation_tells_the_same_a6(late_s, drawn):
    ship, experiment = drawn
    begin = ship.excitation.start_s
    whole = fp.identify(experiment.window(begin - 3.0, experiment.duration))
    late = fp.identify(experiment.window(begin + late_s, experiment.duration))
    for name in ("tau_n", "vK_p", "vK_i", "p", "T_set"):
        assert late[name].ci95[0] <= whole[name].value <= late[name].ci95[1], name


@pytest.mark.parametrize(
    "option",
    [
        {"noise": "coloured"},
        {"starts": 3},
    ],
)
def test_an_option_of_given_structures_is_refused_by_name_a9(option):
    with pytest.raises(fp.InputError, match=f"^{next(iter(option))}: given without a structure"):
        fp.identify(trial(), **option)


def test_what_is_given_is_held_and_a_prior_is_obeyed():
    found = fp.identify(
        trial(),
        torque="brake",
        outputs=["dn", "dM"],
        fixed={"p": 2.0},
        priors={"g": (-0.9, 1e-3)},
        elements=dict.fromkeys(("torque_limit", "rack_rate", "twist"), False),
    )
    assert found["p"].status == "fixed"
    assert found["g"].status == "prior"
    assert found["g"].value == pytest.approx(-0.9, abs=0.02)
    with pytest.raises(fp.InputError, match="fixed: no parameter 'tau'"):
        fp.identify(trial(), fixed={"tau": 1.0})


def test_intervals_by_curvature_take_no_profile_and_lie_near():
    made = trial()
    profile, symmetric = (
        fp.identify(made, torque="brake", outputs=["dn", "dM"], intervals=kind)
        for kind in ("profile", "symmetric")
    )
    assert symmetric["tau_n"].std == pytest.approx(profile["tau_n"].std, rel=0.5)
    assert symmetric["tau_n"].value == pytest.approx(profile["tau_n"].value, rel=1e-3)


def test_points_of_another_figure_do_not_move_the_ends_of_an_interval():
    # They lie inside with a rise near the quantile, which is not that of the profile there.
    question = question_of([trial()], torque="brake", outputs=["dn", "dM"])
    likelihood = question.likelihood("straight")
    c = likelihood.coordinates
    start = c.vector({**DEFAULTS, "c_2": 0.0, "T_d": 0.01, "T_set": 0.01, "tau_act": 0.01})
    likelihood = likelihood.with_noise(descend(likelihood, start).vector)
    best = descend(likelihood, start)
    figures = figures_of(["tau_n", "p", "vK_p"])
    alone = {name: Profiles(likelihood, [best]).interval(figure) for name, figure in figures.items()}
    together = Profiles(likelihood, [best])
    for name, figure in figures.items():
        found, expected = together.interval(figure), alone[name]
        width = expected.high - expected.low
        assert found.low == pytest.approx(expected.low, abs=0.1 * width), name
        assert found.high == pytest.approx(expected.high, abs=0.1 * width), name


def test_every_element_of_the_ship_has_a_place_to_begin_its_search():
    parameters = [parameter for element in ELEMENTS.values() for parameter in element.parameters]
    assert {parameter.name for parameter in parameters} <= set(DEFAULTS)


@pytest.mark.parametrize(
    ("seed", "names"),
    [
        # A flywheel of 43 s.
        (52003, ("tau_n", "tau_prop", "p", "g", "vK_p", "vK_i", "T_d", "T_set")),
        # A drive that filters the speed that its governor measures.
        (41017, ("tau_n", "g", "vK_p", "vK_i", "p", "T_d", "T_set", "tau_act")),
    ],
)
def test_the_answer_of_a_slow_and_of_a_filtered_drive_holds(seed, names):
    drawn = draw("strangers", seed)
    found = fp.identify(fp.Experiment(**drawn.experiment()))
    truth = drawn.truth()["parameters"]
    for name in names:
        low, high = found.parameters[name].ci95
        assert low <= truth[name] <= high, name


def test_the_lag_of_an_engine_is_told_with_its_inertia():
    """Turbocharger or fuel film: an answer without it has a dead time that the loop does not have."""
    drawn = draw("charged", 5007)
    found = fp.identify(fp.Experiment(**drawn.experiment()))
    truth = drawn.truth()["parameters"]
    for name in ("tau_n", "g", "vK_p", "vK_i", "T_d", "T_set", "tau_act", "tau_eng"):
        low, high = found.parameters[name].ci95
        assert low <= truth[name] <= high, name
    assert found.elements["engine_lag"]["state"] == "on"
