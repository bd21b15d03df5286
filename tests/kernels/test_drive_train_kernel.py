"""The kernel of the whole drive train against its NumPy twin, the plant's own kernel, and what physics demands."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from tests.kernels.test_plant_kernel import ENVELOPES, SEVEN_POINTS, assert_close, wander
from tests.kernels.test_plant_kernel import simulate as simulate_plant
from tests.twins import drive_train as twin
from tests.twins import plant as plant_twin
from tests.twins.drive_train import NO_QUADRANTS, vector
from tests.twins.plant import N_E, UNLIMITED

SIX = np.ones(6)
UNEQUAL = np.array([1.1, 0.9, 1.05, 0.95, 1.02, 0.98])
ANGLES = np.linspace(-math.pi, math.pi, 9)
QUADRANTS = np.array([ANGLES, np.cos(ANGLES) - 0.3 * np.sin(ANGLES), np.cos(ANGLES) - 0.5 * np.sin(ANGLES)])
FIRING = {"firing_interval": 1.0 / 3.0, "firing_width": 0.5}
INFINITE = math.inf
DEFAULT = twin.DEFAULTS

# Name: changed parameters, envelope, strength of the cylinders, quadrants.
ELEMENTS = {
    "nothing": ({}, UNLIMITED, SIX, NO_QUADRANTS),
    "dead time of the set point": ({"set_dead_time": 0.13}, UNLIMITED, SIX, NO_QUADRANTS),
    "dead time of the fuel": ({"fuel_dead_time": 0.033}, UNLIMITED, SIX, NO_QUADRANTS),
    "both dead times and a lag": (
        {"set_dead_time": 0.137, "fuel_dead_time": 0.05, "fuel_lag": 0.04},
        SEVEN_POINTS,
        SIX,
        NO_QUADRANTS,
    ),
    "sampled governor": ({"governor_period": 0.033}, UNLIMITED, SIX, NO_QUADRANTS),
    "sampled governor and dead times": (
        {"governor_period": 0.025, "fuel_dead_time": 0.041, "set_dead_time": 0.2},
        UNLIMITED,
        SIX,
        NO_QUADRANTS,
    ),
    "PID": ({"Kd_abs": 0.4}, UNLIMITED, SIX, NO_QUADRANTS),
    "sampled PID": ({"Kd_abs": 0.4, "governor_period": 0.05}, UNLIMITED, SIX, NO_QUADRANTS),
    "rates": ({"rack_rate": 8.0, "torque_rate": 150.0, "fuel_lag": 0.05}, UNLIMITED, SIX, NO_QUADRANTS),
    "limits with anti-windup": (
        {"minimum_rack": 9.0, "maximum_rack": 15.0, "anti_windup": 1.0, "smoke_margin": 1.0},
        SEVEN_POINTS,
        SIX,
        NO_QUADRANTS,
    ),
    "sampled limits with anti-windup": (
        {"maximum_rack": 15.0, "anti_windup": 1.0, "governor_period": 0.05},
        SEVEN_POINTS,
        SIX,
        NO_QUADRANTS,
    ),
    "drag": ({"drag_coefficient": 3.0, "drag_exponent": 1.3}, UNLIMITED, SIX, NO_QUADRANTS),
    "flexible shaft": ({"shaft_stiffness": 2e4, "shaft_damping": 20.0}, UNLIMITED, SIX, NO_QUADRANTS),
    "ripple": ({"shaft_ripple": 0.02, "blade_ripple": 0.05}, UNLIMITED, SIX, NO_QUADRANTS),
    "firing": (FIRING, UNLIMITED, UNEQUAL, NO_QUADRANTS),
    "governor once a firing": (
        {**FIRING, "governor_period": INFINITE, "fuel_dead_time": 0.02},
        UNLIMITED,
        UNEQUAL,
        NO_QUADRANTS,
    ),
    "moving ship": ({"ship_mass": 8e3}, UNLIMITED, SIX, NO_QUADRANTS),
    "four quadrants": ({"ship_mass": 8e3, "inflow": 0.9}, UNLIMITED, SIX, QUADRANTS),
    "everything": (
        {
            **FIRING,
            "torque_exponent": 2.17,
            "torque_coefficient": 8.7,
            "set_dead_time": 0.13,
            "fuel_dead_time": 0.05,
            "fuel_lag": 0.03,
            "governor_period": 0.03,
            "Kd_abs": 0.1,
            "rack_rate": 20.0,
            "torque_rate": 400.0,
            "anti_windup": 1.0,
            "maximum_rack": 16.0,
            "smoke_margin": 2.0,
            "drag_coefficient": 2.0,
            "shaft_stiffness": 2e4,
            "shaft_damping": 30.0,
            "blade_ripple": 0.05,
            "ship_mass": 8e3,
        },
        SEVEN_POINTS,
        UNEQUAL,
        QUADRANTS,
    ),
}


def simulate(n_set, dt=0.02, substeps=4, hold="first", envelope=UNLIMITED, strength=SIX, **changes):
    """Rows by name."""
    rows = _core.simulate_drive_train(
        vector(**changes), *envelope, strength, NO_QUADRANTS, n_set, dt, substeps, hold
    )
    return dict(zip(("n_e", "n_s", "M_b", "M_g", "M_s", "X_f", "E_n", "ship"), rows, strict=True))


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("element", ELEMENTS)
def test_agrees_with_the_equations_as_they_stand(element, hold):
    changes, envelope, strength, quadrants = ELEMENTS[element]
    arguments = (vector(**changes), *envelope, strength, quadrants, wander(120, scale=0.1), 0.02, 4, hold)
    found, expected = _core.simulate_drive_train(*arguments), twin.simulate(*arguments)
    size = np.abs(expected).max(axis=1, keepdims=True)
    size[6] = np.abs(expected[6]).max() + 1e-3  # the integrated error passes through zero
    assert (np.abs(found - expected) <= 1e-9 * size).all()


def test_firings_do_not_beat_with_the_steps_of_the_integration():
    changes, envelope, strength, quadrants = ELEMENTS["governor once a firing"]
    n_set = wander(400, scale=0.1)
    coarse, fine = (
        _core.simulate_drive_train(
            vector(**changes), *envelope, strength, quadrants, n_set, 0.005, steps, "first"
        )
        for steps in (6, 24)
    )
    # Fired at the end of the step that passes the angle, the torque would be off by 1e-2.
    for row, bound in ((1, 1e-5), (3, 1e-4)):
        assert np.abs(coarse[row] / fine[row] - 1.0).max() < bound


@pytest.mark.parametrize("element", [name for name in ELEMENTS if name != "nothing"])
def test_every_element_does_something(element):
    changes, envelope, strength, quadrants = ELEMENTS[element]
    n_set = wander(120, scale=0.1)
    with_it = _core.simulate_drive_train(
        vector(**changes), *envelope, strength, quadrants, n_set, 0.02, 4, "first"
    )
    without = _core.simulate_drive_train(vector(), *UNLIMITED, SIX, NO_QUADRANTS, n_set, 0.02, 4, "first")
    assert np.abs(with_it - without).max() > 1e-3


@pytest.mark.parametrize("envelope", ENVELOPES)
@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("exponent", [2.0, 2.17])
def test_with_all_elements_off_it_is_the_plant(exponent, hold, envelope):
    n_set, start = wander(400, scale=0.1), np.array([N_E / 3.0, 0.0])
    found = simulate(n_set, hold=hold, envelope=ENVELOPES[envelope], torque_exponent=exponent)
    parameters = plant_twin.vector(torque_exponent=exponent)
    plant = simulate_plant(parameters, ENVELOPES[envelope], n_set, 0.02, 4, "rk4", hold, start)
    assert_close(np.array([found[name] for name in ("n_s", "E_n", "X_f", "M_b")]), plant, 1e-10)


def test_a_step_of_the_set_point_arrives_after_its_dead_time():
    n_set = np.where(np.arange(100) < 20, N_E, 1.02 * N_E)
    late = simulate(n_set, hold="zero", set_dead_time=0.3)
    now = simulate(n_set, hold="zero")
    for name in ("n_e", "M_b", "X_f"):
        np.testing.assert_allclose(late[name][15:], now[name][:-15], rtol=1e-9)


def test_a_fuel_dead_time_holds_the_torque_for_so_long_and_then_gives_it_all():
    n_set = np.full(60, 1.02 * N_E)
    rows = simulate(n_set, dt=0.01, hold="zero", fuel_dead_time=0.1)
    step = DEFAULT["A1"] * DEFAULT["Kp_abs"] * 0.02 * N_E
    np.testing.assert_allclose(rows["M_b"][:10], rows["M_b"][0], rtol=1e-9)
    assert rows["M_b"][10] - rows["M_b"][9] == pytest.approx(step, rel=1e-9)


def test_rate_limits_by_hand():
    """A step of the set point asks at once for more rack than its rate gives; the torque goes the same way."""
    n_set = np.full(11, 1.05 * N_E)
    rack = simulate(n_set, dt=0.01, hold="zero", rack_rate=20.0)["X_f"]
    np.testing.assert_allclose(rack, 13.07 + 20.0 * 0.01 * np.arange(11), rtol=1e-12)
    torque = simulate(n_set, dt=0.01, hold="zero", torque_rate=500.0)["M_b"]
    np.testing.assert_allclose(torque - torque[0], 500.0 * 0.01 * np.arange(11), rtol=1e-9)


def test_anti_windup_by_hand():
    """Held at its stop the rack can't follow: the integral waits, or winds up by the error's integral."""
    n_set = np.full(50, 1.2 * N_E)
    waits, winds = (simulate(n_set, hold="zero", maximum_rack=14.0, anti_windup=on) for on in (1.0, 0.0))
    for rows in (waits, winds):
        np.testing.assert_array_equal(rows["X_f"][1:], 14.0)
    np.testing.assert_array_equal(waits["E_n"], 0.0)
    error = n_set - winds["n_e"]
    integral = np.concatenate([[0.0], np.cumsum(0.02 * (error[1:] + error[:-1]) / 2.0)])
    np.testing.assert_allclose(winds["E_n"], integral, rtol=1e-4)  # the trapezoids' own error


def test_a_smoke_limiter_lets_the_rack_grow_with_the_charge_air():
    """Held at a margin m over the charge air c, dc/dt = m / lag: a ramp of the rack."""
    rows = simulate(np.full(40, 1.2 * N_E), hold="zero", smoke_margin=1.5, turbocharger_lag=2.0)
    np.testing.assert_allclose(rows["X_f"], 13.07 + 1.5 * (1.0 + 0.02 * np.arange(40) / 2.0), rtol=1e-9)


def test_a_flexible_shaft_swings_at_its_natural_frequency():
    """Free vibration of two inertias: omega^2 = k (1/J1 + 1/J2); no load, no engine but a constant torque."""
    stiffness, J_2 = 2e4, 2.81
    J_1 = DEFAULT["inertia"] - J_2
    exact = math.sqrt(stiffness * (1.0 / J_1 + 1.0 / J_2)) / (2.0 * math.pi)
    state = np.zeros(10)
    state[:2] = N_E / 3.0

    def rates(state):
        parameters = vector(shaft_stiffness=stiffness, torque_coefficient=0.0, A2=0.0)
        found = _core._drive_train_rates(parameters, *UNLIMITED, SIX, NO_QUADRANTS, state, N_E, 13.07)
        return found[:3]

    jacobian = np.array([(rates(state + 1e-3 * e) - rates(state - 1e-3 * e)) / 2e-3 for e in np.eye(10)[:3]])
    frequency = np.abs(np.linalg.eigvals(jacobian).imag).max() / (2.0 * math.pi)
    assert frequency == pytest.approx(exact, rel=1e-9)


def test_a_stiff_shaft_is_a_rigid_one():
    n_set = wander(60, scale=0.02)
    rigid = simulate(n_set, dt=0.01)
    stiff = simulate(n_set, dt=0.01, substeps=200, shaft_stiffness=1e7, shaft_damping=3e3)
    for name in ("n_e", "M_b", "M_g"):
        # A rigid shaft's gauge jumps with the set point; a stiff one's follows.
        np.testing.assert_allclose(stiff[name][1:], rigid[name][1:], rtol=1e-4)


@settings(max_examples=60)
@given(
    n_1=st.floats(1.0, 12.0),
    n_2=st.floats(-3.0, 12.0),
    twist=st.floats(-0.01, 0.02),
    fuel=st.floats(0.0, 25.0),
    ship=st.floats(-2.0, 4.0),
    flexible=st.booleans(),
)
def test_torques_balance_at_any_state(n_1, n_2, twist, fuel, ship, flexible):
    """What the engine gives goes into both inertias, the drag and the propeller; the gauge sees the propeller's part."""
    n_2 = n_2 if flexible else n_1
    stiffness = {"shaft_stiffness": 2e4, "shaft_damping": 10.0} if flexible else {}
    changes = {**stiffness, "drag_coefficient": 3.0, "drag_exponent": 1.5, "ship_mass": 8e3}
    state = np.array([n_1, n_2, twist, 0.2, 0.1, fuel, fuel, 0.0, 3.0 * n_1, ship])
    found = _core._drive_train_rates(vector(**changes), *UNLIMITED, SIX, QUADRANTS, state, N_E, fuel)
    rates, (_, M_b, M_g, M_s, _) = found[:10], found[10:]
    J_2 = DEFAULT["propeller_inertia"]
    J_1 = DEFAULT["inertia"] - J_2
    # Torque on the propeller by its definition, from the flow at the blades.
    across, along = ship, DEFAULT["blade_path"] * n_2
    flow, angle = math.hypot(across, along) / DEFAULT["blade_path"], math.atan2(across, along)
    M_p = DEFAULT["torque_coefficient"] * flow**2 * np.interp(angle, QUADRANTS[0], QUADRANTS[1])
    scale = 1e-9 * (abs(M_s) + abs(M_p) + abs(M_g) + 1.0)
    assert M_s == pytest.approx(M_b * 3.0 * 0.95 - 3.0 * n_1**1.5, abs=scale)
    assert M_s - M_p == pytest.approx(2 * np.pi * (J_1 * rates[0] + J_2 * rates[1]), abs=scale)
    assert M_g - M_p == pytest.approx(2 * np.pi * J_2 * rates[1], abs=scale)


def test_steps_are_cut_where_signals_break():
    """Dead times and periods that are no whole number of steps cost no accuracy: one step a sample, or thirty."""
    changes = {"fuel_dead_time": 0.051, "set_dead_time": 0.133, "governor_period": 0.037}
    n_set = np.where(np.arange(100) < 25, N_E, 1.03 * N_E)
    coarse, fine = (simulate(n_set, substeps=steps, hold="zero", **changes)["n_e"] for steps in (1, 30))
    np.testing.assert_allclose(coarse, fine, rtol=1e-10)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fuel_dead_time": 0.001}, "fuel_dead_time is 0.001 s, expected 0 or at least a step, 0.005 s"),
        ({"governor_period": 0.001}, "governor_period is 0.001 s, expected 0 or at least a step"),
        ({"governor_period": INFINITE}, "firing_interval is 0, expected a positive angle"),
        ({"propeller_inertia": 30.0}, "propeller_inertia is 30, expected less than inertia, 21.2"),
        ({"maximum_rack": 5.0, "minimum_rack": 6.0}, "minimum_rack is 6, expected less than maximum_rack"),
        ({"set_dead_time": -0.1}, "set_dead_time is -0.1, expected zero or more"),
        ({"rack_rate": 0.0}, "rack_rate is 0, expected a positive number, infinity for none"),
        ({"Kd_abs": math.nan}, "Kd_abs is NaN, expected a finite number"),
    ],
)
def test_parameters_without_sense_are_named(changes, message):
    with pytest.raises(InputError, match=message):
        simulate(np.full(10, N_E), **changes)
