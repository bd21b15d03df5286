"""What decays over a long record becomes zero, not a subnormal number, with which processors compute many times slower."""

from types import SimpleNamespace

import numpy as np
import pytest

from shipfp_rs import _core
from shipfp_rs.structures.state_space import LinearEquations
from tests.twins import ship
from tests.twins.drive_train import detail

RATE_HZ = 200.0
FAST = {"tau_n": 0.03, "g": -0.583, "v": 1.583, "K_p": 1.0, "K_i": 50.0, "p": 2.0}
"""A loop whose slowest pole decays at 23 per second: below the normal numbers after 31 s."""


def assert_normal(values):
    """No number but zero is smaller than the normal ones."""
    sizes = np.abs(values[values != 0.0])
    assert sizes.size > 0
    assert sizes.min() >= np.finfo(float).tiny


@pytest.mark.parametrize("dead_time", [0.0, 0.004])
@pytest.mark.parametrize("moves", [True, False])
def test_breakage_b1_derivatives_by_the_initial_state_of_the_linear_structure(dead_time, moves):
    samples = round(400.0 * RATE_HZ)
    time = np.arange(samples) / RATE_HZ
    dn_set = 0.01 * np.sin(time) if moves else 0.01 * (time < 0.5)
    values, slopes = LinearEquations(("dn", "dM"), gauge=False).sensitivities(
        FAST | {"T_d": dead_time, "initial dn": 0.01},
        SimpleNamespace(dn_set=dn_set, rate_hz=RATE_HZ, hold="first"),
        ["tau_n", "K_p", "initial dn", "initial dE"],
    )
    assert_normal(values)
    assert_normal(slopes)
    # What is cut is next to nothing: the first second is as it was.
    assert np.abs(slopes[2, 0, :200]).max() == pytest.approx(1.0)


ELEMENTS = {
    "nothing": {},
    "lag": {"tau_act": 0.005},
    "sampled governor": {"T_s": 0.005},
    "flexible shaft": {"tau_twist": 0.004, "zeta_twist": 0.3},
}


@pytest.mark.parametrize("element", ELEMENTS)
def test_breakage_b1_a_start_off_the_point_of_the_drive_train(element):
    # A fiftieth of the launch's inertia, and an integral gain that leaves no slow pole.
    fast = {"tau_n": 0.03, "tau_prop": 0.007, "K_p": 1.0, "K_i": 50.0, "initial_N": 1.001}
    u = 1.0 + 0.01 * np.sin(np.arange(20_000) / RATE_HZ)
    rows = _core.simulate_detailed_ship(
        ship.vector(**fast | ELEMENTS[element]),
        *(detail(margin=1.0), np.ones(6), np.empty((3, 0))),
        *(u, 1.0 / RATE_HZ, 2, "first", [0, 1, 2, 3, 4]),
    )
    assert_normal(rows)
