"""A set point that is low-passed, or held from frame to frame, and the torque that hands it on at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shipfp_rs import Structure
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.experiments.interpolation import band_limited
from shipfp_rs.identification.images import between_samples

RATE_HZ, FREQUENCY_HZ, SWING = 50.0, 5.1, 1e-4
TIME = np.arange(4000) / RATE_HZ
SHIP = {"tau_n": 1.5, "g": -0.4, "vK_p": 8.6, "vK_i": 13.0, "p": 1.9, "T_d": 0.064, "T_set": 0.115}
DEAD_TIMES = ("dead_time_loop", "dead_time_set_point")


def amplitude(samples: np.ndarray, frequency_hz: float = FREQUENCY_HZ) -> complex:
    """Of the swing, once it has settled."""
    late = TIME > 20.0
    turned = np.exp(2j * np.pi * frequency_hz * TIME[late])
    columns = np.column_stack([turned.real, turned.imag, np.ones(late.sum())])
    along, across, _ = np.linalg.lstsq(columns, samples[late])[0]
    return complex(across, along)


def swings(values: dict[str, float], torque: str, frequency_hz: float) -> dict[str, complex]:
    """Speed and torque over set point by the equations in the frequency domain."""
    s = 2j * np.pi * frequency_hz
    control = (values["vK_p"] + values["vK_i"] / s) * np.exp(-s * values["T_d"])
    control /= 1.0 + s * values.get("tau_act", 0.0)
    behind = values["p"] + s * values.get("tau_prop", 0.0)
    twist = values.get("tau_twist", 0.0) * s
    twisted = 1.0 + behind * twist / (1.0 + values.get("zeta_twist", 0.0) * twist)
    before = (values["tau_n"] - values.get("tau_prop", 0.0)) * s - values["g"]
    propeller = control * np.exp(-s * values["T_set"]) / ((before + control) * twisted + behind)
    speed = twisted * propeller
    on_brake = (before + values["g"]) * speed + behind * propeller
    late = np.exp(-s * values.get("T_M", 0.0))
    return {"dn": speed, "dM": (behind * propeller if torque == "gauge" else on_brake) * late}


def experiment(held: dict[str, float] | None, frequency_hz: float = FREQUENCY_HZ) -> Experiment:
    n_set = 1000.0 * (1.0 + SWING * np.sin(2.0 * np.pi * frequency_hz * TIME))
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
    ship = Structure.ship(DEAD_TIMES, torque="brake")
    values = {parameter.name: parameter.start for parameter in ship.parameters} | SHIP
    one = experiment(held)
    smooth = band_limited(one)
    plain = ship.equations.simulate(values, smooth)
    row = list(ship.outputs).index("dM")
    told = dict(zip(ship.outputs, plain, strict=True))
    if measured is not None:
        told["dM"] = measured
    return plain[row], between_samples(ship.equations, values, smooth, one.dn_set, told)[row]


@pytest.mark.parametrize("frequency_hz", [5.1, 13.3])
@pytest.mark.parametrize(
    ("elements", "torque", "more"),
    [
        ((), "brake", {}),
        (("actuator_lag",), "brake", {"tau_act": 0.021}),
        (
            ("twist", "late_torque"),
            "gauge",
            {"tau_prop": 0.21, "tau_twist": 1.7e-3, "zeta_twist": 1.4, "T_M": 3.3e-3},
        ),
        ((), "gauge", {"tau_prop": 0.21}),
    ],
)
def test_a_low_passed_record_has_no_images_of_straight_lines(
    elements: tuple[str, ...], torque: str, more: dict[str, float], frequency_hz: float
) -> None:
    ship = Structure.ship((*DEAD_TIMES, *elements), torque=torque)
    values = {parameter.name: parameter.start for parameter in ship.parameters} | SHIP | more
    one = experiment(None, frequency_hz)
    smooth = band_limited(one)
    plain = dict(zip(ship.outputs, ship.equations.simulate(values, smooth), strict=True))
    right = swings(values, torque, frequency_hz)
    lacks = between_samples(ship.equations, values, smooth, one.dn_set, plain)
    for output, lack in zip(plain, lacks, strict=True):
        cleared = amplitude(plain[output] + lack, frequency_hz) / SWING
        assert cleared == pytest.approx(right[output], abs=3e-3 * abs(right["dM"]))
    if torque == "brake" and frequency_hz > 10.0:
        assert amplitude(plain["dM"], frequency_hz) / SWING != pytest.approx(right["dM"], rel=0.02)


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


def test_a_record_that_ends_in_mid_swing_lacks_what_a_longer_one_does() -> None:
    ship = Structure.ship(DEAD_TIMES, torque="brake")
    values = {parameter.name: parameter.start for parameter in ship.parameters} | SHIP
    long = experiment(None)
    signals = {name: samples[:3013] for name, samples in long.signals.items()}
    lacks = []
    for one in (long, replace(long, signals=signals)):
        smooth = band_limited(one)
        told = dict(zip(ship.outputs, ship.equations.simulate(values, smooth), strict=True))
        lacks.append(between_samples(ship.equations, values, smooth, one.dn_set, told)[1][:3013])
    beside = np.abs(lacks[1] - lacks[0])[-100:]
    assert beside.max() < 0.05 * SWING * SHIP["vK_p"]
    assert beside[:-30].max() < 1e-3 * SWING * SHIP["vK_p"]
