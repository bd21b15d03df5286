"""Ships with torque limits where a millionth of a step does not count, beside the sharp passes."""

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
    "a limit with a slope": {"M_max_slope": 0.4, "T_d": 0.0473},
    "both limits": {"M_min": 0.93, "T_d": 0.0473},
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


def rms(signal):
    return np.sqrt(np.mean(signal**2, axis=-1))


@pytest.mark.parametrize("ship", SHIPS)
def test_rough_passes_and_their_derivatives_are_right_to_far_below_the_noise(ship):
    parameters, *rest = arguments(ship)
    names = ["tau_n", "g", "K_p", "K_i", "p", "M_max", "initial_N", "s_u"]
    wrt = [NAMES.index(name) for name in (*names, *SHIPS[ship]) if name in NAMES]
    values, slopes = _core.ship_sensitivities(parameters, *rest, wrt, sharp=False)
    assert np.array_equal(values, _core.simulate_ship(parameters, *rest, sharp=False))
    sharp, sharp_slopes = _core.ship_sensitivities(parameters, *rest, wrt)
    assert (rms(values - sharp) < 2e-4 * sharp.std(axis=1)).all()
    # A lag of a tenth of a sample is a dead time here, but for its second order.
    bound = np.where(np.array([NAMES[place] for place in wrt]) == "tau_act", 0.03, 2e-3)[:, None]
    assert (rms(slopes - sharp_slopes) <= bound * rms(sharp_slopes)).all()
    line = parameters[NAMES.index("M_max")] - 1.0 + parameters[NAMES.index("M_max_slope")] * sharp[0]
    assert (np.abs(sharp[1] - line) < 1e-6).mean() > 0.05 or "s_M" in SHIPS[ship]


def test_blocks_of_samples_join():
    parameters, *rest = arguments("late channels", 3000)
    far = _core.simulate_ship(parameters, *rest, sharp=False)
    parameters, *rest = arguments("late channels", 1100)
    near = _core.simulate_ship(parameters, *rest, sharp=False)
    np.testing.assert_array_equal(far[:, :1090], near[:, :1090])
