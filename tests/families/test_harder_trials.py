"""What makes a trial harder: rates that are limited, exponents that drift, steps off every clock, late windows, no noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.families import events, excitations, sensors, small_steps
from tests.families.draw import CHANNELS, draw, fast_motion, slopes
from tests.families.plant import normalised, physical

BASE = {"tau_n": 1.2, "g": -0.5, "vK_p": 4.5, "vK_i": 10.0, "p": 2.15, "tau_prop": 0.38}
TUG = {"engine_speed": 19.73, "ratio": 3.82, "efficiency": 0.97, "shaft_torque": 1725.0}


def steps(levels, at=(0.0, 6.0), stop_s=20.0):
    return excitations.Excitation("steps", 1.0, stop_s, np.column_stack([at, levels]))


def clamped(relative, excitation, step_s):
    """Speed and torque by Euler's rule, the rack held back by hand."""
    q, N, total, fuel = relative, 1.0, 0.0, 0.0
    asked = excitation(np.arange(0.0, excitation.stop_s, step_s))
    out = np.empty((2, len(asked)))
    for k, u in enumerate(asked):
        total += step_s * (u - N)
        wanted = q["vK_p"] * (u - N) + q["vK_i"] * total
        fuel += max(-q["rate"] * step_s, min(q["rate"] * step_s, wanted - fuel))
        torque = 1.0 + q["g"] * (N - 1.0) + fuel
        out[:, k] = N, torque
        N += step_s * (torque - N ** q["p"]) / q["tau_n"]
    return out


def test_a_rack_that_is_limited_moves_as_a_clamp_by_hand_holds_it():
    relative = BASE | {"rate": 0.2}
    excitation = steps([1.05, 0.97])
    motion = small_steps.simulate(physical(relative, **TUG), excitation, 20.0, step_s=2.5e-4)
    free = small_steps.simulate(physical(BASE, **TUG), excitation, 20.0, step_s=2.5e-4)
    by_hand = clamped(relative, excitation, 5e-5)[:, ::5]
    speed, torque = motion.engine_speed / 19.73, motion.brake_torque / physical(BASE, **TUG).brake_torque
    # Half a step at each edge of the set point.
    assert np.abs(speed - by_hand[0]).max() < 1e-4
    assert np.abs(torque - by_hand[1]).max() < 4e-4
    assert np.abs(free.engine_speed / 19.73 - by_hand[0]).max() > 0.01
    # Its steepest slope at constant speed is the limit.
    fuel = torque - relative["g"] * speed
    assert np.abs(np.diff(fuel)).max() / 2.5e-4 == pytest.approx(0.2, rel=1e-6)


def test_a_rate_without_a_lag_is_refused_by_the_integrator_that_has_no_clamp():
    with pytest.raises(ValueError, match="expected tau_act above zero"):
        events.simulate(BASE | {"rate": 0.2}, steps([1.05, 0.97]), step_s=1e-3)


@pytest.mark.parametrize("drift", [-0.5, 0.3])
def test_the_load_of_a_drifting_exponent_is_its_formula(drift):
    """L = N^(p + c_2 (N - 1)), in steady running at 105 per cent; to the second order N^p + c_2 (N - 1)^2."""
    plant = physical(BASE | {"c_2": drift}, **TUG)
    motion = small_steps.simulate(plant, steps([1.05, 1.05], stop_s=60.0), 60.0, step_s=1e-3)
    load = motion.gauge_torque[-1] / plant.shaft_torque
    assert motion.engine_speed[-1] / plant.engine_speed == pytest.approx(1.05, abs=1e-6)
    assert load == pytest.approx(1.05 ** (2.15 + drift * 0.05), abs=1e-5)
    assert load - 1.05**2.15 == pytest.approx(drift * 0.05**2, rel=0.1)


def test_a_step_between_two_instants_keeps_its_time_in_the_mean():
    """The sum of what is left of it is its height times how late it is."""
    late = 0.1231
    excitation = steps([1.06, 1.0], at=(late, 9.0))
    times = np.arange(0.0, 8.0, 1e-3)
    seen = excitation.mean(times, 1e-3)
    assert np.sum(1.06 - seen) * 1e-3 == pytest.approx(0.06 * (1.0 + late) + 0.06 * 0.5e-3, abs=1e-9)
    assert seen[[0, 1000, -1]] == pytest.approx([1.0, 1.0, 1.06], abs=1e-12)
    assert np.abs(excitation(times) - seen).max() > 0.02


@pytest.mark.slow
def test_steps_keep_the_governors_time_or_none():
    kept, off = [], []
    for seed in range(24):
        one = draw("tug", seed, kind="steps", longest_s=201.0)
        values = one.truth()["parameters"]
        if "T_s" in one.on:
            at = one.excitation.start_s + one.excitation.table[:, 0] - values["T_0"]
            phase = (at / values["T_s"]) % 1.0
            (kept if one.excitation.keeps_time else off).append(np.ptp(phase[1:]))
        assert one.truth()["excitation"]["keeps_time"] == one.excitation.keeps_time
    assert len(kept) > 2
    assert len(off) > 2
    assert max(kept) < 1e-6
    assert min(off) > 0.4


@pytest.mark.slow
def test_a_limit_of_the_rate_acts_where_a_draw_has_one():
    some = [one for one in (draw("tug", seed, longest_s=201.0) for seed in range(16)) if "rate" in one.on]
    assert 2 <= len(some) <= 12
    for one in some:
        rate = one.truth()["parameters"]["rate"]
        moved = np.abs(slopes(one, fast_motion(replace(one, plant=one.plant._replace(limit=np.inf)))))
        assert 0.003 < np.mean(moved > 0.999 * rate) < 0.4
        assert rate == pytest.approx(normalised(one.plant)["rate"])


def test_a_window_that_begins_late_holds_the_rest_of_the_same_trial():
    whole = replace(draw("genset", 2, longest_s=200.0), late_s=None)
    late = replace(whole, late_s=3.5)
    made, cut = whole.experiment(), late.experiment()
    first = round((whole.excitation.start_s + 3.5) * sensors.COMMON_HZ)
    for name, samples in made["signals"].items():
        assert np.array_equal(cut["signals"][name], samples[first:])
    assert cut["operating_point"] == made["operating_point"]
    assert late.truth()["late_s"] == 3.5


def test_channels_without_noise_are_the_motion_itself():
    quiet = next(
        one for one in (draw("tug", seed, longest_s=200.0) for seed in range(60)) if "n_e" in one.noise_free
    )
    quiet = replace(quiet, noise_free=CHANNELS, noise=(sensors.Noise(()),) * 2, late_s=None)
    signals = quiet.experiment()["signals"]
    for made, clean in zip(signals.values(), quiet.clean(), strict=True):
        clean = sensors.to_common(clean)
        assert made / made[0] == pytest.approx(clean / clean[0], abs=1e-12)
