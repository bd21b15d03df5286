"""Events within a step: switching, arrivals late in a record, a start from rest."""

import math

import numpy as np
import pytest

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from tests.twins.drive_train import NO_QUADRANTS, vector
from tests.twins.plant import N_E, UNLIMITED

NAMES = _core.DRIVE_TRAIN_PARAMETERS
SIX = np.ones(6)
ALL_OUTPUTS = list(range(6))
AS_OUTPUTS = [0, 1, 2, 3, 5, 6]


def along(*names):
    return np.array([[float(name == wanted) for name in NAMES] for wanted in names])


def central(parameters, run, name, share, quadrants=NO_QUADRANTS):
    """Central difference of what `simulate_drive_train` gives."""
    place = NAMES.index(name)
    rows = []
    step = share * abs(parameters[place])
    for side in (1.0, -1.0):
        moved = parameters.copy()
        moved[place] += side * step
        rows.append(_core.simulate_drive_train(moved, *UNLIMITED, SIX, quadrants, *run)[AS_OUTPUTS])
    return (rows[0] - rows[1]) / (2.0 * step)


WINDUP = {
    "straight through": {"maximum_rack": 18.0},
    "smoke limiter": {"smoke_margin": 1.0, "turbocharger_lag": 0.5},
    "weak governor": {"maximum_rack": 14.5, "Kp_abs": 2.0, "Ki_abs": 2.0},
    "sliding": {"maximum_rack": 14.5, "Kp_abs": 1.0, "Ki_abs": 12.0},
    "lower limit": {"minimum_rack": 10.0, "Ki_abs": 6.0},
}


@pytest.mark.parametrize("case", WINDUP)
def test_breakage_b2_derivatives_know_when_the_integral_begins_to_wait(case):
    dt, samples = 0.001, 6000
    sign = -1.0 if case == "lower limit" else 1.0
    n_set = N_E * (1.0 + sign * 0.1 * ((np.arange(samples) > 300) & (np.arange(samples) < 3000)))
    parameters = vector(anti_windup=1.0, **WINDUP[case])
    run = (n_set, dt, 16, "zero")
    names = ("inertia", "A1", "Kp_abs", "Ki_abs", "torque_coefficient")
    _, slopes = _core.drive_train_sensitivities(
        parameters, *UNLIMITED, SIX, NO_QUADRANTS, *run, ALL_OUTPUTS, along(*names)
    )
    # The integral must have waited at all.
    winding = parameters.copy()
    winding[NAMES.index("anti_windup")] = 0.0
    error = [
        _core.simulate_drive_train(q, *UNLIMITED, SIX, NO_QUADRANTS, *run)[6] for q in (parameters, winding)
    ]
    assert np.abs(error[0] - error[1]).max() > 1e-3
    for name, found in zip(names, slopes, strict=True):
        # A narrow difference suffers from switching at the same step on both sides, a wide one from curvature.
        differences = [central(parameters, run, name, share) for share in (1e-2, 3e-3, 1e-3)]
        for output in (0, 5):
            # After the last switching; while it lasts both sides of the difference stand at different places.
            off = [
                np.abs(found[output, 4500:] - expected[output, 4500:]).max() / np.abs(expected[output]).max()
                for expected in differences
            ]
            assert min(off) < 0.01, (name, output, off)


@pytest.mark.study
def test_breakage_b3_an_arrival_late_in_a_record_ends_its_step():
    # 102 million steps; the same in no time is tested in Rust, at the step where a search for its end had none.
    parameters = vector(set_dead_time=0.1 / 3.0)
    n_set = np.full(102_450, N_E)
    rows = _core.simulate_drive_train(parameters, *UNLIMITED, SIX, NO_QUADRANTS, n_set, 0.0025, 1000, "zero")
    assert np.isfinite(rows).all()


def test_breakage_b3_steps_too_short_to_have_times_are_refused():
    for kernel in (
        lambda run: _core.simulate_drive_train(vector(), *UNLIMITED, SIX, NO_QUADRANTS, *run),
        lambda run: _core.drive_train_sensitivities(
            vector(), *UNLIMITED, SIX, NO_QUADRANTS, *run, [0], along("A1")
        ),
    ):
        for substeps in (10**12, 2**63, 2**64 - 1):
            with pytest.raises(InputError, match=r"substeps is \d+: found steps of .* use fewer substeps"):
                kernel((np.full(3, N_E), 0.01, substeps, "zero"))


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
        values, slopes = _core.drive_train_sensitivities(
            parameters, *UNLIMITED, SIX, NO_QUADRANTS, n_set, 0.01, 1, "zero", [0], along("Kp_abs")
        )
        assert np.isfinite(slopes).all()
        np.testing.assert_allclose(values, N_E, rtol=1e-3)


@pytest.mark.parametrize("exponent", [1.0, 1.7, 2.0, 2.4])
def test_breakage_b6_from_rest_in_four_quadrants_there_are_sensitivities(exponent):
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
    run = (n_set, 0.01, 4, "zero")
    names = ("inertia", "torque_coefficient", "Kp_abs", "ship_mass")
    values, slopes = _core.drive_train_sensitivities(
        parameters, *UNLIMITED, SIX, quadrants, *run, ALL_OUTPUTS, along(*names)
    )
    assert np.isfinite(values).all()
    for name, found in zip(names, slopes, strict=True):
        expected = central(parameters, run, name, 1e-4, quadrants)
        np.testing.assert_allclose(found[0], expected[0], atol=1e-3 * np.abs(expected[0]).max())
