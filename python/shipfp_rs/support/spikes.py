"""Spikes: short excursions of a recorded signal that the plant can't make; found, then masked or bridged."""

from __future__ import annotations

import numpy as np

from shipfp_rs import _core
from shipfp_rs.support.arrays import Array, Mask
from shipfp_rs.support.spans import Spans

ROBUST_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of Gaussian noise."""

SWINGS_ON = 0.5
"""A crest is nearer to the curve through its sides than this share of its height over the line through them."""

JUMPS_S, FLANK, LOW, HIGH = 0.01, 0.15, 0.25, 0.75
"""What is longer [s] is a spike only if it jumps both up and down: from one share of its height to the other on either side
within this share of its length."""

SCALE_WINDOW_S = 1.0
"""Length of the stretch over which the spread about the running median is measured [s]."""

SCALE_SAMPLES, LEAST_SCALE_SAMPLES = 500, 50
"""Most samples of that stretch that are used, and fewest, for which the stretch of a slow channel is longer."""


def find_spikes(samples: Array, rate_hz: float, *, longest_s: float, threshold: float, least: float) -> Spans:
    """Return the spikes of a signal: short, high, and coming back to where they left.

    A sample is suspect where it is further from the running median than `threshold` robust standard deviations
    (Hampel's rule) and than `least` times the median magnitude. Suspects in a row are a spike if they last, above a
    quarter of its height, no longer than `longest_s`, and the signal goes on where it was left. The kick which a plant
    answers a step with is none: it may jump up as fast, but does not jump down again.

    Parameters
    ----------
    samples
        Signal, shape (N,), finite.
    rate_hz
        Sample rate [Hz].
    longest_s
        Length of the longest spike [s].
    threshold
        Height in robust standard deviations, taken over a second, or 50 samples of a slow channel.
    least
        Height below which nothing is a spike, as a share of the median magnitude.

    Notes
    -----
    F. R. Hampel, doi:10.1080/01621459.1974.10482962.
    """
    # A few hundred samples are enough for a spread.
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
    """Whether an excursion is as steep at its end as at its beginning, over its length."""
    beside = [samples[at] for at in (start - 1, stop) if 0 <= at < len(samples)]
    if not beside:
        return True
    height = np.abs(samples[start:stop] - np.linspace(beside[0], beside[-1], stop - start + 2)[1:-1])
    low, high = (np.flatnonzero(height >= share * height.max()) for share in (LOW, HIGH))
    longest = max(FLANK * (stop - start), 1.0)
    return bool(max(high[0] - low[0], low[-1] - high[-1]) <= longest)


def _is_crest(samples: Array, start: int, stop: int, beside: int) -> bool:
    """Whether an excursion goes on what a curve through the samples on either side of it does: a swing's crest.

    A cubic through so many samples before and after tells where the signal was heading, a straight line what it left.
    """
    sides = np.r_[max(start - beside, 0) : start, stop : min(stop + beside, len(samples))]
    if len(sides) < 2 * beside or beside < 2:
        return False
    top = start + int(np.argmax(np.abs(samples[start:stop] - 0.5 * (samples[start - 1] + samples[stop]))))
    line, curve = (
        float(np.polyval(np.polyfit(sides - top, samples[sides], degree), 0.0)) for degree in (1, 3)
    )
    return bool(abs(samples[top] - curve) < SWINGS_ON * abs(samples[top] - line))


def bridge(samples: Array, missing: Mask) -> Array:
    """Return the signal with straight lines over the missing samples, level at the ends; all missing stays so."""
    if not missing.any() or missing.all():
        return samples
    index = np.arange(len(samples))
    bridged = samples.copy()
    bridged[missing] = np.interp(index[missing], index[~missing], samples[~missing])
    return bridged
