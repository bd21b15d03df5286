"""The plant with derivatives against a complex step through its NumPy twin, the other kernels, and its own sums."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from tests.kernels.test_plant_kernel import ENVELOPES, SEVEN_POINTS, assert_close, wander
from tests.twins import drive_train, plant
from tests.twins import sensitivity as twin
from tests.twins.drive_train import NO_QUADRANTS
from tests.twins.plant import M_B, N_E, UNLIMITED
from tests.twins.sensitivity import vector

NAMES = _core.DRIVE_TRAIN_PARAMETERS
SIX = np.ones(6)
PLANT = (
    *_core.PLANT_PARAMETERS,
    "propeller_inertia",
    "limit_factor",
    "rack_rate",
    "torque_rate",
    "set_dead_time",
    "initial_speed",
    "initial_error",
)
"""Parameters of the plant with rate limits and a late set point."""
ALL_OUTPUTS = list(range(len(_core.GREY_BOX_OUTPUTS)))
ELEMENTS = {
    "nothing": {},
    "exponent": {"torque_exponent": 2.17, "torque_coefficient": 8.7},
    "rates": {"rack_rate": 6.0, "torque_rate": 120.0},
    "dead time": {"set_dead_time": 0.0337},
    "whole dead time": {"set_dead_time": 0.04},
    "all": {
        "torque_exponent": 2.17,
        "torque_coefficient": 8.7,
        "rack_rate": 6.0,
        "torque_rate": 120.0,
        "set_dead_time": 0.0137,
        "minimum_torque": 150.0,
        "limit_factor": 1.1,
    },
}


def unit(*names):
    """Directions along parameters, shape (W, P)."""
    return np.array([[float(name == wanted) for name in NAMES] for wanted in names]).reshape(-1, len(NAMES))


def along_all(parameters):
    """Directions along every parameter that is not infinite, and a dead time that is not a whole number of samples."""
    smooth = np.isfinite(parameters)
    at = NAMES.index("set_dead_time")
    smooth[at] = round(parameters[at] / 0.02, 9) % 1.0 != 0.0
    return unit(*(name for name, take in zip(NAMES, smooth, strict=True) if take and name in PLANT))


def run(parameters, envelope, n_set, directions, dt=0.02, substeps=1, hold="first", outputs=ALL_OUTPUTS):
    return _core.drive_train_sensitivities(
        parameters,
        *envelope,
        SIX,
        NO_QUADRANTS,
        n_set,
        dt,
        substeps,
        hold,
        outputs,
        np.asarray(directions, dtype=float),
    )


def assert_slopes_close(found, expected, tolerance):
    """Equal to a part of each derivative's own size; one a millionth of the others counts as that."""
    size = np.abs(expected).max(axis=-1, keepdims=True)
    floor = 1e-6 * np.abs(expected).max(initial=0.0)
    assert (np.abs(found - expected) <= tolerance * np.maximum(size, floor)).all()


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("envelope", ["unlimited", "seven points"])
@pytest.mark.parametrize("element", ELEMENTS)
def test_derivatives_are_those_of_a_complex_step_through_the_equations(element, envelope, hold):
    n_set = wander(30)
    parameters = vector(**ELEMENTS[element], initial_error=0.1, set_point_before=n_set[0])
    directions = along_all(parameters)
    values, slopes = run(parameters, ENVELOPES[envelope], n_set, directions, substeps=2, hold=hold)
    expected = twin.sensitivities(
        parameters, *ENVELOPES[envelope], n_set, 0.02, 2, hold, ALL_OUTPUTS, directions=directions
    )
    # Dead times of whole samples are made longer by 1e-9 of one.
    assert_close(values, expected[0], 1e-7 if element == "whole dead time" else 1e-12)
    assert_slopes_close(slopes, expected[1], 1e-6 if element == "whole dead time" else 1e-9)


@settings(max_examples=15)
@given(
    factors=st.lists(st.floats(0.7, 1.4), min_size=11, max_size=11),
    exponent=st.floats(1.3, 2.9),
    limit=st.floats(1.05, 1.6),
    whole=st.integers(0, 4),
    part=st.floats(0.05, 0.95),
    rates=st.sampled_from([(math.inf, math.inf), (math.inf, 150.0), (5.0, math.inf), (5.0, 150.0)]),
    seed=st.integers(0, 2**32 - 1),
)
def test_derivatives_hold_for_any_ship(factors, exponent, limit, whole, part, rates, seed):
    parameters = vector(
        torque_exponent=exponent,
        torque_coefficient=635.8 / (N_E / 3.0) ** exponent,
        set_dead_time=0.02 * (whole + part),
        rack_rate=rates[0],
        torque_rate=rates[1],
        minimum_torque=0.5 * M_B,
    )
    for name, factor in zip(
        ("inertia", "A1", "A2", "Kp_abs", "Ki_abs", "X_0", "torque_coefficient", "limit_factor"),
        factors,
        strict=False,
    ):
        parameters[NAMES.index(name)] *= factor
    directions = np.random.default_rng(seed).normal(size=(9, len(NAMES))) * np.where(
        np.isfinite(parameters) & np.isin(NAMES, PLANT), np.maximum(np.abs(parameters), 0.1), 0.0
    )
    directions[:, ~np.isfinite(parameters)] = 0.0
    envelope = (SEVEN_POINTS[0], SEVEN_POINTS[1] * limit)
    n_set = wander(40, seed=seed)
    values, slopes = run(parameters, envelope, n_set, directions)
    expected = twin.sensitivities(
        parameters, *envelope, n_set, 0.02, 1, "first", ALL_OUTPUTS, directions=directions
    )
    assert_close(values, expected[0], 1e-10)
    assert_slopes_close(slopes, expected[1], 1e-6)


def test_without_elements_it_is_the_plant():
    values, _ = run(vector(initial_error=0.3), SEVEN_POINTS, wander(500), unit())
    expected = _core.simulate_plant(
        plant.vector(), *SEVEN_POINTS, wander(500), 0.02, 1, "rk4", "first", np.array([N_E / 3.0, 0.3])
    )
    assert_close(values[[1, 5, 4, 2]], expected)


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize(
    ("elements", "envelope"),
    [({"rack_rate": 6.0, "torque_rate": 120.0}, SEVEN_POINTS), ({"set_dead_time": 0.0337}, UNLIMITED)],
)
def test_with_elements_it_is_the_whole_drive_train(elements, envelope, hold):
    n_set = np.concatenate([np.full(5, N_E), wander(300)])
    values, _ = run(vector(**elements), envelope, n_set, unit(), substeps=4, hold=hold)
    whole = drive_train.vector(
        **elements, propeller_inertia=8.0, initial_speed=N_E / 3.0, set_point_before=N_E
    )
    expected = _core.simulate_drive_train(
        whole, *envelope, np.ones(6), drive_train.NO_QUADRANTS, n_set, 0.02, 4, hold
    )
    # The whole one does not cut the pieces of a sample interval into steps of one length.
    assert_close(values, expected[[0, 1, 2, 3, 5, 6]], 1e-6 if "set_dead_time" in elements else 1e-12)


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("dead_time", [0.0, 0.04])
def test_at_whole_samples_the_derivative_by_the_dead_time_is_that_of_a_later_arrival(hold, dead_time):
    at, later = (
        vector(set_dead_time=dead_time + 1e-7 * side, rack_rate=6.0, torque_rate=120.0) for side in (0, 1)
    )
    n_set = wander(100)
    values, slopes = run(at, UNLIMITED, n_set, unit("set_dead_time"), hold=hold)
    difference = (run(later, UNLIMITED, n_set, unit(), hold=hold)[0] - values) / 1e-7
    # Where a jump arrives with the sample, rack and torque jump too: there is no derivative of these.
    for output in ("n_e", "n_s", "E_n"):
        row = _core.GREY_BOX_OUTPUTS.index(output)
        size = np.abs(difference[row]).max()
        np.testing.assert_allclose(slopes[0, row], difference[row], atol=1e-3 * size)


@pytest.mark.parametrize("taps", [1, 9])
def test_the_sums_are_those_of_residuals_and_sensitivities(taps):
    random = np.random.default_rng(3)
    parameters, n_set = vector(**ELEMENTS["all"]), wander(1000)
    directions = along_all(parameters)[:13]
    outputs, scale, offsets = [0, 2], np.array([1.0 / N_E, 1.0 / M_B]), np.array([-1.0, -0.9])
    values, slopes = run(parameters, SEVEN_POINTS, n_set, directions, outputs=outputs)
    measured = values * scale[:, None] + offsets[:, None] + 0.01 * random.normal(size=values.shape)
    measured[0, 100:103] = np.nan
    measured[1, 700] = np.nan
    filters = np.concatenate([np.ones((2, 1)), 0.3 * random.normal(size=(2, taps - 1))], axis=1)
    sums, count = _core.drive_train_products(
        parameters,
        *SEVEN_POINTS,
        SIX,
        NO_QUADRANTS,
        n_set,
        0.02,
        1,
        "first",
        outputs,
        directions,
        scale,
        measured,
        offsets,
        filters,
    )
    columns = np.concatenate(
        [
            slopes * scale[:, None],
            np.ones((1, *values.shape)),
            (measured - values * scale[:, None] - offsets[:, None])[None],
        ]
    ).transpose(1, 0, 2)
    rows = np.array(
        [lfilter(tap, [1.0], np.nan_to_num(c), axis=1) for tap, c in zip(filters, columns, strict=True)]
    )
    reach = np.convolve(~np.isfinite(measured).all(axis=0), np.ones(taps))[: n_set.size]
    valid = (reach == 0) & (np.arange(n_set.size) >= taps - 1)
    # An offset is filtered as if it had always been there.
    rows[:, -2] = filters.sum(axis=1)[:, None]
    expected = np.einsum("ian,jbn->iajb", rows[..., valid], rows[..., valid])
    assert count == valid.sum()
    size = np.sqrt(np.einsum("iaia->ia", expected))
    np.testing.assert_allclose(sums, expected, atol=1e-10 * (size[:, :, None, None] * size).max(), rtol=1e-8)


@pytest.mark.parametrize(
    ("parameters", "directions", "message"),
    [
        (vector(rack_rate=-1.0), unit(), "rack_rate is -1"),
        (vector(set_dead_time=-0.1), unit(), "set_dead_time is -0.1"),
        (vector(inertia=0.0), unit(), "inertia is 0"),
        (vector(), unit("torque_rate"), "expected 0 where the parameter is inf"),
        (vector()[:-1], unit(), "45 values, expected 46"),
        (vector(), np.ones((2, 3)), r"expected \[2, 46\]"),
        (vector(), np.zeros((40, 46)), "expected up to"),
    ],
)
def test_what_makes_no_sense_is_named(parameters, directions, message):
    with pytest.raises(InputError, match=message):
        run(parameters, UNLIMITED, wander(10), directions)


@pytest.mark.parametrize("outputs", [[], [6]])
def test_outputs_that_there_are_not_are_named(outputs):
    with pytest.raises(InputError, match="outputs"):
        run(vector(), UNLIMITED, wander(10), unit(), outputs=outputs)


def test_a_run_that_leaves_the_numbers_says_when():
    with pytest.raises(SimulationError, match="diverged at sample"):
        run(vector(A1=-1e200), UNLIMITED, wander(100), unit("A1"))
