"""Masked samples are foretold from those beside them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shipfp_rs as fp
from shipfp_rs.identification.sampling import kriged
from tests.identification.parity import Case, simulated


def correlated(count, seed):
    """Two signals of slow noise, the second the first, late, and noise of its own."""
    random = np.random.default_rng(seed)
    white = random.standard_normal(count + 60)
    window = np.hanning(41)
    slow = np.convolve(white, window / np.linalg.norm(window), "same")
    return np.array([slow[30 : 30 + count], slow[20 : 20 + count] + 0.05 * random.standard_normal(count)])


def test_a_short_gap_of_a_slow_signal_is_near_what_it_was():
    whole = correlated(4000, 1)
    gaps = np.zeros(whole.shape, bool)
    for first in range(200, 3800, 300):
        gaps[0, first : first + 5] = True
    filled = kriged(np.where(gaps, np.nan, whole), gaps, 30)
    assert np.array_equal(filled[~gaps], whole[~gaps])
    assert np.std((filled - whole)[gaps]) < 0.05 * np.std(whole[0])


def test_another_signal_foretells_a_long_gap():
    whole = correlated(4000, 2)
    gaps = np.zeros(whole.shape, bool)
    gaps[0, 1000:1100] = True
    both = kriged(np.where(gaps, np.nan, whole), gaps, 30)
    alone = kriged(np.where(gaps, np.nan, whole)[:1], gaps[:1], 30)
    assert np.std((both - whole)[gaps]) < 0.2 * np.std((alone - whole[:1])[gaps[:1]])


def test_the_estimate_is_the_least_squares_one_of_known_covariances():
    # White noise foretells nothing: the mean is left.
    random = np.random.default_rng(3)
    white = random.standard_normal((1, 20_000)) + 5.0
    gaps = np.zeros(white.shape, bool)
    gaps[0, 9000] = True
    filled = kriged(np.where(gaps, np.nan, white), gaps, 5)
    assert filled[0, 9000] == pytest.approx(5.0, abs=0.15)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.3))
def test_what_was_measured_stays_and_what_was_not_is_finite(seed, share):
    random = np.random.default_rng(seed)
    whole = correlated(400, seed)
    gaps = random.random(whole.shape) < share
    filled = kriged(np.where(gaps, np.nan, whole), gaps, 10)
    assert np.isfinite(filled).all()
    assert np.array_equal(filled[~gaps], whole[~gaps])


def test_masked_samples_tell_nothing():
    _, whole = simulated(Case(seconds=150.0))
    random, masked = np.random.default_rng(5), (np.arange(len(whole)) // 20) % 5 == 4
    noisy = {
        name: row * (1.0 + (0.0 if name == "n_set" else 1e-3) * random.standard_normal(len(row)))
        for name, row in whole.signals.items()
    }
    gaps = {name: row if name == "n_set" else np.where(masked, np.nan, row) for name, row in noisy.items()}
    full, less = (fp.identify(replace(whole, signals=signals)) for signals in (noisy, gaps))
    wider = {
        name: less[name].std / full[name].std
        for name in ("tau_n", "g", "vK_p", "vK_i", "p", "tau_prop", "T_d", "T_set")
    }
    # A fifth of the samples is a tenth of the deviations, but for the chance that both noises are estimated by.
    assert 1.03 < np.mean([*wider.values()]) < 1.25, wider
    assert all(0.9 < one < 1.3 for one in wider.values()), wider
