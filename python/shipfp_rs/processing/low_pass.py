"""Low-pass and resampling of every channel to the common rate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import partial

import numpy as np

from shipfp_rs._core import Decimator
from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.support.arrays import Array, Mask
from shipfp_rs.support.fir import taps
from shipfp_rs.support.spans import Spans, runs
from shipfp_rs.support.spikes import bridge

Source = Callable[[int, int], Array]
"""Function (first, stop) that returns samples by a channel's own index, NaN where masked."""

MARGIN_S = 1.0
"""Time read before and after each piece, so that running medians settle [s]."""
PIECE = 1 << 17
"""Samples cleaned at once; windows may exceed the memory."""
MASKED_SHARE = 0.05
"""Largest fraction of the filter's weight on masked samples; beyond it an output is masked."""
ALIGNED = 1e-6
"""Largest difference between two clocks due to rounding, in samples."""
SAME_CLOCK, SAME_RATE = 1e-6, 1e-3
"""Largest relative difference of rates due to rounding on one clock, and between two clocks of one nominal rate."""
REACH = 16
"""Samples on either side that contribute to a value between two samples."""
KAISER = 8.0
"""Parameter of their Kaiser window: the error is at most 1e-3 up to two fifths of the sample rate."""


def nearest_rate(channel: Channel, wanted_hz: float) -> float:
    """Rate nearest to the wanted one that is a simple fraction of a channel's rate [Hz].

    Clocks that differ by a few ppm need no resampling: the signals keep the channel's own time.
    """
    if wanted_hz > channel.rate_hz * (1.0 + 1e-3):
        raise InputError(
            f"processing.rate_hz is {wanted_hz:g}, expected no more than the {channel.rate_hz:g} Hz of channel "
            f"{channel.name!r}"
        )
    share = wanted_hz / channel.rate_hz
    return channel.rate_hz * float(Fraction(share).limit_denominator(max(100, round(1.0 / share))))


def on_a_simple_rate(channel: Channel, source: Source, rate_hz: float) -> tuple[Channel, Source]:
    """Channel and samples at a rate with a simple ratio to the common rate.

    The nodes of a bus have separate clocks, which differ by a few to some hundred ppm: a channel on another clock is
    resampled by a windowed sinc. Channels of any other rate are returned unchanged.
    """
    share = rate_hz / channel.rate_hz
    nearest = Fraction(share).limit_denominator(max(500, round(1.0 / share)))
    if math.isclose(nearest, share, rel_tol=SAME_CLOCK) or not math.isclose(
        nearest, share, rel_tol=SAME_RATE
    ):
        return channel, source
    step = channel.rate_hz * float(nearest) / rate_hz
    samples = int((channel.samples - 1) / step) + 1
    resampled = partial(_between, source, channel.samples, step)
    return replace(channel, rate_hz=rate_hz / float(nearest), samples=samples), resampled


def _between(source: Source, samples: int, step: float, first: int, stop: int) -> Array:
    """Samples [first, stop) of those spaced by `step` samples of a source; NaN beside masked ones."""
    at = np.arange(first, stop) * step
    low = max(int(at[0]) - REACH, 0)
    values = source(low, min(int(at[-1]) + REACH + 2, samples))
    missing = np.isnan(values)
    filled = bridge(values, missing)
    whole = np.floor(at).astype(np.int64)
    taps_at = np.arange(1 - REACH, REACH + 1)
    distance = (at - whole)[:, None] - taps_at
    weights = np.sinc(distance) * np.i0(KAISER * np.sqrt(np.maximum(1.0 - (distance / REACH) ** 2, 0.0)))
    places = np.clip(whole[:, None] + taps_at - low, 0, len(values) - 1)
    found = np.sum(weights * filled[places], axis=1) / weights.sum(axis=1)
    found[missing[places[:, REACH - 1 : REACH + 1]].any(axis=1)] = np.nan
    return np.asarray(found)


class LowPass:
    """Zero-phase FIR low-pass and resampling to the common rate, in pieces, with masked samples.

    `start` is the channel index of the first output, not necessarily whole.
    """

    def __init__(self, channel: Channel, rate_hz: float, start: float) -> None:
        ratio = Fraction(rate_hz / channel.rate_hz).limit_denominator(4096)
        if ratio > 1 or not math.isclose(ratio, rate_hz / channel.rate_hz, rel_tol=SAME_CLOCK):
            raise InputError(
                f"channel {channel.name!r}: found {channel.rate_hz:g} Hz, expected {rate_hz:g} Hz or a multiple of "
                "it by a simple ratio; choose another processing.rate_hz"
            )
        self.up, self.down = ratio.numerator, ratio.denominator
        self.samples = channel.samples
        self.start = max(round(start), 0)
        inner_rate = channel.rate_hz * self.up
        shift = start - self.start
        self.taps = taps(rate_hz / inner_rate, shift * self.up if abs(shift) > ALIGNED else 0.0)
        # Runs of masked samples longer than the filter are not bridged, since no output depends on both sides of them.
        self.longest_bridge = math.ceil(len(self.taps) / self.up) + 1
        self.margin = max(round(MARGIN_S * channel.rate_hz), self.longest_bridge + 1)

    def __call__(self, source: Source, count: int) -> Array:
        """Compute `count` outputs; NaN where too many of their samples are masked."""
        # Start earlier, by the whole number of outputs that the filter needs to fill.
        ahead = min(math.ceil(self.margin / self.down), self.start // self.down)
        begin = self.start - ahead * self.down
        skipped = ahead * self.up
        # A channel may end a sample before the grid.
        total = min(skipped + count, math.ceil((self.samples - begin) * self.up / self.down))
        end = min(begin + math.ceil(total * self.down / self.up) + self.margin, self.samples)
        filter_ = Decimator(self.taps, self.up, self.down)
        values, masked = [], []
        for first in range(begin, end, PIECE):
            stop = min(first + PIECE, end)
            lead = min(self.margin, first)
            samples = source(first - lead, min(stop + self.margin, self.samples))
            missing = np.isnan(samples)
            core = slice(lead, lead + stop - first)
            values.append(filter_.feed(self._bridged(samples, missing)[core]))
            masked.append(runs(missing[core]) + (first - begin))
        filtered = np.concatenate([*values, filter_.finish(total)])[:total]
        filtered[self._masked_share(np.concatenate(masked), total) > MASKED_SHARE] = np.nan
        result = np.full(count, np.nan)
        result[: total - skipped] = filtered[skipped:]
        return result

    def _masked_share(self, spans: Spans, total: int) -> Array:
        """Fraction of the filter's weight on masked samples for each output, shape (total,)."""
        count, half = len(self.taps), len(self.taps) // 2
        weight = np.append(0.0, np.cumsum(np.abs(self.taps)))
        share = np.zeros(total)
        for start, stop in (spans * self.up).tolist():
            reached = slice(
                max(math.ceil((start - half) / self.down), 0), min((stop + half) // self.down + 1, total)
            )
            newest = np.arange(reached.start, reached.stop) * self.down + half + 1
            share[reached] += (
                weight[np.clip(newest - start, 0, count)] - weight[np.clip(newest - stop, 0, count)]
            )
        return np.asarray(share / weight[-1])

    def _bridged(self, samples: Array, missing: Mask) -> Array:
        """Bridge masked samples by straight lines; long runs are filled with the adjacent values.

        Samples further away than the margin have no effect, so the result does not depend on the pieces.
        """
        if not missing.any():
            return samples
        bridged = samples.copy()
        for start, stop in runs(missing).tolist():
            before = samples[start - 1] if start > 0 else np.nan
            after = samples[stop] if stop < len(samples) else np.nan
            if stop - start <= self.longest_bridge and np.isfinite(before + after):
                bridged[start:stop] = before + (after - before) / (stop + 1 - start) * np.arange(
                    1, stop - start + 1
                )
            elif np.isfinite(before):
                held = start + self.longest_bridge if np.isfinite(after) else stop
                bridged[start:held] = before
                bridged[held:stop] = after
            else:
                bridged[start:stop] = after if np.isfinite(after) else 0.0
        return bridged
