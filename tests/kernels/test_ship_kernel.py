"""The ship's steps against an exact twin, differences of themselves, the ship without an element, and NumPy."""

import math
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import upfirdn

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError

from ..twins import ship as twin
from ..twins.ship import OFF, SHIP, vector

NAMES, OUTPUTS = _core.SHIP_PARAMETERS, _core.SHIP_OUTPUTS
ALL = list(range(len(OUTPUTS)))
NO_LOAD = np.zeros(0)
DT, SAMPLES = 0.05, 20
HOLDS = ("first", "zero")
SWITCHES = ("anti_windup", "update")
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
    "rate limits behind a lag": {**RATE, **LATE},
    "derivative gain": {"K_d": 0.1},
    "derivative gain and lag": {"K_d": 0.1, "tau_act": 0.05},
    "derivative gain, late": {"K_d": 0.1, **LATE},
    "derivative gain, load": {"K_d": 0.1, **REST},
    "twist": {**TWIST, **LATE},
    "twist and derivative gain": {**TWIST, "K_d": 0.05},
    "twist at limits": {**TWIST, **TORQUE, "tau_act": 0.05},
    "load": {**REST, **LATE},
    "late channels": {**LATE, **REST, "T_n": 0.0137, "T_M": 0.0211},
    "not at rest": {"initial_N": 0.97, "initial_F": 0.02, "initial_E": 0.003, **LATE, "tau_act": 0.05},
    "sampled": {**SAMPLED, **LATE},
    "sampled before use, lag": {**SAMPLED, "update": 1.0, "tau_act": 0.05},
    "sampled, derivative gain": {**SAMPLED, "K_d": 0.02, **LATE},
    "sampled, limits": {**SAMPLED, **TORQUE, **RATE},
    "sampled, twist": {**SAMPLED, **TWIST, **LATE},
}


def record(samples=SAMPLES, size=0.06):
    """A set point that swings, jumps and trembles, and a load that swings."""
    t = np.arange(samples) * DT
    swing = np.sin(2.0 * np.pi * 0.7 * t + 0.3) + 0.5 * np.sign(np.sin(2.0 * np.pi * 0.31 * t + 0.1))
    u = 1.0 + size * (swing + 0.2 * np.random.default_rng(0).standard_normal(samples))
    return u, 0.05 * np.sin(2.0 * np.pi * 0.4 * t)


def places(*names):
    return [NAMES.index(name) for name in names]


def rms(rows):
    return np.sqrt(np.mean(np.square(rows), axis=-1))


def acting(values, *, begins=False):
    """Parameters that have a derivative on both sides; with `begins` those at their bound, too."""
    full = OFF | SHIP | values
    found = []
    for name in NAMES:
        at_bound = name.startswith("T_") or name in ("tau_act", "tau_twist", "zeta_twist")
        if name in (*SWITCHES, "M_soft") or math.isinf(full[name]):
            continue
        if name == "hold" and full[name] in (0.0, 1.0):
            continue
        needs = {"T_0": "T_s", "M_max_slope": "M_max", "zeta_twist": "tau_twist"}.get(name, name)
        if needs in ("T_s", "tau_twist") and not full[needs]:
            continue
        if needs == "M_max" and math.isinf(full["M_max"]):
            continue
        if not at_bound or full[name] or (begins and name in ("T_d", "T_set", "tau_act")):
            found.append(name)
    return found


def simulated(values, hold, substeps, samples=SAMPLES):
    u, load = record(samples)
    return _core.simulate_ship(vector(**values), u, load, DT, substeps, hold, ALL)


def solution(ship, hold):
    """The twin's outputs."""
    u, load = record()
    return twin.simulate(SHIPS[ship], u, load, DT, hold, OUTPUTS)


# The twin takes seconds a ship: each has one of both holds.
@pytest.mark.parametrize(("ship", "hold"), [(ship, HOLDS[place % 2]) for place, ship in enumerate(SHIPS)])
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


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("ship", SHIPS)
def test_derivatives_are_those_of_the_steps_along_every_parameter(ship, hold):
    values = OFF | SHIP | SHIPS[ship]
    if "rate_up" in SHIPS[ship]:
        values |= {"rate_up": 1.2, "rate_down": 1.0}
    names, samples, (u, load) = acting(values), 80, record(80)
    parameters = vector(**values)
    expected = []
    for name in names:
        # Whole steps and zero have a kink.
        step = {"curvature": 1e-4, "zeta_twist": 3e-5, "tau_prop": 1e-5, "T_0": 1e-6}.get(
            name, 1e-6 * max(abs(values[name]), 0.03)
        )
        moved = [values | {name: values[name] + by} for by in (step, -step)]
        high, low = (simulated(other, hold, 10, samples) for other in moved)
        expected.append((high - low) / (2.0 * step))
    for first in range(0, len(names), 24):
        part = names[first : first + 24]
        _, found = _core.ship_sensitivities(parameters, u, load, DT, 10, hold, ALL, places(*part))
        for name, slopes, differences in zip(part, found, expected[first:], strict=False):
            if name in ("T_d", "T_set") and ship == "dead times of whole steps":
                continue
            error = rms(slopes - differences) / np.maximum(rms(differences), 1e-6)
            assert error.max() < 1e-4, (name, error)


@pytest.mark.parametrize("name", ["T_d", "T_set", "tau_act", "tau_twist"])
@pytest.mark.parametrize("more", [{}, {"K_d": 0.1}, {**REST, "tau_act": 0.0}, TORQUE])
def test_an_element_goes_to_off_continuously(name, more):
    damped = {"zeta_twist": 1.0} if name == "tau_twist" else {}
    without = simulated(more, "first", 10)
    # Behind a shaft stiffer than a thousandth of a step a derivative gain makes the torque ring from step to step.
    small = 1e-6 if name == "tau_twist" and "K_d" in more else 1e-9
    nearly = simulated({**more, name: small, **damped}, "first", 10)
    # A stiff shaft is stepped otherwise, to the same order.
    assert np.abs(nearly - without).max() < (1e-3 if name == "tau_twist" else 1e-6) * np.ptp(without)


@pytest.mark.parametrize("name", ["T_d", "T_set", "tau_act"])
@pytest.mark.parametrize("more", [{}, {"T_d": 0.0413}, {"tau_act": 0.05}, {"K_d": 0.1}, REST])
def test_a_time_that_begins_has_its_derivative_to_the_right(name, more):
    values = {**more, name: 0.0}
    u, load = record()
    _, slopes = _core.ship_sensitivities(vector(**values), u, load, DT, 10, "first", ALL, places(name))
    step = 1e-6
    base, near, far = (simulated({**values, name: by}, "first", 10) for by in (0.0, step, 2.0 * step))
    expected = (4.0 * near - far - 3.0 * base) / (2.0 * step)
    assert (rms(slopes[0] - expected) / rms(expected)).max() < 1e-3


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("ship", SHIPS)
def test_values_are_the_same_with_and_without_derivatives(ship, hold):
    u, load = record()
    names = acting(SHIPS[ship], begins=True)
    for count in (0, 5, 12, 20):
        arguments = (vector(**SHIPS[ship]), u, load, DT, 0, hold, ALL, places(*names[:count]))
        values, slopes = _core.ship_sensitivities(*arguments)
        assert np.abs(values - simulated(SHIPS[ship], hold, 0)).max() < 1e-12
        assert slopes.shape == (min(count, len(names)), len(ALL), SAMPLES)


def bridged(row, masked):
    at = np.arange(row.size)
    return np.interp(at, at[~masked], row[~masked])


@pytest.mark.parametrize(("stride", "down"), [(1, 1), (2, 3), (3, 2)])
def test_what_a_record_shows_is_bridged_filtered_and_decimated(stride, down):
    ship, samples = vector(**LATE, tau_act=0.05), 240
    u, load = record(samples)
    outputs, wrt = [0, 2, 3], places("tau_n", "K_p", "T_d")
    values, slopes = _core.ship_sensitivities(ship, u, load, DT, 4, "first", outputs, wrt)
    rows = np.concatenate([values[:, None], slopes.transpose(1, 0, 2)], axis=1)[:, :, ::stride]
    random = np.random.default_rng(3)
    masked = random.random((rows.shape[2], len(outputs))) < 0.2
    masked[:5, 0] = masked[-7:, 1] = masked[30:50, 2] = True
    taps = np.hanning(11) + 0.1
    found = _core.ship_observed(ship, u, load, DT, 4, "first", stride, outputs, wrt, masked, taps, down)
    for output in range(len(outputs)):
        for column in range(1 + len(wrt)):
            row = bridged(rows[output, column], masked[:, output])
            held = np.pad(row, len(taps) // 2, mode="edge")
            expected = upfirdn(taps[::-1], held)[len(taps) - 1 :][: row.size][::down]
            np.testing.assert_allclose(
                found[output, column], expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max()
            )


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
        (7, [*range(6), *range(6)] * 3, "wrt has 36 entries, expected at most 24"),
        (7, [len(NAMES)], f"wrt: found {len(NAMES)}, expected 0 to {len(NAMES) - 1}"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_line(place, wrong, message):
    arguments = [vector(), np.ones(5), NO_LOAD, DT, 0, "first", [0], []]
    arguments[place] = wrong
    with pytest.raises(InputError, match=message) as caught:
        _core.ship_sensitivities(*arguments)
    assert "\n" not in str(caught.value)


def test_an_envelope_is_the_limit_it_draws_and_bends_where_it_does():
    u, _ = record()
    wrt = places("tau_n", "g", "K_p", "K_i", "p")
    arguments = (u, NO_LOAD, DT, 10, "first", ALL)
    line = _core.ship_sensitivities(vector(M_max=1.05, M_max_slope=-0.5), *arguments, wrt)
    straight = np.array([[0.5, 1.0, 1.5], [1.3, 1.05, 0.8]])
    for found, expected in zip(
        _core.ship_sensitivities(vector(), *arguments, wrt, straight), line, strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)
    bent = np.array([[0.9, 1.0, 1.1], [1.02, 1.05, 1.05]])
    values, slopes = _core.ship_sensitivities(vector(), *arguments, wrt, bent)
    np.testing.assert_array_equal(values, _core.simulate_ship(vector(), *arguments, bent))
    highest = np.interp(1.0 + values[0], *bent)
    reached = 1.0 + values[1] > highest - 1e-9
    assert 0.1 < reached.mean() < 0.9
    assert (1.0 + values[1] <= highest + 1e-12).all()
    for place, slope in zip(wrt, slopes, strict=True):
        moved = [vector() for _ in range(2)]
        for one, step in zip(moved, (1e-6, -1e-6), strict=True):
            one[place] += step
        high, low = (_core.simulate_ship(one, *arguments, bent) for one in moved)
        np.testing.assert_allclose(slope[0], (high[0] - low[0]) / 2e-6, atol=1e-4 * np.abs(slope[0]).max())


def test_an_envelope_stands_in_place_of_a_limit():
    with pytest.raises(InputError, match="M_max beside an envelope"):
        _core.simulate_ship(
            vector(M_max=1.1), np.ones(5), NO_LOAD, DT, 1, "first", [0], np.array([[1.0], [1.2]])
        )


@pytest.mark.parametrize("name", ["M_max", "T_s", "tau_twist", "anti_windup", "zeta_twist"])
def test_what_has_no_derivative_is_refused(name):
    with pytest.raises(InputError, match=name):
        _core.ship_sensitivities(vector(), np.ones(5), NO_LOAD, DT, 0, "first", [0], places(name))


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
    assert moved(0.0) < 1e-12 * max(1e-3 * moved(1e-9) / 1e-9, 1.0)


def test_a_sample_late_in_a_long_record_costs_what_an_early_one_does():
    """Derivatives by the initial state die away; numbers below the normal ones would cost a hundred times as much."""
    wrt = places("initial_N", "initial_F", "tau_n", "K_p")
    ship = vector(tau_n=0.03, K_p=1.0, K_i=50.0, T_d=0.004, tau_act=0.005, initial_N=0.99, tau_prop=0.01)

    def seconds(samples):
        arguments = (ship, np.ones(samples), NO_LOAD, 0.005, 2, "first", [0, 2], wrt)
        best = math.inf
        for _ in range(5):
            start = time.process_time()
            _, slopes = _core.ship_sensitivities(*arguments)
            best = min(best, time.process_time() - start)
        sizes = np.abs(slopes[slopes != 0.0])
        assert sizes.min() >= np.finfo(float).tiny
        return best / samples

    assert seconds(200_000) < 2.0 * seconds(5_000)
