"""A ship in a limit of torque: what the limit takes off, and the moving water that decides when it holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import shipfp_rs as fp
from shipfp_rs import _core
from shipfp_rs.identification.limited_likelihood import PHASES, WATERS_HZ
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
OFF = {"T_s": 0.0, "T_set": 0.0, "tau_act": 0.0, "c_2": 0.0, "T_M": 0.0, "M_soft": 1e-4}


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


def likelihood_of(water, place, water_hz=WATERS_HZ[0]):
    """Return the likelihood at the truth; `water_hz` None: limits by the engine's side alone."""
    likelihood = question_of([measured(water, place)], elements={"torque_limit": True}).likelihood("straight")
    likelihood = replace(likelihood, water_hz=water_hz)
    return likelihood.corrected(likelihood.coordinates.vector({**OFF, **TRUE}))


@pytest.mark.parametrize("off", [1.0, 1.05])
@pytest.mark.parametrize("place", ["M_b", "M_g"])
def test_water_is_seen_through_an_inertia_that_is_not_right_yet(water, place, off):
    likelihood = likelihood_of(water, place)
    name = {"M_b": "tau_n", "M_g": "tau_prop"}[place]
    vector = likelihood.coordinates.vector({**OFF, **TRUE, name: off * TRUE[name]})
    (found,) = likelihood.driven(vector).beyond
    down = likelihood.records[0].down
    inside = slice(round(6.0 * RATE_HZ / down), -round(6.0 * RATE_HZ / down))
    assert np.corrcoef(found[inside], water[::down][: len(found)][inside])[0, 1] > 0.92


@pytest.mark.parametrize("place", ["M_b", "M_g"])
def test_a_ship_in_its_limit_leaves_what_water_does_to_a_ship_without_one(water, place):
    likelihood = likelihood_of(water, place)
    record, at_truth = likelihood.records[0], likelihood.coordinates.vector({**OFF, **TRUE})
    free, calm = (likelihood._simulated(at_truth, 0, {}, one) for one in (water, None))
    noise = record.see(record.low_passed(free - calm))
    dry = likelihood.residual(at_truth, 0) - noise
    wet = likelihood.driven(at_truth).residual(at_truth, 0) - noise
    assert np.linalg.norm(wet) < 0.4 * np.linalg.norm(dry)
    alone = likelihood_of(water, place, None).residual(at_truth, 0) - noise
    assert np.linalg.norm(alone) < 0.4 * np.linalg.norm(dry)


@pytest.mark.parametrize("water_hz", [WATERS_HZ[0], None])
@pytest.mark.parametrize("place", ["M_b", "M_g"])
def test_in_calm_water_nothing_is_left_but_the_noise(water, place, water_hz):
    calm = likelihood_of(0.0 * water, place, water_hz)
    at_truth = calm.coordinates.vector({**OFF, **TRUE})
    left = np.linalg.norm(calm.residual(at_truth, 0)) / np.linalg.norm(calm.records[0].spectrum)
    assert left < (4e-3 if water_hz is None else 3e-3)


@pytest.mark.parametrize("water_hz", [WATERS_HZ[0], None])
def test_derivatives_of_what_a_limit_takes_off_are_the_differences(water, water_hz):
    likelihood = likelihood_of(water, "M_b", water_hz)
    vector = likelihood.coordinates.vector({**OFF, **TRUE})
    likelihood = likelihood.settled_at(vector)
    at, c = likelihood.spectra(vector, 0), likelihood.coordinates
    for name in ("M_max", "vK_p", "p"):
        moved = vector.copy()
        moved[c.place(name)] += 1e-3
        slope = (likelihood.residual(vector, 0) - likelihood.residual(moved, 0)) / 1e-3
        assert np.linalg.norm(at[1][c.place(name)] - slope) < 0.05 * np.linalg.norm(slope)


@pytest.mark.parametrize("wet", [True, False])
def test_the_totals_tell_whether_water_moves_a_ship_in_its_limit(water, wet):
    likelihood = likelihood_of(water if wet else 0.0 * water, "M_b")
    at_truth = likelihood.coordinates.vector({**OFF, **TRUE})
    totals = [
        replace(likelihood, water_hz=hz).resettled_at(at_truth).total(at_truth) for hz in (WATERS_HZ[0], 0.0)
    ]
    assert np.argmin(totals) == (0 if wet else 1)


def test_a_loop_that_a_clamp_opens_is_no_cheaper_for_a_larger_gain(water):
    """Without the determinant's part a bang-bang governor that rests in its limit would explain every speed."""
    likelihood = likelihood_of(water, "M_b", None)
    c = likelihood.coordinates
    at_truth = c.vector({**OFF, **TRUE})
    wild = c.vector({**OFF, **TRUE, "T_d": 0.0, "vK_p": 500.0, "vK_i": 300.0})
    right, wrong = (likelihood.settled_at(one) for one in (at_truth, wild))
    assert 0.0 < right.held[0] < 0.5 < wrong.held[0]
    assert right.total(at_truth) < wrong.total(wild) - 1000.0
    row = right.prior_rows(at_truth)[-1]
    moved = at_truth.copy()
    moved[c.place("vK_p")] += 1e-3
    slope = (right.prior_rows(moved)[-1, 0] - row[0]) / -1e-3
    assert row[1 + c.place("vK_p")] == pytest.approx(slope, rel=0.05)


def test_the_instants_of_a_sampling_governor_move_the_end_about_nothing(water):
    likelihood = likelihood_of(0.0 * water, "M_b")
    at_truth = likelihood.coordinates.vector({**OFF, **TRUE})
    likelihood = likelihood.resettled_at(at_truth)
    moves = likelihood.moved_by_sampling(at_truth)
    assert moves.shape == (PHASES, likelihood.coordinates.size)
    assert np.abs(moves.sum(axis=0)).max() < 1e-6 * np.abs(moves).max()
    # An instant of some milliseconds is a delay of less, however dead time and lag share it.
    late = sum(moves[:, likelihood.coordinates.place(name)] for name in ("T_d", "tau_act", "T_f"))
    assert 0.0 < np.abs(late).max() < 0.01
