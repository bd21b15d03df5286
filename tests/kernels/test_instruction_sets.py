"""Which results are the same bits with every instruction set, and how far the others may be apart."""

import numpy as np
import pytest

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from tests.twins import ship
from tests.twins.drive_train import detail
from tests.twins.plant import N_E

SETS = _core._instruction_sets()
RATE_HZ = 100.0
RNG = np.random.default_rng(1205)
SAMPLES = 5000
DN_SET = 0.01 * np.cumsum(RNG.normal(size=SAMPLES)) / np.sqrt(SAMPLES)
N_SET = N_E * (1.0 + DN_SET)
LINEAR = np.array([1.5, -0.583, 1.583, 10.0, 1.0, 2.0, 0.6, 0.04, 0.013])
COMMON = (DN_SET, 1.0 / RATE_HZ, "first", np.array([0.01, 0.0]))
WRT = [0, 1, 2, 3, 4, 5, 7, 8, 9, 10]
TRAIN = (
    ship.vector(T_d=0.0413, T_set=0.0111, tau_act=0.05, tau_twist=0.004, zeta_twist=0.3),
    detail(interval=1.0 / 3.0, margin=0.5, drag=0.01, drag_exponent=1.3, bollard=0.99, blade_ripple=0.01),
    *(np.ones(6), np.empty((3, 0))),
)
EDGES = np.cumsum(RNG.uniform(0.01, 0.02, size=400))
CUBICS = RNG.normal(size=(4, len(EDGES) - 1))

SHIP = (
    ship.vector(T_d=0.0413, T_set=0.0111, tau_act=0.05, M_max=1.03, load_gain=0.3),
    *(1.0 + DN_SET, DN_SET, 1.0 / RATE_HZ, 2, "first"),
)
SHIP_WRT = [0, 1, 2, 3, 4, 6, 8, 9, 12]


def without_dead_time():
    parameters = LINEAR.copy()
    parameters[7:] = 0.0
    return parameters


def decimated():
    taps = np.hanning(201)
    decimator = _core.Decimator(taps, 2, 3)
    return np.concatenate([decimator.feed(N_SET), decimator.finish(SAMPLES * 2 // 3)])


def repeats():
    scan = _core.RepeatScan()
    once = N_SET.astype(np.float32)
    scan.feed(np.concatenate([once, once[1000:]]))
    return scan.candidates()


EXACT = {
    "decimator": decimated,
    "repeats": repeats,
    "slopes of a spline": lambda: _core.slope_at_even_times(EDGES, CUBICS, 0.0, 1000.0, 8000)[1],
    "spikes": lambda: _core.find_spikes(N_SET, 20, 7, 51, 6.0, 1e-6),
    "running median": lambda: _core.running_median(N_SET, 31),
    "whole drive train": lambda: _core.simulate_detailed_ship(
        *TRAIN, 1.0 + DN_SET, 0.01, 2, "first", [0, 1, 2, 3, 4]
    ),
    "ship by Heun": lambda: _core.simulate_ship_by(
        ship.vector(), 1.0 + DN_SET, 0.01, 2, "heun", "first", np.array([1.0, 0.0]), [0, 1, 2, 3, 4]
    ),
    "ship": lambda: _core.simulate_ship(*SHIP, [0, 1, 2, 3, 4]),
    "frequency response": lambda: _core.linear_response(LINEAR, np.linspace(0.0, 20.0, 99), [0, 2]),
    "state space": lambda: _core.simulate_statespace(
        np.array([[-2.0, 1.0], [-1.0, -0.5]]), np.ones(2), np.eye(2), np.zeros(2), *COMMON
    ),
}
"""The same bits on every machine."""

FUSED = {
    "linear sensitivities": lambda: np.concatenate(
        [part.ravel() for part in _core.linear_sensitivities(LINEAR, *COMMON, [0, 1, 2, 3, 4], WRT)]
    ),
    "linear sensitivities without a dead time": lambda: np.concatenate(
        [
            part.ravel()
            for part in _core.linear_sensitivities(without_dead_time(), *COMMON, [0, 2], [0, 1, 3, 4])
        ]
    ),
    "sensitivities of the ship": lambda: _core.ship_sensitivities(*SHIP, [0, 2, 3], SHIP_WRT)[1],
    "ship as a record shows it": lambda: _core.ship_observed(
        *SHIP, 1, [0, 2], SHIP_WRT, np.zeros((SAMPLES, 2), dtype=bool), np.full(9, 0.1), 2
    ),
}
"""The same bits wherever multiply-adds are fused, within rounding of them elsewhere."""


def results(compute):
    """What each instruction set gives."""
    found = {}
    try:
        for name in SETS:
            _core._set_instruction_set(name)
            found[name] = np.asarray(compute())
    finally:
        _core._set_instruction_set(None)
    return found


@pytest.mark.parametrize("kernel", EXACT)
def test_breakage_b7_the_same_bits_on_every_machine(kernel):
    first, *others = results(EXACT[kernel]).values()
    assert first.size > 0
    for other in others:
        np.testing.assert_array_equal(other, first)


@pytest.mark.parametrize("kernel", FUSED)
def test_breakage_b7_the_same_bits_wherever_multiply_adds_are_fused(kernel):
    found = results(FUSED[kernel])
    fused = [values for name, values in found.items() if name != "scalar"]
    for other in fused[1:]:
        np.testing.assert_array_equal(other, fused[0])


@pytest.mark.parametrize("kernel", FUSED)
def test_breakage_b7_without_fused_multiply_adds_results_are_within_rounding(kernel):
    scalar, *others = results(FUSED[kernel]).values()
    # A record's rounding adds up over its samples: in units of the last place of the largest value.
    bound = 2000.0 * np.finfo(float).eps * np.abs(scalar).max()
    for other in others:
        assert np.abs(other - scalar).max() <= bound


@pytest.mark.skipif(len(SETS) < 2, reason="a machine with one instruction set")
def test_breakage_b7_the_choice_is_followed():
    found = results(FUSED["linear sensitivities"])
    assert not np.array_equal(found["scalar"], found[SETS[-1]])


def test_breakage_b7_a_set_that_there_is_not_is_named():
    with pytest.raises(InputError, match=r"instruction set is 'sse9', expected one of \[.scalar."):
        _core._set_instruction_set("sse9")
