"""Linear models: published parameters, gains and poles, and the nonlinear plant's own slopes."""

from __future__ import annotations

import dataclasses
import math
from typing import get_args

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.vessel.linear_model import Output, linearise, linearise_numerically
from shipfp_rs.vessel.vessel import Vessel

LAUNCH = Vessel.load("stan-launch-804")
TUG = Vessel.load("stan-tug-1205")
SHIPS = pytest.mark.parametrize("ship", [LAUNCH, TUG], ids=lambda ship: ship.name)
OUTPUTS: tuple[Output, ...] = get_args(Output)


def test_launch_has_its_published_parameters() -> None:
    model = linearise(LAUNCH)  # eq. 5.1, but for tau_n
    assert (model.g, model.v, model.K_p, model.K_i) == pytest.approx((-0.583, 1.583, 10.0, 1.0))
    assert model.v * model.K_p == pytest.approx(15.83)


def test_integration_times() -> None:
    # Eq. 3.23 with the shaft torque of Table 3.5, 635.77 Nm.
    assert linearise(LAUNCH).tau_n == pytest.approx(2 * math.pi * 21.2 * (1300 / 180) / 635.77, rel=1e-3)
    assert linearise(LAUNCH).tau_n == pytest.approx(1.513, abs=0.0015)
    # The printed 1.442 leaves out the loss in the gearbox (and rounds the speed up).
    assert linearise(LAUNCH.replace({"gearbox.efficiency": 1.0})).tau_n == pytest.approx(1.442, rel=3e-3)
    # Eq. 7.9, from the torsional vibration calculation.
    assert linearise(TUG).tau_n == pytest.approx(1.17, abs=0.005)
    assert linearise(TUG).tau_prop == pytest.approx(0.43, abs=0.001)


def test_tug_follows_slow_set_points_with_the_delay_that_it_is_configured_for() -> None:
    model = linearise(TUG)
    delay = (model.p - model.g) / (model.v * model.K_i)
    assert delay == pytest.approx(0.35, abs=0.005)
    w = 1e-3
    _, response = model.transfer_function("dn").freqresp([w])
    assert -np.angle(response[0]) / w == pytest.approx(delay, rel=1e-3)


@SHIPS
@pytest.mark.parametrize("fraction", [0.6, 1.0, 1.3])
def test_slopes_are_those_of_the_plant(ship: Vessel, fraction: float) -> None:
    rpm = fraction * ship.operating_point.n_e_rpm
    exact = dataclasses.astuple(linearise(ship, rpm))
    np.testing.assert_allclose(dataclasses.astuple(linearise_numerically(ship, rpm)), exact, rtol=1e-12)


@SHIPS
def test_gains_at_both_ends(ship: Vessel) -> None:
    model = linearise(ship)
    p, vK_p = ship.propeller.torque_exponent, model.v * model.K_p
    slow = {
        "dn": 1.0,
        "dE": (p - model.g) / (model.v * model.K_i),
        "dM_b": p,
        "dM_g": p,
    }  # eq. 3.32, 3.36, 3.39
    fast = {
        "dn": 0.0,
        "dE": 0.0,
        "dM_b": vK_p,
        "dM_g": vK_p * model.tau_prop / model.tau_n,
    }  # eq. 3.33, 3.37, 3.40
    for output, gain in slow.items():
        assert model.dc_gain(output) == pytest.approx(gain)
    for output, gain in fast.items():
        assert model.high_frequency_gain(output) == pytest.approx(gain)
    assert model.dc_gain("dX") == pytest.approx((p - model.g) / model.v)
    assert model.high_frequency_gain("dX") == pytest.approx(model.K_p)


@SHIPS
@pytest.mark.parametrize("output", OUTPUTS)
def test_transfer_function_state_space_and_response_agree(ship: Vessel, output: Output) -> None:
    model = linearise(ship)
    frequency = np.geomspace(1e-3, 50.0, 25)
    _, rational = model.transfer_function(output).freqresp(2 * np.pi * frequency)
    system = model.state_space([output])
    states = [
        (system.C @ np.linalg.solve(2j * np.pi * f * np.eye(2) - system.A, system.B) + system.D).item()
        for f in frequency
    ]
    (found,) = model.response(frequency, [output])
    np.testing.assert_allclose(states, rational, rtol=1e-8)
    np.testing.assert_allclose(found, rational, rtol=1e-12)


def test_transfer_functions_are_the_printed_ones() -> None:
    m = linearise(LAUNCH)
    a, b = (2 - m.g + m.v * m.K_p) / m.tau_n, m.v * m.K_i / m.tau_n
    printed = {
        "dn": [m.v * m.K_p / m.tau_n, b],  # eq. 3.31
        "dE": [1, (2 - m.g) / m.tau_n],  # eq. 3.35
        "dM_b": [m.v * m.K_p, m.v * m.K_i + 2 * m.v * m.K_p / m.tau_n, 2 * b],  # eq. 3.38
    }
    for output, numerator in printed.items():
        rational = m.transfer_function(output)
        np.testing.assert_allclose(rational.num, numerator)
        np.testing.assert_allclose(rational.den, [1, a, b])


def test_state_space_is_the_printed_one() -> None:
    m = linearise(LAUNCH)
    system = m.state_space(["dn", "dE", "dM_b"])
    vK_p, vK_i = m.v * m.K_p, m.v * m.K_i
    np.testing.assert_allclose(system.A, [[(-2 + m.g - vK_p) / m.tau_n, vK_i / m.tau_n], [-1, 0]])  # eq. 3.53
    np.testing.assert_allclose(system.B, [[vK_p / m.tau_n], [1]])
    np.testing.assert_allclose(system.C, [[1, 0], [0, 1], [m.g - vK_p, vK_i]])  # eq. 3.54
    np.testing.assert_allclose(system.D, [[0], [0], [vK_p]])


@SHIPS
def test_loops_are_stable_and_do_not_swing(ship: Vessel) -> None:
    model = linearise(ship)
    assert (model.poles.real < 0).all()
    assert (model.poles.imag == 0).all()
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(model.state_space().A)), np.sort(model.poles.real))


def test_a_dead_time_has_no_poles_but_keeps_its_gains() -> None:
    model = linearise(TUG)
    late = dataclasses.replace(model, T_d=0.12)
    assert late.dc_gain("dM_b") == model.dc_gain("dM_b")
    with pytest.raises(InputError, match=r"found dead times T_d 0\.12 s, T_set 0 s, expected none"):
        _ = late.poles
    for refused in (late.state_space, lambda: late.transfer_function("dn")):
        with pytest.raises(InputError, match="expected none"):
            refused()


def test_unknown_outputs_are_named() -> None:
    model = linearise(LAUNCH)
    with pytest.raises(InputError, match="is 'dM', expected 'dn', 'dE', 'dM_b', 'dM_g' or 'dX'"):
        model.dc_gain("dM")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="outputs is empty"):
        model.state_space([])


def test_a_dead_time_turns_the_phase_of_the_response_only() -> None:
    model = linearise(Vessel.load("stan-tug-1205"))
    late = dataclasses.replace(model, T_set=0.3)
    ratio = late.response([0.5], ["dn"]) / model.response([0.5], ["dn"])
    np.testing.assert_allclose(ratio, np.exp(-2j * np.pi * 0.5 * 0.3), rtol=1e-12)
