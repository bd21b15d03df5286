"""What the engine's side has beyond the model shows in what a smooth fit leaves, before anything more is fitted."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.identification.engine_tests import engine_curves, engine_tests, suspected
from shipfp_rs.identification.noise import real_rows, turned
from shipfp_rs.identification.question import question_of
from shipfp_rs.identification.ship_fit import smooth_ship
from shipfp_rs.identification.stretches import Stretches
from tests.families import other_governors
from tests.identification.parity import Case, simulated


def noisy(own, noise=1.0, **recorded):
    _, clean = simulated(Case(**{"own": own, "seconds": 120.0, "gauge": False, **recorded}))
    random = np.random.default_rng(7)
    signals = {
        name: row + (0.0 if name == "n_set" else noise) * random.standard_normal(len(row))
        for name, row in clean.signals.items()
    }
    return replace(clean, signals=signals)


def smooth_fit(experiment, torque="brake"):
    return smooth_ship(question_of([experiment], torque=torque))


@cache
def fit_of(kind=None, seed=None):
    """The smooth fit of a ship with another governor, or of one without anything beyond the model."""
    if kind is None:
        return smooth_fit(noisy({}))
    ship = other_governors.draw(kind, seed)
    return smooth_fit(fp.Experiment(**ship.experiment()), ship.place)


def test_a_smooth_ship_shows_nothing():
    assert suspected(engine_tests(fit_of())) is None
    for curve in curves(fit_of()).values():
        assert np.all(np.diff(curve["at"]) > 0.0)
        assert np.abs(curve["torque"] / curve["std"]).max() < 3.5
        assert np.abs(curve["torque"]).max() < 1e-3


@pytest.mark.parametrize(
    ("own", "element"),
    [
        ({"M_max": 1.12, "M_soft": 0.003}, "torque_limit"),
        ({"rate": 0.5, "rate_down": 0.5}, "rack_rate"),
    ],
)
def test_a_limit_that_acts_is_shown(own, element):
    assert suspected(engine_tests(smooth_fit(noisy(own)))) == element


@pytest.mark.parametrize(
    ("kind", "seed", "shown"),
    [
        ("dead_band", 150000, "gain"),
        ("way_down", 150002, "rack_rate"),
        ("schedule", 224003, "asymmetry"),
        ("cascade", 224006, "lag"),
    ],
)
def test_a_governor_that_the_model_has_not_is_shown(kind, seed, shown):
    assert suspected(engine_tests(fit_of(kind, seed))) == shown


def test_a_score_is_how_far_the_deviance_falls_with_the_shape_as_one_unknown_more():
    fit = fit_of("cascade", 224006)
    likelihood, vector = fit.likelihood, fit.best.vector
    shape = np.array([likelihood.records[0].see(likelihood.modelled(vector, 0)[0] ** 2)] * 2)
    shape[:, 0] = 0.0
    score = Stretches(likelihood, vector, [shape[None]]).scores()[0]
    rows = likelihood.whitened(vector)
    white = real_rows(turned(likelihood.root(0), shape[None]))[0]
    more = np.concatenate([white, np.zeros(len(rows) - len(white))])
    low, high = likelihood.coordinates.bounds
    moves = np.ones(rows.shape[1] - 1, bool)
    moves[: len(vector)] = (vector > low + 1e-9) & (vector < high - 1e-9)

    def left(columns):
        return np.sum((rows[:, 0] - columns @ np.linalg.lstsq(columns, rows[:, 0], rcond=None)[0]) ** 2)

    known = rows[:, 1:][:, moves]
    assert score.fall == pytest.approx(left(known) - left(np.column_stack([known, more])), rel=1e-3)


def test_without_a_torque_nothing_is_asked():
    experiment = noisy({})
    question = question_of([experiment], outputs=["dn"])
    assert engine_tests(smooth_ship(question)) == {}


def curves(fit):
    return {
        name: {key: np.array(row) for key, row in one.items()} for name, one in engine_curves(fit).items()
    }


def test_a_dead_band_bends_the_curve_against_the_error_into_an_s():
    ship = other_governors.draw("dead_band", 150000)
    curve = curves(fit_of("dead_band", 150000))["error"]
    within = np.abs(curve["at"]) < 1.5 * ship.parameters["band"]
    for side in (-1.0, 1.0):
        this = side * curve["at"] > 0.2 * ship.parameters["band"]
        assert np.all(-side * curve["torque"][within & this] > 2.0 * curve["std"][within & this])
        assert side * curve["torque"][this][0 if side < 0.0 else -1] > 2.0 * curve["std"][this][0]


def test_residuals_of_a_ship_in_its_limit_make_no_curve():
    fit = fit_of()
    limited = replace(fit, likelihood=fit.question.with_elements(fit.likelihood, ["rack_rate"]))
    assert engine_curves(limited) == {}
