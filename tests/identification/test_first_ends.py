"""The first fit: a long lag of the actuator is not taken for a dead time, nor a dead time for a lag."""

import numpy as np
import pytest
from scipy.signal import chirp

from shipfp_rs import Experiment, Structure
from shipfp_rs.identification.automatic import chooser_of
from shipfp_rs.identification.first_ends import with_lag

RATE_HZ, SECONDS = 50.0, 200.0
LOOP = {"tau_n": 0.5, "g": 0.0, "vK_p": 3.0, "vK_i": 9.0, "p": 1.9, "T_set": 0.3}
STATES = {"initial dn": 0.0, "initial fuel": 0.0, "set point scale": 0.0, "torque scale": 0.0}


def trial(elements, **more):
    t = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ
    asked = 0.05 * chirp(t, 0.02, SECONDS, 3.0, method="logarithmic", phi=-90.0)
    point = {"n_set": 1000.0, "n_e": 1000.0, "M_b": 500.0}
    made = Experiment("made", RATE_HZ, {"n_set": 1000.0 * (1.0 + asked)}, operating_point=point)
    ship = Structure.ship(elements, torque="brake", products=True)
    outputs = ship.equations.simulate(LOOP | more | STATES, made)
    noise = np.random.default_rng(3).standard_normal(outputs.shape) * [[2e-4], [5e-4]]
    dn, dM = outputs + noise
    signals = {**made.signals, "n_e": 1000.0 * (1.0 + dn), "M_b": 500.0 * (1.0 + dM)}
    return Experiment("made", RATE_HZ, signals, operating_point=point)


def first(experiment):
    narrow = {"fixed": {}, "prior": {}}
    return chooser_of([experiment], torque=None, outputs=None, elements={}, narrow=narrow, search={}).first()


@pytest.mark.parametrize(
    ("element", "parameter"),
    [("actuator_lag", "tau_act"), ("dead_time_loop", "T_d")],
    ids=["lag", "dead time"],
)
def test_the_first_fit_has_the_delay_that_acts(element, parameter):
    found = first(trial(["dead_time_set_point", element], **{parameter: 0.12}))
    assert set(found.elements) == {"dead_time_set_point", element}
    values = found.search.values(found.minimum.vector)
    assert values[parameter] == pytest.approx(0.12, abs=0.004)
    assert values["vK_p"] == pytest.approx(3.0, rel=0.03)


def test_starts_with_a_lag_have_it_in_place_of_the_dead_time_in_the_loop():
    long, none = with_lag([{"T_d": 0.2, "T_set": 0.1}, {"T_set": 0.4}])
    assert long == {"T_set": 0.1, "tau_act": 0.2}
    assert none == {"T_set": 0.4, "tau_act": 0.03}
