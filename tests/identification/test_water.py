"""Moving water that a record shows, and what a limit makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import shipfp_rs as fp
from shipfp_rs import _core
from shipfp_rs.identification.question import question_of
from tests.twins.ship import vector as ship

RATE_HZ, SECONDS = 50.0, 200.0
TRUE = {
    "tau_n": 1.3,
    "g": -0.6,
    "vK_p": 4.0,
    "vK_i": 5.0,
    "p": 2.1,
    "T_d": 0.06,
    "M_max": 1.08,
    "tau_prop": 0.4,
}
OFF = {"hold": 0.0, "T_set": 0.0, "tau_act": 0.0, "c_2": 0.0, "T_M": 0.0, "M_soft": 1e-4}


@pytest.fixture(scope="module")
def water():
    """Return the load's torque beyond its law, a per cent with a memory of half a second."""
    white = np.random.default_rng(3).standard_normal(round(RATE_HZ * SECONDS))
    stays = np.exp(-1.0 / (0.5 * RATE_HZ))
    return 0.01 * lfilter([np.sqrt(1.0 - stays**2)], [1.0, -stays], white)


def measured(water, place):
    t = np.arange(len(water)) / RATE_HZ
    u = 1.0 + 0.03 * np.sin(2.0 * np.pi * 0.02 * t * (1.0 + 0.1 * t))
    names = {"vK_p": "K_p", "vK_i": "K_i"}
    values = {names.get(name, name): value for name, value in TRUE.items()} | {"v": 1.0, "load_gain": 1.0}
    outputs = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", {"M_b": "dM_b", "M_g": "dM_g"}[place])]
    speed, torque = _core.simulate_ship(ship(**values), u, water, 1.0 / RATE_HZ, 0, "first", outputs)
    noise = 1e-4 * np.random.default_rng(4).standard_normal((2, len(t)))
    return fp.Experiment(
        name="W1",
        rate_hz=RATE_HZ,
        signals={
            "n_set": 1200.0 * u,
            "n_e": 1200.0 * (1.0 + speed + noise[0]),
            place: 100.0 * (1.0 + torque + noise[1]),
        },
        operating_point={"n_set": 1200.0, "n_e": 1200.0, place: 100.0},
        hold="first",
        kind="chirp",
    )


def likelihood_of(water, place, *, limited=True):
    elements = {"torque_limit": limited}
    likelihood = question_of([measured(water, place)], elements=elements).simulated_likelihood(
        (), 0.005, "straight"
    )
    c = likelihood.coordinates
    return likelihood, c, c.vector({**OFF, **TRUE})


@pytest.mark.parametrize("off", [1.0, 1.05])
@pytest.mark.parametrize("place", ["M_b", "M_g"])
def test_water_is_seen_through_an_inertia_that_is_not_right_yet(water, place, off):
    likelihood, c, _ = likelihood_of(water, place)
    name = {"M_b": "tau_n", "M_g": "tau_prop"}[place]
    (found,) = likelihood.with_water(c.vector({**OFF, **TRUE, name: off * TRUE[name]})).water
    true = likelihood.records[0].driven_by(found).load
    inside = slice(round(5.0 * RATE_HZ), -round(5.0 * RATE_HZ))
    every = round(likelihood.records[0].rate_hz / RATE_HZ)
    seen = true[::every][: len(water)][inside]
    assert np.corrcoef(seen, water[inside])[0, 1] > 0.95


def test_a_limited_ship_that_the_water_drives_leaves_little_over(water):
    likelihood, _, at_truth = likelihood_of(water, "M_b")
    dry, _ = likelihood.spectra(at_truth, 0)
    wet, _ = likelihood.with_water(at_truth).spectra(at_truth, 0)
    assert np.linalg.norm(wet) < 0.2 * np.linalg.norm(dry)


def test_water_of_a_ship_without_a_limit_stays_noise(water):
    likelihood, _, at_truth = likelihood_of(water, "M_b", limited=False)
    assert likelihood.with_water(at_truth) is likelihood


@pytest.mark.parametrize("place", ["M_b", "M_g"])
def test_water_that_drives_a_ship_makes_it_likelier_only_beside_a_limit(water, place):
    # Without a limit the one is a straight-line function of the other; what differs is how spectra are averaged.
    free, limited = (
        water_over_noise(*likelihood_of(water, place, limited=limited)[::2], water)
        for limited in (False, True)
    )
    assert abs(free) < 0.1
    assert limited < -0.5


def water_over_noise(likelihood, at_truth, water):
    """What the total gains a number compared where the true water drives the ship."""
    known = likelihood.with_noise(at_truth)
    wet = replace(known, water=(water[:: known.records[0].down],))
    count = 2 * known.records[0].spectrum.size
    return (wet._wet_total(at_truth) - known.total(at_truth)) / count
