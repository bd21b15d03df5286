"""Spikes are what no plant makes: short, high and gone where they came from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from shipfp_rs.logs.faults.spikes import spikes_between
from shipfp_rs.processing.trial import Spikes
from shipfp_rs.support.arrays import runs
from shipfp_rs.support.spikes import bridge, find_spikes, running_median

RATE_HZ = 1000.0
SETTINGS = {"longest_s": 0.05, "threshold": 6.0, "least": 0.05}


def torque(seed: int, samples: int = 6000) -> np.ndarray:
    time = np.arange(samples) / RATE_HZ
    noise = np.random.default_rng(seed).normal(0.0, 10.0, samples)
    return 1725.0 + 150.0 * np.sin(2 * np.pi * 0.7 * time) + 30.0 * np.sin(2 * np.pi * 59.0 * time) + noise


@settings(max_examples=30)
@given(
    seed=st.integers(0, 1000),
    starts=st.lists(st.integers(1, 19), unique=True, max_size=6),
    length=st.integers(2, 45),
    height=st.sampled_from([-3000.0, 900.0, 3000.0]),
)
def test_spikes_are_found_where_they_are_and_nowhere_else(
    seed: int, starts: list[int], length: int, height: float
) -> None:
    samples = torque(seed)
    spans = [(300 * start, 300 * start + length) for start in sorted(starts)]
    for start, stop in spans:
        samples[start:stop] += height
    found = find_spikes(samples, RATE_HZ, **SETTINGS)
    assert found.tolist() == [list(span) for span in spans]


@pytest.mark.parametrize("length", [20, 60, 80, 99])
@pytest.mark.parametrize("phase", [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
def test_a_long_spike_is_found_on_the_steepest_slope_of_a_chirp(length: int, phase: float) -> None:
    # A tug's shaft torque at 0.9 Hz with its ripple, and a receiver at its limit for up to 50 ms.
    time = np.arange(12_000) / 2000.0
    samples = 1720.0 + 400.0 * np.sin(2.0 * np.pi * 0.9 * time + phase)
    for amplitude, frequency_hz in ((12.0, 5.2), (25.0, 20.7), (10.0, 19.8), (40.0, 59.2)):
        samples += amplitude * np.sin(2.0 * np.pi * frequency_hz * time)
    assert find_spikes(samples, 2000.0, **SETTINGS).size == 0
    samples[6000 : 6000 + length] = 5295.0
    ((start, stop),) = find_spikes(samples, 2000.0, **SETTINGS)
    assert start <= 6000 < 6000 + length <= stop <= start + 200


@settings(max_examples=80)
@given(arrays(np.float64, st.integers(0, 100), elements=st.floats(-5, 5)), st.integers(0, 60))
def test_a_running_median_is_that_of_each_window_however_short_the_signal(
    samples: np.ndarray, half: int
) -> None:
    reflected = np.pad(samples, half, mode="symmetric") if len(samples) else samples
    windows = [np.median(reflected[place : place + 2 * half + 1]) for place in range(len(samples))]
    np.testing.assert_array_equal(running_median(samples, 2 * half + 1), windows)


def test_a_spike_at_either_end_is_found() -> None:
    samples = torque(1)
    samples[:8] += 3000.0
    samples[-5:] += 3000.0
    assert find_spikes(samples, RATE_HZ, **SETTINGS).tolist() == [[0, 8], [5995, 6000]]


def test_what_a_plant_makes_is_no_spike() -> None:
    time = np.arange(6000) / RATE_HZ
    kick = np.where(time < 3.0, 1000.0, 1200.0 + 900.0 * np.exp(-(time - 3.0) / 0.15))
    lasting = torque(2)
    lasting[2000:2120] += 3000.0
    for samples in (kick, lasting, np.full(500, 3.0)):
        assert find_spikes(samples, RATE_HZ, **SETTINGS).shape == (0, 2)


@pytest.mark.parametrize("swing_hz", [4.0, 6.0, 8.0])
def test_a_kick_that_rings_out_is_no_spike(swing_hz: float) -> None:
    # A step of the set point behind a quick governor: the torque jumps within 3 ms and comes back through a swing.
    time = np.arange(12_000) / 2000.0
    late = np.maximum(time - 3.0, 0.0)
    swing = np.exp(-late / 0.08) * np.cos(2.0 * np.pi * swing_hz * late)
    samples = 900.0 + 80.0 * -np.expm1(-late / 0.0015) + 250.0 * swing * -np.expm1(-late / 0.0015)
    samples += np.random.default_rng(4).normal(0.0, 5.0, len(time))
    assert find_spikes(samples, 2000.0, **SETTINGS).size == 0
    samples[9000:9080] += 800.0
    assert find_spikes(samples, 2000.0, **SETTINGS).tolist() == [[9000, 9080]]


def test_a_spike_that_swings_both_ways_is_one() -> None:
    samples = torque(3)
    samples[2000:2015] += 3000.0
    samples[2015:2030] -= 3000.0
    assert find_spikes(samples, RATE_HZ, **SETTINGS).tolist() == [[2000, 2030]]


def test_bridges_are_straight_and_level_at_the_ends() -> None:
    samples = np.array([9.0, 1.0, 9.0, 9.0, 4.0, 9.0])
    missing = samples == 9.0
    assert bridge(samples, missing).tolist() == pytest.approx([1.0, 1.0, 2.0, 3.0, 4.0, 4.0])
    assert samples[0] == 9.0, "inputs stay as they are"


@given(st.lists(st.booleans(), max_size=40))
def test_runs_tell_the_flags(flags: list[bool]) -> None:
    rebuilt = np.zeros(len(flags), dtype=bool)
    for start, stop in runs(np.array(flags, dtype=bool)):
        assert stop > start
        rebuilt[start:stop] = True
    assert rebuilt.tolist() == flags


def test_the_crest_of_a_coarsely_sampled_swing_is_no_spike() -> None:
    """Torque in whole per cent, told every 10 ms, that swings at 3 Hz; and a spike on it."""
    time = np.arange(2000) / 100.0
    swing = np.round(60.0 + 25.0 * np.sin(2.0 * np.pi * 3.0 * time))
    found = find_spikes(swing, 100.0, longest_s=0.05, threshold=6.0, least=0.05)
    assert not (
        (found[:, 0] > 5) & (found[:, 1] < 1995)
    ).any()  # at its ends only one side of a crest is seen
    struck = swing.copy()
    struck[1003:1005] += 60.0
    found = find_spikes(struck, 100.0, longest_s=0.05, threshold=6.0, least=0.05)
    assert any(start <= 1003 and stop >= 1005 for start, stop in found.tolist())


@pytest.mark.parametrize(("rate_hz", "held"), [(20.0, 1), (50.0, 1), (50.0, 5), (500.0, 50)])
def test_a_slow_channels_spikes_are_found_and_its_kicks_are_not(rate_hz: float, held: int) -> None:
    """Torque that a bus or a power analyser tells, with the kick that each step of the set point brings."""
    time, draw = np.arange(round(200.0 * rate_hz)) / rate_hz, np.random.default_rng(5)
    torque = 900.0 + draw.normal(0.0, 3.0, len(time))
    for place, at in enumerate(np.arange(8.3, 190.0, 9.7)):
        late = np.maximum(time - at, 0.0)
        torque += (time > at) * (-1.0) ** place * (40.0 + 200.0 * np.exp(-late / 0.2))
    told = np.repeat(torque[::held], held)[: len(time)]
    missing, limits = np.zeros(len(time), dtype=bool), Spikes()
    assert spikes_between(told, missing, rate_hz, limits).size == 0
    starts = [held * int(at * rate_hz / held) for at in (5.0, 23.0, 71.0, 150.0)]
    for start in starts:
        told[start : start + held] *= 1.15
    found = spikes_between(told, missing, rate_hz, limits)
    assert found.tolist() == [[start, start + held] for start in starts]
