"""Detection of spikes, short excursions that the plant can't cause, and bridging of missing samples."""

from __future__ import annotations

import numpy as np

from shipfp_rs import _core
from shipfp_rs.support.arrays import Array, Mask, Spans

ROBUST_SIGMA = 1.4826
"""Ratio of standard deviation to median absolute deviation for Gaussian noise."""

SWINGS_ON = 0.5
"""An excursion is the crest of an oscillation, not a spike, if its distance from a cubic through the adjacent samples
is less than this fraction of its height above a straight line through them.
"""

JUMPS_S, FLANK, LOW, HIGH = 0.01, 0.15, 0.25, 0.75
"""An excursion longer than this [s] is a spike only if it jumps both up and down: between these two fractions of its height
within this fraction of its length, on either side.
"""

SCALE_WINDOW_S = 1.0
"""Length of the stretch in which the spread about the running median is estimated [s]."""

SCALE_SAMPLES, LEAST_SCALE_SAMPLES = 500, 50
"""Most and fewest samples used for the spread; in a slow channel, the stretch is longer to have the fewest."""


def find_spikes(samples: Array, rate_hz: float, *, longest_s: float, threshold: float, least: float) -> Spans:
    """Find the spikes of a signal: short, high excursions after which the signal continues as before.

    A sample is suspect if its distance from the running median exceeds `threshold` robust standard deviations
    (Hampel's rule) and `least` times the median magnitude. Successive suspect samples are a spike if they are above a
    quarter of their height for at most `longest_s`, and the signal then continues as before. A plant's first response
    to a step may rise as fast as a spike, but does not return. The spread is estimated over a second, or 50 samples of a
    slow channel; the samples, shape (N,), are finite. F. R. Hampel, doi:10.1080/01621459.1974.10482962.
    """
    # A few hundred samples suffice for a spread.
    stride = max(round(rate_hz * SCALE_WINDOW_S / SCALE_SAMPLES), 1)
    longest = max(round(longest_s * rate_hz), 1)
    found = _core.find_spikes(
        np.ascontiguousarray(samples, dtype=np.float64),
        longest=longest,
        stride=stride,
        scale_window=2 * round(0.5 * max(SCALE_WINDOW_S * rate_hz / stride, LEAST_SCALE_SAMPLES)) + 1,
        threshold=threshold,
        least=least,
    )
    sure = round(JUMPS_S * rate_hz)
    spikes = [
        (stop - start <= sure or _jumps_both_ways(samples, start, stop))
        and not _is_crest(samples, start, stop, longest)
        for start, stop in found.tolist()
    ]
    return found[np.array(spikes, dtype=np.bool_)]


def _jumps_both_ways(samples: Array, start: int, stop: int) -> bool:
    """Whether an excursion is as steep at its end as at its start, relative to its length."""
    beside = [samples[at] for at in (start - 1, stop) if 0 <= at < len(samples)]
    if not beside:
        return True
    height = np.abs(samples[start:stop] - np.linspace(beside[0], beside[-1], stop - start + 2)[1:-1])
    low, high = (np.flatnonzero(height >= share * height.max()) for share in (LOW, HIGH))
    longest = max(FLANK * (stop - start), 1.0)
    return bool(max(high[0] - low[0], low[-1] - high[-1]) <= longest)


def _is_crest(samples: Array, start: int, stop: int, beside: int) -> bool:
    """Whether an excursion follows the curve through the samples on either side, as the crest of an oscillation does.

    A cubic through the samples before and after continues their trend; a straight line is the level without the excursion.
    """
    sides = np.r_[max(start - beside, 0) : start, stop : min(stop + beside, len(samples))]
    if len(sides) < 2 * beside or beside < 2:
        return False
    top = start + int(np.argmax(np.abs(samples[start:stop] - 0.5 * (samples[start - 1] + samples[stop]))))
    line, curve = (
        float(np.polyval(np.polyfit(sides - top, samples[sides], degree), 0.0)) for degree in (1, 3)
    )
    return bool(abs(samples[top] - curve) < SWINGS_ON * abs(samples[top] - line))


def bridge(samples: Array, missing: Mask | None = None) -> Array:
    """Interpolate missing samples (by default those that are not finite) linearly, constant at the ends.

    Unchanged if all are missing.
    """
    missing = ~np.isfinite(samples) if missing is None else missing
    if not missing.any() or missing.all():
        return samples
    index = np.arange(len(samples))
    bridged = samples.copy()
    bridged[missing] = np.interp(index[missing], index[~missing], samples[~missing])
    return bridged
