"""Constants of the shared types are what SciPy gives."""

from scipy.stats import norm

from shipfp_rs.support.arrays import DEVIATIONS_95


def test_the_half_width_of_a_95_percent_interval_is_the_quantile() -> None:
    assert norm.ppf(0.975) == DEVIATIONS_95
