"""A load that is a shaft's torque ends the model at its meter; a load that is no torque has its own gain."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.closed_loop import closed_loop
from shipfp_rs.identification.whole_ship import whole_ship
from shipfp_rs.report.answer import loop_rows
from shipfp_rs.report.markup import Say
from shipfp_rs.report.operating import feeds_a_generator

BEFORE_S, BEHIND_S, EXPONENT, PITCH_GAIN = 0.9, 0.4, 2.0, 1.6
RATE_HZ, GEAR = 50.0, 4.9


def boat(load: str, moves: float = 0.0) -> fp.Experiment:
    """Pitch steps; the load is the shaft's torque behind a gear, or the pitch in per cent.

    The set point rests, or is a chirp of this amplitude.
    """
    steps, down = 120 * 50, 8
    dt = 1.0 / (RATE_HZ * down)
    at = np.arange(4.0, 118.0, 7.3)
    levels = np.random.default_rng(2).uniform(-0.12, 0.12, len(at))
    time = np.arange(steps * down) * dt
    pitch = np.interp(time, np.ravel([[t, t + 1.5] for t in at]), np.repeat(np.r_[0.0, levels], 2)[1:-1])
    dead = round(0.05 / dt)
    wanted = moves * np.sin(2.0 * np.pi * (0.05 + 0.006 * time) * time)
    speed, error, asked = 0.0, 0.0, np.zeros(steps * down)
    rows = np.empty((steps * down, 3))
    for k in range(steps * down):
        asked[k] = 8.0 * (wanted[k] - speed) + 6.0 * error
        brake = -0.5 * speed + (asked[k - dead] if k >= dead else 0.0)
        law = (1.0 + speed) ** EXPONENT * (1.0 + PITCH_GAIN * pitch[k]) - 1.0
        slope = (brake - law) / (BEFORE_S + BEHIND_S)
        rows[k] = speed, brake, law + BEHIND_S * slope
        speed += dt * slope
        error += dt * (wanted[k] - speed)
    random = np.random.default_rng(3)
    noise = random.standard_normal((3, steps)) * np.array([[2e-4], [2e-3], [2e-3]])
    n, brake, shaft = rows.reshape(steps, down, 3).mean(axis=1).T + noise
    pitch = pitch.reshape(steps, down).mean(axis=1)
    wanted = wanted.reshape(steps, down).mean(axis=1)
    signals = {"n_set": 1600.0 * (1.0 + wanted), "n_e": 1600.0 * (1.0 + n), "M_b": 2300.0 * (1.0 + brake)}
    point = {"n_set": 1600.0, "n_e": 1600.0, "M_b": 2300.0}
    own = 70.0 if load == "other" else 2300.0 * GEAR
    signals["M_load"] = own * (1.0 + (pitch if load == "other" else shaft))
    told = {"load": {"quantity": load, "torque_ratio": GEAR}}
    return fp.Experiment("pitch", RATE_HZ, signals, point | {"M_load": own}, provenance=told)


@pytest.fixture(scope="module")
def metered() -> fp.Fingerprint:
    return fp.identify(boat("torque"), torque="brake", intervals="symmetric")


@pytest.fixture(scope="module")
def pitched() -> fp.Fingerprint:
    return fp.identify(boat("other"), torque="brake", intervals="symmetric")


def test_a_shaft_torque_as_load_makes_the_figures_those_before_its_meter(metered: fp.Fingerprint) -> None:
    assert metered["tau_n"].value == pytest.approx(BEFORE_S, rel=0.1)
    assert metered.ends_at_meter
    assert metered.usability == "usable except"
    assert "of the inertia on the drive's side" in metered.verdict[1]
    assert not any("is the channel a torque?" in line for line in metered.verdict)
    assert metered.to_dict()["data"][0]["load"] == {"quantity": "torque", "share": pytest.approx(1.0)}
    assert not feeds_a_generator(metered, metered.experiments, None)


def test_a_moving_set_point_gives_the_whole_ship_behind_the_meter(tmp_path: Path) -> None:
    found = fp.identify(boat("torque", 0.03), torque="brake")
    assert found.ends_at_meter
    assert found.usability == "usable"
    assert "estimated from speed and this torque: p =" in found.verdict[1]
    ship = whole_ship(found)
    for name, truth in {"tau_n": BEFORE_S + BEHIND_S, "tau_prop": BEHIND_S}.items():
        low, high = ship[name].ci95
        assert low < truth < high
        assert high - low < 0.15 * truth
    # Without pitch the load rises with the speed's square; pitch steps change its mean slope.
    assert ship["p"].value == pytest.approx(EXPONENT, rel=0.2)
    per_second = 2300.0 / (2.0 * np.pi * 1600.0 / 60.0)
    assert found.si["inertia"]["value"] == pytest.approx(1.3 * per_second, rel=0.05)
    assert found.si["inertia_before_meter"]["value"] == pytest.approx(BEFORE_S * per_second, rel=0.02)
    hz = np.geomspace(0.1, 10.0, 10_000)
    jw = 2j * np.pi * hz
    loop = np.exp(-0.05 * jw) * (8.0 + 6.0 / jw) / (1.3 * jw + EXPONENT + 0.5)
    crossed = int(np.argmin(np.abs(np.abs(loop) - 1.0)))
    truth = {"crossover": hz[crossed], "phase margin": 180.0 + np.degrees(np.angle(loop[crossed]))}
    kept = fp.Fingerprint.load(found.save(tmp_path / "fingerprint.json"))
    margins = kept.margins()
    for name in ("crossover", "phase margin"):
        low, high = margins[name].ci95
        assert low < truth[name] < high


def test_a_drive_without_a_governor_is_whole_behind_the_meter_too() -> None:
    trial = boat("torque", 0.03)
    signals = {**trial.signals, "command": trial.signals["M_b"]}
    point = {**trial.operating_point, "command": trial.operating_point["M_b"]}
    del signals["n_set"], point["n_set"]
    found = fp.identify(replace(trial, signals=signals, operating_point=point))
    low, high = whole_ship(found)["tau_n"].ci95
    assert low < BEFORE_S + BEHIND_S < high
    assert found.si["inertia"]["value"] > found.si["inertia_before_meter"]["value"]


def test_no_damping_is_judged_of_an_engine_without_its_propeller(metered: fp.Fingerprint) -> None:
    loop = closed_loop(metered)
    slow = {**loop, "phase margin": replace(loop["phase margin"], value=20.0)}
    rows = loop_rows(slow, Say(), of_ship=not metered.ends_at_meter)
    assert "of the drive alone" in [row[-1] for row in rows]
    assert "close to oscillation" in [row[-1] for row in loop_rows(slow, Say())]


def test_a_pitch_as_load_has_its_own_gain_and_leaves_the_ship_whole(pitched: fp.Fingerprint) -> None:
    assert not pitched.ends_at_meter
    assert pitched["k_L"].value == pytest.approx(PITCH_GAIN, rel=0.05)
    low, high = pitched["tau_n"].ci95
    assert low < BEFORE_S + BEHIND_S < high
    assert pitched.elements["load"]["words"] == "measured load"
    assert pitched.first().unit("M_load") == ""


@pytest.mark.parametrize("scale", [10.0, 80.0])
def test_a_pitch_that_is_called_a_torque_is_doubted(scale: float) -> None:
    pitch = boat("other")
    signals = {**pitch.signals, "M_load": scale * pitch.signals["M_load"]}
    told = {"load": {"quantity": "torque", "torque_ratio": GEAR}}
    point = {**pitch.operating_point, "M_load": scale * 70.0}
    found = fp.identify(
        replace(pitch, signals=signals, operating_point=point, provenance=told),
        torque="brake",
        intervals="symmetric",
    )
    assert any("is the channel a torque?" in line for line in found.verdict), (
        found["k_L"],
        found.verdict[:2],
    )


def test_a_load_of_another_kind_needs_a_torque_and_keeps_its_own_scale() -> None:
    pitch = boat("other")
    assert np.ptp(pitch.normalised("M_load")) == pytest.approx(np.ptp(pitch.signals["M_load"]) / 70.0)
    assert pitch.load == {"quantity": "other", "share": 1.0}
    with pytest.raises(fp.InputError, match="operating point of 'M_load' is 0"):
        replace(pitch, operating_point={**pitch.operating_point, "M_load": 0.0})
