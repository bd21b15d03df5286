"""Where the governor is not the model's, the load's side is told alone, and nothing of the engine."""

from dataclasses import replace

import numpy as np
import pytest

import shipfp_rs as fp
from tests.families import other_governors
from tests.families.draw import draw
from tests.identification.parity import Case, simulated


@pytest.fixture(scope="module")
def undescribed():
    ship = other_governors.draw("dead_band", 150000)
    return ship, fp.identify(fp.Experiment(**ship.experiment()), torque=ship.place)


def test_a_dead_band_leaves_the_loads_side_alone(undescribed):
    ship, found = undescribed
    assert found.adequate["sides"] == {"load": True, "engine": False}
    assert found.usable.startswith("Usable for simulation and comparison of the load's side only")
    assert found.usability == "usable except"
    inertia = "tau_prop" if ship.place == "gauge" else "tau_n"
    for name in ("p", inertia):
        low, high = found.parameters[name].ci95
        assert low <= ship.parameters[name] <= high
    for name in ("g", "vK_p", "vK_i"):
        assert found.parameters[name].status == "unidentifiable"
        assert "gain changes with the error" in found.parameters[name].reason
    assert not found.derived


def test_it_is_read_as_it_was_saved(undescribed, tmp_path):
    _, found = undescribed
    read = fp.Fingerprint.load(found.save(tmp_path / "fingerprint.json"))
    assert read.load_side == found.load_side
    assert read.adequate["sides"] == found.adequate["sides"]
    assert read.parameters == found.parameters
    assert read.adequate["engine_curves"] == found.adequate["engine_curves"] != {}


def test_a_smooth_ship_has_both_sides_and_they_agree():
    ship = next(one for one in (draw("launch", seed) for seed in range(160200, 160230)) if smooth(one))
    others = dict.fromkeys(("torque_limit", "rack_rate", "twist"), False)
    found = fp.identify(fp.Experiment(**ship.experiment()), elements=others, intervals="symmetric")
    assert found.adequate["sides"] == {"load": True, "engine": True}
    alone, whole = found.load_side["p"], found.parameters["p"]
    assert set(found.adequate["engine_curves"]) == {"error", "slope"}
    assert abs(alone.value - whole.value) < 3.5 * (alone.std**2 + whole.std**2) ** 0.5


def smooth(ship):
    return not {"M_max", "rate"} & set(ship.truth()["on"])


def limited(rate, gauge, seconds, rate_hz=50.0):
    """A ship whose rack is nearly always in its limit of rate, with some noise."""
    return noisy(Case(own={"rate": rate, "rate_down": rate}, seconds=seconds, gauge=gauge, rate_hz=rate_hz))


def noisy(case):
    _, clean = simulated(case)
    random = np.random.default_rng(1)
    signals = {
        name: row + (0.0 if name == "n_set" else 0.5) * random.standard_normal(len(row))
        for name, row in clean.signals.items()
    }
    return replace(clean, signals=signals)


@pytest.mark.parametrize(("gauge", "seconds"), [(True, 120.0), (False, 240.0)])
def test_a_ship_in_its_limit_hardly_follows_and_its_load_is_told_all_the_same(gauge, seconds):
    experiment = limited(0.02, gauge, seconds)
    assert np.corrcoef(experiment.dn_set, experiment.normalised("n_e"))[0, 1] < 0.3
    found = fp.identify(experiment, torque="gauge" if gauge else "brake")
    assert found.usability != "usable"
    low, high = found.load_side["p"].ci95
    assert low <= 2.15 <= high


def test_a_rate_limit_is_searched_with_what_it_takes_off_put_back():
    # Once an internal error: the stepper has another name for the limit.
    elements = dict.fromkeys(("torque_limit", "twist", "actuator_lag", "sampling"), False)
    record = limited(0.15, gauge=False, seconds=30.0, rate_hz=20.0)
    found = fp.identify(record, torque="brake", elements={**elements, "rack_rate": True})
    assert found.usability != "usable"


@pytest.mark.parametrize("gauge", [True, False])
def test_cases_a_brake_torque_called_gauge_is_told(gauge):
    found = fp.identify(noisy(Case(gauge=gauge)), torque="gauge")
    told = (
        "the torque is hardly a gauge's, since 9" in found.usable and "say torque = brake" in found.verdict[0]
    )
    assert told is not gauge
    assert found.usability == ("usable" if gauge else "usable except")


def test_cases_a_gauge_torque_called_brake_is_not_usable():
    assert fp.identify(noisy(Case(gauge=True, seconds=150.0)), torque="brake").usability == "not usable"
