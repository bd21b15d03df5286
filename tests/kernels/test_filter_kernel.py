"""The running median, spikes, the decimating low-pass and slopes: as their twins, and SciPy, say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import signal
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter

from shipfp_rs._core import Decimator, find_spikes, running_median, slope_at_even_times
from tests.twins import filter as twin

SAMPLES = arrays(np.float64, st.integers(0, 300), elements=st.floats(-5, 5) | st.sampled_from([0.0, 1.0]))


@settings(max_examples=80)
@given(SAMPLES, st.integers(0, 40))
def test_any_signal_has_the_twins_running_median(samples, half):
    if half <= len(samples):
        np.testing.assert_array_equal(
            running_median(samples, 2 * half + 1), twin.running_median(samples, 2 * half + 1)
        )


@pytest.mark.parametrize("window", [201, 2001])
def test_a_long_signal_has_scipys_running_median(window):
    rng = np.random.default_rng(3)
    torque = 1725.0 + 60.0 * np.sin(np.arange(50_000) * 0.19) + rng.normal(0.0, 21.0, 50_000)
    np.testing.assert_array_equal(running_median(torque, window), median_filter(torque, window))


@settings(max_examples=80)
@given(
    seed=st.integers(0, 10_000),
    level=st.sampled_from([-1725.0, 0.0, 1184.0]),
    swing=st.sampled_from([0.0, 30.0, 200.0]),
    noise=st.sampled_from([0.0, 0.5, 20.0]),
    strikes=st.lists(
        st.tuples(st.integers(0, 1499), st.integers(1, 60), st.sampled_from([-900.0, 100.0, 3000.0]))
    ),
    step=st.sampled_from([0.0, 80.0]),
    least=st.sampled_from([0.0, 0.05, 0.5]),
)
def test_any_signal_has_the_twins_spikes(seed, level, swing, noise, strikes, step, least):
    samples = (
        level + swing * np.sin(np.arange(1500) * 0.02) + np.random.default_rng(seed).normal(0.0, noise, 1500)
    )
    samples[seed % 1500 :] += step
    for start, length, height in strikes:
        samples[start : start + length] += height
    rule = {"longest": 40, "stride": 3, "scale_window": 101, "threshold": 6.0, "least": least}
    np.testing.assert_array_equal(find_spikes(samples, **rule), twin.spikes(samples, **rule))


@settings(max_examples=100)
@given(
    steps=st.lists(st.floats(1e-3, 0.5), min_size=2, max_size=60),
    seed=st.integers(0, 1000),
    start=st.floats(-2.0, 8.0),
    rate=st.sampled_from([7.3, 200.0, 2000.0]),
)
def test_a_splines_slopes_are_scipys_to_the_last_bit(steps, seed, start, rate):
    edges = 1.0 + np.cumsum(steps)
    spline = CubicSpline(edges, np.random.default_rng(seed).normal(size=len(edges)), bc_type="natural")
    grid = start + np.arange(900) / rate
    first, slopes = slope_at_even_times(edges, spline.c, start, rate, 900)
    inside = slice(*np.searchsorted(grid, edges[[0, -1]]))
    assert (first, len(slopes)) == (inside.start, inside.stop - inside.start)
    np.testing.assert_array_equal(slopes, spline(grid[inside], 1))


def test_numbers_that_differ_in_their_last_bits_only_are_told_apart():
    rng = np.random.default_rng(4)
    nearly_constant = 1725.0 * (1.0 + rng.integers(0, 50, 5000) * np.finfo(float).eps)
    np.testing.assert_array_equal(
        running_median(nearly_constant, 101), twin.running_median(nearly_constant, 101)
    )


@settings(max_examples=150)
@given(
    SAMPLES.filter(len),
    arrays(np.float64, st.integers(0, 12).map(lambda half: 2 * half + 1), elements=st.floats(-1, 1)),
    st.integers(1, 4),
    st.integers(1, 6),
    st.lists(st.integers(0, 300), max_size=4),
)
def test_any_pieces_give_the_twins_outputs(samples, taps, up, down, cuts):
    total = -(-len(samples) * up // down)
    filter_ = Decimator(taps, up, down)
    parts = [filter_.feed(piece.copy()) for piece in np.split(samples, sorted(cuts))]
    ours = np.concatenate([*parts, filter_.finish(total)])[:total]
    np.testing.assert_allclose(ours, twin.decimated(samples, taps, up, down, total), atol=1e-12)
    whole = Decimator(taps, up, down)
    np.testing.assert_array_equal(np.concatenate([whole.feed(samples), whole.finish(total)])[:total], ours)


@pytest.mark.parametrize(("up", "down"), [(1, 40), (2, 25)])
def test_the_decimator_is_scipys_polyphase_filter(up, down):
    samples = np.random.default_rng(5).normal(size=20_000)
    taps = signal.firwin(1005, 1.0 / max(up, down))
    theirs = signal.resample_poly(samples, up, down, window=taps, padtype="edge")
    filter_ = Decimator(taps, up, down)
    ours = np.concatenate([filter_.feed(samples), filter_.finish(len(theirs))])[: len(theirs)]
    np.testing.assert_allclose(ours, theirs, atol=1e-12)
