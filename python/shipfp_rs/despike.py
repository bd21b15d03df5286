"""Short excursions of a recorded signal that no plant makes: found, then masked or bridged."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shipfp_rs._core import running_median
from shipfp_rs.spans import Spans, joined, runs

Array = npt.NDArray[np.float64]

ROBUST_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of Gaussian noise."""

SCALE_WINDOW_S = 1.0
"""Stretch over which the spread about the running median is judged [s]."""

SCALE_SAMPLES = 500
"""Samples in that stretch which are looked at, where there are so many."""

COMES_BACK = 0.3
"""Largest difference of level before and after a spike, as a share of its height."""

SHOULDER = 0.5
"""Share of the threshold down to which a spike's flanks belong to it."""


def find_spikes(samples: Array, rate_hz: float, *, longest_s: float, threshold: float, least: float) -> Spans:
    """Return the spikes of a signal: short, high, and coming back to where they left.

    A sample is suspect where it is further from the running median than `threshold` robust standard deviations
    (Hampel's rule) and than `least` times the median magnitude. Suspects in a row are a spike if they last no
    longer than `longest_s` and the signal goes on where it was left. That spares the kick which a plant answers a
    step with: it rises as fast, but decays slowly and to another level.

    Parameters
    ----------
    samples
        Signal, shape (N,), finite.
    rate_hz
        Sample rate [Hz].
    longest_s
        Length of the longest spike [s].
    threshold
        Height in robust standard deviations, taken over a second.
    least
        Height below which nothing is a spike, as a share of the median magnitude.

    Notes
    -----
    F. R. Hampel, doi:10.1080/01621459.1974.10482962.
    """
    longest = max(round(longest_s * rate_hz), 1)
    baseline = running_median(samples, 2 * longest + 1)
    distance = np.abs(samples - baseline)
    # A few hundred samples tell a spread; the others say the same again.
    stride = max(round(rate_hz * SCALE_WINDOW_S / SCALE_SAMPLES), 1)
    scale_window = 2 * round(0.5 * SCALE_WINDOW_S * rate_hz / stride) + 1
    spread = ROBUST_SIGMA * np.repeat(running_median(distance[::stride].copy(), scale_window), stride)
    limit = np.maximum(
        threshold * spread[: len(samples)], least * float(np.median(np.abs(baseline[::stride])))
    )
    suspects = runs(distance > SHOULDER * limit)
    # A spike that swings through the baseline is one spike.
    suspects = joined([suspects], gap=max(longest // 10, 1))
    spikes = [
        (start, stop)
        for start, stop in suspects.tolist()
        if stop - start <= longest
        and _comes_back(samples, distance, limit, start, stop, max(longest // 2, 1))
    ]
    return np.array(spikes, dtype=np.int64).reshape(-1, 2)


def bridge(samples: Array, missing: npt.NDArray[np.bool_]) -> Array:
    """Return the signal with straight lines over the missing samples, level at the ends; all missing stays so."""
    if not missing.any() or missing.all():
        return samples
    index = np.arange(len(samples))
    bridged = samples.copy()
    bridged[missing] = np.interp(index[missing], index[~missing], samples[~missing])
    return bridged


def _comes_back(samples: Array, distance: Array, limit: Array, start: int, stop: int, nearby: int) -> bool:
    """Whether the suspects from `start` to `stop` are high enough and the signal goes on where it was left."""
    peak = start + int(np.argmax(distance[start:stop]))
    if distance[peak] <= limit[peak]:
        return False
    sides = samples[max(start - nearby, 0) : start], samples[stop : stop + nearby]
    if not (sides[0].size and sides[1].size):
        return True
    before, after = (float(np.median(side)) for side in sides)
    return abs(after - before) < COMES_BACK * abs(float(samples[peak]) - before)
