"""A drive in open loop: its equations against an integration of its own, its response, and its file."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import shipfp_rs as fp
from shipfp_rs.structures.ship import commanded
from shipfp_rs.structures.structure import Structure

TRUTH = {"tau_n": 0.8, "g": -0.6, "v": 1.3, "p": 1.6, "T_d": 0.0537, "tau_act": 0.12}
RATE_HZ = 100.0
TIME = np.arange(0.0, 20.0, 1.0 / RATE_HZ)


def command_at(time: np.ndarray | float) -> np.ndarray | float:
    return 0.1 * np.sin(1.3 * time) + 0.05 * np.sin(7.0 * time) * (time > 0.0)


def experiment(command: np.ndarray, size: float = 5.0) -> fp.Experiment:
    return fp.Experiment("x", RATE_HZ, {"command": size * (1.0 + command)}, {"command": size})


def rates(time: float, x: np.ndarray) -> list[float]:
    q, (n, fuel) = TRUTH, x
    late = command_at(max(time - q["T_d"], 0.0))
    torque = 1.0 + q["g"] * (n - 1.0) + q["v"] * fuel
    return [(torque - n ** q["p"]) / q["tau_n"], (late - fuel) / q["tau_act"]]


def test_the_command_moves_the_drive_and_its_speed_does_not_come_back() -> None:
    known = solve_ivp(rates, (0.0, TIME[-1]), [1.0, 0.0], t_eval=TIME, rtol=1e-9, atol=1e-11)
    structure = commanded(Structure)
    found = structure.equations.simulate(TRUTH, experiment(command_at(TIME)))
    assert found[0] == pytest.approx(known.y[0] - 1.0, abs=2e-5)
    torque = TRUTH["g"] * (known.y[0] - 1.0) + TRUTH["v"] * known.y[1]
    assert found[1] == pytest.approx(torque, abs=5e-5)


@pytest.mark.parametrize("torque", ["brake", "gauge"])
def test_derivatives_in_time_and_frequency_are_those_of_differences(torque: str) -> None:
    structure = commanded(
        Structure, ["dead_time_loop", "actuator_lag", "damping", "late_torque"], torque=torque
    )
    equations, values = structure.equations, {**TRUTH, "tau_prop": 0.3, "damping": 0.2, "T_M": 0.0137}
    values = {name: values[name] for name in structure.names}
    data, frequency = experiment(command_at(TIME)), np.array([0.1, 1.0, 4.0])
    _, slopes = equations.sensitivities(values, data, structure.names)
    _, by = equations.response(values, frequency, structure.names)
    for row, of_response, name in zip(slopes, by, structure.names, strict=True):
        step = 1e-5
        above, below = ({**values, name: values[name] + sign * step} for sign in (1.0, -1.0))
        change = equations.simulate(above, data) - equations.simulate(below, data)
        assert row == pytest.approx(change / (2.0 * step), abs=2e-4), name
        change = equations.response(above, frequency, ())[0] - equations.response(below, frequency, ())[0]
        assert of_response == pytest.approx(change / (2.0 * step), abs=1e-6), name


def test_the_response_is_that_of_small_motions() -> None:
    structure, frequency_hz = commanded(Structure), 0.5
    size, period = 1e-3, round(RATE_HZ / frequency_hz)
    time = np.arange(0, 40 * period) / RATE_HZ
    found = structure.equations.simulate(TRUTH, experiment(size * np.sin(2.0 * np.pi * frequency_hz * time)))
    last = np.exp(-2j * np.pi * frequency_hz * time[-10 * period :])
    measured = 2j * (found[:, -10 * period :] * last).mean(axis=1) / size
    told, _ = structure.equations.response(TRUTH, np.array([frequency_hz]), ())
    assert told[:, 0] == pytest.approx(measured, rel=2e-3)


def test_a_file_holds_it() -> None:
    structure = commanded(Structure, ["dead_time_loop"], outputs=["dn"]).with_fixed(v=1.0)
    again = Structure.from_dict(structure.to_dict())
    assert again.to_dict() == structure.to_dict()
    assert again.equations == structure.equations


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"elements": ["sampling"]}, "element 'sampling' of a drive in open loop"),
        ({"outputs": ["dn", "dX"]}, "output 'dX' of a drive in open loop"),
    ],
)
def test_what_needs_a_governor_is_refused(asked: dict, said: str) -> None:
    with pytest.raises(fp.InputError, match=said):
        commanded(Structure, **asked)


@pytest.mark.parametrize("names", [(), ("n_set", "command")])
def test_an_experiment_has_a_set_point_or_a_command(names: tuple[str, ...]) -> None:
    signals = dict.fromkeys((*names, "n_e"), np.ones(300))
    with pytest.raises(fp.InputError, match="expected a governor's set point, or the command"):
        fp.Experiment("x", 50.0, signals, dict.fromkeys(signals, 1.0))
