"""Ships with a torque limit in even steps, beside the passes that locate every event."""

import numpy as np
import pytest

from shipfp_rs import _core

from ..twins.ship import vector

NAMES, OUTPUTS = _core.SHIP_PARAMETERS, _core.SHIP_OUTPUTS
DT = 0.02
SHIPS = {
    "limit": {},
    "dead times": {"T_d": 0.0473, "T_set": 0.0311},
    "a dead time below a step": {"T_d": 0.0031, "T_set": 0.0311},
    "lag": {"tau_act": 0.05, "T_d": 0.0473},
    "a short lag": {"tau_act": 0.002, "T_d": 0.0473},
    "both limits": {"M_min": 0.93, "M_max_slope": 0.4, "T_d": 0.0473},
    "twist": {"tau_twist": 0.003, "zeta_twist": 0.5, "tau_prop": 0.3, "T_d": 0.0473},
    "load": {"load_gain": 0.7, "damping": 0.2, "T_d": 0.0473},
    "late channels": {"T_n": 0.0111, "T_M": 0.0313, "s_M": 1.02, "T_d": 0.0473},
}


def arguments(ship, samples=1500):
    """The ship with its torque limited above, and a set point and a load that make it reach the limit often."""
    t = np.arange(samples) * DT
    u = 1.0 + 0.03 * np.sin(2.0 * np.pi * 0.4 * t) + 0.02 * np.sin(2.0 * np.pi * 1.1 * t)
    load = 0.05 * np.sin(2.0 * np.pi * 0.15 * t) if "load" in ship else np.zeros(0)
    outputs = [OUTPUTS.index(name) for name in ("dn", "dM_b", "dM_g")]
    return vector(**{"M_max": 1.06, **SHIPS[ship]}), u, load, DT, 0, "first", outputs


@pytest.mark.parametrize("ship", SHIPS)
def test_even_steps_are_right_to_far_below_the_noise(ship):
    exact = _core.simulate_ship(*arguments(ship))
    even = _core.simulate_ship(*arguments(ship), sharp=False)
    assert np.abs(even - exact).max() > 0.0  # another way
    assert (np.sqrt(np.mean((even - exact) ** 2, axis=1)) < 1e-3 * exact.std(axis=1)).all()
    brake = exact[1]
    limited = np.isclose(brake, brake.max(), atol=1e-6) | np.isclose(brake, brake.min(), atol=1e-6)
    assert limited.mean() > 0.05


@pytest.mark.parametrize("ship", SHIPS)
def test_derivatives_of_even_steps_are_those_of_the_steps(ship):
    parameters, *rest = arguments(ship)
    names = ["tau_n", "g", "K_p", "K_i", "p", "M_max", "initial_N", "s_u"]
    names += [name for name in SHIPS[ship] if name in NAMES]
    wrt = [NAMES.index(name) for name in names]
    values, slopes = _core.ship_sensitivities(parameters, *rest, wrt, sharp=False)
    assert np.array_equal(values, _core.simulate_ship(parameters, *rest, sharp=False))
    for place, slope in zip(wrt, slopes, strict=True):
        h = 1e-6 * max(abs(parameters[place]), 0.01)
        ends = []
        for sign in (-1.0, 1.0):
            moved = parameters.copy()
            moved[place] += sign * h
            ends.append(_core.simulate_ship(moved, *rest, sharp=False))
        difference = (ends[1] - ends[0]) / (2.0 * h)
        size = np.maximum(np.sqrt(np.mean(difference**2, axis=1)), 1e-9)
        # A stage of a step may pass the limit within the difference.
        assert (np.median(np.abs(slope - difference), axis=1) < 1e-4 * size).all(), NAMES[place]
        assert (np.sqrt(np.mean((slope - difference) ** 2, axis=1)) < 0.05 * size).all(), NAMES[place]


def test_blocks_of_samples_join():
    parameters, *rest = arguments("late channels", 3000)
    far = _core.simulate_ship(parameters, *rest, sharp=False)
    parameters, *rest = arguments("late channels", 1100)
    near = _core.simulate_ship(parameters, *rest, sharp=False)
    np.testing.assert_array_equal(far[:, :1090], near[:, :1090])
