"""The ship model against a slow exact twin, closed forms, an independent reference, and what a search asks of it."""

import csv
import math
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError

from ..twins import ship as twin
from ..twins.ship import SMOOTH, vector

NAMES, OUTPUTS = _core.SHIP_PARAMETERS, _core.SHIP_OUTPUTS
DT = 0.02
NO_LOAD = np.zeros(0)
FIVE = [OUTPUTS.index(name) for name in ("dn", "dM_b", "dM_g", "dX", "dE")]
SPEED_AND_GAUGE = [OUTPUTS.index("dn"), OUTPUTS.index("dM_g")]
REFERENCE = Path(__file__).parents[1] / "data" / "reference_steps.csv"

# Sums of dead times and delays are no whole samples: at a kink itself a derivative has two sides.
SHIPS = {
    "nothing": {},
    "a square": {"p": 2.0},
    "set-point dead time": {"T_set": 0.0351},
    "both dead times": {"T_d": 0.0473, "T_set": 0.0311},
    "a dead time below a sample": {"T_d": 0.0131, "T_set": 0.0331},
    "lag": {"tau_act": 0.05},
    "lag and dead times": {"tau_act": 0.05, "T_d": 0.0473, "T_set": 0.0311},
    "derivative gain": {"K_d": 0.2},
    "derivative gain and lag": {"K_d": 0.2, "tau_act": 0.05},
    "derivative gain and dead time": {"K_d": 0.2, "T_d": 0.0473},
    "not at rest": {"initial_N": 0.95, "initial_F": -0.02, "T_d": 0.0473, "T_set": 0.0113},
    "late channels": {
        "T_n": 0.0111,
        "T_M": 0.0313,
        "s_M": 1.02,
        "s_u": 0.99,
        "damping": 0.3,
        "T_d": 0.0473,
        "T_set": 0.0031,
    },
    "load": {"load_gain": 0.7, "T_d": 0.0473, "T_set": 0.0311},
    "load without dead time": {"load_gain": 0.7, "T_set": 0.0113},
    "no integral gain": {"K_i": 0.0, "T_d": 0.0473, "initial_F": 0.01},
}


def wander(samples, seed=804, scale=0.06):
    """A set point that wanders about the operating point."""
    return 1.0 + scale * np.random.default_rng(seed).normal(size=samples).cumsum() / np.sqrt(samples)


def places(*names):
    return [NAMES.index(name) for name in names]


def inputs_of(ship, samples):
    return wander(samples), wander(samples, 5) - 1.0 if "load" in ship else NO_LOAD


def by_size(found, expected):
    """Largest error of each row over the row's own size; a row of next to nothing counts as 1e-9."""
    size = np.maximum(np.abs(expected).max(axis=-1), 1e-9)
    return (np.abs(found - expected).max(axis=-1) / size).max()


@cache
def signals_of(ship, hold):
    """The twin's signals, once for all instruction sets."""
    u, load = inputs_of(ship, 30)
    parameters = vector(**SHIPS[ship])
    levels = 10 if parameters[NAMES.index("K_d")] else 6
    return twin.simulate(parameters, u, load, DT, hold, FIVE, levels=levels)


@cache
def differences_of(ship, hold, name, length, **more):
    """The twin's central differences, once for all instruction sets."""
    u, load = inputs_of(ship, length)
    return twin.differences(vector(**SHIPS[ship]), name, u, load, DT, hold, FIVE, levels=5, **more)


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("ship", SHIPS)
def test_signals_are_those_of_the_equations(ship, hold):
    u, load = inputs_of(ship, 30)
    parameters = vector(**SHIPS[ship])
    expected = signals_of(ship, hold)
    found = _core.simulate_ship(parameters, u, load, DT, 0, hold, FIVE)
    assert by_size(found, expected) < 1e-7


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize(
    "ship", ["both dead times", "lag and dead times", "not at rest", "late channels", "load"]
)
def test_derivatives_are_those_of_the_solution_along_every_parameter(ship, hold):
    u, load = inputs_of(ship, 12)
    parameters = vector(**SHIPS[ship])
    # One that stands on its bound has no central difference.
    moving = [name for name in SMOOTH if name not in ("T_d", "T_set", "tau_act", "T_n", "T_M")]
    moving += [name for name in ("T_d", "T_set", "tau_act", "T_n", "T_M") if parameters[NAMES.index(name)]]
    # Steps chosen by themselves leave 3e-6 where one is as long as a sample; three of them leave less.
    _, found = _core.ship_sensitivities(parameters, u, load, DT, 3, hold, FIVE, places(*moving))
    for name, slopes in zip(moving, found, strict=True):
        step = 1e-4 if name in ("T_d", "T_set", "T_n", "T_M", "tau_act") else 5e-4
        expected = differences_of(ship, hold, name, 12, step=step)
        # 1e-6 is the aim; behind a lag with steps of the set point five terms leave 2.8e-6 along g.
        assert by_size(slopes, expected) < 5e-6, name


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("ship", SHIPS)
def test_derivatives_along_what_moves_breaks_hold_for_every_element(ship, hold):
    u, load = inputs_of(ship, 10)
    parameters = vector(**SHIPS[ship])
    moving = [name for name in ("T_d", "T_set", "K_d", "tau_act") if parameters[NAMES.index(name)]] or ["p"]
    # Steps chosen by themselves leave 3e-6 where one is as long as a sample; three of them leave less.
    _, found = _core.ship_sensitivities(parameters, u, load, DT, 3, hold, FIVE, places(*moving))
    for name, slopes in zip(moving, found, strict=True):
        expected = differences_of(ship, hold, name, 10)
        assert by_size(slopes, expected) < 1e-6, name


@pytest.mark.parametrize("name", ["T_d", "T_set", "tau_act", "T_n", "T_M"])
def test_a_time_that_begins_has_its_derivative_to_the_right(name):
    u = wander(200)
    by, h = places(name), 1e-5
    outputs = SPEED_AND_GAUGE
    at_zero, slopes = _core.ship_sensitivities(vector(), u, NO_LOAD, DT, 8, "first", outputs, by)
    near = _core.simulate_ship(vector(**{name: h}), u, NO_LOAD, DT, 8, "first", outputs)
    far = _core.simulate_ship(vector(**{name: 2 * h}), u, NO_LOAD, DT, 8, "first", outputs)
    expected = (4.0 * near - far - 3.0 * at_zero) / (2.0 * h)
    # The gauge's torque has kinks at the samples, behind which a difference looks back.
    assert by_size(slopes[0][:1], expected[:1]) < (2e-2 if name == "T_n" else 1e-3)


@pytest.mark.parametrize("step", ["0.05", "0.1", "0.2"])
def test_steps_are_those_of_the_independent_reference(step):
    with REFERENCE.open() as file:
        rows = [
            [
                float(row[name])
                for name in ("time_s", "shaft_speed_rps", "integrated_error_rev", "shaft_torque_Nm")
            ]
            for row in csv.DictReader(file)
            if float(row["step_fraction"]) == float(step) and row["torque_limit_over_Mb0"] == "none"
        ]
    times, n_s, E_n, M_s = np.array(rows).T
    n_s0, M_s0 = 1300.0 / 180.0, 3.0 * 0.95 * 222.93
    ship = vector(
        tau_n=2.0 * math.pi * 21.2 * n_s0 / M_s0,
        g=-0.583,
        v=1.583,
        K_p=10.0,
        K_i=1.0,
        p=2.0,
        initial_F=1.583 * 10.0 * float(step),
    )
    u = np.full(len(times), 1.0 + float(step))
    found, finer = (
        _core.simulate_ship(ship, u, NO_LOAD, float(times[1]), substeps, "first", [0, 1, 4])
        for substeps in (50, 100)
    )
    expected = np.array([n_s / n_s0 - 1.0, M_s / M_s0 - 1.0, E_n / (3.0 * n_s0)])
    assert by_size(found, finer) < 1e-9
    # The reference's own output between its steps is good to 3e-10 of the speed, which 16 times as much of torque follows.
    assert np.abs(found - expected).max() < 5e-9
    assert by_size(found[:, :51], expected[:, :51]) < 2e-9


@pytest.mark.parametrize("frequency", [0.05, 0.5, 2.0])
def test_a_small_sine_is_answered_as_the_closed_forms_say(frequency):
    T_d, T_set, amplitude, dt = 0.12, 0.035, 1e-6, 0.002
    ship = vector(T_d=T_d, T_set=T_set, tau_prop=0.43)
    samples = round(160.0 / dt)
    t = dt * np.arange(samples)
    u = 1.0 + amplitude * np.sin(2.0 * math.pi * frequency * t)
    found = _core.simulate_ship(ship, u, NO_LOAD, dt, 0, "first", SPEED_AND_GAUGE) / amplitude
    last = slice(3 * samples // 4, None)
    wave = np.exp(-2j * math.pi * frequency * t[last])
    basis = np.stack([wave.real, wave.imag, np.ones(wave.size)], axis=1)
    a, b, _ = np.linalg.lstsq(basis, found[:, last].T, rcond=None)[0]
    s = 2j * math.pi * frequency
    tau_n, g, K_p, K_i, p = (ship[NAMES.index(name)] for name in ("tau_n", "g", "K_p", "K_i", "p"))
    loop = (K_p + K_i / s) * np.exp(-s * T_d)
    speed = loop / (tau_n * s + p - g + loop) * np.exp(-s * T_set)
    # Straight lines between the samples of a sine are it, a little smaller.
    smaller = np.sinc(frequency * dt) ** 2
    expected = smaller * speed * np.array([1.0, p + 0.43 * s])
    # Phasors of sin: a cos - b sin of the negative exponential.
    answered = -b + 1j * a
    # Kinks at the samples alias into the torque.
    np.testing.assert_allclose(answered, expected, rtol=5e-5)
    np.testing.assert_allclose(answered[0], expected[0], rtol=2e-6)


def test_without_dead_time_and_for_small_signals_it_is_the_linear_structure():
    u = 1.0 + 1e-5 * (wander(400) - 1.0)
    ship = vector(T_set=0.033)
    linear = np.array([ship[NAMES.index(name)] for name in _core.LINEAR_PARAMETERS])
    u -= u[0] - 1.0
    found = _core.simulate_ship(ship, u, NO_LOAD, DT, 4, "first", FIVE)
    outputs = [_core.LINEAR_OUTPUTS.index(OUTPUTS[output]) for output in FIVE]
    expected = _core.simulate_linear(linear, u - 1.0, DT, "first", np.zeros(2), outputs)
    assert by_size(found, expected) < 1e-5


def test_products_are_those_of_the_sensitivities():
    u, wrt = wander(1500), places("tau_n", "K_p", "p", "T_d", "T_set")
    ship = vector(T_d=0.0473, T_set=0.0311, T_M=0.0071)
    values, slopes = _core.ship_sensitivities(ship, u, NO_LOAD, DT, 0, "first", SPEED_AND_GAUGE, wrt)
    rng = np.random.default_rng(7)
    measured = values + 1e-3 * rng.normal(size=values.shape)
    measured[0, 700:710] = np.nan
    measured[1, 20] = np.inf
    offsets, filters = np.array([0.01, -0.02]), rng.normal(size=(2, 4))
    sums, count = _core.ship_products(
        ship, u, NO_LOAD, DT, 0, "first", SPEED_AND_GAUGE, measured, offsets, filters, wrt
    )
    columns = []
    for output in range(2):
        residual = measured[output] - values[output] - offsets[output]
        own = [*slopes[:, output], np.ones(len(u)), residual]
        columns += [lfilter(filters[output], [1.0], column) for column in own]
    counts = np.isfinite(columns).all(axis=0)
    counts[:3] = False
    matrix = np.array(columns)[:, counts]
    assert count == counts.sum()
    np.testing.assert_allclose(sums.reshape(14, 14), matrix @ matrix.T, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("more", "error"),
    [
        ({}, 1e-3),
        ({"tau_act": 0.03}, 1e-3),
        ({"tau_prop": 0.3, "tau_twist": 8e-4, "zeta_twist": 1.0}, 1e-3),
        # Derivatives jump where a limit takes hold, and this set point breaks at every sample.
        ({"M_max": 1.05}, 3e-2),
    ],
)
def test_on_the_way_to_a_minimum_sums_are_good_to_a_small_part(more, error):
    u, wrt = wander(1500), places("tau_n", "K_p", "p", "T_d", "T_set")
    ship = vector(T_d=0.0473, T_set=0.0311, **more)
    arguments = (
        u,
        NO_LOAD,
        DT,
        0,
        "first",
        SPEED_AND_GAUGE,
        np.zeros((2, 1500)),
        np.zeros(2),
        np.ones((2, 1)),
        wrt,
    )
    exact, count = _core.ship_products(ship, *arguments)
    rough, same = _core.ship_products(ship, *arguments, sharp=False)
    exact, rough = (sums.reshape(14, 14) for sums in (exact, rough))
    size = np.sqrt(np.diag(exact))
    assert count == same
    assert np.abs(rough - exact).max() > 0.0
    np.testing.assert_allclose(rough / np.outer(size, size), exact / np.outer(size, size), atol=error)


@pytest.mark.parametrize("part", [1e-9, 1e-6, 1e-3, 0.015, 0.3, 0.5, 0.7, 0.985, 0.999, 1.0 - 1e-6])
@pytest.mark.parametrize("T_set", [0.0, 0.0173])
def test_a_past_piece_however_short_leads_nothing_astray(part, T_set):
    u, load = wander(800), wander(800, 5) - 1.0
    # A generating set, whose load breaks at the samples themselves, and a ship.
    genset = vector(
        tau_n=0.9, g=-0.3, K_p=4.0, K_i=6.0, p=0.4, T_d=(2.0 + part) * DT, T_set=T_set, load_gain=1.0
    )
    ship = vector(T_d=(3.0 + part) * DT, T_set=T_set)
    for parameters, of_load in [(genset, load), (ship, NO_LOAD)]:
        found, finer = (
            _core.simulate_ship(parameters, u, of_load, DT, substeps, "first", SPEED_AND_GAUGE)
            for substeps in (0, 4)
        )
        assert by_size(found, finer) < 1e-6


# The sum of the error among the outputs, or a derivative gain, makes every piece wait for the one before.
ORDINARY = {
    "both dead times": {"T_d": 0.1213, "T_set": 0.0351},
    "a dead time of two samples": {"T_d": 0.0473, "T_set": 0.0311},
    "a long dead time": {"T_d": 0.5117, "T_set": 0.0311, "K_p": 1.2, "K_i": 0.5},
    "a dead time of whole samples": {"T_d": 0.12, "T_set": 0.04},
    "short time constants": {"tau_n": 0.1, "K_p": 0.4, "K_i": 0.3, "T_d": 0.1213, "tau_prop": 0.05},
    "late channels": {"T_n": 0.0111, "T_M": 0.0313, "s_M": 1.02, "s_u": 0.99, "damping": 0.3, "T_d": 0.0973},
    "load": {"load_gain": 0.7, "T_d": 0.0973, "T_set": 0.0311},
    "not at rest": {"initial_N": 0.9, "initial_F": -0.1, "T_d": 0.0973},
    "a square": {"p": 2.0, "T_d": 0.0973},
}


@pytest.mark.parametrize("ship", ORDINARY)
@pytest.mark.parametrize("scale", [0.06, 2.0])
def test_sample_intervals_side_by_side_are_those_one_after_the_other(ship, scale):
    samples = 700
    u, parameters = wander(samples, scale=scale), vector(**ORDINARY[ship])
    load = wander(samples, 5) - 1.0 if "load" in ship else NO_LOAD
    wrt = places(*(name for name in SMOOTH if name not in ("K_d", "tau_act")))
    outputs = FIVE[:4]

    def answer(outputs):
        return _core.ship_sensitivities(parameters, u, load, DT, 0, "first", outputs, wrt)

    (values, slopes), (expected, expected_slopes) = answer(outputs), answer(FIVE)
    # They round otherwise: two ways were gone.
    assert np.any(values != expected[:4])
    assert by_size(values, expected[:4]) < 1e-9
    assert by_size(slopes, expected_slopes[:, :4]) < 1e-8

    def sums(outputs):
        count = len(outputs)
        measured, offsets, filters = np.zeros((count, samples)), np.zeros(count), np.ones((count, 1))
        arguments = (parameters, u, load, DT, 0, "first", outputs, measured, offsets, filters, wrt)
        found, _ = _core.ship_products(*arguments, sharp=False)
        return found.reshape(count * (len(wrt) + 2), -1)

    found = sums(outputs)
    expected = sums(FIVE)[: len(found), : len(found)]
    size = np.maximum(np.sqrt(np.diag(expected)), 1e-9)
    np.testing.assert_allclose(found / np.outer(size, size), expected / np.outer(size, size), atol=1e-8)


@settings(max_examples=60)
@given(data=st.data())
def test_nothing_finite_makes_it_panic(data):
    number = st.floats(-1e6, 1e6, allow_subnormal=False) | st.sampled_from([0.0, 1.0, -1.0, 1e-9, 1e9])
    names = [*SMOOTH, "tau_twist", "zeta_twist"]
    changes = {name: data.draw(number) for name in data.draw(st.lists(st.sampled_from(names), unique=True))}
    for name in ("T_d", "T_set", "tau_act", "T_n", "T_M", "tau_twist", "zeta_twist"):
        if name in changes:
            changes[name] = data.draw(st.floats(0.0, 1.0) | st.floats(1e-3, 1e12))
    u = np.array(data.draw(st.lists(number, min_size=1, max_size=20)))
    wrt = data.draw(st.lists(st.sampled_from(places(*names)), max_size=21))
    hold = data.draw(st.sampled_from(["zero", "first"]))
    try:
        values, slopes = _core.ship_sensitivities(
            vector(**changes), u, NO_LOAD, data.draw(st.sampled_from([1e-3, 0.02, 10.0])), 1, hold, FIVE, wrt
        )
    except (InputError, SimulationError):
        return
    assert np.isfinite(values).all()
    assert np.isfinite(slopes).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tau_n": 0.0}, "tau_n = 0, expected a positive number"),
        ({"T_d": -0.1}, "T_d = -0.1, expected zero or more"),
        ({"v": 0.0}, "v = 0, expected a finite number other than 0"),
        ({"M_max": 0.5, "M_min": 0.6}, "M_min = 0.6, expected less than M_max = 0.5"),
        ({"update": 0.5}, "update = 0.5, expected 0 or 1"),
    ],
)
def test_a_parameter_that_makes_no_sense_is_named(changes, message):
    with pytest.raises(InputError, match=message):
        _core.simulate_ship(vector(**changes), wander(5), NO_LOAD, DT, 0, "first", [0])


@pytest.mark.parametrize("name", ["M_max", "T_s", "tau_twist", "anti_windup"])
def test_what_has_no_derivative_is_refused(name):
    with pytest.raises(InputError, match=name):
        _core.ship_sensitivities(vector(), wander(5), NO_LOAD, DT, 0, "first", [0], places(name))


def test_a_sample_late_in_a_long_record_costs_what_an_early_one_does():
    """Derivatives by the initial state die away; numbers below the normal ones would cost a hundred times as much."""
    wrt = places("initial_N", "initial_F", "tau_n", "K_p")
    ship = vector(T_d=0.12, T_set=0.0351, initial_N=0.99)

    def seconds(samples):
        u, measured = np.ones(samples), np.zeros((2, samples))
        arguments = (u, NO_LOAD, DT, 0, "first", SPEED_AND_GAUGE, measured, np.zeros(2), np.ones((2, 1)), wrt)
        best = math.inf
        for _ in range(5):
            start = time.process_time()
            _core.ship_products(ship, *arguments)
            best = min(best, time.process_time() - start)
        return best / samples

    assert seconds(200_000) < 2.0 * seconds(5_000)


@pytest.mark.parametrize("quick", [{"tau_n": 1e-7}, {"tau_twist": 1e-9, "tau_prop": 0.3}])
def test_a_search_is_told_at_once_of_a_ship_too_quick_for_its_record(quick):
    ship = {"tau_n": 1.3, "g": -0.5, "v": 1.0, "K_p": 4.0, "K_i": 6.0, "p": 1.8} | quick
    values, u = vector(**ship), wander(2000)
    with pytest.raises(SimulationError, match="expected at most 40"):
        _core.simulate_ship(values, u, NO_LOAD, DT, 0, "first", SPEED_AND_GAUGE, False)
