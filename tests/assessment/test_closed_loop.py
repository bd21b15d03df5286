"""Poles, margins and gains of the loop: closed forms, exact roots with a dead time, bands that hold the truth."""

from __future__ import annotations

from dataclasses import asdict, replace
from types import SimpleNamespace

import control
import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.assessment.closed_loop import closed_loop, poles_of
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.reproduce.fullscale import extended_structure, measured_response
from shipfp_rs.structures.structure import Parameter, Structure
from shipfp_rs.vessel.linear_model import LinearModel, linearise
from shipfp_rs.vessel.vessel import Vessel
from tests.launch import LAUNCH, noisy_record

CHIRP = signals.chirp(0.01, 5.0, 120.0, 13.0, rate_hz=50.0)


@pytest.fixture(scope="module")
def launch() -> Fingerprint:
    return identify(noisy_record(CHIRP, 0.01, 0.0, 1), Structure.linear(products=True))


@pytest.fixture(scope="module")
def tug() -> Fingerprint:
    return identify(measured_response(1.637), extended_structure(), noise="std", starts=8)


def margins(T_d: float = 0.0) -> dict[str, float]:
    """What python-control says of the launch's loop, its dead time by a Pade approximation of high order."""
    plant = control.tf([LAUNCH.v], [LAUNCH.tau_n, LAUNCH.p - LAUNCH.g])
    loop = plant * control.tf([LAUNCH.K_p, LAUNCH.K_i], [1.0, 0.0])
    if T_d:
        loop = loop * control.tf(*control.pade(T_d, 8))
    gain, phase, _, crossing = control.margin(loop)
    return {"gain margin": gain, "phase margin": phase, "crossover": crossing / (2.0 * np.pi)}


LINEAR = Structure.linear(free_exponent=True)
WITH_DEAD_TIME = Structure.linear(free_exponent=True, dead_time_loop=True)


def poles(model: LinearModel, structure: Structure = LINEAR) -> np.ndarray:
    return poles_of(
        structure, {name: value for name, value in asdict(model).items() if name in structure.names}
    )


def test_without_a_dead_time_the_poles_are_those_of_the_quadratic() -> None:
    np.testing.assert_allclose(np.sort(poles(LAUNCH).real), np.sort(LAUNCH.poles.real), rtol=1e-9)


@pytest.mark.parametrize("T_d", [0.01, 0.2])
def test_with_one_they_are_roots_of_the_exact_equation(T_d: float) -> None:
    model = replace(linearise(Vessel.load("stan-tug-1205")), T_d=T_d)
    found = poles(model, WITH_DEAD_TIME)
    left = found * (model.tau_n * found + model.p - model.g)
    right = model.v * (model.K_p * found + model.K_i) * np.exp(-found * T_d)
    np.testing.assert_allclose(left, -right, rtol=1e-8)
    assert len(set(found.round(6))) == len(found) == 2


FLEXIBLE = Structure.ship(["dead_time_loop", "twist"], torque="gauge")
LOOP = {"tau_n": 3.49, "g": -2.74, "vK_p": 9.24, "vK_i": 26.9, "p": 0.437, "tau_prop": 0.812, "T_d": 0.09}
SOFT = {**LOOP, "tau_twist": 5e-4, "zeta_twist": 0.0}


def test_the_slower_pole_comes_first_also_where_the_faster_one_lasts_longer() -> None:
    slow, fast = poles_of(FLEXIBLE, SOFT)
    assert abs(slow) < abs(fast)
    assert fast.real > slow.real  # the shaft's own swing


def test_bands_hold_what_python_control_says_of_the_true_loop(launch: Fingerprint) -> None:
    found = closed_loop(launch)
    for name, truth in margins().items():
        if np.isfinite(truth):
            assert abs(found[name].value - truth) < 4.0 * found[name].std
        else:
            assert found[name].value is None
            assert found[name].reason == "there is none"
    for estimate, truth in zip(
        (found["pole 1, real"], found["pole 2, real"]), sorted(LAUNCH.poles.real, reverse=True), strict=True
    ):
        assert abs(estimate.value - truth) < 4.0 * estimate.std
    assert found["dM_b(inf)"].value == pytest.approx(LAUNCH.v * LAUNCH.K_p, abs=4.0 * found["dM_b(inf)"].std)


def test_a_dead_time_gives_the_margins_of_python_control(launch: Fingerprint) -> None:
    exact = {
        "tau_n": LAUNCH.tau_n,
        "g": LAUNCH.g,
        "vK_p": LAUNCH.v * LAUNCH.K_p,
        "vK_i": LAUNCH.v * LAUNCH.K_i,
    }
    late = replace(launch, settings={**launch.settings, "optimum": exact | {"p": 2.0, "T_d": 0.05}})
    found = closed_loop(late)
    for name, truth in margins(0.05).items():
        assert found[name].value == pytest.approx(truth, rel=1e-5)
    # Of all gains so much larger the loop oscillates: a pair of poles on the axis, with that period.
    grown = {name: exact[name] * found["gain margin"].value for name in ("vK_p", "vK_i")}
    assert found["ultimate gain"].value == pytest.approx(grown["vK_p"])
    known = {**exact, **grown, "p": 2.0, "T_d": 0.05}
    pair = max(poles_of(WITH_DEAD_TIME, known), key=np.imag)
    assert pair.real == pytest.approx(0.0, abs=1e-4 * abs(pair))
    assert found["ultimate period"].value == pytest.approx(2.0 * np.pi / pair.imag, rel=1e-4)


def test_where_engine_and_load_alone_run_away_the_margins_are_those_of_a_loop(launch: Fingerprint) -> None:
    """A generating set whose slope ended at +2.5 was told a phase margin of 410 degrees and a gain margin of 3900."""
    q = {"tau_n": 1.2, "g": 2.5, "vK_p": 8.0, "vK_i": 12.0, "p": 0.0, "T_d": 0.05}
    found = closed_loop(replace(launch, settings={**launch.settings, "optimum": q}))
    loop = control.tf([q["vK_p"], q["vK_i"]], [1.0, 0.0]) * control.tf([1.0], [q["tau_n"], -q["g"]])
    loop = loop * control.tf(*control.pade(q["T_d"], 8))
    margin = control.stability_margins(loop, returnall=True)
    assert found["phase margin"].value == pytest.approx(float(min(margin[1])), rel=1e-4)
    assert 0.0 < found["phase margin"].value < 90.0
    # The gains may fall as well as grow: what is told is by how much they may grow.
    assert found["gain margin"].value == pytest.approx(min(one for one in margin[0] if one > 1.0), rel=1e-4)


def test_of_an_engine_that_is_not_described_no_loop_is_told(launch: Fingerprint) -> None:
    other = replace(launch, adequate={"sides": {"load": True, "engine": False}})
    for estimate in closed_loop(other).values():
        assert estimate.value is None
        assert estimate.reason == "drive and governor are not described"


def test_the_tugs_loop_is_known_though_none_of_its_gains_is(tug: Fingerprint) -> None:
    found = closed_loop(tug)
    assert tug["K_p"].value is None
    assert found["phase margin"].value == pytest.approx(63.0, abs=4.0)
    assert found["phase margin"].std < 2.0
    assert found["dM_g(0)"].value == pytest.approx(tug["p"].value)
    low, high = found["bandwidth"].ci95
    assert 1.0 < low < high < 1.5


# The ratio of a deviation from 12 values scatters by 21 %, from 40 by 11 %.
@pytest.mark.parametrize(("draws", "within"), [(12, 0.6), pytest.param(40, 0.4, marks=pytest.mark.slow)])
def test_the_deviations_are_the_scatter_over_repeated_trials(draws: int, within: float) -> None:
    trials = [
        closed_loop(
            identify(
                noisy_record(CHIRP, 0.05, 0.0, seed), Structure.linear(products=True), intervals="symmetric"
            )
        )
        for seed in range(draws)
    ]
    for name in ("crossover", "phase margin", "bandwidth", "pole 1, real"):
        values = [trial[name].value for trial in trials]
        told = np.median([trial[name].std for trial in trials])
        assert np.std(values, ddof=1) == pytest.approx(told, rel=within)


def test_what_the_data_leave_open_has_no_value() -> None:
    speed_only = identify(noisy_record(CHIRP, 0.01, 0.0, 1), Structure.linear(products=True, outputs=("dn",)))
    found = closed_loop(speed_only)
    assert speed_only["vK_p"].value is None
    assert found["dM_b(inf)"].value is None
    assert "changes along a direction that the data do not determine" in found["dM_b(inf)"].reason
    assert found["crossover"].std < 0.1 * found["crossover"].value


def test_a_structure_without_poles_is_refused(launch: Fingerprint) -> None:
    one = Parameter("tau_n", "s", 1.0, 0.1, 10.0)
    box = Structure.from_function(lambda q, record: record.dn_set[None], [one], ["dn"], name="box")
    with pytest.raises(InputError, match="structure 'box' of the fingerprint is not linear, expected one"):
        closed_loop(launch, box)


@pytest.mark.parametrize("late_s", [0.0, 0.15])
def test_the_ship_with_a_lag_has_its_margins_and_recovers_as_it_is_simulated(late_s: float) -> None:
    ship = Structure.ship(["dead_time_loop", "actuator_lag", "dead_time_set_point"], torque="gauge")
    values = {parameter.name: parameter.start for parameter in ship.parameters}
    values |= {"T_d": 0.04, "T_set": late_s}
    made = SimpleNamespace(
        engine_described=True,
        optimum=values,
        settings={},
        adequate={},
        parameters={},
        derived={},
        behind_meter={},
        identifiability=SimpleNamespace(null_space=()),
        covariance={"names": [], "matrix": []},
    )
    found = closed_loop.__wrapped__(made, ship)
    governor = control.tf([values["vK_p"], values["vK_i"]], [1.0, 0.0]) * control.tf(*control.pade(0.04, 8))
    loop = governor * control.tf([1.0], [values["tau_act"], 1.0])
    loop = loop * control.tf([1.0], [values["tau_n"], values["p"] - values["g"]])
    gain, phase, _, crossing = control.margin(loop)
    assert found["gain margin"].value == pytest.approx(gain, rel=1e-4)
    assert found["phase margin"].value == pytest.approx(phase, rel=1e-4)
    assert found["crossover"].value == pytest.approx(crossing / (2.0 * np.pi), rel=1e-4)
    times = np.linspace(0.0, 10.0, 2001)
    moved = np.full(2001, 1000.0 * (1.0 + 1e-4))
    moved[0] = 1000.0
    record = Experiment("step", 200.0, {"n_set": moved}, {"n_set": 1000.0}, hold="zero")
    speed = ship.equations.simulate(values, record)[0] / 1e-4
    late = times[np.flatnonzero(np.abs(speed - 1.0) > 0.05)[-1]]
    assert found["recovery time"].value == pytest.approx(late, abs=0.02)
    assert found["overshoot"].value == pytest.approx(max(speed.max() - 1.0, 0.0), abs=0.005)


def test_the_interval_holds_every_ship_that_the_profiles_found_possible(launch: Fingerprint) -> None:
    optimum = launch.settings["optimum"]
    others = [{"vK_p": 1.3 * optimum["vK_p"]}, {"T_d": 0.05}]
    found = closed_loop(replace(launch, settings={**launch.settings, "possible": others}))
    for other in others:
        there = closed_loop(replace(launch, settings={**launch.settings, "optimum": {**optimum, **other}}))
        for name in ("crossover", "phase margin", "bandwidth", "recovery time"):
            low, high = found[name].ci95
            assert low <= there[name].value <= high
    assert found["gain margin"].value is None
    assert found["gain margin"].ci95 == pytest.approx((margins(0.05)["gain margin"], np.inf), rel=0.2)


def test_a_figure_known_only_roughly_keeps_its_sign(launch: Fingerprint) -> None:
    matrix = 900.0 * np.array(launch.covariance["matrix"])
    rough = closed_loop(replace(launch, covariance={**launch.covariance, "matrix": matrix.tolist()}))
    told = [name for name, figure in rough.items() if figure.ci95 is not None]
    assert any(rough[name].std > 0.6 * abs(rough[name].value) for name in told)
    for name in set(told) - {"phase margin", "overshoot", "dM_b(0)", "dM_b(inf)"}:
        low, high = rough[name].ci95
        assert low * high > 0.0, name
        # As far off by a factor on either side.
        assert rough[name].value ** 2 == pytest.approx(low * high)
    assert rough["overshoot"].ci95 is None or rough["overshoot"].ci95[0] >= 0.0


def test_a_gain_of_the_torque_that_is_a_parameter_has_its_interval(launch: Fingerprint) -> None:
    assert closed_loop(launch)["dM_b(inf)"].ci95 == launch["vK_p"].ci95


def test_a_pole_of_the_dead_times_approximation_is_none_of_the_loop() -> None:
    ship = Structure.ship(["dead_time_loop"], torque="gauge")
    values = {
        "tau_n": 1.04652,
        "g": -0.5,
        "vK_p": 7.42989,
        "vK_i": 4.97482,
        "p": 1.35028,
        "tau_prop": 0.05626,
    }
    found = poles_of(ship, {**values, "T_d": 0.01, "T_s": 0.0})
    # Without the dead time: 1.046 s^2 + 9.28 s + 4.97.
    assert found[0] == pytest.approx(-0.5736, rel=1e-3)
    assert found[1].real < -5.0
