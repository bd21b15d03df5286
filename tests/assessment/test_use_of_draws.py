"""Bands, comparisons and plans by drawn ships, beside those of the covariance."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.si import response_with_deviation, step_with_deviation
from shipfp_rs.identification.draws import Draws
from shipfp_rs.structures.structure import Structure

SHIP = Structure.ship(["dead_time_loop", "actuator_lag"])
HZ = np.geomspace(0.02, 2.0, 30)


@cache
def fitted(seed: int, inertia: float = 1.0) -> fp.Fingerprint:
    launch = fp.Vessel.load("stan-launch-804")
    launch = launch.replace(
        {
            "actuator.dead_time_s": 0.05,
            "actuator.lag_s": 0.08,
            "shaft.inertia_kg_m2": launch.shaft.inertia_kg_m2 * inertia,
        }
    )
    chirp = fp.signals.chirp(0.02, 3.0, 120.0, 30.0, rate_hz=50.0)
    return fp.identify(fp.simulate(launch, chirp, noise={"n_e": 0.05, "M_b": 0.1}, seed=seed), SHIP)


@cache
def drawn(seed: int, inertia: float = 1.0) -> Draws:
    return fitted(seed, inertia).draws(400, seed=seed)


def test_bands_of_a_ship_that_is_known_well_are_near_those_of_its_covariance():
    """Draws are as wide as the widest interval asks for, of which the errors of the model are part."""
    found = fitted(1)
    ways = [{}, {"draws": drawn(1)}]
    steps = [step_with_deviation(found, 6.0, **way) for way in ways]
    responses = [response_with_deviation(found, HZ, **way) for way in ways]
    for output in ("dn", "dM"):
        np.testing.assert_array_equal(steps[0].mean[output], steps[1].mean[output])
        # Where the torque jumps, a delay decides, which is not known well.
        known, other = (one.std[output][one.time > 0.5] for one in steps)
        assert 0.9 < np.linalg.norm(other) / np.linalg.norm(known) < 1.4
        known, other = (one.amplitude_std[output] for one in responses)
        assert 0.9 < np.linalg.norm(other) / np.linalg.norm(known) < 1.4


def test_a_comparison_by_draws_has_their_intervals_and_sees_the_same_change():
    pairs = {"same": (fitted(1), fitted(2)), "heavier": (fitted(1), fitted(2, 1.1))}
    both = {"same": (drawn(1), drawn(2)), "heavier": (drawn(1), drawn(2, 1.1))}
    found = {name: fp.compare(*pair, draws=both[name]) for name, pair in pairs.items()}
    assert not any(one.significant for one in found["same"].changes)
    assert found["same"].joint.p > 0.01
    assert found["heavier"]["tau_n"].significant
    assert found["heavier"].joint.p < 1e-6
    # The interval of a change is that of the difference of independent draws.
    apart = both["heavier"][1].parameters["tau_n"] - both["heavier"][0].parameters["tau_n"]
    low, high = found["heavier"]["tau_n"].ci95
    assert high - low == pytest.approx(np.diff(np.quantile(apart, [0.025, 0.975]))[0], rel=0.15)


def test_a_plan_says_what_it_brings_on_the_ships_that_may_be():
    plan = fp.design(fitted(1), duration_s=120.0, kind="chirp", draws=drawn(1))
    bare = fp.design(fitted(1), duration_s=120.0, kind="chirp")
    assert not bare.spread
    assert plan.excitation == bare.excitation
    for name, (median, most) in plan.spread.items():
        assert median <= most
        if name in ("tau_n", "p", "vK_p"):
            assert median == pytest.approx(plan.prediction.relative_pct[name], rel=0.3)
    assert plan.to_dict()["relative_std_pct_of_draws"]["tau_n"][1] == plan.spread["tau_n"][1]
