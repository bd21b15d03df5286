"""Derivatives of the whole drive train against central differences of the kernel that only simulates."""

import math

import numpy as np
import pytest

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from shipfp_rs.support.fir import PASSBAND, taps
from tests.kernels.test_drive_train_kernel import ELEMENTS, FIRING, QUADRANTS, SIX, UNEQUAL
from tests.kernels.test_plant_kernel import SEVEN_POINTS, wander
from tests.twins.drive_train import NO_QUADRANTS, vector
from tests.twins.plant import N_E, UNLIMITED

NAMES = _core.DRIVE_TRAIN_PARAMETERS
ROWS = ("n_e", "n_s", "M_b", "M_g", "M_s", "X_f", "E_n", "ship")
AS_OUTPUTS = [ROWS.index(name) for name in _core.GREY_BOX_OUTPUTS]
COUNTS = ("governor_period", "anti_windup", "firing_interval", "firing_width", "blades")
EVERYWHERE = (
    *("inertia", "gear_ratio", "transmission_efficiency", "A1", "A2", "A3", "torque_coefficient"),
    *("torque_exponent", "X_0", "Kp_abs", "Ki_abs", "propeller_inertia", "initial_speed", "initial_error"),
)


def sensitivities(parameters, envelope, strength, quadrants, n_set, names, hold="first", substeps=4):
    """Outputs (O, N) and derivatives (W, O, N)."""
    directions = np.array([[float(name == wanted) for name in NAMES] for wanted in names])
    run = (n_set, 0.02, substeps, hold, list(range(6)))
    found = [
        _core.drive_train_sensitivities(parameters, *envelope, strength, quadrants, *run, part)
        for part in np.array_split(directions, -(-len(names) // 24))
    ]
    return found[0][0], np.concatenate([slopes for _, slopes in found])


def differences(parameters, envelope, strength, quadrants, n_set, names, hold="first", substeps=4):
    """Central differences of what `simulate_drive_train` gives, with four steps, (4, W, O, N).

    A short step suffers from rounding, a long one from curvature and from what changes its order on the way.
    """

    def simulated(name, change):
        moved = parameters.copy()
        moved[NAMES.index(name)] += change
        return _core.simulate_drive_train(moved, *envelope, strength, quadrants, n_set, 0.02, substeps, hold)[
            AS_OUTPUTS
        ]

    def size(name):
        return max(abs(parameters[NAMES.index(name)]), 100.0 if name == "A3" else 0.1)

    return np.array(
        [
            [
                (simulated(name, h) - simulated(name, -h)) / (2.0 * h)
                for name in names
                for h in [share * size(name)]
            ]
            for share in (1e-4, 1e-5, 1e-6, 1e-7)
        ]
    )


def off(found, expected):
    """Largest distance from the nearest of the differences, over the derivative's own size, (W, O).

    What is a millionth of the others counts as that.
    """
    size = np.abs(expected[0]).max(axis=-1)
    size = np.maximum(size, 1e-6 * size.max(axis=0))
    return (np.abs(found - expected).max(axis=-1) / np.maximum(size, np.finfo(float).tiny)).min(axis=0)


def own(changes):
    """Parameters of the elements that a case switches on, of those that are differentiated by."""
    beside = {"fuel_lag": (), "Kd_abs": ("derivative_filter",), "smoke_margin": ("turbocharger_lag",)}
    named = [name for name in changes if name not in COUNTS and name not in EVERYWHERE]
    return [*named, *(more for name in named for more in beside.get(name, ()))]


SMOOTH = [
    *("dead time of the set point", "dead time of the fuel", "both dead times and a lag"),
    *("sampled governor", "sampled governor and dead times", "PID", "sampled PID", "drag", "flexible shaft"),
    *("ripple", "moving ship"),
]
"""Elements that neither jump nor bend within these runs."""


@pytest.mark.parametrize("element", SMOOTH)
def test_derivatives_are_those_of_central_differences(element):
    changes, _, strength, quadrants = ELEMENTS[element]
    # Dead times of no whole number of steps: where a sample arrives with a step, the two sides differ.
    changes = changes | {name: changes[name] + 0.0012 for name in changes if name.endswith("dead_time")}
    parameters = vector(**changes)
    names = [*EVERYWHERE, *own(changes)]
    case = (parameters, UNLIMITED, strength, quadrants, wander(120, scale=0.1), names)
    values, slopes = sensitivities(*case)
    plain = _core.simulate_drive_train(*case[:1], *UNLIMITED, *case[2:5], 0.02, 4, "first")[AS_OUTPUTS]
    # With the late set point alone, sample intervals are cut into equal steps, not steps into unequal ones.
    close = 1e-6 if element == "dead time of the set point" else 1e-12
    np.testing.assert_allclose(values, plain, rtol=close, atol=close)
    assert off(slopes, differences(*case)).max() < 1e-6


def test_limits_and_a_swinging_shaft_in_firing_are_differentiated_on_the_side_they_are_on():
    changes = {
        **FIRING,
        "torque_exponent": 2.17,
        "torque_coefficient": 8.7,
        "smoke_margin": 1.0,
        "turbocharger_lag": 0.5,
        "maximum_rack": 15.0,
        "minimum_rack": 9.0,
        "fuel_lag": 0.03,
        "rack_rate": 25.0,
        "torque_rate": 600.0,
        "shaft_stiffness": 2e4,
        "shaft_damping": 30.0,
        "drag_coefficient": 2.0,
        "blade_ripple": 0.05,
    }
    names = [*EVERYWHERE, *own(changes)]
    case = (vector(**changes), SEVEN_POINTS, UNEQUAL, NO_QUADRANTS, wander(120, scale=0.1), names)
    _, slopes = sensitivities(*case)
    # A difference straddles bends that move: where a limit takes hold, or a firing changes places with a step.
    assert off(slopes, differences(*case)).max() < 1e-4


def test_a_jump_that_arrives_later_moves_what_follows_it():
    n_set = np.where(np.arange(150) % 50 < 25, N_E, 1.03 * N_E)
    speed = [_core.GREY_BOX_OUTPUTS.index(name) for name in ("n_e", "n_s")]  # what else jumps with it
    # Of no whole number of steps; and whole ones, where the difference sees a jump on either side of a step's end.
    for late, close in (((0.133, 0.0513), 1e-6), ((0.12, 0.05), 2e-2)):
        changes = dict(zip(("set_dead_time", "fuel_dead_time"), late, strict=True))
        case = (vector(**changes), UNLIMITED, SIX, NO_QUADRANTS, n_set, [*changes, "inertia"], "zero")
        found, expected = sensitivities(*case)[1][:, speed], differences(*case)[:, :, speed]
        assert off(found, expected).max() < close


def low_passed(rows, band_hz, rate_hz):
    """Rows (..., N) below a frequency, without the ends that the filter does not fill."""
    filter_ = taps(band_hz / rate_hz / PASSBAND, 0.0)
    return np.apply_along_axis(np.convolve, -1, rows, filter_, mode="valid")


@pytest.mark.parametrize("late", [{}, {"fuel_dead_time": 0.0533, "fuel_lag": 0.02}])
def test_a_governor_once_a_firing_moves_its_samples_with_the_crankshaft(late):
    """Its samples come where the crankshaft says, which every parameter moves; their motion counts below 2 Hz.

    Derivatives are exact as long as the order of firings, steps and arrivals stays: to 1e-7 for what moves the
    crankshaft little. Over a change of the order the difference quotient has an error of its own, a part of its step.
    Without a lag the rack jumps at each firing, and a row of its samples has no derivative.
    """
    changes = {**FIRING, "governor_period": math.inf, **late, "set_dead_time": 0.0521}
    little = ["inertia", "Kp_abs", "Ki_abs", "set_dead_time", *(["fuel_lag"] if late else [])]
    names = [*little, "A1", "A2", "torque_exponent", "gear_ratio", *(["fuel_dead_time"] if late else [])]
    time = 0.02 * np.arange(600)
    n_set = N_E * (1.0 + 0.03 * np.sin(2.0 * np.pi * (0.1 + 0.06 * time) * time))
    case = (vector(**changes), UNLIMITED, UNEQUAL, NO_QUADRANTS, n_set, names)
    rows = [_core.GREY_BOX_OUTPUTS.index(name) for name in ("n_e", "n_s", "M_b", "M_g", "E_n")]
    found = low_passed(sensitivities(*case, substeps=12)[1][:, rows], 2.0, 50.0)
    expected = low_passed(differences(*case, substeps=12)[:, :, rows], 2.0, 50.0)
    by_name = dict(zip(names, off(found, expected).max(axis=1).tolist(), strict=True))
    print(by_name)
    assert max(by_name[name] for name in little) < 1e-6
    assert max(by_name.values()) < 3e-3


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("governor_period", "governor_period is 1, expected 0 always"),
        ("fuel_lag", "fuel_lag is 1, expected 0 where the parameter is 0"),
        ("shaft_stiffness", "expected 0 where the parameter is inf"),
    ],
)
def test_what_has_no_derivative_is_named(name, message):
    with pytest.raises(InputError, match=message):
        sensitivities(vector(), UNLIMITED, SIX, NO_QUADRANTS, wander(10), [name])


def test_a_ship_in_four_quadrants_is_differentiated_too():
    changes = {"ship_mass": 8e3, "inflow": 0.9, "initial_ship_speed": 0.5}
    # A straight piece of the curves about the angle of the flow.
    wide = np.ascontiguousarray(QUADRANTS[:, [0, 2, 4, 6, 8]])
    names = [
        *EVERYWHERE,
        "ship_mass",
        "inflow",
        "thrust_coefficient",
        "ship_resistance",
        "initial_ship_speed",
    ]
    case = (vector(**changes), UNLIMITED, SIX, wide, wander(120, scale=0.1), names)
    _, slopes = sensitivities(*case)
    assert off(slopes, differences(*case)).max() < 1e-6
