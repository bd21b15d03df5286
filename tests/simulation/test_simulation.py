"""Virtual experiments: small signals agree with the linear model, large ones saturate, sensors are noisy."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import UNITS, Experiment
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.vessel.linear_model import Output, linearise
from shipfp_rs.vessel.steady_state import steady_state
from shipfp_rs.vessel.vessel import Vessel

LAUNCH = Vessel.load("stan-launch-804")
TUG = Vessel.load("stan-tug-1205")
SHIPS = pytest.mark.parametrize("ship", [LAUNCH, TUG], ids=lambda ship: ship.name)

# The linear model's outputs as signals of an experiment.
SIGNAL: dict[Output, str] = {"dn": "n_e", "dE": "E_n", "dM_b": "M_b", "dM_g": "M_g", "dX": "X_f"}


def _line(samples: np.ndarray, rate_hz: float, frequency: float) -> complex:
    """Complex amplitude at a frequency of which the samples hold whole periods."""
    turns = np.exp(-2j * np.pi * frequency * np.arange(len(samples)) / rate_hz)
    return complex(2.0 * np.mean(samples * turns))


def _response(ship: Vessel, frequency: float, amplitude_rpm: float) -> dict[Output, complex]:
    """Settled response of the nonlinear plant to a sine, over the set point."""
    rate, settle = 500.0 * frequency, math.ceil(200.0 * frequency)
    sine = signals.sine_sequence([frequency], settle + 2, amplitude_rpm, rate_hz=rate)
    experiment = simulate(ship, sine, limits=False)
    last = {name: experiment.normalised(name)[-1000:] for name in experiment.signals}
    return {
        output: _line(last[name], rate, frequency) / _line(last["n_set"], rate, frequency)
        for output, name in SIGNAL.items()
    }


@SHIPS
@pytest.mark.parametrize("frequency", [0.01, 0.5, 8.0])
def test_small_sines_are_answered_as_the_linear_model_says(ship: Vessel, frequency: float) -> None:
    model = linearise(ship)
    for output, response in _response(ship, frequency, 0.1).items():
        _, (exact,) = model.transfer_function(output).freqresp([2 * np.pi * frequency])
        # Straight lines between 500 samples a period take (pi/500)^2 / 3 = 1.3e-5 from the sine; the governor
        # sees that as an error.
        assert abs(response - exact) < 2e-5 * max(abs(exact), model.high_frequency_gain(output))


def test_the_nonlinear_part_of_the_response_grows_with_the_square_of_the_amplitude() -> None:
    exact = _response(TUG, 0.1, 0.05)["dM_b"]
    small, large = (abs(_response(TUG, 0.1, amplitude)["dM_b"] / exact - 1.0) for amplitude in (40.0, 80.0))
    assert large / small == pytest.approx(4.0, rel=0.05)


@SHIPS
@pytest.mark.parametrize("rpm", [800.0, 1500.0])
def test_a_step_settles_at_the_next_steady_state(ship: Vessel, rpm: float) -> None:
    experiment = simulate(ship, signals.steps([30.0], 250.0, rate_hz=10.0), n_e_rpm=rpm)
    before, after = steady_state(ship, rpm), steady_state(ship, rpm + 30.0)
    settled = {name: samples[-1] for name, samples in experiment.signals.items()}
    assert experiment.operating_point["M_s"] == pytest.approx(before.M_s)
    assert settled["n_e"] == pytest.approx(after.n_e_rpm)
    assert settled["n_s"] == pytest.approx(after.n_s)
    assert settled["M_b"] == pytest.approx(after.M_b)
    assert (settled["M_s"], settled["M_g"]) == pytest.approx((after.M_s, after.M_s), rel=1e-6)
    assert settled["X_f"] == pytest.approx(after.X_f)


@SHIPS
def test_nothing_moves_without_excitation(ship: Vessel) -> None:
    rest = signals.Excitation("rest", "rest", 10.0, np.zeros(600))
    experiment = simulate(ship, rest)
    for name in set(SIGNAL.values()) | {"n_s", "M_s"}:
        np.testing.assert_allclose(experiment.normalised(name), 0.0, atol=1e-13)


@SHIPS
def test_at_a_step_the_torques_jump_by_their_high_frequency_gains(ship: Vessel) -> None:
    model = linearise(ship)
    experiment = simulate(ship, signals.steps([6.0], 1.0), limits=False)
    jump = experiment.normalised("n_set")[0]
    assert experiment.normalised("M_b")[0] == pytest.approx(jump * model.v * model.K_p)  # eq. 3.40
    assert experiment.normalised("M_g")[0] == pytest.approx(jump * model.high_frequency_gain("dM_g"))
    assert experiment.normalised("n_e")[0] == 0.0


def test_the_gauge_feels_what_turns_the_propeller_and_its_water() -> None:
    experiment = simulate(TUG, signals.chirp(0.1, 2.0, 20.0, 50.0, rate_hz=1000.0))
    n_s = experiment.signals["n_s"]
    acceleration = np.gradient(n_s, 1e-3)
    M_p = TUG.torque_coefficient * n_s**TUG.propeller.torque_exponent
    expected = M_p + 2 * np.pi * TUG.shaft.propeller_side_inertia_kg_m2 * acceleration
    np.testing.assert_allclose(experiment.signals["M_g"][1:-1], expected[1:-1], rtol=1e-5)


def test_integrated_error_is_the_integral_of_the_normalised_error() -> None:
    experiment = simulate(LAUNCH, signals.chirp(0.05, 0.5, 40.0, 50.0, rate_hz=200.0))
    error = experiment.normalised("n_set") - experiment.normalised("n_e")
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (error[1:] + error[:-1])) / 200.0])
    np.testing.assert_allclose(experiment.normalised("E_n"), integral, atol=1e-6)


@SHIPS
@pytest.mark.parametrize(
    "excitation", [signals.steps([65.0] * 3, 20.0), signals.chirp(0.01, 10.0, 60.0, 104.0)]
)
def test_chosen_steps_are_fine_enough(ship: Vessel, excitation: signals.Excitation) -> None:
    chosen = simulate(ship, excitation, limits=False)
    finer = simulate(ship, excitation, limits=False, substeps=60)
    assert finer.provenance["step_s"] < chosen.provenance["step_s"] / 4
    for name in SIGNAL.values():
        error = np.abs(chosen.normalised(name) - finer.normalised(name)).max()
        assert error < 1e-8 * np.abs(finer.normalised(name)).max()


def test_the_torque_limit_cuts_a_large_step_and_only_that() -> None:
    limited, free = (
        simulate(LAUNCH, signals.steps([260.0], 20.0), limits=limits) for limits in (True, False)
    )
    # A step of 20 % asks for 1 + 0.2 v K_p = 4.17 times the operating torque; the limit is at twice.
    assert free.normalised("M_b").max() == pytest.approx(0.2 * 15.83)
    assert limited.normalised("M_b")[0] == pytest.approx(1.0, rel=1e-3)
    assert limited.signals["n_e"][10] < free.signals["n_e"][10] - 50.0
    small = [
        simulate(LAUNCH, signals.steps([13.0], 5.0), limits=limits).signals["M_b"] for limits in (True, False)
    ]
    np.testing.assert_array_equal(*small)


def test_euler_is_one_step_a_sample_and_less_exact() -> None:
    excitation = signals.steps([13.0], 20.0)
    exact, euler = simulate(LAUNCH, excitation), simulate(LAUNCH, excitation, method="euler")
    assert euler.provenance["step_s"] == pytest.approx(0.01)
    error = np.abs(euler.normalised("n_e") - exact.normalised("n_e")).max()
    halved = simulate(LAUNCH, excitation, method="euler", substeps=2)
    half_error = np.abs(halved.normalised("n_e") - exact.normalised("n_e")).max()
    assert error / half_error == pytest.approx(2.0, rel=0.1)


def test_an_experiment_says_where_it_comes_from() -> None:
    sequence = signals.sine_sequence([0.5, 1.0], 2, 13.0)
    experiment = simulate(LAUNCH, sequence)
    assert set(experiment.signals) == set(experiment.operating_point) == set(UNITS) - {"M_load", "command"}
    assert experiment.kind == "sines"
    assert experiment.hold == "first"
    assert experiment.provenance["vessel"] == "Stan Launch 804"
    assert [segment["frequency_hz"] for segment in experiment.provenance["segments"]] == [0.5, 1.0]


def _noisy(noise: dict[str, float | tuple[float, float]], seed: int | None) -> Experiment:
    return simulate(LAUNCH, signals.chirp(0.01, 2.0, 400.0, 13.0), noise=noise, seed=seed)


def test_noise_has_the_size_and_colour_asked_for() -> None:
    clean, noisy = _noisy({}, None), _noisy({"n_e": 0.05, "M_b": (0.05, 0.9)}, 7)
    for name, correlation in (("n_e", 0.0), ("M_b", 0.9)):
        noise = noisy.signals[name] - clean.signals[name]
        assert noise.std() == pytest.approx(0.05 * clean.signals[name].std(), rel=0.1)
        assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(correlation, abs=0.03)
    for name in set(clean.signals) - {"n_e", "M_b"}:
        np.testing.assert_array_equal(noisy.signals[name], clean.signals[name])


def test_noise_follows_from_its_seed_alone() -> None:
    both, alone = _noisy({"n_e": 0.05, "M_b": 0.05}, 7), _noisy({"M_b": 0.05}, 7)
    np.testing.assert_array_equal(both.signals["M_b"], alone.signals["M_b"])
    other = _noisy({"M_b": 0.05}, 8)
    assert not np.array_equal(other.signals["M_b"], alone.signals["M_b"])
    drawn = _noisy({"M_b": 0.05}, None)
    again = _noisy({"M_b": 0.05}, drawn.provenance["seed"])
    np.testing.assert_array_equal(drawn.signals["M_b"], again.signals["M_b"])


def test_arguments_out_of_range_are_named() -> None:
    step = signals.steps([13.0], 1.0)
    with pytest.raises(InputError, match="method is 'rk5', expected 'rk4', 'heun' or 'euler'"):
        simulate(LAUNCH, step, method="rk5")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="substeps is 0, expected 1 or more"):
        simulate(LAUNCH, step, substeps=0)
    with pytest.raises(InputError, match="noise: found 'n_set', expected outputs among n_e"):
        simulate(LAUNCH, step, noise={"n_set": 0.1})
    with pytest.raises(InputError, match=r"noise\['M_b'\] is -0\.1, expected zero or more"):
        simulate(LAUNCH, step, noise={"M_b": -0.1})
    with pytest.raises(InputError, match=r"noise\['M_b'\] has correlation 1.0, expected between -1 and 1"):
        simulate(LAUNCH, step, noise={"M_b": (0.1, 1.0)})
    with pytest.raises(InputError, match=r"2000 rpm needs 527\.6 Nm of engine torque"):
        simulate(LAUNCH, step, n_e_rpm=2000.0)


def test_signals_of_the_linear_model_are_all_simulated() -> None:
    assert tuple(SIGNAL) == get_args(Output)


@pytest.mark.parametrize("fraction", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("limit", ["none", "2.0"])
def test_steps_of_the_launch_agree_with_an_independent_solution(fraction: float, limit: str) -> None:
    with (Path(__file__).parents[1] / "data" / "reference_steps.csv").open(encoding="utf-8") as lines:
        rows = [row for row in csv.DictReader(lines) if float(row["step_fraction"]) == fraction]
    rows = [row for row in rows if row["torque_limit_over_Mb0"] == limit]
    columns = ("time_s", "shaft_speed_rps", "shaft_torque_Nm", "integrated_error_rev")
    time, n_s, M_s, E_n = np.array([[float(row[name]) for name in columns] for row in rows]).T
    ship = LAUNCH.replace({"engine.envelope": None})
    if limit != "none":
        flat = {"speed_rpm": [600.0, 1800.0], "torque_Nm": [445.86, 445.86]}
        ship = LAUNCH.replace({"engine.envelope": flat})
    step = signals.steps([fraction * 1300.0], time[-1] + 0.1, rate_hz=10.0)
    experiment = simulate(ship, step)
    # The solution is exact to 1e-6 where the limit acts, else to the error of its interpolation.
    tolerance = 5e-9 if limit == "none" else 1e-6
    for name, expected in (("n_s", n_s), ("M_s", M_s), ("E_n", E_n)):
        scale = np.abs(expected).max()
        np.testing.assert_allclose(experiment.signals[name] / scale, expected / scale, atol=tolerance, rtol=0)
