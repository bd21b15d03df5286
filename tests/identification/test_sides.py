"""Where the governor is not the model's, the load's side is told alone, and nothing of the engine."""

import pytest

import shipfp_rs as fp
from tests.families import other_governors
from tests.families.draw import draw


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
    found = fp.identify(fp.Experiment(**ship.experiment()))
    assert found.adequate["sides"] == {"load": True, "engine": True}
    alone, whole = found.load_side["p"], found.parameters["p"]
    assert set(found.adequate["engine_curves"]) == {"error", "slope"}
    assert abs(alone.value - whole.value) < 3.5 * (alone.std**2 + whole.std**2) ** 0.5


def smooth(ship):
    return not {"M_max", "rate"} & set(ship.truth()["on"])
