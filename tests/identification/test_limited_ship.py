"""A ship in a limit of torque: what the limit takes off, in calm and in moving water."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import shipfp_rs as fp
from shipfp_rs import _core
from shipfp_rs.identification.coordinates import loop_of
from shipfp_rs.identification.limited_ship import limit_figures
from shipfp_rs.identification.question import question_of
from shipfp_rs.structures.transfer import SLOWEST, TransferFunctions
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
OFF = {"T_s": 0.0, "T_set": 0.0, "tau_act": 0.0, "c_2": 0.0, "T_M": 0.0, "M_soft": 1e-4}


@pytest.fixture(scope="module")
def water():
    """Return the load's torque beyond its law, a per cent with a memory of half a second."""
    white = np.random.default_rng(3).standard_normal(round(RATE_HZ * SECONDS))
    stays = np.exp(-1.0 / (0.5 * RATE_HZ))
    return 0.01 * lfilter([np.sqrt(1.0 - stays**2)], [1.0, -stays], white)


def measured(water, place, noise=1e-4, size=1.0):
    t = np.arange(len(water)) / RATE_HZ
    u = 1.0 + 0.03 * size * np.sin(2.0 * np.pi * 0.02 * t * (1.0 + 0.1 * t))
    names = {"vK_p": "K_p", "vK_i": "K_i"}
    values = {names.get(name, name): value for name, value in TRUE.items()} | {"v": 1.0, "load_gain": 1.0}
    outputs = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", {"M_b": "dM_b", "M_g": "dM_g"}[place])]
    speed, torque = _core.simulate_ship(ship(**values), u, water, 1.0 / RATE_HZ, 0, "first", outputs)
    noise = noise * np.random.default_rng(4).standard_normal((2, len(t)))
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


def likelihood_of(water, place, size=1.0):
    """Return the likelihood at the truth."""
    likelihood = question_of([measured(water, place, size=size)], elements={"torque_limit": True}).likelihood(
        "straight"
    )
    return likelihood.corrected(likelihood.coordinates.vector({**OFF, **TRUE}))


@pytest.mark.parametrize("place", ["M_b", "M_g"])
def test_a_ship_in_its_limit_leaves_what_water_does_to_a_ship_without_one(water, place):
    likelihood = likelihood_of(water, place)
    at_truth = likelihood.coordinates.vector({**OFF, **TRUE})
    loop = TransferFunctions(("dn", "dM"), place == "M_g", "engine")
    record = likelihood.records[0]
    s = 1j * np.maximum(2.0 * np.pi * record.frequency_hz, SLOWEST)
    values = loop_of(likelihood.coordinates.values(at_truth))
    # The load's torque slows the shaft by the loop's answer to a torque, with the sign turned.
    behind = -loop.answer_to_torque(values, s)[0] * record.see(record.low_passed(water))
    behind[0], left = 0.0, likelihood.residual(at_truth, 0)[0]
    assert np.linalg.norm(left - behind) < 0.4 * np.linalg.norm(behind)


@pytest.mark.parametrize("place", ["M_b", "M_g"])
def test_in_calm_water_nothing_is_left_but_the_noise(water, place):
    calm = likelihood_of(0.0 * water, place)
    at_truth = calm.coordinates.vector({**OFF, **TRUE})
    # The speed that the governor saw is smoothed in the band, so that corners of the limit are a little off.
    ways = (calm, 4e-3), (calm.settled_at(at_truth), 8e-3), (calm.with_models(simulates=True), 3e-3)
    for one, share in ways:
        assert np.linalg.norm(one.residual(at_truth, 0)) < share * np.linalg.norm(one.records[0].spectrum)


@pytest.mark.parametrize("wet", [True, False])
def test_the_speed_that_the_governor_saw_has_the_waters_motion_but_not_the_sensors_noise(water, wet):
    likelihood = likelihood_of(water * wet, "M_b")
    at_truth = likelihood.coordinates.vector({**OFF, **TRUE})
    (model,) = likelihood.with_models(smooths=True).settled_at(at_truth).models
    found = model.governed
    clean, calm = (measured(row, "M_b", noise=0.0).normalised("n_e") for row in (water * wet, 0.0 * water))
    inside = slice(round(6.0 * RATE_HZ), -round(6.0 * RATE_HZ))
    moved, noise = np.std((clean - calm)[inside]), 1e-4
    assert np.std((found.speed - clean)[inside]) < (0.3 * moved if wet else 0.5 * noise)


def test_the_effect_of_a_limit_is_told_with_the_amplitude_that_stays_clear_of_it(water):
    likelihood = likelihood_of(0.0 * water, "M_b")
    at_truth = likelihood.coordinates.vector({**OFF, **TRUE})
    figures = limit_figures(likelihood.settled_at(at_truth), at_truth)
    assert 0.0 < figures["share"] < 0.5
    assert 0.0 < figures["removed"] < 1.0
    assert 0.3 < figures["amplitude"] < 1.0
    smaller = likelihood_of(0.0 * water, "M_b", 0.9 * figures["amplitude"])
    assert limit_figures(smaller, at_truth)["share"] < 0.1 * figures["share"]


def test_derivatives_of_what_a_limit_takes_off_are_the_differences(water):
    likelihood = likelihood_of(water, "M_b")
    vector = likelihood.coordinates.vector({**OFF, **TRUE})
    likelihood = likelihood.settled_at(vector)
    at, c = likelihood.spectra(vector, 0), likelihood.coordinates
    frozen = likelihood.near(vector).spectra(vector, 0)
    for name in ("M_max", "vK_p", "p"):
        moved = vector.copy()
        moved[c.place(name)] += 1e-3
        slope = (likelihood.residual(vector, 0) - likelihood.residual(moved, 0)) / 1e-3
        for one in (at, frozen):
            assert np.linalg.norm(one[1][c.place(name)] - slope) < 0.05 * np.linalg.norm(slope)


def test_a_loop_that_a_clamp_opens_is_no_cheaper_for_a_larger_gain(water):
    """Without the determinant's part a bang-bang governor that rests in its limit would explain every speed."""
    likelihood = likelihood_of(water, "M_b")
    c = likelihood.coordinates
    at_truth = c.vector({**OFF, **TRUE})
    wild = c.vector({**OFF, **TRUE, "T_d": 0.0, "vK_p": 500.0, "vK_i": 300.0})
    right, wrong = (likelihood.settled_at(one) for one in (at_truth, wild))
    assert 0.0 < right.models[0].held < 0.5 < wrong.models[0].held
    assert right.total(at_truth) < wrong.total(wild) - 1000.0
    row = right.prior_rows(at_truth)[-1]
    moved = at_truth.copy()
    moved[c.place("vK_p")] += 1e-3
    slope = (right.prior_rows(moved)[-1, 0] - row[0]) / -1e-3
    assert row[1 + c.place("vK_p")] == pytest.approx(slope, rel=0.05)
