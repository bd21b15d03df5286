"""The kernel of the engine's side: its twin, what it must keep, a known answer by the ship's stepper, what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from tests.twins import engine_side
from tests.twins.engine_side import GOVERNOR, OFF
from tests.twins.ship import vector as ship

EVERY = 0.02


def signals(seed: int = 1, count: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return smooth deviations of set point, speed and torque."""
    t = np.arange(count) * EVERY
    phase = np.random.default_rng(seed).uniform(0.0, 6.28, (3, 4))
    sizes = np.array([0.03, 0.025, 0.15])[:, None]
    rows = [
        np.sin(2.0 * np.pi * hz * t + phase[:, place : place + 1])
        for place, hz in enumerate((0.1, 0.27, 0.6, 1.1))
    ]
    return tuple(np.ascontiguousarray(row) for row in sizes * np.sum(rows, axis=0) / 4.0)


def taken(q: dict[str, float], rows: tuple[np.ndarray, ...], every: float = EVERY) -> np.ndarray:
    return np.array(_core.taken_by_limits(engine_side.vector(**q), *rows, every))


@pytest.mark.parametrize(
    "changes",
    [
        {"M_max": 1.03, "M_soft": 5e-3, "T_d": 0.07, "T_set": 0.11},
        {"rate_down": 0.1},
        {"rate": 0.3, "rate_down": 0.15, "tau_act": 0.05},
        {"rate": 0.2, "rate_down": 0.2, "tau_act": 0.1, "T_d": 0.033, "T_s": 0.033},
        {"rate": 0.3, "M_max": 1.02, "tau_act": 0.05, "u_0": 1e-3, "s_M": 1.01, "T_M": 0.013, "T_n": 0.004},
        {"M_max": 1.03, "ahead": 0.4, "leads": 0.3},
        {"rate": 0.3, "tau_act": 0.05, "T_d": 0.03, "T_f": 0.07},
        {"rate": 0.3, "tau_act": 0.05, "M_max": 1.02, "tau_eng": 0.1},
        {"rate": 0.3, "tau_act": 0.05, "M_max": 1.03, "droop": 0.05},
    ],
)
def test_the_twin_finds_the_same(changes: dict[str, float]) -> None:
    q, rows = OFF | GOVERNOR | changes, signals()
    found, expected = taken(q, rows), engine_side.taken_by_limits(q, *rows, EVERY)
    assert np.abs(expected[0]).max() > 0.01
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected[0]).max())


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 1000), st.floats(0.0, 0.3), st.floats(0.0, 0.2), st.floats(1.01, 1.5))
def test_nothing_is_taken_where_no_limit_is_reached_and_never_added(
    seed: int, dead: float, lag: float, most: float
) -> None:
    rows, q = signals(seed), OFF | GOVERNOR | {"T_d": dead, "tau_act": lag}
    assert np.abs(taken(q, rows)).max() < 1e-12
    torque, rack = taken(q | {"M_max": most}, rows)
    assert torque.max() <= 1e-12
    assert np.abs(rack).max() < 1e-12


@pytest.mark.parametrize(
    ("limit", "inside"),
    [
        ({"M_max": 1.05}, {"M_max": 1.05}),
        ({"rate": 0.08, "rate_down": 0.05}, {"rate_up": 0.08, "rate_down": 0.05}),
    ],
)
def test_known_answer_of_a_ship_in_its_limit(limit: dict[str, float], inside: dict[str, float]) -> None:
    t = np.arange(8000) * 0.005
    u = 1.0 + 0.03 * np.sin(2.0 * np.pi * 0.05 * t * (1.0 + 0.04 * t))
    known = {"v": 1.0, "g": -0.6, "K_p": 4.0, "K_i": 5.0, "T_d": 0.06, "tau_act": 0.08} | inside
    outputs = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dM_b", "dE")]
    speed, torque, total = _core.simulate_ship(ship(**known), u, np.empty(0), 0.005, 0, "first", outputs)
    found, _ = taken(OFF | GOVERNOR | {"T_d": 0.06, "tau_act": 0.08} | limit, (u - 1.0, speed, torque), 0.005)
    # What the governor asks for, behind dead time and lag, is known from the simulation's own sum.
    asked = np.interp(t - 0.06, t, 4.0 * (u - 1.0 - speed) + 5.0 * total)
    fuel = np.empty_like(asked)
    fuel[0] = asked[0]
    stays = np.exp(-0.005 / 0.08)
    for k in range(1, len(t)):
        fuel[k] = fuel[k - 1] * stays + 0.5 * (asked[k] + asked[k - 1]) * (1.0 - stays)
    expected = torque + 0.6 * speed - fuel
    assert np.abs(expected).max() > 0.02
    assert np.abs(found - expected)[400:].max() < 0.02 * np.abs(expected).max()


def test_what_is_refused() -> None:
    u, n, m = signals()
    q = OFF | GOVERNOR
    with pytest.raises(InputError, match="different lengths"):
        taken(q, (u[:-1], n, m))
    with pytest.raises(InputError, match="not finite"):
        taken(q, (u, np.where(n > 0.01, np.nan, n), m))
    for name in ("rate", "rate_down"):
        with pytest.raises(InputError, match="expected them above"):
            taken(q | {name: 0.0}, (u, n, m))
    with pytest.raises(InputError, match="parameters"):
        _core.taken_by_limits(np.zeros(3), u, n, m, EVERY)
