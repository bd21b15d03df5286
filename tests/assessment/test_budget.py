"""The budget beside fits of the same trial with each channel's calibration moved."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.budget import FIT, budget
from shipfp_rs.assessment.si import in_si

INPUTS = ("torque scale", "torque zero", "speed scale", "clock", "gear ratio")
PCT = {"torque_pct": 1.5, "zero_pct": 1.0, "speed_pct": 0.6, "clock_pct": 0.5, "ratio_pct": 0.8}


def tug() -> fp.Vessel:
    return fp.Vessel.load("stan-tug-1205")


@cache
def trial() -> fp.Experiment:
    """A chirp of a tug with a gear, with little noise."""
    chirp = fp.signals.chirp(0.02, 2.0, 60.0, 40.0, rate_hz=20.0)
    noise = {"n_e": 0.02, "M_s": 0.5}
    found = fp.simulate(tug(), chirp, noise=noise, seed=3)
    kept = ("n_set", "n_e", "M_s")
    point = {name: found.operating_point[name] for name in kept}
    return replace(found, signals={name: found.signals[name] for name in kept}, operating_point=point)


def miscalibrated(moved: dict[str, float]) -> tuple[fp.Experiment, fp.Vessel]:
    """The trial as it is read with errors [%] of its calibration, and the vessel with one of its gear ratio."""
    by = {name: 0.01 * moved.get(name, 0.0) for name in INPUTS}
    own, signals, point = trial(), dict(trial().signals), dict(trial().operating_point)
    for name in ("n_set", "n_e"):
        factor = (1.0 + by["speed scale"]) / (1.0 + by["clock"])
        signals[name], point[name] = factor * signals[name], factor * point[name]
    zero = by["torque zero"] * point["M_s"]
    signals["M_s"] = (1.0 + by["torque scale"]) * (signals["M_s"] + zero)
    point["M_s"] = (1.0 + by["torque scale"]) * (point["M_s"] + zero)
    vessel = tug()
    ratio = vessel.gearbox.ratio * (1.0 + by["gear ratio"])
    rate_hz = own.rate_hz / (1.0 + by["clock"])
    return replace(own, rate_hz=rate_hz, signals=signals, operating_point=point), vessel.replace(
        {"gearbox.ratio": ratio}
    )


def quantities(moved: dict[str, float]) -> dict[str, float]:
    experiment, vessel = miscalibrated(moved)
    found = fp.identify(experiment, intervals="symmetric", torque="brake")
    return {name: row["value"] for name, row in in_si(found, vessel).items()}


@cache
def told():
    found = fp.identify(trial(), intervals="symmetric", torque="brake")
    return budget(replace(found, si=in_si(found, tug())), **PCT)


@pytest.mark.parametrize("name", INPUTS)
def test_a_moved_calibration_moves_the_quantities_as_the_budget_says(name):
    own = PCT[f"{name.split()[-1] if name != 'torque scale' else 'torque'}_pct".replace("scale", "speed")]
    up, down = (quantities({name: sign * own}) for sign in (1.0, -1.0))
    for quantity in ("inertia", "engine_slope", "proportional_gain", "propeller_exponent"):
        row = told()[quantity]
        said = next((part.u for part in row.contributions if part.input == name), 0.0)
        seen = 0.5 * abs(up[quantity] - down[quantity])
        assert said == pytest.approx(seen, rel=0.1, abs=0.02 * row.u), quantity


def test_shares_are_of_the_variance_and_halving_the_largest_helps_most():
    for row in told().values():
        assert sum(part.share for part in row.contributions) == pytest.approx(1.0)
        assert row.u**2 == pytest.approx(sum(part.u**2 for part in row.contributions))
        assert row.halved == row.contributions[0].input
        assert row.then_u < row.u
        assert any(part.input == FIT for part in row.contributions)


def test_a_fingerprint_without_units_is_refused_in_a_line():
    found = replace(fp.identify(trial(), intervals="symmetric", torque="brake"), si={})
    with pytest.raises(fp.InputError, match="no quantity in SI units, expected some; give a vessel"):
        budget(found)


@pytest.mark.study
def test_shares_are_those_of_draws_of_the_calibrations():
    random, draws = np.random.default_rng(5), 60
    for name, pct in zip(INPUTS, PCT.values(), strict=True):
        found = [quantities({name: pct * random.standard_normal()}) for _ in range(draws)]
        for quantity, row in told().items():
            said = next((part.u for part in row.contributions if part.input == name), 0.0)
            seen = float(np.std([one[quantity] for one in found]))
            print(
                f"{name:14} {quantity:22} budget {said / row.u:.3f} draws {seen / row.u:.3f} of u", flush=True
            )
            assert said**2 == pytest.approx(seen**2, abs=0.1 * row.u**2 + 0.4 * said**2)
