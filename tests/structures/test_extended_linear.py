"""The drive train with actuator lag, derivative gain, sampling and twist, against closed forms and the exact kernel."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shipfp_rs import Experiment, Structure, Vessel, signals, simulate
from shipfp_rs.errors import InputError
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
}
FREQUENCIES = np.array([0.0, 0.01, 0.1, 0.5, 1.0, 2.0])
ALL = {
    "torque": "gauge",
    "products": True,
    "free_exponent": True,
    "dead_time_loop": True,
    "dead_time_set_point": True,
}


def test_nothing_added_is_the_linear_structure_of_the_kernel():
    plain, lagged = Structure.linear(**ALL), Structure.linear(**ALL, actuator_lag=True)
    values = {name: TUG[name] for name in plain.names}
    expected, slopes = plain.equations.response(values, FREQUENCIES[1:], list(plain.names))
    found, own_slopes = lagged.equations.response(
        values | {"tau_act": 0.0}, FREQUENCIES[1:], list(plain.names)
    )
    assert np.allclose(found, expected, rtol=1e-10)
    assert np.allclose(own_slopes, slopes, rtol=1e-7, atol=1e-8)


def test_every_element_acts_as_its_closed_form_says():
    q = TUG | {"vK_d": 0.2, "T_s": 0.05, "misread": 0.003}
    structure = Structure.linear(
        **ALL,
        actuator_lag=True,
        derivative=True,
        sampling=True,
        misreading=True,
        twist=True,
        speed="propeller",
    )
    s = 2j * np.pi * FREQUENCIES[1:]
    governor = q["vK_p"] + q["vK_i"] / s + q["vK_d"] * s / (1 + 0.1 * q["vK_d"] / q["vK_p"] * s)
    hold = (1 - np.exp(-s * q["T_s"])) / (s * q["T_s"])
    loop = governor * np.exp(-s * q["T_d"]) / (1 + q["tau_act"] * s) * hold
    # Engine's side, propeller's side and the spring between them, three equations for n_e, n_s and M_g.
    matrix = np.zeros((len(s), 3, 3), dtype=complex)
    # M_b* = g n_e* + L (n_set* - n_e* - misread (M_b* - 2 n_e*)).
    held = 1 + q["misread"] * loop
    own = (q["g"] - loop * (1 - 2 * q["misread"])) / held
    matrix[:, 0] = np.stack([(q["tau_n"] - q["tau_prop"]) * s - own, 0 * s, 0 * s + 1], axis=-1)
    matrix[:, 1] = np.stack([0 * s, q["p"] + q["tau_prop"] * s, 0 * s - 1], axis=-1)
    matrix[:, 2] = np.stack([0 * s + 1, 0 * s - 1, -q["tau_twist"] * s], axis=-1)
    right = np.zeros((len(s), 3, 1), dtype=complex)
    # The derivative is the speed's alone.
    asked = loop * (q["vK_p"] + q["vK_i"] / s) / governor
    right[:, 0, 0] = asked / held * np.exp(-s * q["T_set"])
    n_s, M_g = np.linalg.solve(matrix, right)[:, 1:, 0].T
    found, _ = structure.equations.response(q, FREQUENCIES[1:], [])
    assert np.allclose(found, [n_s, M_g], rtol=1e-12)


def test_a_slow_set_point_is_followed_in_full():
    found, _ = Structure.linear(**ALL, twist=True).equations.response(TUG, np.zeros(1), [])
    assert np.allclose(found[:, 0], [1.0, TUG["p"]], rtol=1e-6)


@pytest.mark.parametrize("initial", [{}, {"initial dn": 0.02, "initial dE": 0.01, "T_d": 0.0}])
def test_a_record_is_what_the_exact_kernel_makes_of_it(initial):
    # So fine that a set point interpolated by the kernel, whose slope jumps, is as good as a smooth one.
    rate = 400.0
    time = np.arange(24000) / rate
    samples = 0.05 * np.sin(2 * np.pi * 0.3 * time) * np.sin(np.pi * time / 60.0) ** 2
    experiment = Experiment("swing", rate, {"n_set": 1000.0 * (1 + samples)}, {"n_set": 1000.0}, "first")
    plain = Structure.linear(**ALL)
    values = {name: TUG[name] for name in plain.names} | initial
    names = [*plain.names, *initial]
    expected, slopes = plain.equations.sensitivities(values, experiment, names)
    lagged = Structure.linear(**ALL, actuator_lag=True).equations
    found, own = lagged.sensitivities(values | {"tau_act": 0.0}, experiment, names)
    # A free motion begins with a jump, which by FFT is rounded off in the first samples.
    later = slice(80 if initial else 0, None)
    scale = np.abs(expected).max(axis=1)
    assert np.all(np.abs(found - expected)[:, later].max(axis=1) < 2e-3 * scale)
    for name in ("initial dn", "initial dE") if initial else names:
        largest = np.abs(slopes[names.index(name)]).max()
        assert np.abs(own[names.index(name)] - slopes[names.index(name)])[:, later].max() < 5e-3 * largest, (
            name
        )


@pytest.mark.parametrize("speed", ["engine", "propeller"])
@pytest.mark.parametrize("torque", ["brake", "gauge"])
@pytest.mark.parametrize("products", [True, False])
def test_derivatives_are_those_of_finite_differences(speed, torque, products):
    excitation = signals.chirp(0.05, 0.9, 60.0, 60.0, rate_hz=5.0)
    experiment = simulate(Vessel.load("stan-tug-1205"), excitation)
    structure = Structure.linear(
        **ALL | {"torque": torque, "products": products},
        actuator_lag=True,
        derivative=True,
        sampling=True,
        misreading=True,
        twist=torque == "gauge",
        curvature=True,
        speed=speed,
        outputs=("dn", "dM", "dX"),
    )
    gains = {"vK_d": 0.2, "v": 1.2, "K_p": 4.4, "K_i": 10.5, "K_d": 0.17}
    states = {"initial dn": 0.01, "initial dE": 0.02}
    values = {
        name: (TUG | gains | {"T_s": 0.03, "misread": 0.002}).get(name) for name in structure.names
    } | states
    _, slopes = structure.equations.sensitivities(values, experiment, list(values))
    for name, slope in zip(values, slopes, strict=True):
        step = 1e-5 * values[name]
        ahead, behind = (
            structure.equations.simulate(values | {name: values[name] + side * step}, experiment)
            for side in (1.0, -1.0)
        )
        assert np.allclose(slope, (ahead - behind) / (2 * step), atol=1e-5 * np.abs(slope).max()), name


def test_stability_is_that_of_the_kernel_structure():
    plain = Structure.linear(**ALL).equations
    lagged = Structure.linear(**ALL, actuator_lag=True).equations
    random = np.random.default_rng(3)
    told = []
    for _ in range(60):
        q = {
            name: TUG[name] * random.uniform(0.3, 3.0) for name in TUG if name not in ("tau_act", "tau_twist")
        }
        told.append(plain.stable(q))
        assert lagged.stable(q | {"tau_act": 0.0}) == told[-1]
    assert 5 < sum(told) < 55


def test_the_full_tug_moves_as_the_structure_with_lag_and_twist_says():
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
    lagged = Structure.linear(**ALL, actuator_lag=True, twist=True)
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


def test_a_derivative_gain_is_that_of_the_simulated_governor():
    # Of the speed alone: a governor that kicks at steps of the set point would answer otherwise.
    gains = {"governor.K_d": 0.3, "governor.derivative_filter_s": 0.03, "governor.K_p": 1.0}
    tug = Vessel.load("stan-tug-1205").replace(gains)
    time = np.arange(4000) / 100.0
    swing = 0.1 * np.sin(2 * np.pi * 1.0 * time) * np.sin(np.pi * time / 40.0) ** 2
    experiment = simulate(tug, signals.Excitation("swing", "sine", 100.0, swing, hold="first"))
    structure = Structure.linear(
        torque="gauge", derivative=True, free_exponent=True, outputs=("dn", "dM", "dX")
    )
    model = dataclasses.asdict(linearise(tug)) | {"K_d": 0.3}
    found = structure.equations.simulate({name: model[name] for name in structure.names}, experiment)
    for name, row in zip(("n_e", "M_g", "X_f"), found, strict=True):
        expected = experiment.normalised(name)
        assert np.abs(row - expected).max() < 2e-3 * np.abs(expected).max()


def test_curvature_is_the_second_order_of_the_plant():
    # The thesis's plant but for a cubic propeller, in swings of 8 %: what is left is of third order.
    tug = Vessel.load("stan-tug-1205").replace({"propeller.torque_exponent": 3.0})
    time = np.arange(2400) / 20.0
    swing = 100.0 * np.sin(2 * np.pi * 0.2 * time) * np.sin(np.pi * time / 120.0)
    left = {}
    model = linearise(tug)
    for size in (1.0, 0.5):
        experiment = simulate(tug, signals.Excitation("swing", "sine", 20.0, size * swing, hold="first"))
        values = {name: getattr(model, name) for name in ("tau_n", "g", "v", "K_p", "K_i", "p", "tau_prop")}
        for curvature in (False, True):
            structure = Structure.linear(torque="gauge", derivative=True, curvature=curvature)
            simulated = structure.equations.simulate(values | {"K_d": 0.0}, experiment)
            rest = [
                experiment.normalised(name) - row for name, row in zip(("n_e", "M_g"), simulated, strict=True)
            ]
            left[size, curvature] = np.abs(rest).max(axis=1)
    assert np.all(left[1.0, True] < 0.05 * left[1.0, False])
    # Of second order.
    assert np.allclose(left[1.0, False] / left[0.5, False], 4.0, rtol=0.05)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"twist": True}, "gauge torque"),
        ({"speed": "bridge"}, "'engine' or 'propeller'"),
        ({"actuator_lag": True, "outputs": ("dn", "dE")}, "'dE'"),
    ],
)
def test_what_cannot_go_together_is_refused(settings, says):
    with pytest.raises(InputError, match=says):
        Structure.linear(**settings)
