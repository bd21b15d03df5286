"""A set point that is low-passed, or held from frame to frame, and the torque that hands it on at once."""

from __future__ import annotations

import numpy as np
import pytest

from shipfp_rs import Structure
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.experiments.interpolation import band_limited
from shipfp_rs.identification.sampling import between_samples

RATE_HZ, FREQUENCY_HZ, SWING = 50.0, 5.1, 1e-4
TIME = np.arange(4000) / RATE_HZ
SHIP = {"tau_n": 1.5, "g": -0.4, "vK_p": 8.6, "vK_i": 13.0, "p": 1.9, "T_d": 0.064, "T_set": 0.115}


def amplitude(samples: np.ndarray) -> complex:
    """Of the swing, once it has settled."""
    late = TIME > 20.0
    turned = np.exp(2j * np.pi * FREQUENCY_HZ * TIME[late])
    columns = np.column_stack([turned.real, turned.imag, np.ones(late.sum())])
    along, across, _ = np.linalg.lstsq(columns, samples[late])[0]
    return complex(along, -across)


def torque_of_a_swing() -> complex:
    """Torque over set point by the equations in the frequency domain."""
    s = 2j * np.pi * FREQUENCY_HZ
    control = (SHIP["vK_p"] + SHIP["vK_i"] / s) * np.exp(-s * SHIP["T_d"])
    shaft = SHIP["tau_n"] * s + SHIP["p"] - SHIP["g"]
    speed = control * np.exp(-s * SHIP["T_set"]) / (shaft + control)
    return speed * (SHIP["tau_n"] * s + SHIP["p"])


def experiment(held: dict[str, float] | None) -> Experiment:
    n_set = 1000.0 * (1.0 + SWING * np.sin(2.0 * np.pi * FREQUENCY_HZ * TIME))
    return Experiment(
        "swing",
        RATE_HZ,
        {"n_set": n_set, "n_e": n_set, "M_b": n_set},
        {"n_set": 1000.0, "n_e": 1000.0, "M_b": 1000.0},
        hold="first",
        provenance={"held_set_point": held},
    )


def parts(held: dict[str, float] | None, measured: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Torque of straight lines, and what it lacks."""
    ship = Structure.ship(["dead_time_loop", "dead_time_set_point"], torque="brake")
    values = {parameter.name: parameter.start for parameter in ship.parameters} | SHIP
    one = experiment(held)
    smooth = band_limited(one)
    plain = ship.equations.simulate(values, smooth)[list(ship.outputs).index("dM")]
    told = np.zeros(len(TIME)) if measured is None else measured
    return plain, between_samples(ship.equations, values, smooth, one.dn_set, told)


def test_a_low_passed_torque_has_no_images_of_straight_lines() -> None:
    plain, lacks = parts(None)
    right = SWING * abs(torque_of_a_swing())
    assert abs(amplitude(plain)) / right > 1.02
    assert abs(amplitude(plain + lacks)) / right == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("unknown_s", [0.0, 0.0031])
def test_the_age_of_a_held_set_point_is_found_in_the_torque(unknown_s: float) -> None:
    period, phase, slip = 0.01, 0.004, 1.1e-4
    late = SHIP["T_d"] + SHIP["T_set"]
    age = (phase + slip * TIME - late - unknown_s) % period
    swing = 2.0 * np.pi * FREQUENCY_HZ
    smooth = SWING * np.sin(swing * (TIME - late))
    stairs = SHIP["vK_p"] * (SWING * np.sin(swing * (TIME - late - age + 0.5 * period)) - smooth)
    plain, lacks = parts(None)
    noise = 0.1 * np.std(stairs) * np.random.default_rng(0).standard_normal(len(TIME))
    _, found = parts({"period_s": period, "phase_s": phase, "slip": slip}, plain + lacks + stairs + noise)
    settled = TIME > 20.0
    wrong = np.std((found - lacks - stairs)[settled]) / np.std(stairs[settled])
    assert wrong < 0.25
