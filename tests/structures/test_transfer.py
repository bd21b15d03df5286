"""The transfer functions of the drive train against closed forms, the linear kernel and the simulated tug."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shipfp_rs import Structure, Vessel, signals, simulate
from shipfp_rs.structures.transfer import TransferFunctions
from shipfp_rs.vessel.linear_model import linearise

TUG = {
    "tau_n": 1.17,
    "g": -0.6,
    "vK_p": 5.3,
    "vK_i": 12.6,
    "p": 2.17,
    "tau_prop": 0.43,
    "T_d": 0.09,
    "T_set": 0.25,
    "tau_act": 0.03,
    "tau_twist": 6.6e-4,
    "zeta_twist": 2.3,
}
FREQUENCIES = np.array([0.0, 0.01, 0.1, 0.5, 1.0, 2.0])
ALL = {
    "torque": "gauge",
    "products": True,
    "free_exponent": True,
    "dead_time_loop": True,
    "dead_time_set_point": True,
}


LOOP = ["dead_time_loop", "dead_time_set_point"]


def test_nothing_added_is_the_linear_structure():
    plain = Structure.linear(**ALL)
    values = {name: TUG[name] for name in plain.names}
    expected, slopes = plain.equations.response(values, FREQUENCIES[1:], list(plain.names))
    ship = Structure.ship(LOOP, torque="gauge").equations
    found, own_slopes = ship.response(values, FREQUENCIES[1:], list(plain.names))
    assert np.allclose(found, expected, rtol=1e-10)
    assert np.allclose(own_slopes, slopes, rtol=1e-7, atol=1e-8)


def test_every_element_acts_as_its_closed_form_says():
    q = TUG | {"vK_d": 0.2, "T_s": 0.05}
    s = 2j * np.pi * FREQUENCIES[1:]
    governor = q["vK_p"] + q["vK_i"] / s + q["vK_d"] * s / (1 + 0.1 * q["vK_d"] / q["vK_p"] * s)
    hold = (1 - np.exp(-s * q["T_s"])) / (s * q["T_s"])
    loop = governor * np.exp(-s * q["T_d"]) / (1 + q["tau_act"] * s) * hold
    # Engine's side, propeller's side and the spring between them, three equations for n_e, n_s and M_g.
    matrix = np.zeros((len(s), 3, 3), dtype=complex)
    # M_b* = g n_e* + L (n_set* - n_e*).
    engine = (q["tau_n"] - q["tau_prop"]) * s - q["g"] + loop
    matrix[:, 0] = np.stack([engine, 0 * s, 0 * s + 1], axis=-1)
    matrix[:, 1] = np.stack([0 * s, q["p"] + q["tau_prop"] * s, 0 * s - 1], axis=-1)
    damped = 1 + q["zeta_twist"] * q["tau_twist"] * s
    matrix[:, 2] = np.stack([damped, -damped, -q["tau_twist"] * s], axis=-1)
    right = np.zeros((len(s), 3, 1), dtype=complex)
    # The derivative is the speed's alone.
    right[:, 0, 0] = loop * (q["vK_p"] + q["vK_i"] / s) / governor * np.exp(-s * q["T_set"])
    n_s, M_g = np.linalg.solve(matrix, right)[:, 1:, 0].T
    elements = [*LOOP, "actuator_lag", "derivative", "sampling", "twist"]
    structure = Structure.ship(elements, torque="gauge", propeller_speed=True)
    found, _ = structure.equations.response(q, FREQUENCIES[1:], [])
    assert np.allclose(found, [n_s, M_g], rtol=1e-12)


def test_the_mean_effect_of_sampling_is_that_of_the_hold_within_the_dead_time():
    late = {name: value for name, value in TUG.items() if name != "T_d"}
    elements = [*LOOP, "actuator_lag", "twist", "sampling"]
    mean, exact = (
        Structure.ship(elements, torque="gauge", mean_sampling=one).equations for one in (True, False)
    )
    names = ["T_s", "T_d", "tau_n"]
    found, slopes = mean.response(late | {"T_d": 0.06, "T_s": 0.05}, FREQUENCIES[1:], names)
    expected, _ = exact.response(late | {"T_d": 0.035, "T_s": 0.05}, FREQUENCIES[1:], [])
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    near, _ = mean.response(late | {"T_d": 0.06, "T_s": 0.05 + 1e-6}, FREQUENCIES[1:], [])
    np.testing.assert_allclose(slopes[0], (near - found) / 1e-6, atol=1e-4 * np.abs(slopes[0]).max())


def test_a_slow_set_point_is_followed_in_full():
    found, _ = Structure.ship(["twist"], torque="gauge").equations.response(TUG, np.zeros(1), [])
    assert np.allclose(found[:, 0], [1.0, TUG["p"]], rtol=1e-6)


@pytest.mark.parametrize("speed", ["engine", "propeller"])
@pytest.mark.parametrize("gauge", [True, False])
@pytest.mark.parametrize("products", [True, False])
def test_derivatives_are_those_of_finite_differences(speed, gauge, products):
    gains = {"vK_d": 0.2} if products else {"v": 1.2, "K_p": 4.4, "K_i": 10.5, "K_d": 0.17}
    values = {name: value for name, value in TUG.items() if products or not name.startswith("v")}
    values |= gains | {"T_s": 0.03}
    equations = TransferFunctions(("dn", "dM", "dX"), gauge, speed)
    frequency = np.geomspace(0.01, 5.0, 30)
    _, slopes = equations.response(values, frequency, list(values))
    for name, slope in zip(values, slopes, strict=True):
        step = 1e-5 * values[name]
        ahead, behind = (
            equations.response(values | {name: values[name] + side * step}, frequency, [])[0]
            for side in (1.0, -1.0)
        )
        assert np.allclose(slope, (ahead - behind) / (2 * step), atol=1e-6 * np.abs(slope).max()), name


def test_the_full_tug_moves_as_the_ship_with_lag_and_twist_says():
    tug = Vessel.load("stan-tug-1205-full")
    model = dataclasses.asdict(linearise(tug))
    q = model | {
        "T_d": model["T_d"] - tug.actuator.lag_s,
        "tau_act": tug.actuator.lag_s,
        "tau_twist": 1725.0 / (2 * np.pi * tug.nominal_shaft_speed * tug.shaft.stiffness_Nm_rad),
    }
    at, periods, rate = 1.6, 24, 400.0
    time = np.arange(round(periods / at * rate)) / rate
    sine = signals.Excitation("sine", "sine", rate, 7.6 * np.sin(2 * np.pi * at * time), hold="first")
    experiment = simulate(tug, sine)
    late = time > 8 / at
    basis = np.column_stack([np.exp(2j * np.pi * at * time), np.exp(-2j * np.pi * at * time), 1.0 + 0 * time])
    measured = [
        np.linalg.lstsq(basis[late], experiment.normalised(name)[late])[0][0] * 2j / (7.6 / 1183.8)
        for name in ("n_e", "M_g")
    ]
    lagged = Structure.ship([*LOOP, "actuator_lag", "twist"], torque="gauge", products=False)
    expected, _ = lagged.equations.response(q, np.array([at]), [])
    assert np.abs(np.array(measured) / expected[:, 0] - 1).max() < 0.015
    # Lag taken for a dead time, twist for none.
    plain, _ = Structure.linear(**ALL).equations.response(
        {name: model[name] for name in model if name not in ("v", "K_p", "K_i")}
        | {"vK_p": q["v"] * q["K_p"], "vK_i": q["v"] * q["K_i"]},
        np.array([at]),
        [],
    )
    assert np.abs(np.array(measured) / plain[:, 0] - 1).max() > 0.05
