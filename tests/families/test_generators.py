"""The generators of simulated trials themselves: equations, normalisation and sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benches import rival_ship
from scipy.signal import csd, welch

from tests.families import events as by_events
from tests.families import excitations, matters, recording, sensors, small_steps, wrong
from tests.families.draw import FAMILIES, Loads, draw, fast_motion, has_margins, open_loop
from tests.families.plant import ELEMENTS, LIMITS, normalised, physical, without
from tests.families.water import Water

BASE = {"tau_n": 1.2, "g": -0.5, "vK_p": 4.5, "vK_i": 10.0, "p": 2.15, "tau_prop": 0.38}
TUG = {"engine_speed": 19.73, "ratio": 3.82, "efficiency": 0.97, "shaft_torque": 1725.0}
ALL = {
    "T_s": 0.03,
    "T_0": 0.013,
    "T_d": 0.05,
    "T_set": 0.1,
    "M_max": 1.1,
    "tau_act": 0.05,
    "rate": 2.0,
    "tau_twist": 0.004,
    "zeta_twist": 0.5,
}


def nightly(cases, *always):
    """Return cases of which those named, or at these places, are always run, and the others at night."""
    return [
        case if place in always or case in always else pytest.param(case, marks=pytest.mark.slow)
        for place, case in enumerate(cases)
    ]


def chirp(swing=0.06, seconds=20.0, low=0.05, high=3.0):
    growth = np.log(high / low) / seconds
    return excitations.Excitation("chirp", 1.0, 1.0 + seconds, np.array([[low, growth, swing]]))


def relative_outputs(relative, excitation, step_s=2.5e-4, water=None):
    plant = physical(relative, **TUG)
    motion = small_steps.simulate(plant, excitation, excitation.stop_s, step_s=step_s, water=water)
    return np.vstack(
        [
            motion.engine_speed / plant.engine_speed,
            motion.load_speed / plant.shaft_speed,
            motion.brake_torque / plant.brake_torque,
            motion.gauge_torque / plant.shaft_torque,
        ]
    )


@pytest.mark.parametrize(
    "elements",
    nightly(
        [
            {},
            {"T_d": 0.07, "T_set": 0.3},
            {"T_s": 0.02, "T_0": 0.003},
            {"T_s": 0.03, "T_0": 0.013, "T_d": 0.05, "T_set": 0.1, "update": 1.0},
            {"tau_act": 0.1, "T_d": 0.03},
            {"tau_act": 0.1, "rate": 0.4, "c_2": 0.45},
            {"M_max": 1.08},
            {"tau_twist": 0.004, "zeta_twist": 0.5},
            ALL,
        ],
        ALL,
    ),
    ids=lambda elements: "+".join(elements) or "none",
)
def test_two_integrators_agree(elements):
    """Small steps in physical units, and solve_ivp with events in relative ones, were written apart."""
    excitation, water = chirp(), Water(0.01, 0.5, 25.0, 3)
    one = relative_outputs(BASE | elements, excitation, water=water)
    other = np.vstack(by_events.simulate(BASE | elements, excitation, step_s=2.5e-4, water=water))
    assert np.abs(one - other).max() < 5e-6
    assert np.abs(one - other).mean() < 1e-7
    if "M_max" in elements:
        assert 0.01 < np.mean(other[2] > elements["M_max"] - 1e-9) < 0.7


@pytest.mark.parametrize("kind", nightly(excitations.KINDS, "steps"))
def test_integrators_agree_on_every_excitation(kind):
    drawn = excitations.drawn(np.random.default_rng(5), kind)
    excitation = excitations.Excitation(kind, 1.0, 16.0, drawn.table)
    relative = BASE | {"T_d": 0.05, "T_set": 0.1}
    one = relative_outputs(relative, excitation)
    other = np.vstack(by_events.simulate(relative, excitation, step_s=2.5e-4))
    # At a step the torque jumps; small steps spread that over one of them.
    assert np.abs(one - other).mean() < (5e-6 if kind == "steps" else 1e-7)
    assert np.abs(one - other)[0].max() < 5e-5


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


@pytest.mark.parametrize(
    "elements",
    nightly(
        [
            {},
            {"T_d": 0.07, "T_set": 0.3},
            {"tau_act": 0.1, "T_d": 0.03},
            {"tau_twist": 0.004, "zeta_twist": 0.5},
            {"damping": 0.8, "p": 0.0, "c_2": 0.5},
        ],
        1,
    ),
    ids=lambda elements: "+".join(elements) or "none",
)
@pytest.mark.parametrize("frequency", nightly([0.1, 1.0, 3.0], 1.0))
def test_small_motion_is_the_linear_model(elements, frequency):
    """n*/n_set* = L / (tau_n s + p - g + L), M_b* = (p + tau_n s) n*, M_g* = (p + tau_prop s) n*.

    Eq. 3.31 to 3.38 of the thesis, with p, two inertias, dead times and an actuator.
    """
    relative = BASE | elements
    periods = max(3, round(3.0 * frequency))
    seconds = 15.0 + periods / frequency
    table = np.array([[0.0, frequency, 1e-5]])
    excitation = excitations.Excitation("sines", 1.0, 1.0 + seconds, table)
    out = relative_outputs(relative, excitation, step_s=5e-4) - 1.0
    last = slice(-round(periods / frequency / 5e-4), None)
    times = np.arange(out.shape[1]) * 5e-4
    turn = np.exp(-2j * np.pi * frequency * (times[last] - 1.0))
    found = 2.0 * (out[:, last] * turn).mean(axis=1) / (1e-5 / 1j)
    s = 2j * np.pi * frequency
    loop = open_loop(relative, s)
    closed = loop / (1.0 + loop) * np.exp(-s * relative.get("T_set", 0.0))
    slope = relative["p"] + relative.get("damping", 0.0)
    assert found[0] == pytest.approx(closed, rel=2e-3)
    # At the load, whose speed a twisting shaft sets apart.
    assert found[3] == pytest.approx((slope + relative["tau_prop"] * s) * found[1], rel=2e-3)
    behind = (relative["tau_n"] - relative["tau_prop"]) * s * found[0] + found[3]
    assert found[2] == pytest.approx(behind, rel=2e-3)


@pytest.mark.parametrize("update", nightly([0.0, 1.0], 1.0))
def test_a_sampling_governor_is_late_by_half_its_period(update):
    """With a sum updated before use it is also stronger by vK_i T_s / 2, after use weaker."""
    period, excitation = 0.04, chirp(swing=0.01, high=0.5)
    sampled = relative_outputs(BASE | {"T_s": period, "T_d": 0.03, "update": update}, excitation)
    gain = 4.5 + 10.0 * period * (update - 0.5)
    smooth = relative_outputs(BASE | {"T_d": 0.03 + period / 2.0, "vK_p": gain}, excitation)
    plain = relative_outputs(BASE | {"T_d": 0.03}, excitation)
    assert np.std(sampled[0] - smooth[0]) < 0.05 * np.std(sampled[0] - plain[0])


def test_physical_and_relative_numbers_lead_back_to_each_other():
    relative = BASE | ALL | {"damping": 0.3, "update": 1.0}
    found = normalised(physical(relative, **TUG))
    assert {name: found[name] for name in relative} == pytest.approx(relative)


@pytest.mark.parametrize("element", ELEMENTS)
def test_an_element_switched_off_is_off_and_nothing_else(element):
    plant = physical(BASE | ALL, **TUG)
    before, after = normalised(plant), normalised(without(plant, element))
    assert after[element] == (np.inf if element in LIMITS else 0.0)
    with_it = {"T_s": {"T_0", "update"}, "tau_twist": {"zeta_twist"}}.get(element, set()) | {element}
    assert all(after[name] == before[name] for name in before if name not in with_it)


def test_margins_tell_a_stable_loop_from_an_unstable_one():
    assert has_margins(BASE)
    assert not has_margins(BASE | {"T_d": 0.6})
    assert not has_margins(BASE | {"vK_p": 40.0, "T_d": 0.15})


@pytest.mark.parametrize(
    ("family", "draws"),
    [("lab_drive", 5), *(pytest.param(one, 16, marks=pytest.mark.slow) for one in FAMILIES)],
)
def test_draws_are_seeded_and_keep_their_ranges(family, draws):
    some = [draw(family, seed, longest_s=240.0) for seed in range(draws)]
    again = draw(family, 3, longest_s=240.0)
    assert again.truth() == some[3].truth()
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


@pytest.mark.parametrize(
    "family", ["tug", *(pytest.param(one, marks=pytest.mark.slow) for one in FAMILIES if one != "tug")]
)
def test_experiments_hold_the_trial(family):
    # The launch is integrated by solve_ivp, where sampling governors take long.
    one = replace(draw(family, 0 if family == "launch" else 2, longest_s=200.0), late_s=None)
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


def test_water_has_its_share_and_memory():
    water = Water(0.01, 0.8, 4000.0, 7)
    values = water(np.arange(0.0, 4000.0, 0.1))
    assert values.std() == pytest.approx(0.01, rel=0.08)
    assert np.corrcoef(values[:-8], values[8:])[0, 1] == pytest.approx(2.0 / np.e, abs=0.06)


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


def test_faults_of_pulses_come_at_their_rate():
    random = np.random.default_rng(2)
    turns, step = 10.0 * np.arange(0.0, 100.0, 2.5e-4), 2.5e-4
    times = np.arange(0.0, 100.0, 2e-4)

    def count(**faults):
        pulses = sensors.Pulses(np.array([0.1]), width=0.3, noise=0.0, **faults)
        high = pulses(turns, step, times, random) > 2.45
        return int((~high[:-1] & high[1:]).sum())

    whole = count()
    assert whole == pytest.approx(1000, abs=2)
    assert 0.03 < count(double=0.05) / whole - 1.0 < 0.08
    assert 0.03 < 1.0 - count(broken=0.05) / whole < 0.08


@pytest.mark.parametrize(
    "family", ["genset", *(pytest.param(one, marks=pytest.mark.slow) for one in ("tug", "lab_drive"))]
)
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


def only(elements, kind):
    """Return a draw with these elements and noise, all else that it had switched off."""
    some = (draw("tug", seed, kind=kind, longest_s=220.0) for seed in range(40))
    one = next(d for d in some if elements <= set(d.on) and not d.noise_free)
    for name in set(one.on) - elements - {"water"}:
        one = replace(one, plant=without(one.plant, name))
    return replace(one, water=None, late_s=None)


@pytest.mark.slow
def test_an_element_matters_by_its_effect_against_the_noise():
    """A dead time of 0.1 s does, one of a tenth of a millisecond does not; less noise makes more matter."""
    one = only({"T_set"}, kind="multisine")
    found = matters.judged(one)
    assert found["T_set"]["verdict"] == "matters"
    assert found["T_set"]["distinct"] <= found["T_set"]["size"]
    little = replace(one, plant=one.plant._replace(set_point_dead_time=1e-4))
    assert matters.judged(little)["T_set"]["verdict"] == "idle"


def test_the_weight_of_white_noise_is_one_a_degree_of_freedom():
    noise = sensors.Noise(((0.01, ()),))
    random = np.random.default_rng(3)
    parts = matters._weigh(sensors.to_common(noise.samples(random, 80_000)), noise)
    assert np.mean(parts[1:] ** 2) == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow  # small steps on drawn elements agree above
def test_launch_agrees_with_small_steps_on_a_draw():
    one = next(
        d
        for d in (draw("launch", seed, longest_s=200.0) for seed in range(20))
        if not {"T_s", "rate"} & set(d.on)
    )
    ours, other = one.motion(1e-3), fast_motion(one, step_s=2.5e-4)
    apart = ours.engine_speed - other.engine_speed[::4][: len(ours.engine_speed)]
    assert np.abs(apart).max() < 1e-4 * one.plant.engine_speed
    assert np.abs(apart).mean() < 2e-6 * one.plant.engine_speed


@pytest.mark.parametrize("seed", nightly(range(len(wrong.KINDS)), 0))
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


@pytest.mark.parametrize("some", [{"T_d", "T_set"}, pytest.param({"T_d"}, marks=pytest.mark.slow)])
def test_a_third_simulation_finds_the_truth_in_an_experiment(some):
    """The rival's ship, at the truth and on the set point at 50 Hz, leaves far less than the noise.

    What it leaves is its set point's straight lines between samples.
    """
    one = replace(only(some, kind="chirp"), torque_delay_s=0.0)
    asked, speed, torque = (sensors.to_common(signal) for signal in one.clean())
    values = one.truth()["parameters"]
    numbers = np.array([values.get(name, 1.0) for name in rival_ship.NAMES])
    left = np.vstack([speed, torque]) - rival_ship.ship(numbers, asked, 0.02, 20)
    for residual, noise in zip(left, one.noise, strict=True):
        assert residual[100:].std() < 0.15 * noise.samples(np.random.default_rng(0), 40_000).std()
