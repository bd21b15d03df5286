"""The ship's steps against an exact twin and the ship without an element."""

import math
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError

from ..twins import ship as twin
from ..twins.ship import vector

NAMES, OUTPUTS = _core.SHIP_PARAMETERS, _core.SHIP_OUTPUTS
ALL = list(range(len(OUTPUTS)))
NO_LOAD = np.zeros(0)
DT, SAMPLES = 0.05, 20
HOLDS = ("first", "zero")
LATE = {"T_d": 0.0413, "T_set": 0.0311}
TORQUE = {"M_max": 1.12, "M_max_slope": -0.5, "M_min": 0.93}
RACK = {"X_max": 0.1, "X_min": -0.07}
RATE = {"rate_up": 0.6, "rate_down": 0.5, "tau_act": 0.08}
TWIST = {"tau_twist": 0.004, "zeta_twist": 0.3}
SAMPLED = {"T_s": 0.03, "T_0": 0.0071}
REST = {"damping": 0.2, "curvature": 0.5, "load_gain": 0.7, "s_u": 1.01, "u_0": -0.01, "s_M": 0.99}
SHIPS = {
    "PI alone": {},
    "a square": {"p": 2.0},
    "both dead times": LATE,
    "a dead time below a step": {"T_d": 0.0007, "T_set": 0.0011},
    "dead times of whole steps": {"T_d": 0.05, "T_set": 0.025},
    "a command held": {**LATE, "hold": 0.6},
    "a command held as long as it is late": {"T_d": 0.0413, "hold": 1.0, "tau_act": 0.03},
    "lag": {"tau_act": 0.05},
    "lag and dead times": {**LATE, "tau_act": 0.05},
    "torque limits": TORQUE,
    "torque limits, late": {**TORQUE, **LATE},
    "anti-windup at the torque": {**TORQUE, "anti_windup": 1.0, "tau_act": 0.06},
    "anti-windup at the rack": {**RACK, "anti_windup": 1.0, "T_d": 0.0413},
    "rack limits": {**RACK, **LATE},
    "rate limits": {**RATE, "tau_act": 0.0},
    "rate limits behind a lag": {**RATE, **LATE},
    "derivative gain": {"K_d": 0.1},
    "derivative gain and lag": {"K_d": 0.1, "tau_act": 0.05},
    "derivative gain, late": {"K_d": 0.1, **LATE},
    "derivative gain, load": {"K_d": 0.1, **REST},
    "twist": {**TWIST, **LATE},
    "twist and derivative gain": {**TWIST, "K_d": 0.05},
    "twist at limits": {**TWIST, **TORQUE, "tau_act": 0.05},
    "speed filter": {"T_f": 0.06},
    "speed filter, late": {"T_f": 0.06, **LATE, "tau_act": 0.05},
    "speed filter, derivative gain, twist": {"T_f": 0.06, "K_d": 0.1, **TWIST},
    "speed filter, limits": {"T_f": 0.06, **RACK, "anti_windup": 1.0},
    "engine lag": {"tau_eng": 0.15},
    "engine lag, late, twist": {"tau_eng": 0.15, **LATE, **TWIST, "tau_act": 0.05},
    "engine lag, rack limits": {"tau_eng": 0.15, **RACK, "initial_N": 0.98},
    "engine lag, derivative gain": {"tau_eng": 0.15, "K_d": 0.1},
    "droop": {"droop": 0.05},
    "droop, late, lag": {"droop": 0.05, **LATE, "tau_act": 0.05},
    "droop, derivative gain": {"droop": 0.05, "K_d": 0.1},
    "droop, speed filter, twist": {"droop": 0.05, "T_f": 0.06, **TWIST},
    "sampled, droop": {**SAMPLED, "droop": 0.05, **LATE},
    "sampled before use, droop": {**SAMPLED, "droop": 0.05, "update": 1.0, "tau_act": 0.05},
    "load": {**REST, **LATE},
    "late channels": {**LATE, **REST, "T_n": 0.0137, "T_M": 0.0211},
    "not at rest": {"initial_N": 0.97, "initial_F": 0.02, "initial_E": 0.003, **LATE, "tau_act": 0.05},
    "sampled": {**SAMPLED, **LATE},
    "sampled before use, lag": {**SAMPLED, "update": 1.0, "tau_act": 0.05},
    "sampled, derivative gain": {**SAMPLED, "K_d": 0.02, **LATE},
    "sampled, speed filter": {**SAMPLED, "T_f": 0.06, "K_d": 0.02},
    "sampled, engine lag": {**SAMPLED, "tau_eng": 0.15, **LATE},
    "sampled, rate limits": {**SAMPLED, **RATE, "tau_act": 0.0},
    "sampled, rate limits behind a lag": {**SAMPLED, **RATE},
    "sampled, limits": {**SAMPLED, **TORQUE, **RATE},
    "sampled, twist": {**SAMPLED, **TWIST, **LATE},
}


def record(samples=SAMPLES, size=0.06):
    """A set point that swings, jumps and trembles, and a load that swings."""
    t = np.arange(samples) * DT
    swing = np.sin(2.0 * np.pi * 0.7 * t + 0.3) + 0.5 * np.sign(np.sin(2.0 * np.pi * 0.31 * t + 0.1))
    u = 1.0 + size * (swing + 0.2 * np.random.default_rng(0).standard_normal(samples))
    return u, 0.05 * np.sin(2.0 * np.pi * 0.4 * t)


def rms(rows):
    return np.sqrt(np.mean(np.square(rows), axis=-1))


def simulated(values, hold, substeps):
    u, load = record()
    return _core.simulate_ship(vector(**values), u, load, DT, substeps, hold, ALL)


def solution(ship, hold):
    """The twin's outputs."""
    u, load = record()
    return twin.simulate(SHIPS[ship], u, load, DT, hold, OUTPUTS)


DEAR = {
    "derivative gain, late",
    "a command held as long as it is late",
    "lag and dead times",
    "a dead time below a step",
    "not at rest",
}
"""Ships for which the twin takes seconds; what they join is tested alone every day."""


@pytest.mark.parametrize(
    ("ship", "hold"),
    [
        pytest.param(ship, HOLDS[place % 2], marks=pytest.mark.slow if ship in DEAR else ())
        for place, ship in enumerate(SHIPS)
    ],
)
def test_outputs_are_those_of_the_equations_and_come_nearer_with_shorter_steps(ship, hold):
    expected = solution(ship, hold)
    spread = np.ptp(expected, axis=1)
    coarse, fine = (rms(simulated(SHIPS[ship], hold, substeps) - expected) / spread for substeps in (10, 40))
    limited = any(name in SHIPS[ship] for name in ("M_max", "X_max", "rate_up"))
    late = any(name in SHIPS[ship] for name in ("T_n", "K_d")) and "T_d" in SHIPS[ship]
    if (
        "anti_windup" in SHIPS[ship]
        or (limited and "T_s" in SHIPS[ship])
        or (hold == "zero" and (limited or late))
    ):
        # What turns or jumps amid a step is not located in it.
        assert coarse.max() < 1e-2
        assert fine.max() < 3e-3
        return
    assert coarse.max() < 1e-3
    if "T_s" not in SHIPS[ship]:
        assert (fine <= np.maximum(coarse / 3.0, 4e-6)).all()


@pytest.mark.parametrize(
    ("more", "size"),
    [({}, 0.06), (TWIST, 0.06), (SAMPLED, 0.03), ({**SAMPLED, "tau_act": 0.05, "T_d": 0.0413}, 0.03)],
)
def test_a_rate_limit_is_left_and_reached_amid_a_step(more, size):
    t = np.arange(1500) * 0.02
    u = 1.0 + size * (np.sin(2.0 * np.pi * 0.23 * t) + 0.6 * np.sin(2.0 * np.pi * 0.71 * t + 1.0))
    ship = vector(**more, rate_up=0.35, rate_down=0.3)
    coarse, fine = (
        _core.simulate_ship(ship, u, NO_LOAD, 0.02, steps, "first", [0, 1, 3]) for steps in (4, 40)
    )
    assert np.abs(np.diff(fine[2])).max() > 0.9 * 0.3 * 0.02
    assert (rms(coarse - fine) < 3e-4 * np.std(fine, axis=1)).all()


@pytest.mark.parametrize("name", ["T_d", "T_set", "tau_act", "T_f", "tau_eng", "tau_twist"])
@pytest.mark.parametrize("more", [{}, {"K_d": 0.1}, {**REST, "tau_act": 0.0}, TORQUE])
def test_an_element_goes_to_off_continuously(name, more):
    damped = {"zeta_twist": 1.0} if name == "tau_twist" else {}
    without = simulated(more, "first", 10)
    # Behind a shaft stiffer than a thousandth of a step a derivative gain makes the torque ring from step to step.
    small = 1e-6 if name == "tau_twist" and "K_d" in more else 1e-9
    nearly = simulated({**more, name: small, **damped}, "first", 10)
    # A stiff shaft, and a derivative of a filtered speed, are stepped otherwise, to the same order.
    otherwise = name == "tau_twist" or (name in ("T_f", "tau_eng") and "K_d" in more)
    assert np.abs(nearly - without).max() < (1e-3 if otherwise else 1e-6) * np.ptp(without)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tau_n": 0.0}, "tau_n = 0, expected a positive number"),
        ({"T_d": -0.1}, "T_d = -0.1, expected zero or more"),
        ({"T_s": -0.1}, "T_s = -0.1, expected zero or more"),
        ({"v": 0.0}, "v = 0, expected a finite number other than 0"),
        ({"M_max": 0.5, "M_min": 0.6}, "M_min = 0.6, expected less than M_max = 0.5"),
        ({"update": 0.5}, "update = 0.5, expected 0 or 1"),
        ({"tau_twist": 0.1, "tau_prop": 2.0}, "tau_prop = 2 s beside a flexible shaft, expected"),
    ],
)
def test_a_parameter_that_makes_no_sense_is_named(changes, message):
    with pytest.raises(InputError, match=message) as caught:
        _core.simulate_ship(vector(**changes), np.ones(5), NO_LOAD, DT, 0, "first", [0])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("place", "wrong", "message"),
    [
        (0, np.ones(3), f"parameters: found 3 values, expected {len(NAMES)}"),
        (1, np.array([1.0, np.nan]), r"u\[1\] is NaN, expected a finite number"),
        (1, np.ones(0), "u has no samples"),
        (2, np.ones(3), "load has 3 samples, expected none or 5"),
        (3, 0.0, "dt is 0, expected a positive sample time"),
        (4, 1 << 20, "substeps is 1048576, expected 1 to"),
        (6, [6], "outputs: found 6, expected 0 to 5"),
        (6, [], "outputs is empty"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_line(place, wrong, message):
    arguments = [vector(), np.ones(5), NO_LOAD, DT, 0, "first", [0]]
    arguments[place] = wrong
    with pytest.raises(InputError, match=message) as caught:
        _core.simulate_ship(*arguments)
    assert "\n" not in str(caught.value)


def test_an_envelope_is_the_limit_it_draws_and_bends_where_it_does():
    u, _ = record()
    arguments = (u, NO_LOAD, DT, 10, "first", ALL)
    straight = np.array([[0.5, 1.0, 1.5], [1.3, 1.05, 0.8]])
    line = _core.simulate_ship(vector(M_max=1.05, M_max_slope=-0.5), *arguments)
    np.testing.assert_allclose(
        _core.simulate_ship(vector(), *arguments, straight), line, rtol=1e-9, atol=1e-11
    )
    bent = np.array([[0.9, 1.0, 1.1], [1.02, 1.05, 1.05]])
    values = _core.simulate_ship(vector(), *arguments, bent)
    highest = np.interp(1.0 + values[0], *bent)
    reached = 1.0 + values[1] > highest - 1e-9
    assert 0.1 < reached.mean() < 0.9
    assert (1.0 + values[1] <= highest + 1e-12).all()


def test_an_envelope_stands_in_place_of_a_limit():
    with pytest.raises(InputError, match="M_max beside an envelope"):
        _core.simulate_ship(
            vector(M_max=1.1), np.ones(5), NO_LOAD, DT, 1, "first", [0], np.array([[1.0], [1.2]])
        )


def test_a_ship_that_runs_away_ends_the_simulation():
    with pytest.raises(SimulationError, match="dn"):
        _core.simulate_ship(vector(K_p=-9.0, g=4.0), record(400)[0], NO_LOAD, DT, 0, "first", [0])


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_set_point_that_stands_leaves_the_ship_at_rest(data):
    def draw(low, high):
        return data.draw(st.floats(low, high))

    values = {
        "tau_n": draw(0.5, 3.0),
        "g": draw(-1.0, 0.3),
        "v": draw(0.5, 2.0),
        "K_p": draw(0.5, 4.0),
        "K_i": draw(0.1, 3.0),
        "K_d": draw(0.0, 0.05),
        "p": draw(1.2, 3.0),
        "T_d": draw(0.0, 0.1),
        "T_set": draw(0.0, 1.0),
        "tau_act": draw(0.0, 0.1),
        "T_f": draw(0.0, 0.1),
        "tau_eng": draw(0.0, 0.3),
        "damping": draw(0.0, 0.5),
        "curvature": draw(-0.5, 0.5),
        "tau_prop": 0.3,
        "T_n": draw(0.0, 0.1),
        "T_M": draw(0.0, 0.1),
    }
    values |= data.draw(
        st.sampled_from([{}, {"M_max": 1.1, "M_min": 0.9, "anti_windup": 1.0}, RATE, TWIST, SAMPLED])
    )
    hold = data.draw(st.sampled_from(["zero", "first"]))

    def moved(by):
        ship = vector(**values, initial_N=1.0 + by)
        return np.abs(_core.simulate_ship(ship, np.ones(200), NO_LOAD, 0.02, 0, hold, ALL)).max()

    # A loop that is not stable lets a rounding error of the start grow, as it does with one that is put there.
    assert moved(0.0) < 1e-12 * max(0.3 * moved(1e-9) / 1e-9, 1.0)


def test_a_sample_late_in_a_long_record_costs_what_an_early_one_does():
    """A deviation dies away; numbers below the normal ones would cost a hundred times as much."""
    ship = vector(tau_n=0.03, K_p=1.0, K_i=50.0, T_d=0.004, tau_act=0.005, initial_N=0.99, tau_prop=0.01)

    def seconds(samples):
        arguments = (ship, np.ones(samples), NO_LOAD, 0.005, 2, "first", [0, 2])
        best = math.inf
        for _ in range(5):
            start = time.process_time()
            rows = _core.simulate_ship(*arguments)
            best = min(best, time.process_time() - start)
        sizes = np.abs(rows[rows != 0.0])
        assert sizes.min() >= np.finfo(float).tiny
        return best / samples

    assert seconds(200_000) < 2.0 * seconds(5_000)
