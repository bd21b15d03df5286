"""Steady states: Table 3.5, the sea-trial figures, and set points out of reach."""

from __future__ import annotations

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.vessel.steady_state import steady_state
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


def pull(ship: Vessel, n_e_rpm: float) -> float:
    return (1.0 - ship.propeller.thrust_deduction) * steady_state(ship, n_e_rpm).thrust


def test_bollard_pull_of_the_launch_agrees_with_its_sea_trial() -> None:
    # Section 3.2.2: at 1100 rpm 0.036 t are 7 % of the pull; the rounding of the two leaves some 10 %.
    assert pull(LAUNCH, 1100.0) / 9810.0 == pytest.approx(0.036 / 0.07, rel=0.1)


def test_bollard_pull_of_the_tug_agrees_with_its_product_sheet() -> None:
    # Appendix C: 9.1 t with both propellers.
    assert 2 * pull(TUG, 1800.0) / 9810.0 == pytest.approx(9.1, rel=0.01)


def test_a_set_point_out_of_reach_is_refused_with_both_torques() -> None:
    with pytest.raises(InputError, match=r"1900 rpm needs 476\.2 Nm of engine torque, 472 Nm are available"):
        steady_state(LAUNCH, 1900.0)
    with pytest.raises(InputError, match=r"400 rpm needs a fuel rack of -.* mm, expected a positive one"):
        steady_state(TUG, 400.0)
    for bad in (0.0, -5.0, np.nan):
        with pytest.raises(InputError, match="expected a positive number"):
            steady_state(LAUNCH, bad)
    assert steady_state(LAUNCH.replace({"engine.envelope": None}), 2500.0).M_b > 472.0
