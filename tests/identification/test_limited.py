"""A torque limit beside moving water: what it cuts off of the water is taken from the records."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from shipfp_rs import Experiment, Structure
from shipfp_rs.identification.chooser import Chooser
from shipfp_rs.identification.fitted import Fitted
from shipfp_rs.identification.limited import beyond_limit

RATE_HZ, SECONDS = 50.0, 240.0
TRUTH = {"tau_n": 1.2, "g": -0.4, "vK_p": 3.0, "vK_i": 5.0, "p": 2.1, "M_max": 1.12}
STATES = {"initial dn": 0.0, "initial fuel": 0.0, "set point scale": 0.0, "torque scale": 0.0}
SHARE = 0.012


def trial(water_share=SHARE, seed=5):
    """A trial with the torque at its limit for some of the time, its load moved by water."""
    t = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ
    random = np.random.default_rng(seed)
    asked = 0.05 * np.sin(2.0 * np.pi * 0.05 * t) + 0.02 * np.sin(2.0 * np.pi * 0.31 * t)
    water = lfilter(*butter(2, 0.3, fs=RATE_HZ), random.standard_normal(len(t)))
    water *= water_share / water.std()
    point = {"n_set": 1000.0, "n_e": 1000.0, "M_b": 500.0, "M_load": 1.0}
    made = Experiment(
        "made", RATE_HZ, {"n_set": 1000.0 * (1.0 + asked), "M_load": 1.0 + water}, operating_point=point
    )
    ship = Structure.ship(["torque_limit", "load"], torque="brake", products=True)
    dn, dM = ship.equations.simulate({**TRUTH, **STATES, "k_L": 1.0}, made)
    noise = random.standard_normal((2, len(t)))
    signals = {
        "n_set": made.signals["n_set"],
        "n_e": 1000.0 * (1.0 + dn + 1e-4 * noise[0]),
        "M_b": 500.0 * (1.0 + dM + 5e-4 * noise[1]),
    }
    del point["M_load"]
    return Experiment("made", RATE_HZ, signals, operating_point=point)


def fitted(clears):
    chooser = Chooser([trial()], torque="brake", outputs=("dn", "dM"), forced=["torque_limit"])
    chooser.band_limited = False
    search = chooser.search(("torque_limit",))
    values = TRUTH | STATES
    first = search.refine(search.minimise(np.array([values[name] for name in search.unknowns])))
    chooser.clears_limits = clears
    found = chooser.refined(Fitted(("torque_limit",), search, first))
    return found.search.values(found.minimum.vector)


def test_the_limit_is_found_too_low_beside_water_and_right_when_that_is_taken_off():
    plain, cleared = fitted(False), fitted(True)
    assert plain["M_max"] < TRUTH["M_max"] - 2e-3
    assert cleared["M_max"] == pytest.approx(TRUTH["M_max"], abs=0.4 * (TRUTH["M_max"] - plain["M_max"]))
    assert abs(cleared["p"] - TRUTH["p"]) < max(0.7 * abs(plain["p"] - TRUTH["p"]), 0.02)


def test_without_water_little_is_taken_off():
    experiment = trial(water_share=0.0)
    measured = {"dn": experiment.normalised("n_e"), "dM": experiment.normalised("M_b")}
    equations = Structure.ship(["torque_limit"], torque="brake", products=True).equations
    beyond = beyond_limit(
        equations, TRUTH | STATES, experiment, measured, experiment.dn_set, band_limited=False
    )
    assert beyond.shape == (2, len(experiment))
    assert beyond.std(axis=1) == pytest.approx([0.0, 0.0], abs=2e-3)


def test_a_ship_without_a_limit_has_nothing_taken_off():
    experiment = trial()
    equations = Structure.ship([], torque="brake", products=True).equations
    values = {name: value for name, value in (TRUTH | STATES).items() if name != "M_max"}
    measured = {"dn": experiment.normalised("n_e"), "dM": experiment.normalised("M_b")}
    beyond = beyond_limit(equations, values, experiment, measured, experiment.dn_set, band_limited=False)
    assert not beyond.any()
    held = replace(experiment, hold="zero")
    assert not beyond_limit(equations, TRUTH | STATES, held, measured, held.dn_set, band_limited=False).any()
