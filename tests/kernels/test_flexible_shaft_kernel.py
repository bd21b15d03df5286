"""The ship with a flexible shaft and no switch: against a slow exact twin, the path of switches, and a rigid shaft."""

import functools
import math

import numpy as np
import pytest

from shipfp_rs import _core

from ..twins import ship_events as twin
from ..twins.ship import OFF, SMOOTH, vector
from .test_ship_kernel import NO_LOAD, OUTPUTS, SPEED_AND_GAUGE, by_size, inputs_of, places, wander

DT = 1.0 / 48.0
ALL = list(range(len(OUTPUTS)))
SHAFTS = [(4.0, 0.01), (7.0, 2.0), (10.0, 0.3), (20.0, 0.05)]
"""Resonances [Hz] and dampings of a flexible shaft."""
SMALL = {"tau_n": 1.2, "g": -0.5, "K_p": 4.5, "K_i": 5.0, "p": 2.15, "tau_prop": 0.4}
FLEXIBLE = {
    "nothing": {},
    "both dead times": {"T_d": 0.0473, "T_set": 0.0311},
    "a dead time below a sample": {"T_d": 0.0131, "T_set": 0.0331},
    "lag": {"tau_act": 0.05},
    "lag and dead times": {"tau_act": 0.05, "T_d": 0.0473, "T_set": 0.0311},
    "derivative gain": {"K_d": 0.05},
    "load": {"load_gain": 0.7, "T_d": 0.0473, "T_set": 0.0311, "damping": 0.3},
    "not at rest, late channels": {
        "initial_N": 0.95,
        "initial_F": -0.02,
        "T_n": 0.0111,
        "T_M": 0.0313,
        "s_M": 1.02,
        "s_u": 0.99,
        "T_d": 0.0473,
        "T_set": 0.0031,
    },
}
"""What acts beside a flexible shaft."""


def flexible(frequency, zeta, **changes):
    """Parameters of a ship whose shaft swings at a frequency [Hz]."""
    values = SMALL | changes
    engine, propeller = values["tau_n"] - values["tau_prop"], values["tau_prop"]
    give = (1.0 / engine + 1.0 / propeller) / (2.0 * math.pi * frequency) ** 2
    return OFF | values | {"tau_twist": give, "zeta_twist": zeta}


def acting(values):
    """Names of the parameters that a derivative is compared by: those that act, and no time that begins."""
    names = [*SMOOTH, "tau_twist", "zeta_twist"]
    begins = ("K_d", "T_d", "T_set", "tau_act", "T_n", "T_M", "load_gain")
    return [name for name in names if values[name] != 0.0 or name not in begins]


@functools.cache
def solution(ship, shaft, hold):
    """The twin's signals."""
    u, load = inputs_of(ship, 24)
    return twin.simulate(flexible(*shaft, **FLEXIBLE[ship]), u, load, DT, hold, OUTPUTS)


@functools.cache
def differences(ship, shaft, hold, name):
    """Central differences of the twin along a parameter."""
    values, (u, load) = flexible(*shaft, **FLEXIBLE[ship]), inputs_of(ship, 10)
    step = 2e-2 * max(abs(values[name]), 0.5)
    if name in ("tau_n", "tau_prop", "tau_twist"):
        # Along these the swing's phase moves, to the record's end by a few hundredths of a radian.
        step = 0.05 / shaft[0] * values[name]
    elif name.startswith("T_") or name == "tau_act":
        step = 1e-4

    def moved(by):
        return twin.simulate(values | {name: values[name] + by}, u, load, DT, hold, OUTPUTS)

    near, far = moved(step) - moved(-step), moved(2.0 * step) - moved(-2.0 * step)
    return (8.0 * near - far) / (12.0 * step)


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("shaft", SHAFTS)
@pytest.mark.parametrize("ship", FLEXIBLE)
def test_a_flexible_shaft_swings_as_the_equations_say(ship, shaft, hold):
    ship_vector = vector(**flexible(*shaft, **FLEXIBLE[ship]))
    u, load = inputs_of(ship, 24)
    found = _core.simulate_ship(ship_vector, u, load, DT, 0, hold, ALL)
    assert by_size(found, solution(ship, shaft, hold)) < 1e-7


@pytest.mark.parametrize(
    ("ship", "shaft", "hold"),
    [
        ("nothing", (20.0, 0.05), "first"),
        ("nothing", (10.0, 0.3), "zero"),
        ("both dead times", (10.0, 0.3), "first"),
        ("lag and dead times", (4.0, 0.01), "zero"),
        ("lag", (20.0, 0.05), "first"),
        ("load", (7.0, 2.0), "first"),
        ("not at rest, late channels", (10.0, 0.01), "zero"),
    ],
)
def test_derivatives_of_a_flexible_shaft_are_those_of_the_solution(ship, shaft, hold):
    values = flexible(*shaft, **FLEXIBLE[ship])
    u, load = inputs_of(ship, 10)
    names = acting(values)
    _, found = _core.ship_sensitivities(vector(**values), u, load, DT, 0, hold, ALL, places(*names))
    for name, slopes in zip(names, found, strict=True):
        expected = differences(ship, shaft, hold, name)
        # A derivative that is zero is so to what a millionth of the output's range is per unit of the parameter.
        size = np.maximum(np.abs(expected).max(axis=-1), 0.1 * np.abs(expected).max())
        size = np.maximum(size, 0.05 / max(abs(values[name]), 0.1))
        assert (np.abs(slopes - expected).max(axis=-1) / size).max() < 1e-6, name


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("shaft", SHAFTS)
@pytest.mark.parametrize("ship", FLEXIBLE)
def test_a_limit_out_of_reach_leaves_the_flexible_shaft(ship, shaft, hold):
    values = flexible(*shaft, **FLEXIBLE[ship])
    u, load = inputs_of(ship, 100)
    names = acting(values)
    found = _core.ship_sensitivities(vector(**values), u, load, DT, 0, hold, ALL, places(*names))
    switched = vector(**values | {"M_max": 1e3})
    expected = _core.ship_sensitivities(switched, u, load, DT, 400, hold, ALL, places(*names))
    assert by_size(found[0], expected[0]) < 1e-7
    size = np.abs(expected[1]).max(axis=-1)
    size = np.maximum(size, 0.1 * size.max(axis=-1, keepdims=True))
    assert (np.abs(found[1] - expected[1]).max(axis=-1) / size).max() < 1e-6


@pytest.mark.parametrize("ship", ["nothing", "both dead times", "lag", "load"])
def test_a_stiff_shaft_goes_over_into_a_rigid_one(ship):
    u, load = inputs_of(ship, 100)
    values = OFF | SMALL | FLEXIBLE[ship]
    names = acting(values)[:-2]
    rigid = _core.ship_sensitivities(vector(**values), u, load, DT, 0, "first", ALL, places(*names))

    def apart(give):
        # Damped as well as a shaft can be; the first sample stands before the spring is wound up.
        values["zeta_twist"] = 1.0 / math.sqrt((1.0 / 0.8 + 1.0 / 0.4) * give)
        stiff = vector(**values | {"tau_twist": give})
        found = _core.ship_sensitivities(stiff, u, load, DT, 0, "first", ALL, places(*names))
        size = np.abs(rigid[1]).max(axis=-1)
        size = np.maximum(size, 1e-2 * size.max(axis=-1, keepdims=True))
        slopes = (np.abs(found[1] - rigid[1])[..., 1:].max(axis=-1) / size).max()
        return by_size(found[0][:, 1:], rigid[0][:, 1:]), slopes

    softer, stiff = apart(1e-5), apart(1e-7)
    assert max(stiff) < 1e-3
    assert stiff[0] < 0.2 * softer[0]


@pytest.mark.parametrize("ship", ["nothing", "both dead times", "lag and dead times"])
def test_a_rough_pass_over_a_flexible_shaft_is_near_the_sharp_one(ship):
    values, u = flexible(10.0, 0.05, **FLEXIBLE[ship]), wander(600)
    wrt = places("tau_n", "K_p", "tau_twist", "zeta_twist")
    arguments = (vector(**values), u, NO_LOAD, DT, 0, "first", SPEED_AND_GAUGE)
    measured, offsets, filters = np.zeros((2, len(u))), np.zeros(2), np.ones((2, 1))
    sharp, _ = _core.ship_products(*arguments, measured, offsets, filters, wrt)
    rough, _ = _core.ship_products(*arguments, measured, offsets, filters, wrt, sharp=False)
    size = np.sqrt(np.diagonal(sharp.reshape(12, 12)))
    apart = np.abs((rough - sharp).reshape(12, 12)) / np.outer(size, size)
    assert 0.0 < apart.max() < 1e-3
