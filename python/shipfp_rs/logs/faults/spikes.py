"""Spikes of a channel: short excursions that stand out from the noise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from shipfp_rs.logs.log import Rows
from shipfp_rs.support.arrays import Array, Mask, Spans, joined, marks, runs
from shipfp_rs.support.spikes import bridge, find_spikes
from shipfp_rs.support.threads import require_going
from shipfp_rs.support.units import Calibration

PIECE = 1 << 18
"""Samples processed together."""
SHORTEST = 2
"""A spike may have this many samples, even if they exceed the longest duration of a spike, as in a slow channel."""
BY_A_CLOCK, LONGEST_HELD_S = 0.9, 0.2
"""A channel holds its values if more than this fraction of its changes is at multiples of one period; longest period
[s].
"""
BESIDE_S, LEAST_BESIDE = 2.0, 64
"""Margin read on either side of a piece, for the noise near its ends: duration [s] and least number of samples."""


class SpikeLimits(Protocol):
    """Limits of spikes: duration [s], height in robust standard deviations, and height relative to the median magnitude."""

    @property
    def longest_s(self) -> float: ...  # noqa: D102
    @property
    def threshold(self) -> float: ...  # noqa: D102
    @property
    def least(self) -> float: ...  # noqa: D102


def spikes_between(
    samples: Array,
    missing: Mask,
    rate_hz: float,
    limits: SpikeLimits,
    shortest: int = 1,
    *,
    steps: bool = False,
) -> Spans:
    """Spans of spikes in calibrated samples after interpolation of `missing`; `steps`: the signal itself may have steps."""
    filled = bridge(samples, missing)
    held = 1 if steps else held_samples(filled, rate_hz)
    # A spike in a slow channel may have `shortest` samples.
    # If a power analyser or a bus holds each value, a spike may last as long as one value.
    longest_s = max(limits.longest_s, shortest / rate_hz, held / rate_hz)
    # Long gaps are excluded: beside interpolated samples without noise, normal noise would look like spikes.
    absent = np.zeros(len(samples), dtype=np.bool_)
    gaps = runs(missing)
    for start, stop in gaps[gaps[:, 1] - gaps[:, 0] > longest_s * rate_hz]:
        absent[start:stop] = True
    return joined(
        start
        + find_spikes(
            filled[start:stop], rate_hz, longest_s=longest_s, threshold=limits.threshold, least=limits.least
        )
        for start, stop in runs(~absent)
    )


def spikes_along(samples: Array, rate_hz: float, limits: SpikeLimits) -> Spans:
    """Spans of spikes in a long signal whose missing samples are NaN; Ctrl-C is checked after each piece."""
    beside = max(round(BESIDE_S * rate_hz), LEAST_BESIDE)

    def found() -> Iterator[Spans]:
        for begin in range(0, len(samples), PIECE):
            require_going()
            low = max(begin - beside, 0)
            part = samples[low : begin + PIECE + beside]
            spans = low + spikes_between(part, ~np.isfinite(part), rate_hz, limits)
            yield spans[(spans[:, 0] >= begin) & (spans[:, 0] < begin + PIECE)]

    return joined(found())


def held_samples(samples: Array, rate_hz: float) -> int:
    """Number of samples for which each value is held; 1 where values do not change at a constant period."""
    lasting = np.diff(np.flatnonzero(np.diff(samples)))
    if len(lasting) < LEAST_BESIDE:
        return 1
    held = int(np.median(lasting))
    on_the_clock = np.abs(lasting - held * np.rint(lasting / held)) <= held / 8
    return held if np.mean(on_the_clock) > BY_A_CLOCK and held <= LONGEST_HELD_S * rate_hz else 1


def spikes_of(
    rows: Rows,
    lost: Spans,
    limits: SpikeLimits,
    noise: float,
    calibration: Calibration | None = None,
    *,
    steps: bool = False,
) -> Spans:
    """Spans of spikes in a channel apart from the faults `lost`; `noise` is its standard deviation in recorded units."""
    rate_hz, count = rows.channel.rate_hz, rows.channel.samples
    beside = max(round(BESIDE_S * rate_hz), LEAST_BESIDE)

    def found() -> Iterator[Spans]:
        for begin in range(0, count, PIECE):
            end = min(begin + PIECE, count)
            low, high = max(begin - beside, 0), min(end + beside, count)
            raw = rows.read(low, high).astype(np.float64)
            samples = raw if calibration is None else calibration(raw)
            spans = spikes_between(
                samples, ~np.isfinite(raw) | marks(lost, low, high), rate_hz, limits, SHORTEST, steps=steps
            )
            starts, stops = (low + spans).T
            own = (starts >= begin) & (starts < end)
            own &= (starts > 0) & (stops < count)  # an excursion at an end of the log need not be a spike
            # The height is also compared with the noise: where the level is near zero, the relative height says little.
            stands_out = [not _height(raw, *span) <= limits.threshold * noise for span in spans.tolist()]
            yield low + spans[own & np.array(stands_out, dtype=np.bool_)]

    return joined(found())


def _height(samples: Array, start: int, stop: int) -> float:
    """Height of a spike above its neighbouring samples; NaN if these are missing."""
    level = 0.5 * (samples[max(start - 1, 0)] + samples[min(stop, len(samples) - 1)])
    return float(np.abs(samples[start:stop] - level).max())
