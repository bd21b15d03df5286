"""Derivatives inside and at the bounds of delays are those of differences; bands where a delay is zero stay bands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.assessment import closed_loop
from shipfp_rs.assessment.si import response_with_deviation, step_with_deviation
from shipfp_rs.identification.estimate import Estimate, Identifiability
from shipfp_rs.identification.identifiability import gradient_of
from shipfp_rs.structures.structure import Structure

DELAYS = ("dead_time_loop", "dead_time_set_point", "actuator_lag")
SHIP = Structure.ship(DELAYS)
FLEXIBLE = Structure.ship((*DELAYS, "twist"), torque="gauge")
INSIDE = {
    "tau_n": 0.9, "g": -0.3, "vK_p": 4.0, "vK_i": 6.0, "p": 1.5, "T_d": 0.06, "tau_act": 0.05, "T_set": 0.05,
    "tau_prop": 0.3, "tau_twist": 0.004, "zeta_twist": 0.01,
}  # fmt: skip
PLACES: Mapping[str, Mapping[str, float]] = {
    "inside": {},
    "T_d": {"T_d": 0.0},
    "tau_act": {"tau_act": 0.0},
    "both": {"T_d": 0.0, "tau_act": 0.0},
    "nearly": {"T_d": 1e-9, "tau_act": 1e-8},
}
SMOOTH = fp.Experiment(
    "chirp", 50.0, {"n_set": 1.0 + 0.01 * np.sin(0.5 * np.arange(0, 12, 0.02) ** 2)}, {"n_set": 1.0}
)


def values_of(structure: Structure, place: str) -> dict[str, float]:
    return {name: {**INSIDE, **PLACES[place]}[name] for name in structure.names}


def slope(
    function: Callable[[Mapping[str, float]], np.ndarray | float], values: Mapping[str, float], name: str
):
    """Return the difference quotient of second order, upwards at zero."""
    step = 2e-4 if 0.0 <= values[name] < 1e-3 else 1e-3 * abs(values[name])
    below, here, one, two = (
        partial(function, {**values, name: values[name] + k * step}) for k in (-1.0, 0.0, 1.0, 2.0)
    )
    if 0.0 <= values[name] < 1e-3:
        return (4.0 * one() - two() - 3.0 * here()) / (2.0 * step)
    return (one() - below()) / (2.0 * step)


@pytest.mark.parametrize("place", PLACES)
def test_gradients_of_the_loops_figures_are_differences(place: str) -> None:
    values = values_of(SHIP, place)
    figures = {name: figure for name, (_, figure) in closed_loop._figures(SHIP, values).items()}
    for name, figure in figures.items():
        found = gradient_of(figure, values, SHIP.names)
        for parameter, one in zip(SHIP.names, found, strict=True):
            size = abs(figure(values)) / max(abs(values[parameter]), 0.05)
            assert one == pytest.approx(
                slope(figure, values, parameter), rel=0.03, abs=3e-3 * size, nan_ok=True
            ), (
                name,
                parameter,
            )


@pytest.mark.parametrize("structure", [SHIP, FLEXIBLE])
@pytest.mark.parametrize("place", PLACES)
def test_derivatives_of_stepper_and_response_are_differences(place: str, structure: Structure) -> None:
    values, frequency = values_of(structure, place), np.geomspace(0.01, 3.0, 40)
    equations = structure.equations
    for found, function in (
        (
            equations.sensitivities(values, SMOOTH, structure.names)[1],
            lambda known: equations.simulate(known, SMOOTH),
        ),
        (
            equations.response(values, frequency, structure.names)[1],
            lambda known: equations.response(known, frequency, ())[0],
        ),
    ):
        for parameter, one in zip(structure.names, found, strict=True):
            other = slope(function, values, parameter)
            assert np.abs(one - other).max() < 0.02 * np.abs(other).max() + 1e-6, parameter


def found_at(place: str, *, held: bool = True) -> fp.Fingerprint:
    """Return a fingerprint whose delays may be on their bounds, with intervals of 0.03 s upwards.

    With `held`, the covariance has no delay on a bound.
    """
    values = values_of(SHIP, place)
    names = [name for name in SHIP.names if values[name] != 0.0 or not held]
    deviations = np.array([0.02 * abs(values[name]) or 0.015 for name in names])
    parameters = {
        name: Estimate(value, 0.01, (value, value + 0.03), "s", "at_bound")
        if value == 0.0
        else Estimate(
            value, 0.02 * abs(value), (value - 0.04 * abs(value), value + 0.04 * abs(value)), "s", "free"
        )
        for name, value in values.items()
    }
    return fp.Fingerprint(
        parameters, {}, Identifiability(len(names), len(names), 1.0), {}, SHIP.to_dict(),
        settings={"optimum": values},
        covariance={"names": names, "matrix": np.diag(deviations**2).tolist()},
    )  # fmt: skip


@pytest.mark.parametrize("place", ["inside", "T_d", "tau_act", "both"])
@pytest.mark.parametrize("held", [True, False])
def test_bands_of_a_step_stay_within_the_step_where_delays_are_zero(place: str, held: bool) -> None:
    step = step_with_deviation(found_at(place, held=held), 8.0, structure=SHIP)
    assert step.std["dn"].max() < 0.2
    assert step.std["dM"].max() <= np.abs(step.mean["dM"]).max()


def test_a_delay_on_its_bound_widens_the_bands_by_its_interval() -> None:
    held, inside = found_at("T_d"), found_at("inside")
    wide = response_with_deviation(held, [1.0], SHIP).phase_std["dn"]
    values = dict(held.optimum)
    ends = [
        SHIP.equations.response({**values, "T_d": late}, np.array([1.0]), ())[0][0, 0] for late in (0.0, 0.03)
    ]
    assert wide[0] >= 0.8 * abs(np.angle(ends[1] / ends[0])) / 1.96
    assert response_with_deviation(inside, [1.0], SHIP).phase_std["dn"][0] < wide[0]
