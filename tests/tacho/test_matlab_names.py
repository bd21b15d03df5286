"""MATLAB's names for bilevel waveforms, against what MATLAB and Octave print."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from shipfp_rs.errors import InputError
from shipfp_rs.tacho.matlab import midcross, pulseperiod, statelevels, tachorpm
from tests.twins import pulse

FOLDER = Path(__file__).parents[1] / "data" / "tachorpm"


@pytest.fixture(scope="module")
def recording():
    pulses = np.loadtxt(FOLDER / "test_input.csv", delimiter=",", skiprows=1)[:, 1]
    time, rpm = np.loadtxt(FOLDER / "matlab_ref_output.csv", delimiter=",", skiprows=1).T
    return pulses, time, rpm


def test_the_speed_is_that_of_matlab_s_tachorpm(recording):
    pulses, time, rpm = recording
    found = tachorpm(pulses, 1000.0)
    np.testing.assert_allclose(found.t, time, atol=1e-9)
    error = np.abs(found.rpm / rpm - 1.0)
    print(f"tachorpm against MATLAB's: largest {error.max():.3%}, median {np.median(error):.4%}")
    assert error.max() < 1e-3
    assert np.median(error) < 2e-5
    # Pulse centres to rpm without the spline are several per cent away, as the sampling of 1 kHz makes them.
    linear = np.abs(tachorpm(pulses, 1000.0, fittype="linear").rpm / rpm - 1.0)
    print(f"without the spline: largest {linear.max():.3%}")
    assert linear.max() > 0.02


def test_the_levels_are_those_of_octave_s_statelevels():
    # Demonstration of https://octave.sourceforge.io/signal/function/statelevels.html, which prints -1.9795, 1.9800.
    time = np.linspace(0.0, 20.0 * np.pi, 100)
    np.testing.assert_allclose(
        statelevels(signal.square(time) + np.cos(time)).levels, [-1.9795, 1.98], atol=5e-5
    )


def test_the_histogram_has_matlab_s_bins():
    # MATLAB's own example, statelevels(x, 4) of a clock from -0.0573 to 2.3429 V: 50 0 0 50 at these centres.
    clock = np.repeat([-0.0573, 0.0, 2.3, 2.3429], [1, 49, 49, 1])
    found = statelevels(clock, 4)
    assert found.histogram.tolist() == [50, 0, 0, 50]
    np.testing.assert_allclose(found.binlevels, [0.2427, 0.8427, 1.4428, 2.0428], atol=1e-4)
    np.testing.assert_allclose(found.levels, [0.2427, 2.0428], atol=1e-4)


def test_levels_by_the_mean_and_within_bounds():
    x = np.concatenate([np.linspace(0.0, 1.0, 500), np.linspace(9.0, 10.0, 500), [1e6]])
    np.testing.assert_allclose(statelevels(x, 100, "mean", (0.0, 10.0)).levels, [0.5, 9.5], atol=0.06)


@settings(max_examples=40)
@given(
    low=st.floats(-1e3, 1e3),
    height=st.floats(1e-2, 1e3),
    share=st.floats(0.05, 0.95),
    seed=st.integers(0, 99),
)
def test_levels_are_found_to_half_a_bin_whatever_the_share_of_the_pulses(low, height, share, seed):
    high = np.random.default_rng(seed).random(400) < share
    high[:2] = [False, True]
    np.testing.assert_allclose(
        statelevels(low + height * high).levels, [low, low + height], atol=0.0051 * height
    )


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_crossings_are_those_of_the_rules_said_sample_by_sample(seed):
    rng = np.random.default_rng(seed)
    x = np.repeat(rng.choice([0.0, 5.0], 40), rng.integers(1, 6, 40)) + 0.1 * rng.standard_normal(1)[0]
    x = np.convolve(x, np.ones(3) / 3, mode="valid") + rng.normal(0.0, 0.02, 1)
    if np.ptp(x) < 4.9:
        return
    low, high = statelevels(x).levels
    margin, middle = 0.02 * (high - low), 0.5 * (low + high)
    rising, _ = pulse.crossings(x, low + margin, high - margin, middle)
    falling, _ = pulse.crossings(-x, -high + margin, -low - margin, -middle)
    found = midcross(x)
    np.testing.assert_allclose(found.c, np.sort(rising + falling), atol=1e-9)
    assert found.midlev == pytest.approx(middle)


def test_periods_are_those_of_the_wave_in_any_unit_of_time():
    wave = np.tile([0.0, 0.0, 1.0, 1.0, 1.0], 6)
    by_index, by_rate = pulseperiod(wave), pulseperiod(wave, 10.0)
    by_time = pulseperiod(wave, 3.0 + 0.1 * np.arange(30))
    np.testing.assert_allclose(by_index.p, 5.0)
    np.testing.assert_allclose(by_rate.p, 0.5)
    np.testing.assert_allclose(by_time.initcross, 3.0 + by_rate.initcross)
    np.testing.assert_allclose(by_rate.initcross, 0.15 + 0.5 * np.arange(5), atol=1e-6)
    np.testing.assert_allclose(by_rate.finalcross - by_rate.initcross, 0.3)
    np.testing.assert_allclose(by_rate.nextcross - by_rate.initcross, by_rate.p)
    negative = pulseperiod(wave, 10.0, polarity="negative")
    np.testing.assert_allclose(negative.finalcross - negative.initcross, 0.2)
    np.testing.assert_allclose(negative.p, 0.5)


def test_a_runt_within_the_tolerance_is_no_transition():
    wave = [0.0, 0.0, 1.0, 1.0, 0.5, 1.0, 1.0, 0.0, 0.0]
    assert len(midcross(wave).c) == 2
    np.testing.assert_allclose(
        midcross(wave, midpercentreferencelevel=25.0, statelevels=[0.0, 1.0]).c, [1.25, 6.75]
    )


def test_a_steady_train_has_its_speed_with_any_fit_and_rate():
    time = np.arange(20_000) / 2000.0
    pulses = (np.sin(2 * np.pi * 20.0 * time) > 0.5).astype(float)
    for options in ({}, {"fittype": "linear"}, {"fitpoints": 20}, {"outputfs": 100.0}):
        found = tachorpm(pulses, 2000.0, pulsesperrev=4, **options)
        np.testing.assert_allclose(found.rpm, 300.0, rtol=5e-3)
        assert found.t[1] == pytest.approx(1 / options.get("outputfs", 2000.0))
    np.testing.assert_allclose(np.diff(found.tp), 0.05, atol=1e-3)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda x: statelevels(np.ones(9)), "x: found no two levels from 1 to 1"),
        (lambda x: statelevels(np.full(9, np.nan)), "x: found no two levels"),
        (lambda x: statelevels(x, 1), "nbins: found 1"),
        (lambda x: statelevels(x, 10, "median"), "method is 'median', expected 'mode' or 'mean'"),
        (lambda x: midcross(x, np.zeros(3)), r"t: found shape \(3,\)"),
        (lambda x: midcross(x, -1.0), "t: found -1.0"),
        (lambda x: midcross(x, tolerance=60.0), "midpercentreferencelevel, tolerance: found 50.0, 60.0"),
        (lambda x: midcross(x, statelevels=[1.0, 0.0]), r"statelevels: found \[1.0, 0.0\]"),
        (lambda x: pulseperiod(x, polarity="up"), "polarity is 'up'"),
        (lambda x: pulseperiod([[0.0]]), r"x: found shape \(1, 1\)"),
        (lambda x: tachorpm(x, 0.0), "fs: found 0.0"),
        (lambda x: tachorpm(x, 10.0, fittype="cubic"), "fittype is 'cubic'"),
        (lambda x: tachorpm(x, 10.0, fitpoints=1), "fitpoints: found 1"),
        (lambda x: tachorpm(x, 10.0), "x: found 6 pulses, expected 13 or more"),
    ],
)
def test_what_is_none_is_refused(call, said):
    with pytest.raises(InputError, match=said):
        call(np.tile([0.0, 0.0, 1.0, 1.0, 0.0], 6))
