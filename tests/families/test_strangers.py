"""Strangers: seeded, at rest at first, as their linear transfer function for small swings, torques in balance."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.families import recording, score, strangers
from tests.families.excitations import Excitation
from tests.families.strangers import KINDS, draw

SEEDS = range(len(KINDS))
drawn_once = cache(draw)


def calm(seed, **changes):
    """Return a draw without wake, firing, bus and ramp."""
    one = drawn_once(seed)
    numbers = one.numbers | {"firing": 0.0, "set_rate": np.inf} | changes
    return replace(one, wake=0.0, bus_hz=None, numbers=numbers)


@pytest.mark.parametrize("seed", SEEDS, ids=KINDS)
def test_a_draw_is_seeded_and_simulated_at_once(seed):
    one = drawn_once(seed)
    one.motion()  # compiles
    began = time.perf_counter()
    motion = one.motion()
    assert time.perf_counter() - began < 3.0
    assert one.kind == KINDS[seed]
    assert draw(seed).truth() == one.truth()
    for first, second in zip(motion, one.motion(), strict=True):
        assert np.array_equal(first, second)
    made, again = one.experiment(), one.experiment()
    for name, samples in made["signals"].items():
        assert np.array_equal(samples, again["signals"][name])
        assert np.isfinite(samples).all()
    assert one.truth()["loop"]["phase_margin_deg"] > 25.0


@pytest.mark.parametrize("seed", SEEDS, ids=KINDS)
def test_speed_and_torque_rest_at_their_operating_point(seed):
    one = calm(seed)
    motion = one.motion()
    rest = slice(0, int(one.excitation.start_s / motion.step_s))
    for signal in (motion.engine, motion.propeller, motion.shaft, motion.brake):
        assert np.abs(signal[rest] - 1.0).max() < 1e-9


def swing(signal, hz, step_s, seconds):
    """Complex amplitude of a signal's last whole periods."""
    signal = signal[-round(seconds / step_s) :]
    wave = np.exp(-2j * np.pi * hz * step_s * np.arange(len(signal)))
    return 2.0 * np.mean((signal - signal.mean()) * wave)


@pytest.mark.parametrize("seed", [0, 1, 3, 4, 9], ids=lambda seed: f"{KINDS[seed % 4]} {seed}")
def test_a_small_sine_is_answered_as_by_the_transfer_function(seed):
    """N / N_set = K way / (Y + F K way) exp(-s T_set), M / N by the load and the shaft, all from the truth alone."""
    one = calm(seed, T_f=0.03) if KINDS[seed % 4] == "vfd" else calm(seed)
    q, period = one.numbers, 2.0
    sine = Excitation("sines", 1.0, 401.0, np.array([[0.0, 1.0 / period, 1e-4]]))
    one = replace(one, excitation=sine)
    motion = one.motion()
    s = 2j * np.pi / period
    gain = (q["vK_p"] + q["vK_i"] / s) * np.exp(-s * q["T_d"]) / (1.0 + s * q["tau_act"])
    behind = q["tau_prop"] * s + q["p"]
    ratio = 1.0
    if q["tau_twist"]:
        spring = 1.0 / (s * q["tau_twist"]) + q["zeta_twist"]
        ratio = spring / (spring + behind)
    whole = (q["tau_n"] - q["tau_prop"]) * s - q["g"] + behind * ratio
    speed = gain / (whole + gain / (1.0 + s * q["T_f"])) * np.exp(-s * q["T_set"])
    seconds = 40.0
    asked, engine, propeller, shaft, brake = (
        swing(signal, 1.0 / period, motion.step_s, seconds)
        for signal in (
            motion.asked / one.plant.engine_speed,
            motion.engine,
            motion.propeller,
            motion.shaft,
            motion.brake,
        )
    )
    assert engine / asked == pytest.approx(speed, rel=0.01)
    assert propeller / engine == pytest.approx(ratio, rel=0.01)
    assert shaft / engine == pytest.approx(behind * ratio, rel=0.01)
    assert brake / engine == pytest.approx(whole + q["g"], rel=0.01)


@pytest.mark.parametrize("seed", SEEDS, ids=KINDS)
def test_the_shaft_s_torque_is_load_and_propeller_s_inertia(seed):
    """M = q N_p^p (1 + wake) + tau_prop dN_p/dt, by differences of the simulated speed."""
    one = drawn_once(seed)
    motion, h = one.motion(), strangers.STEP_S
    times = np.arange(len(motion.propeller)) * h
    load = motion.propeller ** one.numbers["p"]
    load = load * (1.0 + one.moved(times)) + motion.added * (1.0 + one.moved(times))
    slope = np.gradient(motion.propeller, h)
    balance = load + one.numbers["tau_prop"] * slope
    # Where a set point or a pitch begins to move, a difference is of the first order.
    middle = slice(10, -10)
    assert np.quantile(np.abs(motion.shaft - balance)[middle], 0.999) < 2e-4


def test_a_ramp_follows_at_its_fastest_and_then_stands():
    jump = np.repeat([1.0, 1.1], [10, 40])
    followed = strangers.ramped(jump, 0.004)
    assert followed[10:13] == pytest.approx([1.004, 1.008, 1.012])
    assert followed[34:] == pytest.approx(1.1)


def test_drives_have_ramp_filter_and_bus_in_some_draws_and_not_in_others():
    some = [draw(seed, longest_s=130.0) for seed in range(1, 49, 4)]
    for has in ("set_rate", "T_f"):
        assert 0 < sum(has in one.on for one in some) < len(some)
    assert {one.bus_hz for one in some} > {None}


def test_margins_are_those_of_a_known_loop():
    """K exp(-s T) / (tau s): crossover K / (2 pi tau), margin 90 deg - wT, gain margin pi tau / (2 K T)."""
    q = dict.fromkeys(("T_set", "tau_act", "T_f", "tau_eng", "tau_twist", "zeta_twist", "g", "tau_prop"), 0.0)
    q |= {"tau_n": 2.0, "p": 1e-9, "vK_p": 3.0, "vK_i": 1e-9, "T_d": 0.2}
    found = strangers.loop_figures(q)
    assert found["crossover_hz"] == pytest.approx(1.5 / (2.0 * np.pi), rel=1e-6)
    assert found["phase_margin_deg"] == pytest.approx(90.0 - np.degrees(0.3), rel=1e-6)
    assert found["gain_margin"] == pytest.approx(np.pi / (2.0 * 1.5 * 0.2), rel=1e-6)


def test_a_loop_s_figures_hold_where_their_intervals_hold_the_truth():
    truth = {"crossover_hz": 0.5, "phase_margin_deg": 60.0, "gain_margin": 4.0}
    told = {"crossover": {"ci95": [0.4, 0.6]}, "phase margin": {"ci95": [61.0, 65.0]}, "gain margin": None}
    assert score.loop_inside(told, truth) == {
        "crossover": True,
        "phase margin": False,
        "gain margin": False,
    }
    assert score.loop_inside({"gain margin": {"ci95": [3.0, None]}}, truth)["gain margin"]
    assert not any(score.loop_inside(None, truth).values())


def test_a_raw_log_holds_teeth_and_volts(tmp_path):
    one = drawn_once(0)
    trial, log = recording.write(one, tmp_path)
    text = trial.read_text(encoding="utf-8")
    assert log.rate_hz in (2000.0, 5000.0)
    assert "pulses_per_rev = 60" in text
    assert f'shaft = "{one.side}"' in text
    volts = log.columns["teeth"].astype(float)
    turns = np.count_nonzero((volts[:-1] < 2.45) & (volts[1:] >= 2.45)) / 60.0
    speed = one.plant.engine_speed / (1.0 if one.side == "engine" else one.plant.ratio)
    assert turns == pytest.approx(speed * one.excitation.stop_s, rel=0.01)
