"""Detection of spikes, short excursions that the plant can't cause, and bridging of missing samples."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from shipfp_rs.support.arrays import Array, Mask, Spans, joined, runs

ROBUST_SIGMA = 1.4826
"""Ratio of standard deviation to median absolute deviation for Gaussian noise."""

COMES_BACK, SHOULDER, FOOT = 0.3, 0.5, 0.25
"""Largest difference of the levels before and after a spike, relative to its height; fraction of a spike's least height
above which a sample is suspect; and fraction of its height at which its length is measured.
"""

SWINGS_ON = 0.5
"""An excursion is the crest of an oscillation, not a spike, if its distance from a cubic through the adjacent samples
is less than this fraction of its height above a straight line through them.
"""

JUMPS_S, FLANK, LOW, HIGH = 0.01, 0.15, 0.25, 0.75
"""An excursion longer than `JUMPS_S` [s] is a spike only if both of its edges are steep: each rises or falls between
the fractions `LOW` and `HIGH` of the height within the fraction `FLANK` of the length.
"""

SCALE_WINDOW_S = 1.0
"""Length of the stretch in which the spread about the running median is estimated [s]."""

SCALE_SAMPLES, LEAST_SCALE_SAMPLES = 500, 50
"""Largest and smallest number of samples for the spread; a slow channel's stretch is extended to the smallest."""


def find_spikes(samples: Array, rate_hz: float, *, longest_s: float, threshold: float, least: float) -> Spans:
    """Find the spikes of a signal: short, high excursions after which the signal continues as before.

    A sample is suspect if its distance from the running median exceeds `threshold` robust standard deviations
    (Hampel's rule) and `least` times the median magnitude. Successive suspect samples are a spike if they are above a
    quarter of their height for at most `longest_s`, and the signal then continues as before. A plant's response to a
    step may rise as fast as a spike, but does not return. The spread is estimated over a second, or 50 samples of a
    slow channel; the samples, shape (N,), are finite. F. R. Hampel, doi:10.1080/01621459.1974.10482962.
    """
    samples = np.asarray(samples, dtype=np.float64)
    longest = max(round(longest_s * rate_hz), 1)
    if not (len(samples) and _has_suspects(samples, longest, least)):
        return np.empty((0, 2), dtype=np.int64)
    baseline = running_median(samples, 2 * longest + 1)
    distance = np.abs(samples - baseline)
    # A few hundred samples suffice for a spread.
    stride = max(round(rate_hz * SCALE_WINDOW_S / SCALE_SAMPLES), 1)
    window = 2 * round(0.5 * max(SCALE_WINDOW_S * rate_hz / stride, LEAST_SCALE_SAMPLES)) + 1
    spread = ROBUST_SIGMA * np.repeat(running_median(distance[::stride], window), stride)[: len(samples)]
    limit = np.maximum(threshold * spread, least * np.median(np.abs(baseline[::stride])))
    # A spike with samples on both sides of the baseline counts as one spike.
    suspects = joined([runs(distance > SHOULDER * limit)], gap=max(longest // 10, 1))
    sure = round(JUMPS_S * rate_hz)
    found = [
        _trimmed(samples, limit, start, stop, longest)
        for start, stop in suspects.tolist()
        if _is_spike(samples, distance, limit, start, stop, longest)
    ]
    return np.array(
        [
            (start, stop)
            for start, stop in found
            if (stop - start <= sure or _jumps_both_ways(samples, start, stop))
            and not _is_crest(samples, start, stop, longest)
        ],
        dtype=np.int64,
    ).reshape(-1, 2)


def running_median(samples: Array, window: int) -> Array:
    """Median of the `window` samples (odd) around each one, the signal reflected at its ends, shape (N,)."""
    if not len(samples):
        return samples
    half = window // 2
    # SciPy reads beyond a signal that is shorter than half the window.
    return np.asarray(
        median_filter(np.pad(samples, half, mode="symmetric"), window)[half : half + len(samples)]
    )


def _has_suspects(samples: Array, longest: int, least: float) -> bool:
    """Whether the samples in a running median's window differ by more than half the least height of a spike.

    Their median is between their extremes; its magnitude is at least that of the signal's sample nearest to zero.
    """
    starts = np.arange(0, len(samples), longest)
    low, high = np.minimum.reduceat(samples, starts), np.maximum.reduceat(samples, starts)
    nearest_zero = max(low.min(), -high.max(), 0.0)
    # The window of a sample reaches into the blocks before and after its own.
    reach = maximum_filter1d(high, 3) - minimum_filter1d(low, 3)
    return bool(reach.max() > SHOULDER * least * nearest_zero)


def _beside(samples: Array, start: int, stop: int, longest: int) -> tuple[Array, Array]:
    """Samples before and after a span: half the longest spike on each side, fewer at the signal's ends."""
    nearby = max(longest // 2, 1)
    return samples[max(start - nearby, 0) : start], samples[stop : stop + nearby]


def _is_spike(samples: Array, distance: Array, limit: Array, start: int, stop: int, longest: int) -> bool:
    """Whether suspect samples are a short, high excursion which, except at the signal's ends, returns to its level."""
    peak = start + int(np.argmax(distance[start:stop]))
    tall = np.flatnonzero(distance[start:stop] > FOOT * distance[peak])
    if np.ptp(tall) >= longest or stop - start > 2 * longest or distance[peak] <= limit[peak]:
        return False
    before, after = _beside(samples, start, stop, longest)
    if not (len(before) and len(after)):
        return True
    level = np.median(before)
    return bool(abs(np.median(after) - level) < COMES_BACK * abs(samples[peak] - level))


def _trimmed(samples: Array, limit: Array, start: int, stop: int, longest: int) -> tuple[int, int]:
    """Span without samples near the level at its ends, which are suspect only because a long spike shifts the median.

    The level is a line from the median before the spike to the median after it.
    """
    before, after = _beside(samples, start, stop, longest)
    if not (len(before) or len(after)):
        return start, stop
    left, right = (np.median(one if len(one) else other) for one, other in ((before, after), (after, before)))
    ends = (start - 0.5 * len(before), stop + 0.5 * len(after))
    level = np.interp(np.arange(start, stop), ends, (left, right))
    beyond = np.flatnonzero(np.abs(samples[start:stop] - level) > SHOULDER * limit[start:stop])
    return (start + int(beyond[0]), start + int(beyond[-1]) + 1) if len(beyond) else (start, stop)


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
