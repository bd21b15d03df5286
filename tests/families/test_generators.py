"""The families' generators: they move as the package's ship does, seeds give the same trial, sensors do what they state."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import csd, welch

from shipfp_rs import _core
from shipfp_rs.structures.ship import INDEX, KERNEL
from tests.families import excitations, matters, recording, sensors, small_steps, wrong
from tests.families.draw import CHANNELS, FAMILIES, Loads, draw, has_margins
from tests.families.plant import ELEMENTS, LIMITS, Plant, normalised, physical, without

BASE = {"tau_n": 1.2, "g": -0.5, "vK_p": 4.5, "vK_i": 10.0, "p": 2.15, "tau_prop": 0.38}
TUG = {"engine_speed": 19.73, "ratio": 3.82, "efficiency": 0.97, "shaft_torque": 1725.0}
TWIST = {"tau_twist": 0.004, "zeta_twist": 0.5}
SAMPLED = {"T_s": 0.03, "T_0": 0.013, "T_d": 0.05, "T_set": 0.1}
ALL = {**SAMPLED, **TWIST, "M_max": 1.1, "tau_act": 0.05, "rate": 2.0, "damping": 0.3, "update": 1.0}
STEP_S = 5e-4
drawn_once = cache(draw)


def nightly(family, others):
    """Return a family that is always run, and the others at night."""
    return [family, *(pytest.param(one, marks=pytest.mark.slow) for one in others if one != family)]


def of_package(relative, asked):
    """Return speed, brake and gauge torque over the operating point by the package's stepper."""
    vector = np.array(_core.SHIP_OFF)
    true = normalised(physical(BASE | relative, **TUG))
    for name, value in {"v": 1.0, **true, "rate_down": true["rate"]}.items():
        vector[INDEX[KERNEL.get(name, name)]] = value
    outputs = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dM_b", "dM_g")]
    return 1.0 + _core.simulate_ship(vector, asked, np.empty(0), STEP_S, 1, "first", outputs)


@pytest.mark.parametrize(
    "elements",
    [
        {"T_d": 0.07, "T_set": 0.3},
        SAMPLED,
        {**SAMPLED, "update": 1.0},
        {"tau_act": 0.1, "rate": 0.4},
        {"rate": 0.3},
        {"M_max": 1.08},
        {"damping": 0.8, "p": 0.0},
        TWIST,
        ALL,
    ],
    ids=lambda elements: "+".join(elements) or "none",
)
def test_a_generated_ship_moves_as_the_package_s(elements):
    """Small steps in physical units, and the package's stepper in relative ones, were written apart."""
    drawn = excitations.drawn(np.random.default_rng(5), "multisine")
    excitation = excitations.Excitation("multisine", 1.0, 20.0, drawn.table)
    plant = physical(BASE | elements, **TUG)
    motion = small_steps.simulate(plant, excitation, excitation.stop_s, step_s=STEP_S)
    speed, brake, gauge = of_package(elements, motion.asked / plant.engine_speed)
    mean, late = (
        np.abs(motion.brake_torque / plant.brake_torque - brake).mean(),
        {"rate", "T_s"} & set(elements),
    )
    # A rack without a lag follows its limit, or a governor's clock, between the steps.
    jumps = late and "tau_act" not in elements
    assert np.ptp(speed) > 0.05
    assert np.abs(motion.engine_speed / plant.engine_speed - speed).max() < (5e-5 if jumps else 5e-8)
    assert mean < (2e-4 if jumps else 5e-8)
    assert np.abs(motion.gauge_torque / plant.shaft_torque - gauge).mean() < (6e-5 if jumps else 5e-8)
    if "M_max" in elements:
        assert 0.01 < np.mean(brake > elements["M_max"] - 1e-9) < 0.7


def test_a_step_of_the_load_slows_the_set_as_in_closed_form():
    """Without governor and damping: tau_n dN/dt = -w right behind the step, w / (p - g) in the end."""
    relative = {"tau_n": 1.0, "g": -0.5, "vK_p": 0.0, "vK_i": 0.0, "p": 1.0, "tau_prop": 0.4}
    plant = physical(relative, engine_speed=25.0, shaft_torque=1000.0)
    loads = Loads(np.array([[1.0, 0.01]]), 1000.0, ramp_s=1e-3)
    motion = small_steps.simulate(plant, np.ones_like, 15.0, step_s=5e-4, load=loads)
    n = motion.engine_speed / 25.0 - 1.0
    expected = -0.01 / 1.5 * (1.0 - np.exp(-1.5 * 4.0))
    assert n[round(5.0 / 5e-4)] == pytest.approx(expected, rel=1e-3)
    assert motion.gauge_torque[-1] / 1000.0 - 1.0 == pytest.approx(0.01 + n[-1], abs=1e-6)


@pytest.mark.parametrize("drift", [-0.5, 0.3])
def test_the_load_of_a_drifting_exponent_is_its_formula(drift):
    """L = N^(p + c_2 (N - 1)), in steady running at 105 per cent; to the second order N^p + c_2 (N - 1)^2."""
    plant = physical(BASE | {"c_2": drift}, **TUG)
    excitation = excitations.Excitation("steps", 1.0, 60.0, np.array([[0.0, 1.05]]))
    motion = small_steps.simulate(plant, excitation, 60.0, step_s=1e-3)
    load = motion.gauge_torque[-1] / plant.shaft_torque
    assert motion.engine_speed[-1] / plant.engine_speed == pytest.approx(1.05, abs=1e-6)
    assert load == pytest.approx(1.05 ** (2.15 + drift * 0.05), abs=1e-5)
    assert load - 1.05**2.15 == pytest.approx(drift * 0.05**2, rel=0.1)


def test_truth_is_normalised_at_the_operating_point():
    """Stan Launch 804 (Table 3.5): tau_n = 2 pi 21.2 * 7.222 / 635.77 = 1.513 s; A1, A2 and the gains of section 2."""
    n_e = 1300.0 / 60.0
    plant = Plant(
        engine_speed=n_e,
        ratio=3.0,
        efficiency=635.77 / (3.0 * 222.93),
        shaft_torque=635.77,
        engine_inertia=15.0,
        load_inertia=6.2,
        exponent=2.0,
        load_damping=0.0,
        engine_slope=-0.100 * 60.0,
        rack=13.07,
        rack_slope=27.0,
        gain=0.1005 * 60.0,
        integral_gain=0.01005 * 60.0,
    )
    found = normalised(plant)
    assert found["tau_n"] == pytest.approx(1.513, abs=1e-3)
    assert found["tau_prop"] == pytest.approx(1.513 * 6.2 / 21.2, abs=1e-3)
    assert found["g"] == pytest.approx(-0.583, abs=1e-3)
    assert found["vK_p"] == pytest.approx(15.83, abs=0.02)
    assert found["vK_i"] == pytest.approx(1.583, abs=0.002)
    assert plant.brake_torque == pytest.approx(222.93)


def test_physical_and_relative_numbers_lead_back_to_each_other_and_each_element_to_off():
    relative = BASE | ALL
    plant = physical(relative, **TUG)
    before = normalised(plant)
    assert {name: before[name] for name in relative} == pytest.approx(relative)
    for element in ELEMENTS:
        after = normalised(without(plant, element))
        assert after[element] == (np.inf if element in LIMITS else 0.0)
        off = {"T_s": {"T_0", "update"}, "tau_twist": {"zeta_twist"}}.get(element, set()) | {element}
        assert [name for name in before if after[name] != before[name] and name not in off] == []


@pytest.mark.parametrize(
    ("family", "draws"),
    [("lab_drive", 2), *(pytest.param(one, 16, marks=pytest.mark.slow) for one in FAMILIES)],
)
def test_draws_are_seeded_and_keep_their_ranges(family, draws):
    some = [draw(family, seed, longest_s=240.0) for seed in range(draws)]
    assert draw(family, 1, longest_s=240.0).truth() == some[1].truth()
    on = np.zeros(len(ELEMENTS))
    for one in some:
        values = one.truth()["parameters"]
        assert 0.3 <= values["tau_n"] <= 3.0
        assert 0.0 <= values["p"] <= 2.5
        assert -1.5 <= values["g"] <= 0.3
        assert 0.2 <= values["tau_prop"] / values["tau_n"] <= 0.6
        assert values["T_d"] <= 0.15
        assert values["T_set"] <= 0.6
        assert 20.0 <= one.excitation.start_s <= 40.0
        assert 0.039 < one.excitation.swing < 0.081
        assert 200.0 <= one.excitation.stop_s - one.excitation.start_s <= 600.0
        assert has_margins({name: 0.0 if value is None else value for name, value in values.items()})
        on += [name in one.on for name in ELEMENTS]
    # Most are on with probability 1/2; a twist keeps its margins more rarely.
    assert draws < 16 or ((on > 0) & (on < len(some))).all()


@pytest.mark.parametrize("family", nightly("tug", FAMILIES))
def test_experiments_hold_the_trial(family):
    one = replace(drawn_once(family, 2, longest_s=200.0), late_s=None)
    made, again = one.experiment(), one.experiment()
    truth = one.truth()
    torque = "M_g" if truth["place"] == "gauge" else "M_b"
    length = len(made["signals"]["n_set"])
    assert length == pytest.approx(50.0 * one.excitation.stop_s, abs=1.0)
    for name, samples in made["signals"].items():
        assert np.array_equal(samples, again["signals"][name])
        assert samples.shape == (length,)
        assert np.isfinite(samples).all()
    true = {"n_set": "n_e_rpm", "n_e": "n_e_rpm", torque: "M_Nm"}
    # What the water does to the mean of a short stretch, and the noise.
    slack = 0.002 + (3.0 * one.water.share if one.water else 0.0)
    for name, key in true.items():
        assert made["operating_point"][name] == pytest.approx(truth["operating_point"][key], rel=slack)


@pytest.mark.parametrize("family", nightly("genset", ("tug", "lab_drive")))
def test_raw_logs_hold_the_trial(family, tmp_path):
    """Pulses count the turns, volts and their line give the set point, and nothing of the truth is in the files."""
    one = draw(family, 6, longest_s=200.0, load=False)
    trial, log = recording.write(one, tmp_path)
    assert log.rate_hz in (2000.0, 5000.0)
    assert 3 <= len(log.columns) <= 6
    text = trial.read_text(encoding="utf-8")
    assert "[identify]" not in text
    assert "[structure]" not in text
    line = text.split("scale = ")[1].split(" }")[0].split(", offset = ")
    rpm = float(line[0]) * np.median(log.columns["U_setpoint"][: int(10 * log.rate_hz)]) + float(line[1])
    assert rpm == pytest.approx(60.0 * one.plant.engine_speed, rel=2e-3)
    name = [key for key in log.columns if not key.startswith("U_")][-1]
    teeth = int(text.split(f"[channels.{name}]")[1].split("pulses_per_rev = ")[1].split("\n")[0])
    volts = log.columns[name].astype(float)
    armed = np.where(volts > 3.5, 1, np.where(volts < 1.4, 0, -1))
    armed = armed[armed >= 0]
    turns = (np.diff(armed) > 0).sum() / teeth
    assert turns == pytest.approx(one.plant.engine_speed * one.excitation.stop_s, rel=0.02)
    told = text + (tmp_path / "vessel.toml").read_text(encoding="utf-8")
    truth = one.truth()["parameters"]
    for key in ("tau_n", "g", "vK_p", "vK_i", "tau_prop", "T_d"):
        assert f"{truth[key]:.4g}" not in told or truth[key] == 0.0


def test_a_window_that_begins_late_holds_the_rest_of_the_same_trial():
    whole = replace(drawn_once("genset", 2, longest_s=200.0), late_s=None)
    late = replace(whole, late_s=3.5)
    made, cut = whole.experiment(), late.experiment()
    first = round((whole.excitation.start_s + 3.5) * sensors.COMMON_HZ)
    for name, samples in made["signals"].items():
        assert np.array_equal(cut["signals"][name], samples[first:])
    assert cut["operating_point"] == made["operating_point"]
    assert late.truth()["late_s"] == 3.5


def test_channels_without_noise_are_the_motion_itself():
    quiet = replace(
        drawn_once("tug", 2, longest_s=200.0),
        noise_free=CHANNELS,
        noise=(sensors.Noise(()),) * 2,
        late_s=None,
    )
    signals = quiet.experiment()["signals"]
    for made, clean in zip(signals.values(), quiet.clean(), strict=True):
        clean = sensors.to_common(clean)
        assert made / made[0] == pytest.approx(clean / clean[0], abs=1e-12)


def test_all_signals_of_an_experiment_pass_one_filter():
    """A sine far below the band passes unchanged, one above half the rate is gone."""
    t = np.arange(0.0, 20.0, 5e-4)
    for frequency, gain in ((1.0, 1.0), (10.0, 1.0), (28.0, 0.0)):
        through = sensors.to_common(sensors.to_middle(np.sin(2.0 * np.pi * frequency * t), 5e-4))
        expected = gain * np.sin(2.0 * np.pi * frequency * np.arange(len(through)) / 50.0)
        assert np.abs(through - expected)[50:-50].max() < 2e-3


def test_noise_has_the_spectrum_that_it_states():
    random = np.random.default_rng(4)
    for noise in (sensors.speed_noise(random), sensors.torque_noise(random)):
        samples = sensors.to_common(noise.samples(random, 400_000))
        f, power = welch(samples, 50.0, nperseg=2048)
        use = (f > 0.2) & (f < 17.0)
        # One-sided density times half the rate: variance a sample.
        ratio = power[use] * 25.0 / noise.spectrum(f[use])
        assert np.median(ratio) == pytest.approx(1.0, abs=0.03)
        assert ((ratio > 0.5) & (ratio < 1.6)).all()


def test_telemetry_is_late_by_what_it_states():
    step, telemetry = 1e-4, sensors.Telemetry(300.0, 250.0)
    t = np.arange(0.0, 8.0, step)
    given = 1000.0 * (1.0 + 0.05 * np.sin(2.0 * np.pi * 1.5 * t))
    heard = telemetry(given, step)
    _, cross = csd(given, heard, 1.0 / step, nperseg=len(t) // 3)
    k = np.argmax(np.abs(cross[1:])) + 1
    late = -np.angle(cross[k]) / (2.0 * np.pi * 1.5)
    assert late == pytest.approx(telemetry.delay_s, abs=6e-5)
    assert len(np.unique(heard[10_000:11_000])) <= 51


def test_pulses_stand_where_the_reflectors_are():
    random = np.random.default_rng(1)
    positions = sensors.reflectors(random, 4, 0.02)
    pulses = sensors.Pulses(positions, width=0.3, rise_s=3e-4, noise=0.02)
    step = 2.5e-4
    turns = 5.0 * np.arange(0.0, 10.0, step)
    times = np.arange(0.0, 10.0, 5e-4)
    volts = pulses(turns, step, times, random).astype(float)
    high = volts > 2.45
    rises = np.flatnonzero(~high[:-1] & high[1:])
    at = times[rises] + 5e-4 * (2.45 - volts[rises]) / (volts[rises + 1] - volts[rises])
    edges = pulses.edges(turns, step)
    assert abs(len(at) - 200) <= 2
    nearest = edges[np.abs(np.subtract.outer(at, edges)).argmin(axis=1)]
    # The middle level is reached half a rise late; the rest is the sampling, Ts / sqrt(12) at most.
    assert np.abs(at - nearest - 1.5e-4).max() < 5e-4
    assert np.std(at - nearest) < 5e-4 / np.sqrt(12.0) * 1.2
    angle = np.sort(np.interp(edges, np.arange(len(turns)) * step, turns)[:40] % 1.0)
    assert np.abs(np.subtract.outer(angle, positions)).min(axis=1).max() < 1e-9
    assert volts.min() > -0.1
    assert volts.max() < 5.0


@pytest.mark.slow
def test_an_element_matters_by_its_effect_against_the_noise():
    """A dead time of 0.1 s does, one of a tenth of a millisecond does not; less noise makes more matter."""
    some = (draw("tug", seed, kind="multisine", longest_s=220.0) for seed in range(40))
    one = next(d for d in some if "T_set" in d.on and not d.noise_free)
    for name in set(one.on) - {"T_set", "water"}:
        one = replace(one, plant=without(one.plant, name))
    one = replace(one, water=None, late_s=None)
    found = matters.judged(one)["T_set"]
    assert found["verdict"] == "matters"
    assert found["distinct"] <= found["size"]
    little = replace(one, plant=one.plant._replace(set_point_dead_time=1e-4))
    assert matters.judged(little)["T_set"]["verdict"] == "idle"


@pytest.mark.parametrize("seed", nightly(0, range(len(wrong.KINDS))))
def test_wrong_data_are_wrong_in_the_way_they_say(seed):
    made = wrong.wrong(seed)
    signals, point = made.experiment["signals"], made.experiment["operating_point"]
    assert len({len(one) for one in signals.values()}) == 1
    assert set(point) == set(signals)
    if made.kind == "constant set point":
        assert np.ptp(signals["n_set"]) == 0.0
    if made.kind == "too few samples":
        assert len(signals["n_set"]) < 60
    if made.kind == "torque of the wrong sign":
        torque = next(name for name in signals if name.startswith("M_"))
        assert np.corrcoef(signals[torque], signals["n_e"])[0, 1] < 0.0
