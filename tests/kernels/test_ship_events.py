"""The ship with sampling, limits, delays and twist against its twin, by every parameter; the smooth path; odd parameters."""

import _thread
import math
import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError

from ..twins import ship_events as twin

NAMES = _core.SHIP_PARAMETERS
OUTPUTS = _core.SHIP_OUTPUTS
ALL = list(range(len(OUTPUTS)))
SWITCHES = ("anti_windup", "update")
NO_LOAD = np.zeros(0)
DT = 0.05
SHIP = {
    "tau_n": 1.44,
    "g": -0.58,
    "v": 1.58,
    "K_p": 4.0,
    "K_i": 3.0,
    "p": 2.17,
    "tau_prop": 0.4,
    "initial_F": 0.01,
}
SAMPLED = {"T_s": 0.03, "T_0": 0.0071, "T_d": 0.0413}
TORQUE = {"M_max": 1.12, "M_max_slope": -0.5, "M_min": 0.93}
RACK = {"X_max": 0.1, "X_min": -0.07}
RATE = {"rate_up": 0.6, "rate_down": 0.5}
TWIST = {"tau_twist": 0.004, "zeta_twist": 0.3}
REST = {
    "damping": 0.2,
    "load_gain": 0.7,
    "s_u": 1.01,
    "s_M": 0.99,
    "T_n": 0.0137,
    "T_M": 0.0211,
    "initial_N": 0.99,
}
FAR = {"M_max": 1e3}
"""A limit that is never reached, which takes the smooth ship through the event path."""
CASES = {
    "sampled": SAMPLED,
    "sampled before use": {**SAMPLED, "update": 1.0},
    "sampled, late set point": {**SAMPLED, "T_set": 0.113},
    "sampled, lag": {**SAMPLED, "tau_act": 0.05},
    "sampled, derivative": {**SAMPLED, "K_d": 0.02},
    "sampled, torque limits": {**SAMPLED, **TORQUE},
    "sampled, rack limits": {**SAMPLED, **RACK},
    "sampled, anti-windup": {**SAMPLED, **TORQUE, **RACK, "anti_windup": 1.0},
    "sampled, rate limits": {**SAMPLED, **RATE},
    "sampled, rate limits behind a lag": {**SAMPLED, **RATE, "tau_act": 0.05},
    "sampled, twist": {**SAMPLED, **TWIST},
    "torque limits": TORQUE,
    "rack limits": RACK,
    "anti-windup at the torque": {**TORQUE, "anti_windup": 1.0},
    "anti-windup at the rack": {**RACK, "anti_windup": 1.0},
    "anti-windup that slides": {**TORQUE, "anti_windup": 1.0, "K_p": 1.0, "K_i": 8.0},
    "anti-windup behind a lag": {**TORQUE, **RACK, "anti_windup": 1.0, "tau_act": 0.06},
    "rate limits": RATE,
    "rate limits behind a lag": {**RATE, "tau_act": 0.05},
    "derivative at limits": {"K_d": 0.1, "M_max": 1.12, "X_min": -0.07},
    "twist": TWIST,
    "twist at limits": {**TWIST, **TORQUE, "K_d": 0.05},
    "damping, load and channels": {**FAR, **REST},
    "late command at a torque limit": {"T_d": 0.073, "T_set": 0.03, "M_max": 1.12},
    "command barely late at a torque limit": {"T_d": 0.0031, "T_set": 0.03, "M_max": 1.02},
    "command barely late at all limits": {"T_d": 0.0053, **TORQUE, **RACK, **RATE},
    "command barely late at anti-windup": {"T_d": 0.0053, **TORQUE, "anti_windup": 1.0},
    "late command at rate limits": {"T_d": 0.073, **RATE},
    "everything": {
        **SAMPLED,
        **TORQUE,
        "X_max": 0.1,
        "anti_windup": 1.0,
        "update": 1.0,
        "tau_act": 0.06,
        "T_set": 0.11,
        "rate_up": 0.9,
        "rate_down": 1.1,
        "K_d": 0.02,
        **TWIST,
        **REST,
    },
}


def vector(values):
    """The parameter vector."""
    full = {**twin.OFF, **values}
    return np.array([full[name] for name in NAMES])


def record(samples, dt=DT, size=0.06):
    """A set point that swings, jumps and trembles."""
    t = np.arange(samples) * dt
    swing = np.sin(2.0 * np.pi * 0.7 * t + 0.3) + 0.5 * np.sign(np.sin(2.0 * np.pi * 0.31 * t + 0.1))
    return 1.0 + size * (swing + 0.2 * np.random.default_rng(0).standard_normal(samples))


def load_of(values, samples):
    """A load where there is a gain for one."""
    return 0.02 * np.sin(0.7 * np.arange(samples)) if "load_gain" in values else NO_LOAD


def sensitivities(values, u, load=NO_LOAD, hold="first", names=(), dt=DT, substeps=0, outputs=ALL):
    """The kernel's outputs and derivatives."""
    wrt = [NAMES.index(name) for name in names]
    return _core.ship_sensitivities(vector(values), u, load, dt, substeps, hold, list(outputs), wrt)


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("case", CASES)
def test_outputs_are_those_of_an_exact_solution(case, hold):
    values = {**SHIP, **CASES[case]}
    u = record(24)
    load = load_of(values, len(u))
    found, _ = sensitivities(values, u, load, hold)
    expected = twin.simulate(values, u, load, DT, hold, OUTPUTS)
    assert np.abs(found - expected).max() < 2e-8


@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_an_exact_solution(case):
    values = {**SHIP, **CASES[case]}
    names = [name for name in values if name not in SWITCHES and values[name] != FAR["M_max"]]
    u = record(18)
    load = load_of(values, len(u))
    _, slopes = sensitivities(values, u, load, names=names)
    for name, slope in zip(names, slopes, strict=True):
        share = 2e-5 if name.startswith("T_") else 5e-5
        step = share * max(abs(values[name]), 0.1)

        def at(change, name=name):
            return twin.simulate({**values, name: values[name] + change}, u, load, DT, "first", OUTPUTS)

        expected = (8.0 * (at(step) - at(-step)) - (at(2.0 * step) - at(-2.0 * step))) / (12.0 * step)
        # A derivative that is zero is so to what a millionth of the output's range is per unit of the parameter.
        size = np.maximum(np.abs(expected).max(axis=1), 0.1 * np.abs(expected).max())
        size = np.maximum(size, 0.05 / max(abs(values[name]), 0.1))
        worst = np.abs(slope - expected).max(axis=1) / size
        assert worst.max() < 1e-6, f"{name}: {dict(zip(OUTPUTS, worst, strict=True))}"


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize(
    "more",
    [
        {},
        {"K_d": 0.1},
        {"tau_act": 0.06},
        {"T_d": 0.073},
        {"T_d": 0.003},
        {"T_d": 0.1217, "T_set": 0.2131, "tau_act": 0.06, "K_d": 0.05, **REST},
    ],
)
def test_a_limit_out_of_reach_leaves_the_smooth_ship(more, hold):
    values = {**SHIP, **more}
    u = record(400)
    load = load_of(values, len(u))
    names = [name for name in values if name not in SWITCHES]
    smooth = sensitivities(values, u, load, hold, names)
    switched = sensitivities({**values, **FAR}, u, load, hold, names)
    assert np.abs(switched[0] - smooth[0]).max() < 1e-7
    size = np.abs(smooth[1]).max(axis=(1, 2), keepdims=True)
    assert (np.abs(switched[1] - smooth[1]) / size).max() < 2e-6


def test_fine_steps_change_nothing():
    for case in CASES:
        values = {**SHIP, **CASES[case]}
        u = record(60)
        load = load_of(values, len(u))
        chosen, _ = sensitivities(values, u, load)
        fine, _ = sensitivities(values, u, load, substeps=100)
        assert np.abs(chosen - fine).max() < 2e-8, case


def test_a_short_dead_time_goes_over_into_none():
    values = {**SHIP, **TORQUE}
    u = record(60)
    none, slopes = sensitivities(values, u, names=["T_d"])
    short, _ = sensitivities({**values, "T_d": 1e-6}, u)
    rise = (short - none) / 1e-6
    # All but the samples at which a limit takes hold in between.
    assert np.median(np.abs(rise - slopes[0])[:2]) < 1e-4
    assert np.abs(short - none).max() < 1e-4


def test_the_error_falls_with_the_fourth_power_of_the_step():
    values = {**SHIP, **TORQUE, "K_p": 10.0}
    u = record(60)
    exact, _ = sensitivities(values, u, substeps=200)
    coarse, fine = (np.abs(sensitivities(values, u, substeps=n)[0] - exact).max() for n in (2, 4))
    assert 8.0 < coarse / fine < 40.0


def test_a_sampled_governor_by_hand():
    """With K_i alone, one sample in a record and no dead time, the rack is the sum at that sample."""
    values = {**SHIP, "K_p": 0.0, "K_i": 2.0, "T_s": 10.0, "T_0": 0.12, "initial_F": 0.0}
    found, _ = sensitivities(values, np.full(10, 1.1), hold="zero")
    rack, total = found[3], found[4]
    assert np.abs(rack).max() == 0.0
    assert np.abs(total - np.where(np.arange(10) * DT < 0.12, 0.0, 1.0)).max() < 1e-12
    before_use, _ = sensitivities({**values, "update": 1.0}, np.full(10, 1.1), hold="zero")
    assert np.abs(before_use[3] - np.where(np.arange(10) * DT < 0.12, 0.0, 2.0)).max() < 1e-12


def test_what_happens_at_a_sample_counts_already():
    values = {**SHIP, "K_i": 2.0, "T_s": 0.1}
    u = np.where(np.arange(20) < 8, 1.0, 1.1)
    found, _ = sensitivities({**values, "initial_F": 0.0}, u, hold="zero")
    assert abs(found[3][7]) < 1e-12
    assert found[3][8] > 0.1


def test_hours_into_a_record_no_step_is_lost():
    """A last digit of the time that is coarser than a step's part must not stop the march."""
    samples = 400_000
    u = np.ones(samples)
    u[-40:] = 1.05
    values = {**SHIP, "initial_F": 0.0, "T_s": 0.02, "T_0": 0.0071, "T_d": 0.011}
    found, _ = sensitivities(values, u, dt=0.1, outputs=[0])
    short, _ = sensitivities(values, u[-80:], dt=0.1, outputs=[0])
    assert np.abs(found[0][-40:] - short[0][-40:]).max() < 1e-6
    few = np.r_[np.ones(50), np.full(50, 1.02)]
    sensitivities({**SHIP, **TORQUE}, few, dt=0.0025, substeps=1000)


def test_derivatives_that_fade_do_not_slow_down():
    def seconds(samples):
        u = np.ones(samples)
        start = time.process_time()
        sensitivities({**SHIP, **SAMPLED, **TORQUE}, u, names=["initial_N", "initial_F", "tau_n"], dt=0.5)
        return time.process_time() - start

    seconds(100)
    early = min(seconds(200) for _ in range(3)) / 200
    late = (min(seconds(3000) for _ in range(3)) - min(seconds(1500) for _ in range(3))) / 1500
    assert late < 3.0 * early


def test_more_samples_than_anyone_waits_for_are_refused():
    for more in ({"T_s": 1e-9}, {"tau_twist": 1e-15}):
        with pytest.raises(SimulationError, match="expected at most"):
            sensitivities({**SHIP, **more}, record(10))


def test_diverging_ships_end_with_an_error():
    with pytest.raises(SimulationError, match="diverged at sample"):
        sensitivities({**SHIP, "K_p": 500.0, "T_s": 0.05, "T_d": 0.3}, record(4000))


def test_blocks_of_products_are_those_of_the_sensitivities():
    values = {**SHIP, **SAMPLED, **TORQUE, "T_M": 0.0211}
    u = record(700)
    names = ["tau_n", "K_p", "T_d"]
    outputs = [0, 2]
    found, slopes = sensitivities(values, u, names=names, outputs=outputs)
    measured = found + 0.01 * np.random.default_rng(1).standard_normal(found.shape)
    wrt = [NAMES.index(name) for name in names]
    sums, count = _core.ship_products(
        vector(values), u, NO_LOAD, DT, 0, "first", outputs, measured, np.zeros(2), np.ones((2, 1)), wrt
    )
    columns = np.stack([np.vstack([slopes[:, k], np.ones(len(u)), measured[k] - found[k]]) for k in range(2)])
    expected = np.einsum("iak,jbk->iajb", columns, columns)
    assert count == len(u)
    np.testing.assert_allclose(sums, expected, rtol=1e-9, atol=1e-12)


anything = st.one_of(
    st.floats(-2.0, 2.0),
    st.floats(0.0, 0.2),
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from([0.0, 1e-300, 1e300, 1.0, 0.05, 0.1, math.inf, -math.inf]),
)
likely = st.fixed_dictionaries(
    {
        "tau_n": st.floats(0.1, 5.0),
        "g": st.floats(-2.0, 0.5),
        "v": st.floats(0.2, 3.0),
        "K_p": st.floats(-1.0, 20.0),
        "K_i": st.floats(0.0, 10.0),
        "p": st.floats(1.0, 3.0),
    },
    optional={
        "T_s": st.floats(0.004, 0.3),
        "T_0": st.floats(0.0, 0.5),
        "T_d": st.floats(0.0, 0.3),
        "T_set": st.floats(0.0, 0.3),
        "tau_act": st.floats(0.0, 0.3),
        "K_d": st.floats(-0.1, 0.3),
        "M_max": st.floats(1.0, 1.5),
        "M_min": st.floats(0.3, 0.99),
        "M_max_slope": st.floats(-2.0, 2.0),
        "X_max": st.floats(0.0, 0.3),
        "X_min": st.floats(-0.3, -1e-6),
        "rate_up": st.floats(0.01, 10.0),
        "rate_down": st.floats(0.01, 10.0),
        "anti_windup": st.sampled_from([0.0, 1.0]),
        "update": st.sampled_from([0.0, 1.0]),
        "T_n": st.floats(0.0, 0.4),
        "T_M": st.floats(0.0, 0.4),
        "initial_F": st.floats(-0.5, 0.5),
        "initial_N": st.floats(0.3, 1.4),
    },
)
odd = st.fixed_dictionaries({}, optional=dict.fromkeys(NAMES, anything))


def ends(values, hold):
    """Run, and accept finite outputs or an error of one line."""
    u = record(40)
    names = [name for name in ("tau_n", "K_i", "T_d") if name in values]
    try:
        found, slopes = sensitivities(values, u, hold=hold, names=names)
    except (InputError, SimulationError) as found_wrong:
        error = found_wrong
    else:
        assert np.isfinite(found).all()
        assert np.isfinite(slopes).all()
        return
    assert "\n" not in str(error)


@given(likely, st.sampled_from(["zero", "first"]))
@settings(max_examples=150, deadline=20_000)
def test_likely_ships_end(values, hold):
    ends(values, hold)


@given(likely, odd, st.sampled_from(["zero", "first"]))
@settings(max_examples=150, deadline=60_000)
def test_odd_ships_end_in_a_result_or_one_line(values, more, hold):
    ends({**values, **more}, hold)


@pytest.mark.parametrize("lag", [4e-5, 6e-5])
def test_a_rate_limit_beside_a_lag_far_below_a_sample(lag):
    u = record(200)
    without, _ = sensitivities({**SHIP, **RATE}, u)
    found, _ = sensitivities({**SHIP, **RATE, "tau_act": lag}, u)
    np.testing.assert_allclose(found, without, atol=2e-3)


def test_ctrl_c_ends_a_long_run():
    """The kernel looks at the stop flag within a sample, too."""
    values = {**SHIP, **TORQUE, "rate_up": 1e3, "tau_act": 1e-4}
    timer = threading.Timer(0.5, _thread.interrupt_main)
    timer.start()
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        sensitivities(values, record(200_000), substeps=0)
    assert time.monotonic() - start < 5.0
