"""A governor that samples, exactly: against the simulated ship and a pulse transfer function, and as a model to fit."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.signal import cont2discrete

from shipfp_rs import Experiment, Structure, Vessel, signals, simulate
from shipfp_rs.assessment.closed_loop import closed_loop
from shipfp_rs.assessment.prediction import structure_of
from shipfp_rs.errors import InputError
from shipfp_rs.identification.identify import identify
from shipfp_rs.vessel.linear_model import linearise

RATE = 64.0
SIGNALS = ("n_e", "M_g", "X_f")
ELEMENTS = {"actuator.lag_s": 0.03, "actuator.dead_time_s": 0.13, "governor.set_point_dead_time_s": 0.07}


def tug(sample_rate_hz: float, K_d: float = 0.0) -> Vessel:
    """The tug with an actuator, dead times that are no multiple of a period, and gains that keep the slowest loop stable."""
    gains = {"governor.sample_rate_hz": sample_rate_hz, "governor.K_p": 1.0, "governor.K_i": 2.0}
    derivative = {"governor.K_d": K_d, "governor.derivative_filter_s": 0.1 * K_d} if K_d else {}
    return Vessel.load("stan-tug-1205").replace(gains | derivative | ELEMENTS)


def declared(sampling: bool | str, **options: object) -> Structure:
    settings = {
        "torque": "gauge",
        "free_exponent": True,
        "dead_time_loop": True,
        "dead_time_set_point": True,
        "actuator_lag": True,
        "sampling": sampling,
        "outputs": ("dn", "dM", "dX"),
    }
    return Structure.linear(**settings | options)


def values(ship: Vessel, structure: Structure) -> dict[str, float]:
    model = linearise(ship)
    known = asdict(model) | {
        "vK_p": model.v * model.K_p,
        "vK_i": model.v * model.K_i,
        "K_d": ship.governor.K_d,
        "T_d": ship.actuator.dead_time_s,
        "tau_act": ship.actuator.lag_s,
        "T_s": 1.0 / ship.governor.sample_rate_hz,
        "T_0": 0.0,
    }
    return {name: known[name] for name in structure.names}


def small_signal(ship: Vessel, excitation: signals.Excitation) -> tuple[Experiment, list[np.ndarray]]:
    """What the nonlinear simulation answers to 1e-3 of the excitation, even orders taken off by turning it over."""
    runs = [
        simulate(ship, replace(excitation, samples=sign * 1e-3 * excitation.samples), substeps=32)
        for sign in (1, -1)
    ]
    return runs[0], [0.5 * (runs[0].normalised(name) - runs[1].normalised(name)) for name in SIGNALS]


def swing(frequency_hz: float, hold: str = "first") -> signals.Excitation:
    """A sine that swells and dies away in 30 s."""
    time = np.arange(round(30.0 * RATE)) / RATE
    samples = 76.0 * np.sin(2 * np.pi * frequency_hz * time) * np.sin(np.pi * time / 30.0) ** 2
    return signals.Excitation("swing", "sine", RATE, samples, hold=hold)


def errors(structure: Structure, ship: Vessel, excitation: signals.Excitation) -> np.ndarray:
    """Largest error of each output over its largest value."""
    experiment, expected = small_signal(ship, excitation)
    found = structure.equations.simulate(values(ship, structure), experiment)
    rows = zip(found, expected, strict=True)
    return np.array([np.abs(row - true).max() / np.abs(true).max() for row, true in rows])


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("K_d", [0.0, 0.1])
@pytest.mark.parametrize("sample_rate_hz", [2.0, 5.0, 10.0, 50.0])
def test_it_moves_as_the_simulated_ship_does_beyond_the_nyquist_frequency(sample_rate_hz, K_d, hold):
    ship = tug(sample_rate_hz, K_d)
    beyond = swing(min(0.8 * sample_rate_hz, 28.0), hold)
    assert errors(declared("exact", derivative=K_d > 0), ship, beyond).max() < 1e-6


@pytest.mark.parametrize("sample_rate_hz", [2.0, 5.0, 10.0, 50.0])
def test_the_hold_alone_is_right_for_slow_motions_and_fails_beyond(sample_rate_hz):
    ship = tug(sample_rate_hz)
    slow, beyond = swing(0.02 * sample_rate_hz), swing(min(0.8 * sample_rate_hz, 28.0))
    found = {kind: [errors(declared(kind), ship, one) for one in (slow, beyond)] for kind in (True, "exact")}
    # Speed and torque; the rack's stairs are not those of a set point that it would follow smoothly.
    assert found[True][0][:2].max() < 0.04
    # The rack answers an alias, a swing that is slower than the set point's.
    assert found[True][1][2] > 0.5
    assert max(row.max() for row in found["exact"]) < 1e-6


@pytest.mark.study
def test_how_far_both_are_off():
    print("largest errors of speed, torque and rack over their largest values")
    for rate in (2.0, 5.0, 10.0, 50.0):
        for frequency in (0.02 * rate, 0.3 * rate, min(0.8 * rate, 28.0)):
            rows = {kind: errors(declared(kind), tug(rate), swing(frequency)) for kind in (True, "exact")}
            shown = "   ".join(
                f"{kind!s:>5}: " + " ".join(f"{e:.1e}" for e in row) for kind, row in rows.items()
            )
            print(f"{rate:4.0f} samples a second, swing of {frequency:5.2f} Hz   {shown}")
            assert rows["exact"].max() < 1e-6


def test_a_step_is_that_of_the_simulated_ship_whenever_the_governor_looks():
    ship = tug(3.0)
    time = np.arange(900) / RATE
    steps = 50.0 * (time > 2.11) - 70.0 * (time > 7.3)
    assert errors(declared("exact"), ship, signals.Excitation("steps", "steps", RATE, steps)).max() < 1e-6


@pytest.mark.parametrize("torque", ["brake", "gauge"])
@pytest.mark.parametrize("speed", ["engine", "propeller"])
@pytest.mark.parametrize("products", [True, False])
def test_derivatives_are_those_of_finite_differences(torque, speed, products):
    structure = declared(
        "exact", torque=torque, speed=speed, products=products, derivative=True, twist=torque == "gauge"
    )
    time = np.arange(600) / RATE
    moving = 0.05 * np.sin(2 * np.pi * 0.3 * time + 0.3) + 0.02 * np.sin(2 * np.pi * 7.0 * time)
    experiment = Experiment("swing", RATE, {"n_set": 1000.0 * (1.0 + moving)}, {"n_set": 1000.0}, "first")
    extra = {"K_d": 0.1, "vK_d": 0.1, "tau_twist": 2e-3, "T_0": 0.033, "initial dn": 0.01, "initial dE": 0.02}
    ship = tug(8.0)
    known = values(ship, declared("exact")) | values(ship, declared("exact", products=True)) | extra
    at = {name: known[name] for name in (*structure.names, *structure.equations.states)}
    simulated, slopes = structure.equations.sensitivities(at, experiment, list(at))
    assert np.array_equal(simulated, structure.equations.simulate(at, experiment))
    bands = np.array([0.1, 1.0, 5.0, 9.0])
    own = [name for name in structure.names if name != "T_0"]
    _, in_frequency = structure.equations.response(at, bands, own)
    for name, slope in zip(at, slopes, strict=True):
        step = 1e-6 * at[name]
        sides = [at | {name: at[name] + h} for h in (step, -step)]
        ahead, behind = (structure.equations.simulate(side, experiment) for side in sides)
        difference = (ahead - behind) / (2 * step)
        assert np.abs(slope - difference).max() < 1e-5 * np.abs(difference).max(), name
        if name in own:
            ahead, behind = (structure.equations.response(side, bands, ())[0] for side in sides)
            difference = (ahead - behind) / (2 * step)
            assert np.abs(in_frequency[own.index(name)] - difference).max() < 1e-4 * np.abs(difference).max()


def test_the_response_is_that_of_the_pulse_transfer_function():
    # Astrom and Wittenmark: Y = P(s) (1 - exp(-sT)) / (sT) C(z) / (1 + C(z) P*(z)), z = exp(sT).
    structure = Structure.linear(products=True, sampling="exact", outputs=("dn",))
    q = {"tau_n": 1.2, "g": -0.6, "vK_p": 1.3, "vK_i": 2.0, "p": 2.0, "T_s": 0.2, "T_0": 0.0}
    frequency = np.array([0.01, 0.3, 2.0, 2.6, 4.0, 11.0])
    s, T = 2j * np.pi * frequency, q["T_s"]
    z = np.exp(s * T)
    rate = (q["p"] - q["g"]) / q["tau_n"]
    top, bottom, _ = cont2discrete(([1.0 / q["tau_n"]], [1.0, rate]), T, "zoh")
    pulse = np.polyval(top[0], z) / np.polyval(bottom, z)
    governor = q["vK_p"] + q["vK_i"] * 0.5 * T * (z + 1.0) / (z - 1.0)
    plant = 1.0 / (q["tau_n"] * (s + rate))
    expected = plant * (1.0 - np.exp(-s * T)) / (s * T) * governor / (1.0 + governor * pulse)
    found, _ = structure.equations.response(q, frequency, ())
    assert np.allclose(found[0], expected, rtol=1e-9)
    # At rest the set point is met, and far below the sample rate it is the hold alone.
    slow = Structure.linear(products=True, sampling=True, outputs=("dn",))
    assert np.allclose(found[0][0], slow.equations.response(q, frequency[:1], ())[0], rtol=1e-3)


def test_a_settled_sine_is_the_response_and_its_aliases():
    # Five of the governor's samples are sixty of the record's, which it reads without interpolating.
    structure, rate = declared("exact"), 60.0
    ship = tug(5.0)
    q, at = values(ship, structure) | {"T_set": 0.05}, 3.0
    time = np.arange(round(60.0 * rate)) / rate
    experiment = Experiment(
        "sine",
        rate,
        {"n_set": 1000.0 * (1.0 + 0.01 * np.sin(2 * np.pi * at * time))},
        {"n_set": 1000.0},
        "first",
    )
    late = time >= 40.0
    settled = structure.equations.simulate(q, experiment)[:, late]
    # 3 Hz sampled at 5 Hz passes for 2 Hz, too; a held rack has all distances of 5 Hz.
    lines = [2.0 * np.exp(-2j * np.pi * f * time[late]) @ settled.T / late.sum() for f in (3.0, 2.0)]
    measured = lines[0] * 1j / 0.01
    response = structure.equations.response(q, np.array([at]), ())[0][:, 0]
    assert np.allclose(measured[:2], response[:2], rtol=0.003)
    assert abs(lines[1][2]) > abs(lines[0][2])


def test_stability_is_that_of_the_samples():
    structure = declared("exact")
    stable = {rate: structure.equations.stable(values(tug(rate), structure)) for rate in (2.0, 10.0)}
    assert stable == {2.0: True, 10.0: True}
    # A loop that is stable when it always looks is not when it looks twice a second.
    hot = {"K_p": 6.0, "K_i": 12.0, "T_d": 0.0}
    for rate, expected in ((2.0, False), (50.0, True)):
        assert structure.equations.stable(values(tug(rate), structure) | hot) is expected


@pytest.fixture(scope="module")
def trial() -> tuple[Vessel, Experiment]:
    """Swings of 5 rpm from 0.05 to 4 Hz in 100 s, a governor that looks five times a second, sensors with noise."""
    ship = tug(5.0)
    chirp = signals.chirp(0.05, 4.0, 100.0, 5.0, rate_hz=20.0)
    noise = {"n_e": 0.01, "M_g": 0.01, "X_f": 0.01}
    return ship, simulate(ship, chirp, noise=noise, seed=3)


def test_a_fit_finds_the_ship_where_the_hold_alone_is_called_wrong(trial, tmp_path):
    ship, record = trial
    period = 1.0 / ship.governor.sample_rate_hz
    given = {"T_s": period, "v": linearise(ship).v}
    exact = declared("exact").with_fixed(**given)
    found = identify(record, exact, starts=1, noise="white")
    truth = values(ship, exact)
    for name in found.covariance["names"]:
        assert abs(found[name].value - truth[name]) < 4 * found[name].std, name
    assert found.model_adequate is not False
    approximate = identify(record, declared(True).with_fixed(**given), starts=1, noise="white")
    # What the governor mistakes one frequency for is no answer at the set point's own: it is noise to the hold alone.
    for output in found.structure["outputs"]:
        assert found.fit[output]["whiteness_p"] > 1e-4 > 1e-6 > approximate.fit[output]["whiteness_p"]
    assert approximate.fit["dX"]["nrmse_pct"] < 85.0 < 98.0 < found.fit["dX"]["nrmse_pct"]
    for name in ("K_p", "K_i", "T_d", "T_set"):
        assert found[name].std < 0.1 * approximate[name].std
    loaded = type(found).load(found.save(tmp_path / "fingerprint.json"))
    assert structure_of(loaded).equations == exact.equations
    # Below half its rate the governor is late by half its period, more or less.
    assert closed_loop(loaded)["phase margin"].value == pytest.approx(
        closed_loop(approximate)["phase margin"].value, abs=15.0
    )


def test_what_cannot_go_together_is_refused():
    with pytest.raises(InputError, match="misreading or curvature"):
        Structure.linear(sampling="exact", misreading=True)
    with pytest.raises(InputError, match="'exact'"):
        Structure.linear(sampling="sometimes")
    with pytest.raises(InputError, match="'dE'"):
        Structure.linear(sampling="exact", outputs=("dn", "dE"))


def test_when_the_governor_looks_is_found_from_aliases(trial):
    # Cut 3.05 s after the start: the governor's next sample, at 3.2 s, is 0.15 s into the record.
    ship, record = trial
    later = record.window(3.05, 100.0)
    structure = declared("exact").with_fixed(T_s=0.2, v=linearise(ship).v).with_bounds(T_0=(0.0, 0.1, 0.2))
    found = identify(later, structure, starts=1, noise="white")
    assert abs(found["T_0"].value - 0.15) < 4 * found["T_0"].std
    assert found["T_0"].std < 1e-3
    assert abs(found["T_d"].value - ship.actuator.dead_time_s) < 4 * found["T_d"].std
