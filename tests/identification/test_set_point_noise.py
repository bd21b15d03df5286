"""Noise of the set point: left out where the outputs do not follow it, kept where they do."""

import numpy as np
import pytest
from scipy.signal import butter, chirp, lfilter

from shipfp_rs import Experiment, Structure, identify
from shipfp_rs.identification.chooser import CANDIDATES

RATE_HZ, SECONDS, NOISE = 50.0, 240.0, 3e-4
TRUTH = {"tau_n": 0.8, "g": -0.3, "vK_p": 8.0, "vK_i": 20.0, "p": 2.0}
STATES = {"initial dn": 0.0, "initial fuel": 0.0, "set point scale": 0.0, "torque scale": 0.0}


def logged(followed, level=NOISE, water=0.0):
    """A trial whose set point is logged with noise that the governor follows, or with the logger's own.

    `water` is the standard deviation of a load that moves slowly.
    """
    t = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ
    random = np.random.default_rng(7)
    sent = 0.05 * chirp(t, 0.02, SECONDS, 3.0, method="logarithmic", phi=-90.0)
    noise = level * random.standard_normal(len(t))
    point = {"n_set": 1000.0, "n_e": 1000.0, "M_b": 500.0}
    driving = sent + noise if followed else sent
    moving = lfilter(*butter(2, 0.3, fs=RATE_HZ), random.standard_normal(len(t)))
    load = 1.0 + water * moving / moving.std()
    made = Experiment(
        "made",
        RATE_HZ,
        {"n_set": 1000.0 * (1.0 + driving), "M_load": load},
        operating_point={**point, "M_load": 1.0},
    )
    ship = Structure.ship(["load"], torque="brake", products=True)
    dn, dM = ship.equations.simulate(TRUTH | STATES | {"k_L": 1.0}, made)
    own = random.standard_normal((2, len(t)))
    signals = {
        "n_set": 1000.0 * (1.0 + sent + noise),
        "n_e": 1000.0 * (1.0 + dn + 0.7 * level * own[0]),
        "M_b": 500.0 * (1.0 + dM + 3.0 * level * own[1]),
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


@pytest.mark.parametrize("followed", [False, True])
def test_water_a_hundred_times_as_strong_does_not_hide_which_it_is(followed):
    off = dict.fromkeys((*CANDIDATES, "late_torque"), False)
    found = identify(logged(followed, level=3e-5, water=0.02), elements=off)
    assert found.settings["set_point_noise"] == ("taken for signal" if followed else "left out")
