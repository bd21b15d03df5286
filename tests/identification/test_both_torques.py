"""A brake's torque measured beside a gauge's: the engine's inertia takes their difference, whatever the governor does."""

from dataclasses import replace

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.errors import InputError
from shipfp_rs.structures.structure import Structure
from tests.identification.parity import Case, simulated

BOTH = ["n_e", "M_g", "M_b"]


def recorded(own=None, seed=1, noise=(2e-4, 3e-3, 3e-3), scale=1.0):
    """Truth, and a record of speed and both torques with white noise; the brake's torque is read by a scale."""
    truth, experiment = simulated(Case(both=True, own={"tau_act": 0.05, **(own or {})}, seconds=150.0))
    rng = np.random.default_rng(seed)
    signals = dict(experiment.signals)
    for name, level in zip(BOTH, noise, strict=True):
        signals[name] = signals[name] + 1000.0 * level * rng.normal(size=len(signals[name]))
    signals["M_b"] = signals["M_b"] * scale
    return truth, replace(experiment, signals=signals)


def outside(estimate, value):
    """How far a value lies outside of an interval, over the interval's length."""
    low, high = estimate.ci95
    return max(low - value, value - high, 0.0) / (high - low)


@pytest.fixture(scope="module")
def fitted():
    truth, experiment = recorded({"T_M": 0.004, "T_B": 0.004}, scale=1.02)
    return truth, experiment, fp.identify(experiment, outputs=BOTH)


def test_every_parameter_holds_the_truth(fitted):
    truth, _, found = fitted
    assert set(found.data[0]["signals"].values()) == set(BOTH)
    for name in ("tau_n", "g", "vK_p", "vK_i", "p", "tau_prop", "T_d", "T_set", "tau_act", "T_M", "T_B"):
        one = found.parameters[name]
        assert outside(one, truth[name]) <= 0.2, name


def test_the_inertia_is_told_without_the_governor(fitted):
    _, experiment, both = fitted
    alone = fp.identify(experiment, outputs=["n_e", "M_g"])
    assert alone.data[0]["signals"]["dM"] == "M_g"
    widths = [np.ptp(one.parameters["tau_n"].ci95) for one in (alone, both)]
    assert widths[1] < 0.5 * widths[0]


def test_a_given_ship_is_fitted_the_same(fitted):
    _, experiment, found = fitted
    ship = Structure.ship(
        ["dead_time_loop", "dead_time_set_point", "actuator_lag", "curvature", "late_torque", "late_brake"],
        torque="gauge",
        outputs=["dn", "dM", "dM_b"],
    )
    given = fp.identify(experiment, ship)
    for name in ("tau_n", "g", "vK_p", "tau_prop", "T_B"):
        one, other = found.parameters[name], given.parameters[name]
        assert abs(one.value - other.value) < 0.25 * np.ptp(one.ci95), name


def test_predictions_have_both_torques(fitted):
    _, experiment, found = fitted
    predicted = found.predict()
    for name, level in (("M_g", 3e-3), ("M_b", 3e-3)):
        left = predicted.signals[name] - experiment.signals[name]
        assert left.std() < 1.1 * 1000.0 * level, name


def test_a_shaft_that_twists_is_found():
    truth, experiment = recorded({"tau_twist": 0.004, "zeta_twist": 0.5})
    found = fp.identify(experiment, outputs=BOTH, elements={"twist": True})
    for name in ("tau_n", "tau_prop", "tau_twist", "p"):
        one = found.parameters[name]
        assert outside(one, truth[name]) <= 0.2, name


def test_a_brake_stands_beside_a_gauge_only():
    _, experiment = recorded()
    signals = {name: row for name, row in experiment.signals.items() if name != "M_g"}
    with pytest.raises(InputError, match="'dM_b' stands beside a gauge's, expected the signal M_g, too"):
        fp.identify(replace(experiment, signals=signals), outputs=["dn", "dM", "dM_b"])
    with pytest.raises(InputError, match="output 'dM_b', expected some of dn, dM, dE, dX"):
        Structure.ship(outputs=["dn", "dM", "dM_b"])
