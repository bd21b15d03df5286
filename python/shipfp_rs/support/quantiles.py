"""Quantiles of the normal distribution."""

from scipy.special import ndtri


def normal_quantile(level: float) -> float:
    """Half the width, in standard deviations, of the central interval with this probability."""
    return float(ndtri(0.5 + 0.5 * level))


DEVIATIONS_95 = normal_quantile(0.95)
"""Half the width of a 95 % interval, in standard deviations: 1.96."""
