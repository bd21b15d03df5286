"""Rotation that is irregular within each turn, as of an engine that is cranked or fires on one cylinder."""

import numpy as np
import pytest

from shipfp_rs import tacho
from shipfp_rs.logs.log import Log, Rows
from shipfp_rs.processing.speed_sources import MarkedWheel, with_missing
from shipfp_rs.processing.trial_channels import Tacho
from shipfp_rs.tacho import PulseFlag

TURNS_PER_S = 250.0 / 60.0


def teeth(pulses_per_rev, missing, depth, order):
    """Return times [s] of a wheel's teeth at a speed of 250 rpm (1 - depth cos(order angle)), and the turns in 4 s."""
    angle = np.linspace(0.0, 20.0, 400_001)
    slowness = 1.0 / (TURNS_PER_S * (1.0 - depth * np.cos(2.0 * np.pi * order * angle)))
    time = np.append(0.0, np.cumsum(0.5 * (slowness[1:] + slowness[:-1]) * np.diff(angle)))
    count = np.arange(20 * pulses_per_rev)
    times = np.interp(count[count % pulses_per_rev < pulses_per_rev - missing] / pulses_per_rev, angle, time)
    times = times[times < 4.0]
    return times, np.interp(times[-1], time, angle)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("depth", [0.4, 0.5])
@pytest.mark.parametrize(("pulses_per_rev", "missing"), [(12, 0), (36, 1), (60, 2)])
def test_irregular_rotation_of_half_the_speed_loses_no_tooth(pulses_per_rev, missing, depth, order):
    times, turned = teeth(pulses_per_rev, missing, depth, order)
    every = with_missing(times, pulses_per_rev, missing) if missing else times
    speed = tacho.speed_from_pulses(every, pulses_per_rev)
    assert speed.turned_rev.sum() == pytest.approx(turned, rel=1e-6)


def test_teeth_lost_and_doubled_in_irregular_rotation_are_still_repaired():
    times, turned = teeth(12, 0, 0.4, 3)
    worn = np.sort(np.append(np.delete(times, [76]), times[120] + 1e-6))
    speed = tacho.speed_from_pulses(worn, 12)
    assert (speed.flags & PulseFlag.EXTRA).any()
    assert (speed.flags & PulseFlag.MISSED).any()
    assert speed.turned_rev.sum() == pytest.approx(turned, abs=0.2)


def test_a_wheel_says_which_turns_it_counts_wrong():
    rate_hz = 20_000.0
    # The fifth turn has 33 teeth at even distances where the others have 35.
    turns = [
        (turn + np.arange(count) / (count + 1)) / 5.0
        for turn, count in enumerate([35] * 5 + [33] + [35] * 14)
    ]
    times, at = np.concatenate(turns) + 1e-3, np.arange(round(4.0 * rate_hz)) / rate_hz
    since = at - times[np.maximum(np.searchsorted(times, at, side="right") - 1, 0)]
    log = Log.from_arrays({"teeth": ((since >= 0.0) & (since < 2e-3)).astype(np.float64)}, rate_hz=rate_hz)
    table = Tacho.model_construct(pulses_per_rev=36, missing=1, shaft="engine")
    wheel = MarkedWheel(Rows(log, "teeth"), "teeth", table, 1.0, {"all": (0.0, 4.0)})
    found = wheel.faults("all", wheel.speed("all"), 0.0, 4.0)
    (fault,) = (one for one in found if "gap to gap" in str(one.method))
    (span,) = fault.spans / rate_hz
    assert span[0] < 1.1 < span[1]


def train(rate_hz, high, order, deviation=0.0):
    """Return 20 s of a wheel of 12 teeth at 260 teeth per second, its turn uneven by 20 %, and its number of teeth."""
    time, turns = np.arange(0.0, 20.0, 1.0 / rate_hz), 260.0 / 12.0
    angle = turns * time + 0.2 / (2.0 * np.pi * order) * (1.0 - np.cos(2.0 * np.pi * order * turns * time))
    noise = np.random.default_rng(0).normal(0.0, deviation, len(time)) if deviation else 0.0
    return (12.0 * angle % 1.0 < high) + noise, 12.0 * angle[-1]


@pytest.mark.parametrize("high", [0.3, 0.5, 0.7])
@pytest.mark.parametrize("rate_hz", [2000.0, 5000.0])
@pytest.mark.parametrize("deviation", [0.0, 0.01, 0.05])
def test_a_turn_uneven_by_a_fifth_loses_no_tooth_at_eight_samples_a_tooth(rate_hz, high, deviation):
    samples, teeth_passed = train(rate_hz, high, 1, deviation)
    pulses = tacho.pulse_times(samples, rate_hz)
    assert len(pulses.times_s) == pytest.approx(teeth_passed, abs=1.5)
    assert not len(pulses.gaps_s)


@pytest.mark.parametrize("high", [0.07, 0.1, 0.93])
@pytest.mark.parametrize("order", [1, 2])
def test_pulses_shorter_than_a_sample_are_told_to_be_missing(high, order):
    pulses = tacho.pulse_times(train(2000.0, high, order)[0], 2000.0)
    assert np.diff(pulses.gaps_s).sum() == pytest.approx(20.0, abs=0.1)
