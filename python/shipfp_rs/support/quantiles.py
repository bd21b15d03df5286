"""Quantiles of the normal distribution, the one place of the 1.96 behind a 95 % interval."""

from scipy.special import ndtri


def normal_quantile(level: float) -> float:
    """Return how many standard deviations on either side of the mean hold a normal variable with this probability."""
    return float(ndtri(0.5 + 0.5 * level))


DEVIATIONS_95 = normal_quantile(0.95)
"""Half the width of a 95 % interval, in standard deviations: 1.96."""
