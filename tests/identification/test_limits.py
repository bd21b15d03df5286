"""A limit that acts shows in what the smooth model leaves, before any is fitted."""

from dataclasses import replace

import numpy as np
import pytest

from shipfp_rs.identification.limits import falls_by_limits
from shipfp_rs.identification.question import question_of
from shipfp_rs.identification.ship_fit import smooth_ship
from shipfp_rs.identification.trials import LEAST_FALL
from tests.identification.parity import Case, simulated


def falls(own):
    _, clean = simulated(Case(own=own, seconds=120.0, gauge=False))
    random = np.random.default_rng(7)
    noisy = {
        name: row + (0.0 if name == "n_set" else 1.0) * random.standard_normal(len(row))
        for name, row in clean.signals.items()
    }
    question = question_of([replace(clean, signals=noisy)], torque="brake")
    return falls_by_limits(smooth_ship(question))


def test_a_smooth_ship_shows_no_limit():
    found = falls({})
    assert found["torque_limit"] < LEAST_FALL["torque_limit"]
    assert found["rack_rate"] < LEAST_FALL["rack_rate"]


@pytest.mark.parametrize(
    ("own", "element"),
    [
        ({"M_max": 1.12, "M_soft": 0.003}, "torque_limit"),
        ({"rate": 0.5, "rate_down": 0.5}, "rack_rate"),
    ],
)
def test_a_limit_that_acts_is_shown(own, element):
    assert falls(own)[element] > 2.0 * LEAST_FALL[element]
