"""The levels of a min/max pyramid: as their twin says, in any chunks, of any type that loggers store."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from shipfp_rs._core import Extremes, coarser_extremes
from shipfp_rs.errors import InputError
from tests.twins import pyramid as twin

VALUES = st.floats(-5, 5, width=32) | st.sampled_from([0.0, np.nan, np.inf, -np.inf])


@settings(max_examples=80)
@given(
    samples=arrays(np.float64, st.integers(0, 400), elements=VALUES),
    block=st.integers(1, 70),
    chunk=st.integers(1, 150),
    kind=st.sampled_from([np.float32, np.float64, np.int16]),
)
def test_any_chunks_give_the_twins_extremes_and_gaps(samples, block, chunk, kind):
    if kind is np.int16:
        samples = np.nan_to_num(samples, posinf=9, neginf=-9)
    samples = samples.astype(kind)
    extremes = Extremes(block)
    parts = [extremes.feed(samples[k : k + chunk]) for k in range(0, len(samples), chunk)]
    found = np.concatenate([np.empty((0, 2)), *parts, extremes.finish()])
    np.testing.assert_array_equal(found, twin.extremes(samples, block))
    np.testing.assert_array_equal(extremes.gaps, twin.gaps(samples))
    assert (extremes.seen, extremes.gap_count) == (len(samples), len(twin.gaps(samples)))


@settings(max_examples=40)
@given(arrays(np.float64, st.integers(0, 300), elements=VALUES), st.integers(2, 9), st.integers(1, 20))
def test_a_coarser_level_is_that_of_larger_blocks(samples, factor, block):
    fine = twin.extremes(samples, block)
    np.testing.assert_array_equal(coarser_extremes(fine, factor), twin.extremes(samples, block * factor))


def test_a_channel_of_holes_keeps_the_first_ones_and_counts_all():
    samples = np.zeros(50_000, dtype=np.float32)
    samples[::2] = np.nan
    extremes = Extremes(64)
    extremes.feed(samples)
    assert extremes.gap_count == 25_000
    assert 1000 < len(extremes.gaps) < 10_000


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: Extremes(0), "block: found 0"),
        (lambda: Extremes(4).feed(np.zeros(3, dtype=np.int64)), "samples: found int64"),
        (lambda: coarser_extremes(np.zeros((4, 3)), 2), "pairs: found 3 columns"),
        (lambda: coarser_extremes(np.zeros((4, 2)), 1), "factor: found 1"),
    ],
)
def test_what_can_not_be_is_refused(call, told):
    with pytest.raises(InputError, match=told):
        call()
