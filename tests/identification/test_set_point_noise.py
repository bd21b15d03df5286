"""Noise of the set point: left out where the outputs do not follow it, kept where they do."""

import numpy as np
import pytest
from scipy.signal import chirp

from shipfp_rs import Experiment, Structure, identify
from shipfp_rs.identification.chooser import CANDIDATES

RATE_HZ, SECONDS, NOISE = 50.0, 240.0, 3e-4
TRUTH = {"tau_n": 0.8, "g": -0.3, "vK_p": 8.0, "vK_i": 20.0, "p": 2.0}
STATES = {"initial dn": 0.0, "initial fuel": 0.0, "set point scale": 0.0, "torque scale": 0.0}


def logged(followed):
    """A trial whose set point is logged with noise that the governor follows, or with the logger's own."""
    t = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ
    random = np.random.default_rng(7)
    sent = 0.05 * chirp(t, 0.02, SECONDS, 3.0, method="logarithmic", phi=-90.0)
    noise = NOISE * random.standard_normal(len(t))
    point = {"n_set": 1000.0, "n_e": 1000.0, "M_b": 500.0}
    driving = sent + noise if followed else sent
    made = Experiment("made", RATE_HZ, {"n_set": 1000.0 * (1.0 + driving)}, operating_point=point)
    ship = Structure.ship([], torque="brake", products=True)
    dn, dM = ship.equations.simulate(TRUTH | STATES, made)
    own = random.standard_normal((2, len(t)))
    signals = {
        "n_set": 1000.0 * (1.0 + sent + noise),
        "n_e": 1000.0 * (1.0 + dn + 2e-4 * own[0]),
        "M_b": 500.0 * (1.0 + dM + 1e-3 * own[1]),
    }
    return Experiment("made", RATE_HZ, signals, operating_point=point)


@pytest.mark.parametrize("followed", [False, True])
def test_noise_is_left_out_only_where_the_outputs_do_not_follow_it(followed):
    off = dict.fromkeys((*CANDIDATES, "late_torque"), False)
    found = identify(logged(followed), elements=off)
    assert found.settings["set_point_noise"] == ("taken for signal" if followed else "left out")
    for name, true in TRUTH.items():
        low, high = found[name].ci95
        slack = 0.5 * (high - low)
        assert low - slack <= true <= high + slack, name
