"""Speeds of intervals against their twin; trains that go on as they were against such as are looked at anew."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import median_filter

from shipfp_rs._core import PulseTracker, interval_speeds, pulses_are_even
from shipfp_rs.errors import InputError
from tests.twins import pulse as twin

WINDOW = 60_000


@settings(max_examples=60)
@given(
    wholes=st.integers(1, 200),
    pulses=st.integers(1, 5),
    per_sample=st.booleans(),
    steps=st.booleans(),
    sample=st.sampled_from([0.0, 5e-4, 0.004]),
    seed=st.integers(0, 99),
)
def test_any_track_has_the_twins_speeds(wholes, pulses, per_sample, steps, sample, seed):
    rng = np.random.default_rng(seed)
    edges = 3.0 + np.cumsum(rng.uniform(0.01, 0.02, wholes + 1))
    count = rng.choice([1, 1, 1, 2, 4], wholes).astype(np.int64)
    fractions = rng.uniform(0.5, 1.0, pulses)
    relative, stds = 0.001 * rng.random(pulses), 1e-4 * rng.random((2, wholes + 1 if per_sample else 1))
    noise, grid = (0.1 * stds[0], stds[1] + (sample if steps else 0.0))
    arguments = edges, count, fractions / fractions.sum(), relative, noise, grid, sample
    for ours, expected in zip(interval_speeds(*arguments), twin.interval_speeds(*arguments), strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("position", "wrong", "complaint"),
    [
        (1, np.ones(5, dtype=np.int64), "count: found 5"),
        (1, np.zeros(4, dtype=np.int64), "expected 1 or more true intervals"),
        (3, np.zeros(2), "relative: found 2"),
        (4, np.zeros(2), "noise: found 2"),
        (0, np.zeros(0), "count: found 4"),
    ],
)
def test_tracks_that_do_not_fit_are_refused(position, wrong, complaint):
    arguments = [
        np.arange(5.0),
        np.ones(4, dtype=np.int64),
        np.ones(1),
        np.zeros(1),
        np.zeros(1),
        np.zeros(1),
    ]
    arguments[position] = wrong
    with pytest.raises(InputError, match=complaint):
        interval_speeds(*arguments, 0.0)


@settings(max_examples=100)
@given(count=st.integers(0, 400), spread=st.floats(0.0, 0.4), seed=st.integers(0, 99))
def test_even_pulses_have_none_that_a_median_would_find(count, spread, seed):
    periods = np.random.default_rng(seed).uniform(1.0 - spread, 1.0 + spread, count)
    if pulses_are_even(np.append(0.0, np.cumsum(periods)), 0.6, 1.6):
        median = median_filter(periods, 21, mode="reflect") if count else periods
        assert (periods >= 0.6 * median).all()
        assert (periods < 1.6 * median).all()
    else:
        assert spread > 0.2


def train(period: float = 97.3, windows: int = 24) -> np.ndarray:
    rng = np.random.default_rng(7)
    phase = np.arange(windows * WINDOW) / period + 0.2 * np.sin(np.arange(windows * WINDOW) / 40_000.0)
    noise = 0.05 * rng.standard_normal(windows * WINDOW)
    return (np.where(phase % 1.0 < 0.35, 5.0, 0.2) + noise).astype(np.float32)


def followed(samples: np.ndarray, window: int) -> list[np.ndarray]:
    return list(PulseTracker().follow(samples, window))


def one_by_one(samples: np.ndarray, window: int) -> list[np.ndarray]:
    tracker, windows = PulseTracker(), [samples[k : k + window] for k in range(0, len(samples), window)]
    found = []
    for before, part in zip([None, *windows], [*windows, None], strict=True):
        if part is not None:
            tracker.look(part)
        if before is not None:
            found.append(tracker.cross(before))
    return [np.concatenate(parts) for parts in zip(*found, strict=True)]


@pytest.mark.parametrize("period", [97.3, 33.1, 12.4, 3.3])
def test_a_train_that_goes_on_has_the_crossings_of_its_levels(period):
    samples = train(period)
    times, heights, _, _, levels, windows = followed(samples, WINDOW)
    (low, high, middle) = levels[-1]
    assert np.ptp(levels, axis=0).max() < 0.2
    fixed, _ = twin.crossings(samples, low, high, middle)
    np.testing.assert_allclose(times, fixed, atol=0.02)
    assert windows[:, 0].sum() == len(times) == len(heights)
    assert np.ptp(heights) < 0.2
    # The noise is measured only where a window is looked at anew.
    assert len(np.unique(windows[:, 1])) < 8


def spoilt(kind: str) -> np.ndarray:
    samples, at = train(), 13 * WINDOW + 1234
    if kind == "fades":
        samples[at:] *= 0.3
    elif kind == "drifts":
        samples += np.linspace(0.0, 6.0, len(samples), dtype=np.float32)
    elif kind == "is lost":
        samples[at : at + 900] = 0.2
    elif kind == "has a gap":
        samples[at : at + 5000] = np.nan
    elif kind == "has a gap between windows":
        samples[13 * WINDOW - 700 : 13 * WINDOW + 700] = np.nan
    elif kind == "doubles":
        samples[at - 1 : at + 2] = [5.0, 0.2, 5.0]
    elif kind == "gets noisy":
        samples[at:] += np.random.default_rng(3).normal(0.0, 0.3, len(samples) - at).astype(np.float32)
    elif kind == "stops":
        samples[at:] = 0.2
    return samples


@pytest.mark.parametrize(
    "kind",
    [
        "goes on", "fades", "drifts", "is lost", "has a gap", "has a gap between windows", "doubles", "gets noisy",
        "stops",
    ],
)  # fmt: skip
def test_a_train_that_changes_is_looked_at_anew(kind):
    samples = spoilt(kind)
    whole, parts = followed(samples, WINDOW), one_by_one(samples, WINDOW)
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(one, other)
    # In windows so short that each is looked at anew.
    times, heights = followed(samples, 6000)[:2]
    if kind in ("stops", "is lost", "has a gap", "has a gap between windows"):
        times, heights = (column[heights > 2.0] for column in (times, heights))
        whole[0] = whole[0][whole[1] > 2.0]
    assert len(whole[0]) == len(times)
    # An edge within one sample is crossed anywhere in it, by the levels.
    np.testing.assert_allclose(whole[0], times, atol=0.5)
