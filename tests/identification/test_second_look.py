"""The data's own starts once more, with the elements that were found meanwhile."""

from dataclasses import replace

import numpy as np
import pytest

from shipfp_rs import Experiment, Structure
from shipfp_rs.identification.chooser import Chooser
from shipfp_rs.identification.fitted import Fitted, cost
from shipfp_rs.identification.second_look import second_look
from shipfp_rs.identification.start_vector import start_vector
from shipfp_rs.identification.starts import starts

RATE_HZ, SECONDS = 50.0, 120.0
TRUTH = {
    "tau_n": 0.33,
    "g": -0.5,
    "vK_p": 2.33,
    "vK_i": 28.8,
    "p": 0.986,
    "tau_prop": 0.147,
    "T_d": 0.024,
    "T_set": 0.482,
    "tau_twist": 0.0117,
    "zeta_twist": 0.58,
}
STATES = {"initial dn": 0.0, "initial fuel": 0.0, "set point scale": 0.0, "torque scale": 0.0}
ELEMENTS = ("dead_time_loop", "dead_time_set_point", "twist")


def trial(seed=5):
    """A light shaft that swings at 5 Hz behind a loop of 1.5 Hz: without the twist all starts lead to a late loop."""
    t = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ
    random = np.random.default_rng(seed)
    tones = ((0.02, 0.06), (0.02, 0.17), (0.015, 0.41), (0.01, 0.93), (0.006, 1.7))
    asked = sum(size * np.sin(2.0 * np.pi * f * t + k) for k, (size, f) in enumerate(tones))
    asked *= np.clip((t - 10.0) / 2.0, 0.0, 1.0)
    point = {"n_set": 1000.0, "n_e": 1000.0, "M_b": 500.0}
    made = Experiment("made", RATE_HZ, {"n_set": 1000.0 * (1.0 + asked)}, operating_point=point)
    ship = Structure.ship(ELEMENTS, torque="brake", products=True)
    dn, dM = ship.equations.simulate(TRUTH | STATES, made)
    noise = random.standard_normal((2, len(t)))
    signals = {
        "n_set": made.signals["n_set"],
        "n_e": 1000.0 * (1.0 + dn + 1e-4 * noise[0]),
        "M_b": 500.0 * (1.0 + dM + 5e-4 * noise[1]),
    }
    return Experiment("made", RATE_HZ, signals, operating_point=point)


def fitted(elements):
    """A chooser with the data's own starts, and the fit that leads there from a loop that is late."""
    chooser = Chooser([trial()], torque="brake", outputs=("dn", "dM"))
    chooser.band_limited = False
    search = replace(chooser.search(elements), enough=0.02)
    chooser.begins = starts(search.structure, chooser.experiments)
    late = TRUTH | {"T_d": 0.14, "T_set": 0.36, "vK_i": 1.0, "g": 0.9, "T_M": 0.002}
    end = replace(search, noise="white", max_evaluations=25).minimise(start_vector(search, late))
    return chooser, chooser.refined(Fitted(elements, search, end))


def test_a_twist_is_found_in_place_of_a_late_torque_that_no_start_of_its_own_helps():
    chooser, late = fitted(("dead_time_loop", "dead_time_set_point", "late_torque"))
    alone = second_look(chooser, late)
    assert abs(alone.search.values(alone.minimum.vector)["T_set"] - TRUTH["T_set"]) > 0.02
    found = second_look(chooser, late, [ELEMENTS])
    assert found.elements == ELEMENTS
    assert cost(found) < cost(late) - 100.0
    assert found.search.values(found.minimum.vector)["T_set"] == pytest.approx(TRUTH["T_set"], abs=0.02)
    # Where nothing is better the fit itself comes back.
    assert second_look(chooser, found) is found
