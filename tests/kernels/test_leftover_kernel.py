"""The sums of the residual tests are those of their twin, and what can't be used is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs._core import leftover_sums
from shipfp_rs.errors import InputError
from tests.twins import leftover as twin


def arguments(samples, inputs, outputs, slopes, basis, lags, masked, seed):
    rng = np.random.default_rng(seed)
    valid = rng.random(samples) >= masked
    models = np.zeros((outputs, 8))
    # Poles well inside the unit circle, and one filter that does nothing.
    models[0, :3] = [-1.2, 0.5, -0.1]
    mix = rng.normal(size=(outputs, basis, slopes + 1))
    mix[:, 0] = 0.0
    return (
        rng.normal(size=(inputs, max(lags) + samples)),
        lags,
        rng.normal(size=(slopes, samples)),
        mix,
        rng.normal(size=(outputs, samples)) * valid,
        valid,
        models,
    )


@settings(max_examples=60)
@given(
    st.integers(1, 700),
    st.booleans(),
    st.integers(1, 3),
    st.integers(1, 7),
    st.integers(1, 9),
    st.lists(st.integers(0, 40), min_size=1, max_size=13, unique=True),
    st.sampled_from([0.0, 0.01, 0.5]),
    st.integers(0, 2**32 - 1),
)
def test_any_record_has_the_twins_sums(samples, own, outputs, slopes, basis, lags, masked, seed):
    given = arguments(samples, outputs if own else 1, outputs, slopes, basis, lags, masked, seed)
    for found, expected in zip(leftover_sums(*given), twin.leftover_sums(*given), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-10 * np.abs(expected).max())


def test_lengths_and_filters_that_do_not_fit_are_refused():
    good = list(arguments(50, 1, 2, 3, 2, [0, 4], 0.0, 1))
    for place, wrong, message in (
        (0, good[0][:, 1:].copy(), r"set_points: found an array of shape \[1, 53\], expected \[1, 54\]"),
        (0, np.ones((3, 54)), "set_points has 3 rows, expected 1 or one for each of 2 outputs"),
        (3, np.ones((2, 2, 3)), r"mix: found an array of shape \[2, 2, 3\], expected \[2, 2, 4\]"),
        (4, np.ones((2, 49)), r"residuals: found an array of shape \[2, 49\], expected \[2, 50\]"),
        (5, np.ones(0, dtype=bool), "set_points: found an array of shape"),
        (6, np.ones((2, 9)), "expected up to 8 finite numbers"),
        (6, np.full((2, 8), np.nan), "expected up to 8 finite numbers"),
    ):
        bad = list(good)
        bad[place] = wrong
        with pytest.raises(InputError, match=message):
            leftover_sums(*bad)
