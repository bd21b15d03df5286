"""Steady states: Table 3.5, the sea-trial figures, and set points out of reach."""

from __future__ import annotations

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.vessel.steady_state import bollard_curve, steady_state
from shipfp_rs.vessel.vessel import Vessel

LAUNCH = Vessel.load("stan-launch-804")
TUG = Vessel.load("stan-tug-1205")


def test_the_launch_runs_at_its_published_operating_point() -> None:
    point = steady_state(LAUNCH)  # Table 3.5
    assert point.n_e_rpm == pytest.approx(1300.0)
    assert point.n_s == pytest.approx(7.222, abs=5e-4)
    assert point.X_f == pytest.approx(13.07)
    assert point.M_b == pytest.approx(222.93)
    assert point.M_s == pytest.approx(635.766, rel=1e-3)
    assert point.brake_power == pytest.approx(30.3e3, rel=5e-3)


def test_the_tug_runs_at_its_published_operating_point() -> None:
    point = steady_state(TUG)  # Table 6.12
    assert point.n_e_rpm == pytest.approx(1183.8)
    assert point.M_s == pytest.approx(1725.0)


def test_the_tug_agrees_with_the_static_torque_measured_at_other_speeds() -> None:
    # Table 6.8; the lowest point, 500 Nm, reads 12.6 % from the thesis's own calculation too.
    for rpm, torque, tolerance in [(927.5, 1000.0, 0.03), (1430.0, 2600.0, 0.02), (1684.0, 3550.0, 0.05)]:
        assert steady_state(TUG, rpm).M_s == pytest.approx(torque, rel=tolerance)


@pytest.mark.parametrize("ship", [LAUNCH, TUG], ids=lambda ship: ship.name)
@pytest.mark.parametrize("fraction", [0.6, 0.9, 1.2])
def test_a_steady_state_has_no_derivative(ship: Vessel, fraction: float) -> None:
    point = steady_state(ship, fraction * ship.operating_point.n_e_rpm)
    _, ratio, efficiency, A1, A2, A3, coefficient, p, *_ = ship.plant_parameters()
    assert point.n_e == pytest.approx(ratio * point.n_s)
    assert A1 * point.X_f + A2 * point.n_e + A3 == pytest.approx(point.M_b)
    assert point.M_b * ratio * efficiency == pytest.approx(coefficient * point.n_s**p)


def test_bollard_pull_of_the_launch_agrees_with_its_sea_trial() -> None:
    # Section 3.2.2: at 1100 rpm 0.036 t are 7 % of the pull; the rounding of the two leaves some 10 %.
    pull = bollard_curve(LAUNCH, [1100.0]).bollard_pull[0]
    assert pull / 9810.0 == pytest.approx(0.036 / 0.07, rel=0.1)


def test_bollard_pull_of_the_tug_agrees_with_its_product_sheet() -> None:
    # Appendix C: 9.1 t with both propellers.
    assert 2 * bollard_curve(TUG, [1800.0]).bollard_pull[0] / 9810.0 == pytest.approx(9.1, rel=0.01)


def test_brake_power_meets_the_rating_at_rated_speed_and_not_before() -> None:
    for ship in (LAUNCH, TUG):
        curve = bollard_curve(ship, np.linspace(600.0, 1800.0, 25))
        assert (curve.brake_power < curve.power_limit).all()
        assert curve.brake_power[-1] / curve.power_limit[-1] > 0.9
    point = steady_state(LAUNCH, 1500.0)
    curve = bollard_curve(LAUNCH, [1500.0])
    assert curve.brake_power[0] == pytest.approx(point.brake_power)
    assert curve.bollard_pull[0] == pytest.approx(0.94 * point.thrust)  # thrust deduction 0.06, Table 3.2


def test_at_rest_nothing_is_needed_and_unlimited_engines_have_no_limit() -> None:
    curve = bollard_curve(LAUNCH, [0.0])
    assert curve.bollard_pull[0] == curve.brake_power[0] == curve.power_limit[0] == 0.0
    unlimited = LAUNCH.replace({"engine.envelope": None})
    assert bollard_curve(unlimited, [1300.0]).power_limit[0] == np.inf
    assert steady_state(unlimited, 2500.0).M_b > 472.0


def test_a_set_point_out_of_reach_is_refused_with_both_torques() -> None:
    with pytest.raises(InputError, match=r"1900 rpm needs 476\.2 Nm of engine torque, 472 Nm are available"):
        steady_state(LAUNCH, 1900.0)
    with pytest.raises(InputError, match=r"400 rpm needs a fuel rack of -.* mm, expected a positive one"):
        steady_state(TUG, 400.0)
    for bad in (0.0, -5.0, np.nan):
        with pytest.raises(InputError, match="expected a positive number"):
            steady_state(LAUNCH, bad)
    with pytest.raises(InputError, match="none negative"):
        bollard_curve(LAUNCH, [-1.0])
