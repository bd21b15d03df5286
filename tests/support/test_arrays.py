"""Constants of the shared types are what their functions give."""

from shipfp_rs.support.arrays import DEVIATIONS_95, normal_quantile


def test_the_half_width_of_a_95_percent_interval_is_the_quantile() -> None:
    assert normal_quantile(0.95) == DEVIATIONS_95
