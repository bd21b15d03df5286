"""Events within a step: arrivals late in a record, a start from rest."""

import math

import numpy as np
import pytest

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from tests.twins.drive_train import NO_QUADRANTS, vector
from tests.twins.plant import N_E, UNLIMITED

SIX = np.ones(6)


@pytest.mark.study
def test_breakage_b3_an_arrival_late_in_a_record_ends_its_step():
    # 102 million steps; the same in no time is tested in Rust, at the step where a search for its end had none.
    parameters = vector(set_dead_time=0.1 / 3.0)
    n_set = np.full(102_450, N_E)
    rows = _core.simulate_drive_train(parameters, *UNLIMITED, SIX, NO_QUADRANTS, n_set, 0.0025, 1000, "zero")
    assert np.isfinite(rows).all()


def test_breakage_b3_steps_too_short_to_have_times_are_refused():
    for substeps in (10**12, 2**63, 2**64 - 1):
        with pytest.raises(InputError, match=r"substeps is \d+: found steps of .* use fewer substeps"):
            _core.simulate_drive_train(
                vector(), *UNLIMITED, SIX, NO_QUADRANTS, np.full(3, N_E), 0.01, substeps, "zero"
            )


@pytest.mark.parametrize("late", [1e300, 1e18, 2.0**63 * 0.01])
def test_breakage_b5_a_set_point_later_than_any_record_never_comes(late):
    linear = np.array([1.5, -0.583, 1.583, 10.0, 1.0, 2.0, 0.6, 0.0, late])
    dn_set = np.concatenate([np.zeros(50), np.ones(50)])
    common = (dn_set, 0.01, "zero", np.zeros(2), [0])
    assert not _core.simulate_linear(linear, *common).any()
    squares, count = _core.linear_products(
        linear, *common, np.ones((1, 100)), np.zeros(1), np.ones((1, 1)), []
    )
    assert (squares[0, -1, 0, -1], count) == (100.0, 100)
    n_set = N_E * (1.0 + 0.1 * dn_set)
    for elements in ({}, {"fuel_lag": 0.05}):
        parameters = vector(set_dead_time=late, **elements)
        rows = _core.simulate_drive_train(parameters, *UNLIMITED, SIX, NO_QUADRANTS, n_set, 0.01, 1, "zero")
        np.testing.assert_allclose(rows[0], N_E, rtol=1e-3)


@pytest.mark.parametrize("exponent", [1.0, 1.7, 2.0, 2.4])
def test_breakage_b6_from_rest_in_four_quadrants_a_ship_starts(exponent):
    angle = np.linspace(-math.pi, math.pi, 17)
    quadrants = np.array([angle, np.cos(angle), np.cos(angle)])
    parameters = vector(
        initial_speed=0.0,
        initial_ship_speed=0.0,
        set_point_before=0.0,
        torque_exponent=exponent,
        torque_coefficient=635.8 / (N_E / 3.0) ** exponent,
        ship_mass=2e4,
    )
    n_set = np.full(400, N_E)
    rows = _core.simulate_drive_train(parameters, *UNLIMITED, SIX, quadrants, n_set, 0.01, 4, "zero")
    assert np.isfinite(rows).all()
    assert rows[0, -1] > 0.5 * N_E
