"""What moving water tells about the engine's side, and the end of the shaft at which the speed is measured."""

from pathlib import Path

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.identification.moving_water import water_of
from shipfp_rs.identification.question import question_of
from shipfp_rs.structures.transfer import TransferFunctions
from tests.identification.parity import Case, at_the_truth

TUGS = Path(__file__).parents[1] / "data" / "heavy_tugs.npz"
NAMES = ("tau_n", "tau_prop", "p", "g", "vK_p", "vK_i", "T_d", "T_set", "tau_act", "tau_twist")
RECORDED = {name: {"signal": name, "rate_hz": 2500.0} for name in ("n_set", "n_e", "M_g")}


def tug(name: str, shaft: str) -> tuple[fp.Experiment, dict[str, float]]:
    """A heavy tug in wake, simulated without the package: shafts of 10 and 11 Hz, pulses on the propeller's shaft."""
    with np.load(TUGS) as data:
        signals = {one: 1000.0 * (1.0 + data[f"{name}_{one}"].astype(float)) for one in RECORDED}
        truth = dict(zip(NAMES, data[f"{name}_truth"].tolist(), strict=True))
    provenance = {"filter": "as processed", "recorded": RECORDED, "speed": {"shaft": shaft}}
    point = dict.fromkeys(signals, 1000.0)
    return fp.Experiment(name, 50.0, signals, point, kind="chirp", provenance=provenance), truth


@pytest.mark.parametrize("name", ["tug15", "tug24"])
def test_a_heavy_tug_in_wake_is_told_with_its_inertia_and_its_shaft(name):
    experiment, truth = tug(name, "propeller")
    found = fp.identify(experiment)
    for one, true in truth.items():
        low, high = found[one].ci95
        assert low <= true <= high, one
    assert found.usability == "usable"
    assert found["tau_n"].std < 0.02 * truth["tau_n"]
    # Unknown lags, of the speed's filter and of the engine's torque, are part of it.
    assert found["T_d"].std < 0.15 * truth["T_d"]
    assert found.elements["twist"]["state"] == "on"


def test_a_speed_on_the_other_side_of_the_shaft_hides_the_twist():
    experiment, _ = tug("tug24", "engine")
    assert fp.identify(experiment).elements["twist"]["state"] != "on"


S = 2j * np.pi * np.linspace(0.0, 2.0, 801)
SIDE, LOAD = -(3.0 + 2.0 / (S + 0.1) + 0.8 * S), 2.0 + 0.4 * S


def moved(ratio: np.ndarray, noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of a speed, and of a torque that moves with it by a ratio."""
    random = np.random.default_rng(seed)
    speed, own = random.standard_normal((2, len(S))) + 1j * random.standard_normal((2, len(S)))
    return speed, ratio * speed + noise * np.abs(ratio) * own


def test_the_ratio_of_torque_to_speed_is_that_of_the_engines_side():
    hz = np.abs(S) / (2.0 * np.pi)
    speed, torque = moved(SIDE, 0.05)
    water = water_of(hz, speed, torque, 1.2 * SIDE, LOAD, 1e-3, 0.0)
    rows = water.rows(SIDE[np.searchsorted(hz, water.s.imag / (2.0 * np.pi))], np.empty((0, len(water.s))))
    assert len(water.s) > 8
    assert np.abs(water.ratio - 1.0 / 1.2).max() < 0.05
    assert np.abs(rows[0]).max() < 4.0


@pytest.mark.parametrize(("ratio", "noise"), [(SIDE, 3.0), (LOAD, 0.05)], ids=["noise", "a wrong governor"])
def test_residuals_that_no_load_causes_tell_nothing(ratio, noise):
    hz = np.abs(S) / (2.0 * np.pi)
    assert water_of(hz, *moved(ratio, noise), SIDE, LOAD, 1e-3, 0.0) is None


@pytest.mark.parametrize("speed", ["engine", "propeller"])
@pytest.mark.parametrize("gauge", [True, False])
def test_the_ratio_is_that_of_a_load_and_its_derivatives_are_differences(speed, gauge):
    values = {
        "tau_n": 1.2,
        "tau_prop": 0.4,
        "g": -0.5,
        "vK_p": 4.5,
        "vK_i": 10.0,
        "p": 2.1,
        "T_d": 0.07,
        "tau_act": 0.05,
        "tau_twist": 3e-3,
        "zeta_twist": 0.4,
        "T_s": 0.03,
    }
    loop = TransferFunctions(("dn", "dM"), gauge, speed)
    s = 2j * np.pi * np.array([0.1, 0.7, 2.0])
    names = [name for name in values if name != "p"]
    ratio, slopes = loop.torque_over_speed(values, s, names)
    for name, slope in zip(names, slopes, strict=True):
        step = 1e-6 * max(values[name], 1.0)
        ends = [
            loop.torque_over_speed(values | {name: values[name] + by * step}, s, [])[0] for by in (1.0, -1.0)
        ]
        np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2.0 * step), rtol=1e-5, atol=1e-6)
    # The engine's side alone: the load's law has no part in it.
    np.testing.assert_allclose(loop.torque_over_speed(values | {"p": 0.3}, s, [])[0], ratio, rtol=1e-12)


def test_calm_water_tells_nothing():
    likelihood, vector = at_the_truth(Case(seconds=100.0))
    assert likelihood.with_noise(vector).models[0].water is None


def test_a_search_stays_within_reach_of_what_is_known_of_every_ship():
    c = question_of([tug("tug15", "propeller")[0]]).likelihood(None).coordinates
    assert c.free["T_M"] == pytest.approx((-0.037, 0.043), rel=0.01)
    assert c.free["tau_twist"] == (0.0, pytest.approx(0.02))
