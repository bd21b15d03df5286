"""The running median, the decimating low-pass and the all-pole filter give what their twins, and SciPy, give."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import signal
from scipy.ndimage import median_filter

from shipfp_rs._core import Decimator, all_pole_backwards, running_median
from shipfp_rs.errors import InputError
from tests.twins import filter as twin

SAMPLES = arrays(np.float64, st.integers(0, 300), elements=st.floats(-5, 5) | st.sampled_from([0.0, 1.0]))


@settings(max_examples=200, deadline=None)
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


def test_numbers_that_differ_in_their_last_bits_only_are_told_apart():
    rng = np.random.default_rng(4)
    nearly_constant = 1725.0 * (1.0 + rng.integers(0, 50, 5000) * np.finfo(float).eps)
    np.testing.assert_array_equal(
        running_median(nearly_constant, 101), twin.running_median(nearly_constant, 101)
    )


@pytest.mark.parametrize("window", [0, 2, 2**31 + 1])
def test_windows_without_a_middle_or_out_of_range_are_refused(window):
    with pytest.raises(InputError, match="window: found"):
        running_median(np.ones(4), window)


@settings(max_examples=150, deadline=None)
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


def test_a_filter_is_never_left_without_samples_or_middle():
    with pytest.raises(InputError, match="taps: found 2"):
        Decimator(np.ones(2), 1, 1)
    with pytest.raises(InputError, match="found 1 and 0"):
        Decimator(np.ones(1), 1, 0)
    with pytest.raises(InputError, match="none were fed"):
        Decimator(np.ones(1), 1, 1).finish(3)


def test_the_all_pole_filter_runs_scipys_backwards():
    rng = np.random.default_rng(7)
    rows, model = rng.normal(size=(11, 500)), np.array([-1.2, 0.5, -0.1])
    expected = signal.lfilter([1.0], [1.0, *model], rows[:, ::-1], axis=1)[:, ::-1]
    late = all_pole_backwards(np.ascontiguousarray(rows[:, 200:]), model, np.zeros((11, 3)))
    after = np.ascontiguousarray(late[:, :3])
    early = all_pole_backwards(np.ascontiguousarray(rows[:, :200]), model, after)
    np.testing.assert_allclose(np.hstack([early, late]), expected, rtol=1e-12, atol=1e-12)
