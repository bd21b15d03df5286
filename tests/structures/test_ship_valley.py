"""The ship's valley: where a step of its parameters leads that the outputs hardly see."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shipfp_rs import Structure

NAMES = ("tau_n", "g", "vK_p", "vK_i", "p", "tau_prop", "T_d", "initial fuel")
VALUES = np.array([1.2, -0.5, 4.5, 10.0, 2.15, 0.38, 0.07, 0.02])
SHIP = Structure.ship(["dead_time_loop"], torque="gauge").equations
FINITE = st.floats(-1.0, 1.0)


@given(st.lists(FINITE, min_size=len(NAMES), max_size=len(NAMES)))
def test_to_first_order_it_is_the_sum(direction):
    step = 1e-6 * np.array(direction) * np.abs(VALUES)
    led = SHIP.curved(NAMES, VALUES, step)
    np.testing.assert_allclose(led, VALUES + step, atol=1e-10)


@given(st.floats(-0.4, 2.0))
def test_an_inertia_that_is_held_takes_its_step(part):
    step = 0.05 * VALUES
    step[0] = part * VALUES[0]
    led = SHIP.curved(NAMES, VALUES, step, 0)
    assert led[0] == pytest.approx((1.0 + part) * VALUES[0], rel=1e-12)


@pytest.mark.parametrize("held", ["g", "vK_p", "vK_i"])
@given(st.floats(-0.3, 0.3))
def test_what_else_is_held_is_met_by_the_others(held, part):
    step = 0.01 * VALUES
    place = NAMES.index(held)
    step[place] = part * abs(VALUES[place])
    led = SHIP.curved(NAMES, VALUES, step, place)
    # Straight in 1 / tau_n: the value is met up to what p moves along.
    assert led[place] == pytest.approx(VALUES[place] + step[place], abs=0.05 * abs(VALUES[place]))


def test_ratios_stay_where_a_step_goes_along_the_valley():
    step = np.zeros(len(NAMES))
    for name in ("tau_n", "vK_p", "vK_i", "initial fuel"):
        step[NAMES.index(name)] = 0.5 * VALUES[NAMES.index(name)]
    # p - g grows as the others do.
    step[NAMES.index("g")] = -0.5 * (VALUES[NAMES.index("p")] - VALUES[NAMES.index("g")])
    led = dict(zip(NAMES, SHIP.curved(NAMES, VALUES, step), strict=True))
    for name in ("vK_p", "vK_i"):
        assert led[name] / led["tau_n"] == pytest.approx(VALUES[NAMES.index(name)] / VALUES[0], rel=1e-12)
    assert (led["p"] - led["g"]) / led["tau_n"] == pytest.approx((2.15 + 0.5) / 1.2, rel=1e-12)


def test_without_all_of_them_free_it_is_the_sum():
    names = ("tau_n", "vK_p", "p")
    values, step = np.array([1.2, 4.5, 2.15]), np.array([0.6, 1.0, 0.1])
    np.testing.assert_array_equal(SHIP.curved(names, values, step), values + step)
