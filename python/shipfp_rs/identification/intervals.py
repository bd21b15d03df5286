"""Both ends of a parameter's interval: along the profile of the cost, or as far as the covariance says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shipfp_rs.identification.profile import End, Profile
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.weighted_problem import Minimum
from shipfp_rs.structures.structure import Parameter

Array = npt.NDArray[np.float64]

EXACT = 1e-7
"""Part of a parameter's size below which an interval is too narrow for its cost to be told from rounding."""


def along_valley(
    search: Search, best: Minimum, names: Sequence[str], row: Array, place: int, quantile: float
) -> tuple[float, float]:
    """Both ends of a parameter's interval, from its row (P,) of the covariance.

    Where the structure knows the curve on which its outputs change least, the ends lie on that curve; else they lie as
    many standard deviations from the value as the quantile says.
    """
    kept = best.vector[~search.linear]
    index = search.names.index(names[place])
    if not row[place] > 0.0:
        return float(kept[index]), float(kept[index])
    step = np.zeros(len(kept))
    step[[search.names.index(name) for name in names]] = row * (quantile / np.sqrt(row[place]))
    low, high = sorted(float(search.curved(kept, sign * step)[index]) for sign in (-1.0, 1.0))
    return low, high


def profile_ends(
    profile: Profile,
    value: float,
    index: int,
    quantile: float,
    variance: float,
    told: float,
    scale: float,
    about: tuple[float, float],
) -> tuple[End, End]:
    """Both ends of a parameter's interval: where the cost has risen by the square of the quantile.

    The search for them begins at the two values `about`. The rise is larger by the ratio of the estimate's `variance` to
    `told`, its variance for residuals of unit variance.
    """
    half = quantile * float(np.sqrt(variance))
    if half < EXACT * scale:
        return End(value - half, "data"), End(value + half, "data")
    threshold = quantile**2 * variance / told
    down, up = (min(about[0] - value, -1e-3 * half), max(about[1] - value, 1e-3 * half))
    return profile.end(index, down, threshold), profile.end(index, up, threshold)


def within_bounds(parameter: Parameter, low: float, high: float) -> tuple[End, End]:
    """Both ends, moved to the bounds where they lie beyond."""
    return (
        End(low, "data") if low > parameter.lower else End(parameter.lower, "bound"),
        End(high, "data") if high < parameter.upper else End(parameter.upper, "bound"),
    )


def deviation_of(value: float, low: End, high: End, quantile: float) -> float | None:
    """Return the standard deviation: half the interval over the quantile.

    Where a bound cuts one side, only the other counts; None where bounds cut both.
    """
    sides = [abs(end.value - value) for end in (low, high) if end.kind == "data"]
    return float(np.mean(sides)) / quantile if sides else None
