"""The pulse tracker against its twin: trains of any shape whose amplitude and offset change, and whatever else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs._core import PulseTracker
from shipfp_rs.errors import InputError
from tests.twins import pulse_tracker as twin


def tracked(windows, threshold=None, hysteresis=None):
    tracker = PulseTracker(threshold, hysteresis)
    found = []
    for k, window in enumerate(windows):
        tracker.look(window)
        if k:
            found.append(tracker.cross(windows[k - 1]))
    found.append(tracker.cross(windows[-1]))
    return tracker, [np.concatenate(parts) for parts in zip(*(crossed[:5] for crossed in found), strict=True)]


def shape(kind, phase):
    return {
        "sine": np.sin(2 * np.pi * phase),
        "saw": phase % 1 - 0.5,
        "square": np.where(phase % 1 < 0.3, 1.0, 0.0),
        "bipolar": np.exp(-(((phase % 1 - 0.4) / 0.08) ** 2)) - np.exp(-(((phase % 1 - 0.6) / 0.08) ** 2)),
    }[kind]


@settings(max_examples=30)
@given(
    kind=st.sampled_from(["sine", "saw", "square", "bipolar"]),
    period=st.floats(3.0, 120.0),
    ends=st.tuples(st.floats(0.05, 1.0), st.floats(0.05, 1.0)),
    drift=st.floats(-1.0, 1.0),
    noise=st.sampled_from([0.0, 0.003, 0.02, 0.2]),
    dtype=st.sampled_from([np.float64, np.float32, np.int16]),
    size=st.integers(200, 3000),
    options=st.sampled_from([(None, None), (None, 0.05), (0.1, None), (0.1, 0.05)]),
    seed=st.integers(0, 99),
)
def test_any_train_gives_the_twins_crossings(kind, period, ends, drift, noise, dtype, size, options, seed):
    rng = np.random.default_rng(seed)
    count = 6000
    way = np.linspace(0.0, 1.0, count)
    train = shape(kind, np.arange(count) / period) * np.interp(way, [0, 1], ends) + drift * way
    train += noise * rng.standard_normal(count)
    scale = 10_000.0 if dtype is np.int16 else 1.0
    train = np.clip(scale * train, -32_000, 32_000).astype(dtype)
    if dtype is not np.int16:
        train[rng.integers(0, count, 5)] = [np.nan, np.inf, -np.inf, 50.0, np.nan]
        train[count // 2 : count // 2 + int(rng.integers(0, 200))] = np.nan
    windows = [train[k : k + size] for k in range(0, count, size)]
    threshold, hysteresis = (None if option is None else scale * option for option in options)
    _, (times, heights, grid, spread, _) = tracked(windows, threshold, hysteresis)
    expected, expected_heights = twin.track(
        [np.asarray(window, dtype=np.float64) for window in windows], threshold, hysteresis
    )
    np.testing.assert_allclose(times, expected, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(heights, expected_heights, rtol=1e-9)
    assert ((grid >= 0.0) & (grid < 0.29)).all()
    assert (spread >= 0.0).all()


@settings(max_examples=40)
@given(st.lists(st.floats(width=32), max_size=400), st.integers(1, 100))
def test_whatever_comes_is_gone_through(samples, size):
    train = np.array(samples, dtype=np.float32)
    windows = [train[k : k + size] for k in range(0, max(len(train), 1), size)]
    _, (times, heights, _, _, _) = tracked(windows)
    assert (np.diff(times) >= 0.0).all()
    assert len(heights) == len(times)


def test_gaps_are_told_with_levels_and_without():
    train = np.full(1000, 2.0)
    train[100:200] = np.nan
    tracker, _ = tracked([train[:500], train[500:]])
    assert tracker.gaps.tolist() == [[100, 200]]


def test_a_window_must_be_looked_at_first():
    tracker = PulseTracker()
    with pytest.raises(InputError, match="found 3 of them, expected a window that was looked at"):
        tracker.cross(np.zeros(3))
    with pytest.raises(InputError, match=r"hysteresis: found -1.0, expected a positive number"):
        PulseTracker(0.0, -1.0)
    with pytest.raises(InputError, match="threshold: found inf"):
        PulseTracker(np.inf)
