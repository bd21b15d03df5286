"""The pulse detector against its twin: any train, any type, any chunks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs._core import PulseCrossings, pulse_levels
from shipfp_rs.errors import InputError
from tests.twins import pulse as twin

LOW, HIGH, MIDDLE = 1.0, 3.0, 2.0
SPECIAL = [0.0, LOW, MIDDLE, HIGH, 5.0, np.nan, np.inf, -np.inf]
sample = st.sampled_from(SPECIAL) | st.floats(-1.0, 5.0, width=32)


def detect(chunks):
    detector = PulseCrossings(LOW, HIGH, MIDDLE)
    times = [detector.feed(chunk) for chunk in chunks]
    return np.concatenate(times), [tuple(gap) for gap in detector.gaps], detector.seen


@settings(max_examples=60)
@given(
    samples=st.lists(sample, max_size=200),
    cuts=st.lists(st.integers(0, 200), max_size=5),
    dtype=st.sampled_from([np.float32, np.float64, np.int16]),
)
def test_any_train_in_any_chunks_gives_the_twins_crossings(samples, cuts, dtype):
    train = np.array([x for x in samples if np.isfinite(x) or dtype is not np.int16], dtype=dtype)
    times, gaps, seen = detect(np.split(train, sorted(min(cut, len(train)) for cut in cuts)))
    expected, expected_gaps = twin.crossings(train, LOW, HIGH, MIDDLE)
    assert times.tolist() == expected
    assert gaps == expected_gaps
    assert seen == len(train)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16])
def test_a_long_noisy_train_with_gaps_gives_the_twins_crossings(dtype):
    rng = np.random.default_rng(3)
    scale = 1000 if dtype is np.int16 else 1
    phase = np.arange(20_000) * 20.65 / 2000
    train = (scale * (np.where(phase % 1 < 0.3, 4.5, 0.3) + 0.6 * rng.standard_normal(phase.size))).astype(
        dtype
    )
    if dtype is not np.int16:
        train[rng.integers(0, train.size, 40)] = np.nan
        train[5000:5200] = np.nan
    detector = PulseCrossings(LOW * scale, HIGH * scale, MIDDLE * scale)
    times = np.concatenate([detector.feed(chunk) for chunk in np.array_split(train, 77)])
    expected, gaps = twin.crossings(train, LOW * scale, HIGH * scale, MIDDLE * scale)
    assert times.tolist() == expected
    assert len(expected) > 150
    assert detector.gaps.tolist() == [list(gap) for gap in gaps]


def test_the_threshold_itself_counts_exactly_in_float32():
    low, high = 0.1, 0.3
    below, above = np.float32(low), np.float32(high)
    train = np.array([below, above], dtype=np.float32)
    expected, _ = twin.crossings(train, low, high, 0.2)
    assert PulseCrossings(low, high, 0.2).feed(train).tolist() == expected


def test_the_samples_are_not_changed_and_may_be_read_only():
    train = np.array([0.0, 4.0, 0.0, 4.0])
    train.flags.writeable = False
    assert PulseCrossings(LOW, HIGH, MIDDLE).feed(train).tolist() == [0.5, 2.5]


@pytest.mark.parametrize(
    ("samples", "said"),
    [
        (np.zeros(10)[::2], "not C-contiguous"),
        (np.zeros((2, 5)), "float64 of shape (2, 5)"),
        (np.zeros(3, dtype=np.int32), "int32 of shape (3,)"),
        (np.zeros(3, dtype=">f4"), "expected one axis of float32, float64 or int16"),
        ([0.0, 1.0], "found <class 'list'>"),
    ],
)
def test_what_is_no_plain_row_of_samples_is_refused_by_name(samples, said):
    with pytest.raises(InputError) as caught:
        PulseCrossings(LOW, HIGH, MIDDLE).feed(samples)
    assert said in str(caught.value)
    assert "samples" in str(caught.value)


@pytest.mark.parametrize("levels", [(2.0, 1.0, 1.5), (1.0, 2.0, 2.0), (np.nan, 2.0, 1.5), (0.0, np.inf, 1.0)])
def test_levels_out_of_order_are_refused(levels):
    with pytest.raises(InputError, match="low < middle < high"):
        PulseCrossings(*levels)


def test_volts_for_a_train_of_counts_are_refused_where_they_do_not_fit():
    with pytest.raises(InputError, match=r"high = 40000 is outside the range of int16"):
        PulseCrossings(1.0, 40_000.0, 5.0).feed(np.zeros(3, dtype=np.int16))


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16])
def test_the_levels_are_the_twins_modes(dtype):
    rng = np.random.default_rng(5)
    train = np.where(np.arange(20_000) % 97 < 30, 4500, 300) + 100 * rng.standard_normal(20_000)
    train = np.clip(train, 100, 4700).astype(dtype)  # the ends are as full as a real train's
    width = np.ptp(train.astype(float)) / 100
    np.testing.assert_allclose(pulse_levels(train), twin.levels(train), atol=2 * width)


def test_levels_of_nothing_are_nan():
    assert np.isnan(pulse_levels(np.full(2, np.nan))).all()
    assert np.isnan(pulse_levels(np.empty(0, dtype=np.int16))).all()


def test_rare_peaks_do_not_move_the_levels():
    train = np.where(np.arange(20_000) % 97 < 30, 4.5, 0.25)
    clean = pulse_levels(train)
    train[::1300] = 1e4
    train[7::1700] = np.inf
    np.testing.assert_allclose(pulse_levels(train), clean, atol=0.05)


def test_levels_may_change_between_chunks():
    detector = PulseCrossings(LOW, HIGH, MIDDLE)
    assert detector.feed(np.array([0.0, 1.5])).size == 0
    detector.set_levels(0.5, 2.5, 1.25)
    # The new middle met the signal at sample 1; the next edge is interpolated at it.
    assert detector.feed(np.array([2.0, 3.0, 0.0, 5.0])).tolist() == [1.0, 4.25]
    with pytest.raises(InputError, match="low < middle < high"):
        detector.set_levels(1.0, 0.0, 0.5)
