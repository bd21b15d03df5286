"""A governor that samples: its sum of rectangles, the ripple of its own stairs, steps that it takes late."""

from dataclasses import replace

import numpy as np

import shipfp_rs as fp
from tests.identification.parity import BETWEEN_S, Case, simulated

NAMES = ("tau_n", "g", "vK_p", "vK_i", "p", "T_d", "T_set")


def recorded(own, excitation, seed=1, *, gauge=False, quiet=1.0):
    """Truth in the words of the fit, and a record with white noise of speed and torque."""
    truth, clean = simulated(Case(own=own, excitation=excitation, gauge=gauge))
    random = np.random.default_rng(seed)
    levels = {"n_set": 0.0, "n_e": 0.2, "M_b": 1.0, "M_g": 1.0}
    signals = {
        name: row + quiet * levels[name] * random.standard_normal(len(row))
        for name, row in clean.signals.items()
    }
    return truth, replace(clean, signals=signals, provenance={"filter": "as of parity"})


def test_steps_that_keep_the_clocks_time_bias_no_gain():
    own = {"T_s": 0.04, "T_0": 0.02 + BETWEEN_S, "T_d": 0.02, "T_set": 0.1, "vK_p": 4.2, "vK_i": 20.0}
    truth, experiment = recorded(own, "steps", quiet=0.1)
    found = fp.identify(experiment)
    for name in NAMES:
        low, high = found.parameters[name].ci95
        assert low <= truth[name] <= high, name


def test_a_soft_shaft_of_a_small_ship_biases_no_load():
    own = {"tau_n": 0.38, "tau_prop": 0.08, "vK_p": 0.8, "vK_i": 8.0, "tau_act": 0.18, "T_d": 0.02}
    truth, experiment = recorded(own | {"tau_twist": 0.0142, "zeta_twist": 0.35}, "chirp")
    side = fp.load_side(experiment)
    low, high = side.parameters["tau_n"].ci95
    assert low <= truth["tau_n"] <= high
