"""Every kernel with every instruction set: what is the same bits with all of them, and how far the rest may be apart.

The other tests of the kernels use the widest set alone.
"""

import functools
import os

import numpy as np
import pytest

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from tests.kernels import test_two_equations_kernel as two_equations
from tests.kernels.test_plant_kernel import ENVELOPES, METHODS
from tests.kernels.test_ship_kernel import SHIPS, record
from tests.twins import engine_side, ship
from tests.twins.drive_train import detail
from tests.twins.plant import N_E

WIDEST = os.environ.get("SHIPFP_INSTRUCTION_SET")
FOUND = _core._instruction_sets()
SETS = FOUND if WIDEST is None else FOUND[: FOUND.index(WIDEST) + 1]
RATE_HZ = 100.0
RNG = np.random.default_rng(1205)
SAMPLES = 5000
DN_SET = 0.01 * np.cumsum(RNG.normal(size=SAMPLES)) / np.sqrt(SAMPLES)
TRAIN = (
    ship.vector(T_d=0.0413, T_set=0.0111, tau_act=0.05, tau_twist=0.004, zeta_twist=0.3),
    detail(interval=1.0 / 3.0, margin=0.5, drag=0.01, drag_exponent=1.3, bollard=0.99, blade_ripple=0.01),
    *(np.ones(6), np.empty((3, 0))),
)

SHIP = (
    ship.vector(T_d=0.0413, T_set=0.0111, tau_act=0.05, M_max=1.03, load_gain=0.3),
    *(1.0 + DN_SET, DN_SET, 1.0 / RATE_HZ, 2, "first"),
)


def recursion(states, directions):
    """Outputs and derivatives of any recursion that decays."""
    random = np.random.default_rng(states)
    system = random.normal(size=(1 + directions, states + 3, states + 4)) / (4.0 * np.sqrt(states))
    start = random.normal(size=(1 + directions, states))
    return flat(_core.run_recursion(system, start, DN_SET, [-7, -1, 0, 1], 1.0 / RATE_HZ))


def tacho():
    """A train of pulses with noise, a stop and a gap."""
    wave = 2.5 + 2.0 * np.sin(2.0 * np.pi * np.arange(20_000) / 23.7) + 0.05 * RNG_OF_TRAIN
    wave[9000:9700] = 0.4
    wave[15_000:15_010] = np.nan
    return wave


RNG_OF_TRAIN = np.random.default_rng(804).normal(size=20_000)
TACHO = tacho()


def flat(parts):
    """All numbers that a kernel returns, in one row."""
    if isinstance(parts, tuple | list):
        return np.concatenate([flat(part) for part in parts])
    return np.zeros(0) if parts is None else np.ravel(parts)


def tracked():
    kernel = _core.PulseTracker()
    found = []
    for window in (TACHO[:7001], TACHO[7001:]):
        kernel.look(window)
        found.append(kernel.cross(window))
    return flat([*found, _core.PulseTracker().follow(TACHO, 4096), kernel.gaps])


def speeds():
    times = np.cumsum(1.0 + 0.01 * RNG_OF_TRAIN[:4000])
    four, one = np.full(4, 0.25), np.array([0.3])
    return flat(
        _core.interval_speeds(times, np.ones(3999, dtype=np.int64), four, 0.01 * four, one, 0.1 * one, 0.1)
    )


def of_ship(name, compute):
    """What a call of a ship with some elements gives, with both holds."""
    u, load = record(200)
    return flat([compute(ship.vector(**SHIPS[name]), u, load, 0.05, 3, hold) for hold in ("first", "zero")])


def ship_by(method, envelope):
    speeds_at, torques = ENVELOPES[envelope]
    start, limit = np.array([1.0, 0.0]), np.array([speeds_at / N_E, torques / torques.max(initial=1.0) * 1.2])
    return _core.simulate_ship_by(
        ship.vector(), 1.0 + 0.2 * DN_SET, 0.01, 2, method, "first", start, [0, 1, 2, 3, 4], limit
    )


EXACT = {
    "taken_by_limits": lambda: np.array(
        _core.taken_by_limits(
            engine_side.vector(T_d=0.04, M_max=1.01, rate=0.1, rate_down=0.08),
            DN_SET,
            0.9 * DN_SET,
            DN_SET,
            0.01,
        )
    ),
    "loop_is_stable": lambda: np.array([float(_core.loop_is_stable(EQUATIONS[0], False))]),
    "PulseTracker": tracked,
    "pulse_levels": lambda: _core.pulse_levels(TACHO),
    "pulses_are_even": lambda: _core.pulses_are_even(np.cumsum(1.0 + 0.01 * RNG_OF_TRAIN), 0.9, 1.1),
    "interval_speeds": speeds,
    "simulate_detailed_ship": lambda: _core.simulate_detailed_ship(
        *TRAIN, 1.0 + DN_SET, 0.01, 2, "first", [0, 1, 2, 3, 4]
    ),
    "simulate_ship_by": lambda: _core.simulate_ship_by(
        ship.vector(), 1.0 + DN_SET, 0.01, 2, "heun", "first", np.array([1.0, 0.0]), [0, 1, 2, 3, 4]
    ),
    **{
        f"simulate_ship_by: {method}, {envelope}": functools.partial(ship_by, method, envelope)
        for method in METHODS
        for envelope in ENVELOPES
    },
    "simulate_ship": lambda: _core.simulate_ship(*SHIP, [0, 1, 2, 3, 4]),
    **{
        f"simulate_ship: {name}": functools.partial(
            of_ship, name, lambda *common: _core.simulate_ship(*common, [0, 1, 2, 3, 4])
        )
        for name in SHIPS
    },
}
"""The same bits on every machine: calls by the kernel's name, and what is special about them."""

FUSED = {
    "run_recursion": functools.partial(recursion, 2, 7),
    "run_recursion: values alone": functools.partial(recursion, 8, 0),
    "run_recursion: two passes": functools.partial(recursion, 8, 10),
}
"""The same bits wherever multiply-adds are fused, within rounding of them elsewhere."""

EQUATIONS = two_equations.arguments(two_equations.SHIP, two_equations.record(count=128), [0, 1])
ROUNDED = {
    "equation_residuals": lambda: _core.equation_residuals(*EQUATIONS, two_equations.MOVING),
    "equation_products": lambda: np.concatenate(
        _core.equation_products(*EQUATIONS, two_equations.MOVING, *two_equations.noise(2, 128))
    ),
}
"""Within rounding: delays turn by the width of a vector at a time, and sums have a part for each lane."""


def test_every_kernel_is_compared():
    kernels = {name for name in dir(_core) if not name.startswith("_") and callable(getattr(_core, name))}
    assert {name.partition(":")[0] for name in EXACT | FUSED | ROUNDED} == kernels


def results(compute):
    """What each instruction set gives."""
    found = {}
    try:
        for name in SETS:
            _core._set_instruction_set(name)
            found[name] = np.asarray(compute())
    finally:
        _core._set_instruction_set(WIDEST)
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


@pytest.mark.parametrize("kernel", [*FUSED, *ROUNDED])
def test_breakage_b7_without_fused_multiply_adds_results_are_within_rounding(kernel):
    scalar, *others = results((FUSED | ROUNDED)[kernel]).values()
    # A record's rounding adds up over its samples: in units of the last place of the largest value.
    bound = 2000.0 * np.finfo(float).eps * np.abs(scalar).max()
    for other in others:
        assert np.abs(other - scalar).max() <= bound


@pytest.mark.skipif(len(SETS) < 2, reason="a machine with one instruction set")
def test_breakage_b7_the_choice_is_followed():
    found = results(FUSED["run_recursion"])
    assert not np.array_equal(found["scalar"], found[SETS[-1]])


def test_breakage_b7_a_set_that_there_is_not_is_named():
    with pytest.raises(InputError, match=r"instruction set is 'sse9', expected one of \[.scalar."):
        _core._set_instruction_set("sse9")
