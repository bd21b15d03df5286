"""At the truth the two equations leave what a simulation leaves: nothing."""

from dataclasses import replace

import pytest

from tests.identification.parity import CASES, Case, engine_residual, left

MOST = 2e-4
WIDER = {
    "twist": 1.2e-3,  # squares of the propeller's speed are taken from the engine's
    "sampling, 0.01 s": 3e-4,
    "sampling, 0.05 s": 6e-4,
    "sampling, 0.05 s, no dead time": 5e-4,
    "sampling, 0.05 s, steps in time": 9e-4,
    "held, 50 Hz": 4e-4,
    "straight, 20 Hz": 4e-4,
    "held, 20 Hz": 1.5e-3,
    "held, 20 Hz, lag 0.1 s": 4e-4,
    "held, 20 Hz, brake": 4e-3,
}
"""What is left where more than 2e-4 of the signal is; set points held at 20 Hz make the torque jump between its samples."""


@pytest.mark.parametrize("name", CASES)
def test_the_two_equations_leave_next_to_nothing_at_the_truth(name):
    assert max(left(CASES[name]).values()) < WIDER.get(name, 1.15 * MOST), name


@pytest.mark.parametrize(
    "case",
    [Case(), Case(gauge=False), Case(own={"tau_act": 0.1}), Case(own={"tau_twist": 4e-4, "zeta_twist": 0.5})],
    ids=["gauge", "brake", "lag", "twist"],
)
def test_the_wake_stays_out_of_the_engines_equation(case):
    """The wake is a hundred times what a sensor leaves; the engine's equation has the measured torque and not the wake."""
    torque, engine = engine_residual(replace(case, amplitude=0.03, seconds=160.0, wake=0.02))
    assert torque > 0.1
    assert engine < 1e-4 * torque
