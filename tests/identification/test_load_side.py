"""The load's side by itself: p, inertia and lateness, whatever governor moves the ship."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import shipfp_rs as fp
from tests.families import draw, excitations, other_governors, sensors

SILENT = (sensors.Noise(()), sensors.Noise(()))


def other(kind: str, place: str, *, noisy: bool = False) -> other_governors.OtherGovernor:
    """Return a ship of 200 s of multisine, dry, with or without noise."""
    found = other_governors.draw(kind, 140000)
    random = np.random.default_rng(1)
    excitation = excitations.drawn(random, "multisine", 201.0)
    noise = (sensors.speed_noise(random), sensors.torque_noise(random)) if noisy else SILENT
    return replace(found, place=place, excitation=excitation, water=None, noise=noise, torque_delay_s=0.003)


def experiment(ship: other_governors.OtherGovernor, **changes: object) -> fp.Experiment:
    return fp.Experiment(**ship.experiment() | changes)


def without(one: fp.Experiment, *names: str) -> fp.Experiment:
    """Return an experiment without some of its signals."""
    left = {name: row for name, row in one.signals.items() if name not in names}
    return replace(one, signals=left, operating_point={name: one.operating_point[name] for name in left})


@pytest.mark.parametrize(
    ("kind", "place", "inertia"),
    [
        (kind, *(("gauge", "tau_prop"), ("brake", "tau_n"))[index % 2])
        for index, kind in enumerate(other_governors.KINDS)
    ],
)
def test_known_answer_without_noise_under_any_governor(kind: str, place: str, inertia: str) -> None:
    ship = other(kind, place)
    found = fp.load_side(experiment(ship)).parameters
    assert list(found) == ["p", "c_2", inertia, "T_M", "torque scale"]
    assert found["p"].value == pytest.approx(ship.parameters["p"], rel=2e-3)
    assert found[inertia].value == pytest.approx(ship.parameters[inertia], rel=0.01)
    assert found["T_M"].value == pytest.approx(0.003, abs=1.5e-3)
    assert found["torque scale"].value == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("kind", ["way_down", "dead_band"])
def test_intervals_hold_with_noise(kind: str) -> None:
    ship = other(kind, "brake", noisy=True)
    found = fp.load_side(experiment(ship)).parameters
    for name in ("p", "tau_n"):
        low, high = found[name].ci95
        assert low < ship.parameters[name] < high
        assert high - low < 0.1 * ship.parameters[name]


def test_a_ship_that_its_limit_keeps_from_its_set_point_is_not_refused() -> None:
    ship = other("way_down", "gauge")
    lame = replace(ship, parameters=ship.parameters | {"up": 0.03, "down": 0.02, "vK_p": 2.0})
    one = experiment(lame)
    asked, speed = one.dn_set, one.normalised("n_e")
    assert np.corrcoef(asked, speed)[0, 1] < 0.5
    found = fp.load_side(one).parameters
    assert found["p"].value == pytest.approx(ship.parameters["p"], rel=0.02)


def test_records_are_fitted_together_each_with_a_scale_of_its_own() -> None:
    one = other("gain", "brake", noisy=True)
    both = [experiment(one), experiment(replace(one, seed=one.seed + 1), name="again")]
    point = both[1].operating_point
    both[1] = replace(both[1], operating_point={**point, "M_b": 1.01 * point["M_b"]})
    alone, joint = fp.load_side(both[0]), fp.load_side(both)
    assert [record.name for record in joint.records] == [both[0].name, "again"]
    assert joint.records[1].torque_scale.value == pytest.approx(0.99, abs=3e-3)
    assert "torque scale" not in joint.parameters
    assert joint.covariance.shape == (4, 4)
    assert joint.parameters["tau_n"].std < alone.parameters["tau_n"].std


def test_a_measured_load_is_the_instrument_where_the_set_point_rests() -> None:
    ship = draw.draw("genset", 140011, kind="steps", longest_s=201.0)
    assert ship.on == ("T_d", "T_s", "load")
    resting = replace(
        ship, excitation=replace(ship.excitation, table=ship.excitation.table * [1.0, 0.0] + [0.0, 1.0])
    )
    one = fp.Experiment(**resting.experiment())
    assert np.std(one.dn_set) < 1e-3
    found, truth = fp.load_side(one, torque=ship.place).parameters, ship.truth()["parameters"]
    inertia = "tau_prop" if ship.place == "gauge" else "tau_n"
    for name, true in ((inertia, truth[inertia]), ("k_L", 1.0), ("p", truth["p"] + truth["damping"])):
        assert abs(found[name].value - true) < 3.0 * found[name].std
    assert found["k_L"].std < 0.05
    with pytest.raises(fp.InputError, match="nothing excites the ship"):
        fp.load_side(without(one, "M_load"))


def test_inertia_in_si_of_the_engine_or_through_the_gear() -> None:
    ship = other("gain", "brake")
    one = experiment(ship)
    alone = fp.load_side(one)
    tau, point = alone.parameters["tau_n"], one.operating_point
    assert alone.si["inertia"]["seen_from"] == "engine"
    assert alone.si["inertia"]["value"] == pytest.approx(
        tau.value * point["M_b"] / (2 * np.pi * point["n_e"] / 60.0)
    )
    vessel = fp.Vessel.load("stan-launch-804")
    geared = fp.load_side(one, vessel=vessel).si["inertia"]
    ratio = vessel.gearbox.ratio
    assert geared["seen_from"] == "propeller shaft"
    assert geared["value"] == pytest.approx(alone.si["inertia"]["value"] * ratio * vessel.torque_ratio)
    assert fp.load_side(one, vessel="stan-launch-804").si["inertia"] == geared
    assert fp.load_side(experiment(other("gain", "gauge"))).si == {}


def test_the_same_data_give_the_same_answer_and_a_short_word() -> None:
    one = experiment(other("gain", "gauge"))
    first, again = fp.load_side(one), fp.load_side([one])
    assert first.parameters == again.parameters
    np.testing.assert_array_equal(first.covariance, again.covariance)
    assert repr(first).startswith("LoadSide(gauge: p 2.")
    assert len(repr(first)) < 200


def test_bad_inputs_are_told_in_one_line() -> None:
    one = experiment(other("gain", "gauge"))
    still = {**one.signals, "n_set": np.full(len(one), one.operating_point["n_set"])}
    alien = 1200.0 + 20.0 * np.sin(2.0 * np.pi * 0.7131 * one.time)
    mirrored = {**one.signals, "M_g": 2.0 * one.operating_point["M_g"] - one.signals["M_g"]}
    masked = {**one.signals, "M_g": np.full(len(one), np.nan)}
    for data, said in (
        ([], "no experiment, expected one or more"),
        (without(one, "M_g"), "no torque in every experiment, expected one of M_b, M_s, M_g"),
        (without(one, "n_e"), "no experiment has a speed, expected the signal n_e or n_s"),
        (replace(one, signals=still), "the set point moves by 0 %, expected .*nothing excites the ship"),
        (replace(one, signals={**one.signals, "n_set": alien}), "next to nothing of the speed"),
        (replace(one, signals=masked), "every sample of M_g is masked"),
        (replace(one, signals=mirrored), "M_g falls while the shaft speeds up"),
        (
            replace(one, signals={**one.signals, "M_g": 0.0 * still["n_set"] + one.operating_point["M_g"]}),
            "M_g stands still",
        ),
        (one.window(60.0, 70.0), "expected .* s or more"),
    ):
        with pytest.raises(fp.InputError, match=said) as found:
            fp.load_side(data)
        assert "\n" not in str(found.value)
