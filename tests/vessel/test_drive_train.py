"""Vessels with more than the thesis's plant: dead times, sampling, limits, firing, a flexible shaft, a moving ship."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.signal import find_peaks

from shipfp_rs import signals
from shipfp_rs.errors import InputError
from shipfp_rs.inspection.checks import amplitude_spectrum
from shipfp_rs.simulation.raw_log import TABLE_6_6, simulate_raw_log
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.support.toml import built_in
from shipfp_rs.vessel.drive_train import drive_train
from shipfp_rs.vessel.linear_model import LinearModel, linearise, linearise_numerically
from shipfp_rs.vessel.steady_state import steady_state
from shipfp_rs.vessel.vessel import Vessel

TUG = Vessel.load("stan-tug-1205")
FULL = Vessel.load("stan-tug-1205-full")
SMOOTH = FULL.replace(
    {
        "engine.firing": None,
        "governor.once_a_firing": False,
        "governor.sample_rate_hz": 60.0,
        "propeller.shaft_ripple": 0.0,
        "propeller.blade_ripple": 0.0,
    }
)
"""Without ripple, the governor sampling as often: what a linear model can describe."""
SHIP = {"mass_kg": 2.0e4, "resistance_N_s2_m2": 3000.0, "propellers": 2, "wake_fraction": 0.05}
ANGLES = tuple(range(-180, 180, 5))
FOUR_QUADRANT = {
    "angle_deg": ANGLES,
    "C_Q": tuple(math.cos(math.radians(angle)) - 0.3 * math.sin(math.radians(angle)) for angle in ANGLES),
    "C_T": tuple(math.cos(math.radians(angle)) - 0.5 * math.sin(math.radians(angle)) for angle in ANGLES),
}
ELEMENTS: dict[str, dict[str, Any]] = {
    "fuel dead time": {"actuator.dead_time_s": 0.1},
    "actuator lag": {"actuator.lag_s": 0.05},
    "rack rate": {"actuator.rate_mm_s": 50.0},
    "torque rate": {"engine.torque_rate_Nm_s": 500.0},
    "smoke limiter": {"engine.smoke_margin_mm": 1.0},
    "firing": {"engine.firing": {}},
    "governor once a firing": {"engine.firing": {}, "governor.once_a_firing": True},
    "sampled governor": {"governor.sample_rate_hz": 50.0},
    "computation delay": {"governor.computation_delay_s": 0.02},
    "set-point dead time": {"governor.set_point_dead_time_s": 0.25},
    "PID": {"governor.K_d": 0.1},
    "rack stops": {"governor.minimum_rack_mm": 2.0, "governor.maximum_rack_mm": 20.0},
    "drag": {"gearbox.drag_Nm": 30.0},
    "flexible shaft": {"shaft.stiffness_Nm_rad": 8e4},
    "ripple": {"propeller.blade_ripple": 0.02},
    "four quadrants": {"propeller.four_quadrant": FOUR_QUADRANT},
    "ship": {"ship": SHIP},
}


def _response(ship: Vessel, frequency: float, amplitude_rpm: float = 0.1) -> dict[str, complex]:
    """Settled response of engine speed and gauge torque to a small sine, over the set point."""
    rate, settle = 500.0 * frequency, math.ceil(60.0 * frequency)
    sine = signals.sine_sequence([frequency], settle + 2, amplitude_rpm, rate_hz=rate)
    experiment = simulate(ship, sine, limits=False)
    turns = np.exp(-2j * np.pi * frequency * np.arange(1000) / rate)
    lines = {name: np.mean(experiment.normalised(name)[-1000:] * turns) for name in ("n_set", "n_e", "M_g")}
    return {name: complex(lines[name] / lines["n_set"]) for name in ("n_e", "M_g")}


def _error(ship: Vessel, model: LinearModel, frequency: float) -> float:
    """Largest error of the plant's response against a linear model, relative."""
    exact = dict(zip(("n_e", "M_g"), model.response([frequency], ["dn", "dM_g"])[:, 0], strict=True))
    return max(abs(found / exact[name] - 1.0) for name, found in _response(ship, frequency).items())


@pytest.mark.parametrize("element", ELEMENTS)
def test_each_element_is_off_until_it_is_configured(element: str) -> None:
    assert not drive_train(TUG).extends_the_plant
    assert drive_train(TUG.replace(ELEMENTS[element])).extends_the_plant


@pytest.mark.parametrize("frequency", [0.05, 0.5, 2.0])
@pytest.mark.parametrize(
    "changes",
    [
        {"actuator.dead_time_s": 0.1, "governor.set_point_dead_time_s": 0.3},
        {"gearbox.drag_Nm": 100.0, "gearbox.drag_exponent": 1.5},
        {"shaft.add_entrained_water": True},
        {"propeller.four_quadrant": FOUR_QUADRANT},
    ],
    ids=["both dead times", "drag", "entrained water", "four quadrants"],
)
def test_small_sines_are_answered_as_the_exact_linear_model_says(
    changes: dict[str, Any], frequency: float
) -> None:
    ship = TUG.replace(changes)
    # Straight lines between 500 samples a period, and between steps in the dead time's history: 3e-4.
    assert _error(ship, linearise(ship), frequency) < 3e-4


@pytest.mark.parametrize(
    ("changes", "tolerance"),
    [
        ({"governor.sample_rate_hz": 50.0, "governor.computation_delay_s": 0.01}, 2e-3),
        ({"actuator.lag_s": 0.03}, 5e-3),
    ],
    ids=["sampling", "lag"],
)
def test_slow_sines_see_sampling_and_lag_as_a_dead_time(changes: dict[str, Any], tolerance: float) -> None:
    """Up to 0.5 Hz; the dead time makes the loop's model far better than one without."""
    ship = TUG.replace(changes)
    model = linearise(ship)
    assert model.T_d == pytest.approx(0.02 if "actuator.lag_s" not in changes else 0.03)
    error = _error(ship, model, 0.5)
    assert error < tolerance
    assert error < 0.2 * _error(ship, dataclasses.replace(model, T_d=0.0), 0.5)


def test_the_torque_shows_the_lines_that_were_measured() -> None:
    """Table 6.9 at 1184 rpm: shaft, blades, engine, firing of six cylinders in four strokes."""
    rest = signals.Excitation("rest", "rest", 2000.0, np.zeros(80_000))
    experiment = simulate(FULL, rest, n_e_rpm=1184.0)
    frequency, amplitude = amplitude_spectrum(experiment.signals["M_g"], 2000.0)
    peaks, _ = find_peaks(amplitude)
    highest = peaks[np.argsort(amplitude[peaks])[-4:]]
    # The trial's lines belong to 1181.6 rpm, 0.2 % lower; lines are 0.05 Hz apart.
    np.testing.assert_allclose(
        np.sort(frequency[highest]), [5.15, 15.49, 19.68, 59.08], rtol=0.002, atol=0.05
    )


def test_firing_leaves_the_mean_torque_and_speed_as_they_are() -> None:
    ship = TUG.replace({"engine.firing": {}})
    experiment = simulate(ship, signals.Excitation("rest", "rest", 2000.0, np.zeros(8000)))
    turn = round(2000.0 * 2.0 / 19.73)  # one working cycle
    for name, tolerance in (("n_e", 1e-4), ("M_g", 2e-3), ("M_b", 5e-3)):
        assert experiment.normalised(name)[-turn:].mean() == pytest.approx(0.0, abs=tolerance)
    assert experiment.signals["M_b"][-turn:].max() > 1.2 * experiment.operating_point["M_b"]


def test_a_ship_that_moves_settles_where_thrust_is_resistance() -> None:
    ship = TUG.replace({"ship": SHIP, "propeller.four_quadrant": FOUR_QUADRANT})
    point = steady_state(ship)
    # Closed form of this propeller: thrust is c n w (n - 0.5 u / w) with u the inflow, w the blades' path.
    path, inflow = 0.7 * math.pi * 1.05, 0.95 * point.ship_speed
    flow = math.hypot(point.n_s, inflow / path)
    pull = 2.0 * 1000.0 * 1.05**4 * 0.595 * flow * (point.n_s - 0.5 * inflow / path)
    # Straight lines between angles of the table 5 degrees apart cut its arcs by 1e-3.
    assert 3000.0 * point.ship_speed**2 == pytest.approx(pull, rel=2e-3)
    assert point.M_p < steady_state(TUG).M_p
    before = steady_state(ship, 1100.0)
    moved = simulate(ship, signals.steps([83.8], 150.0, rate_hz=10.0), n_e_rpm=1100.0)
    assert moved.signals["M_s"][0] > before.M_s
    assert moved.signals["M_s"][-1] == pytest.approx(point.M_s, rel=1e-5)
    assert moved.signals["X_f"][-1] == pytest.approx(point.X_f, rel=1e-5)


def test_behind_a_moving_ship_the_torques_exponent_is_its_slope() -> None:
    ship = TUG.replace(
        {"ship": SHIP, "propeller.four_quadrant": FOUR_QUADRANT, "propeller.torque_exponent": 2.0}
    )
    point = steady_state(ship)
    along, across = 0.7 * math.pi * 1.05 * point.n_s, 0.95 * point.ship_speed
    # Q = c w (along - 0.3 across), w the flow: n Q'/Q = along^2 / w^2 + along / (along - 0.3 across).
    exact = along**2 / (along**2 + across**2) + along / (along - 0.3 * across)
    assert linearise(ship).p == pytest.approx(exact, rel=0.02)  # the table's straight lines


def test_entrained_water_is_added_to_both_inertias() -> None:
    wet = TUG.replace({"shaft.add_entrained_water": True})
    assert wet.inertia - TUG.inertia == pytest.approx(5.75, abs=0.005)  # Schwanecke
    assert wet.propeller_side_inertia - TUG.propeller_side_inertia == pytest.approx(5.75, abs=0.005)
    assert FULL.inertia == pytest.approx(TUG.inertia, abs=0.01)
    assert FULL.propeller_side_inertia == pytest.approx(TUG.propeller_side_inertia, abs=0.01)


def test_the_full_tug_is_the_tug_of_the_trial() -> None:
    model = linearise(FULL)
    assert model.tau_n == pytest.approx(1.17, abs=0.005)  # eq. 7.9
    assert model.tau_prop == pytest.approx(0.43, abs=0.005)
    assert model.p == 2.17
    assert model.T_d == pytest.approx(0.12, abs=0.005)
    assert 0.2 <= model.T_set <= 0.4
    assert 0.45 < (model.p - model.g) / (model.v * model.K_i) + model.T_set < 0.49
    assert steady_state(FULL).M_s == pytest.approx(1725.0)  # Table 6.12


def test_a_raw_log_of_the_full_tug_has_its_own_ripple_and_only_that() -> None:
    log, truth = simulate_raw_log(FULL, signals.steps([20.0], 5.0, rate_hz=2000.0), steady_s=30.0, faults=())
    assert truth.linear == dataclasses.asdict(linearise(FULL))
    torque = TABLE_6_6.scale * log.read("U_torque", 0.0, 30.0).astype(float)
    frequency, recorded = amplitude_spectrum(torque, 2000.0)
    _, made = amplitude_spectrum(truth.clean.signals["M_g"][:60_000], 2000.0)
    for line in (5.16, 15.49, 59.19):
        near = np.abs(frequency - line) < 0.2
        assert recorded[near].max() == pytest.approx(made[near].max(), rel=0.05, abs=0.5)


def test_only_the_method_that_knows_all_elements_is_taken() -> None:
    with pytest.raises(
        InputError, match=r"method is 'euler', expected 'rk4' for vessel 'Stan Tug 1205, full'"
    ):
        simulate(FULL, signals.steps([10.0], 1.0), method="euler")
    with pytest.raises(InputError, match=r"found elements in addition to the plant of eq\. 3\.1-3\.11"):
        linearise_numerically(FULL)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"actuator.dead_time_s": -0.1}, r"actuator\.dead_time_s: found -0\.1, expected greater than or equal"),
        ({"actuator.delay": 0.1}, r"actuator\.delay: found an unknown key, expected one of dead_time_s"),
        ({"governor.once_a_firing": True}, r"once_a_firing: found true, expected a table engine\.firing"),
        (
            {"engine.firing": {}, "governor.once_a_firing": True, "governor.sample_rate_hz": 50.0},
            r"governor\.sample_rate_hz: found 50, expected nothing beside once_a_firing = true",
        ),
        ({"engine.firing": {"strength": [1.0, 1.0]}}, r"strength: found 2 values, expected 6 as engine\.cylin"),
        ({"engine.firing": {"stroke_deg": 800.0}}, r"stroke_deg: found 800, expected at most .* 720"),
        (
            {"propeller.four_quadrant": {**FOUR_QUADRANT, "C_T": [1.0]}},
            r"four_quadrant\.C_T: found 1 values, expected 72 as in angle_deg",
        ),
        ({"ship": {"mass_kg": 2e4}}, r"ship\.resistance_N_s2_m2: found nothing, expected this key"),
    ],
)  # fmt: skip
def test_a_wrong_element_gets_one_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        TUG.replace(changes)
    assert "\n" not in str(error.value)


def test_a_set_point_beyond_the_rack_is_refused() -> None:
    with pytest.raises(InputError, match=r"needs a fuel rack of .* expected less than maximum_rack_mm, 12"):
        steady_state(TUG.replace({"governor.maximum_rack_mm": 12.0}), 1500.0)
    with pytest.raises(InputError, match=r"resistance_N_s2_m2: found 1e-06, with which the thrust drives"):
        steady_state(TUG.replace({"ship": {**SHIP, "resistance_N_s2_m2": 1e-6}}))


def test_the_file_of_the_full_tug_is_a_ship_of_ones_own(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(built_in("vessels")["stan-tug-1205-full"].read_text(encoding="utf-8"), encoding="utf-8")
    assert Vessel.load(path) == FULL
