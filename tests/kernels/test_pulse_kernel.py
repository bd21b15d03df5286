"""State levels of a pulse train against their twin, and samples of a wrong kind."""

import numpy as np
import pytest

from shipfp_rs._core import pulse_levels
from shipfp_rs.errors import InputError
from tests.twins import pulse as twin


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
        pulse_levels(samples)
    assert said in str(caught.value)
    assert "samples" in str(caught.value)


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
