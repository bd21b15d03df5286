"""The low-pass that every channel goes through on its way to the common rate."""

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
"""(first, stop) to samples on a channel's own index, NaN where masked."""

MARGIN_S = 1.0
"""Time read before and after each piece, so that running medians have settled within it [s]."""
PIECE = 1 << 17
"""Samples cleaned at once; windows may be longer than memory."""
MASKED_SHARE = 0.05
"""An output is masked where more than this share of the filter's weight lies on masked samples."""
ALIGNED = 1e-6
"""Largest difference of two clocks by rounding alone, as a part of a sample."""
SAME_CLOCK, SAME_RATE = 1e-6, 1e-3
"""Largest relative difference of rates by rounding on one clock, and between two clocks of one nominal rate."""
REACH = 16
"""Samples on either side from which a value between two samples is computed."""
KAISER = 8.0
"""Shape of the Kaiser window over them: up to two fifths of the sample rate a value is right to one part in a thousand."""


def nearest_rate(channel: Channel, wanted_hz: float) -> float:
    """Return the rate nearest to the wanted one that is a simple fraction of a channel's rate [Hz].

    A clock that is off by a few parts in a million then costs nothing: the signals keep the channel's own time.
    """
    if wanted_hz > channel.rate_hz * (1.0 + 1e-3):
        raise InputError(
            f"processing.rate_hz is {wanted_hz:g}, expected no more than the {channel.rate_hz:g} Hz of channel "
            f"{channel.name!r}"
        )
    share = wanted_hz / channel.rate_hz
    return channel.rate_hz * float(Fraction(share).limit_denominator(max(100, round(1.0 / share))))


def on_a_simple_rate(channel: Channel, source: Source, rate_hz: float) -> tuple[Channel, Source]:
    """Return a channel, and samples of it, at a rate that is to the common one as two small numbers are.

    The nodes of a bus have a clock each, a few parts in a million or ten thousand off: a channel of such another clock is
    sampled again, by a windowed sinc. Any other rate is returned as it is.
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
    """Return samples [first, stop) of those that lie `step` samples of a source apart; NaN beside what is masked there."""
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
    """Zero-phase FIR low-pass and resampling to the common rate, in pieces, masked samples allowed for.

    Parameters
    ----------
    channel
        The channel, or that on whose index the samples come.
    rate_hz
        Common rate [Hz].
    start
        Place of the first output on the channel's index [samples]; may lie between two samples.
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
        # Runs of masked samples longer than the filter are not bridged: no output depends on both of their sides.
        self.longest_bridge = math.ceil(len(self.taps) / self.up) + 1
        self.margin = max(round(MARGIN_S * channel.rate_hz), self.longest_bridge + 1)

    def __call__(self, source: Source, count: int) -> Array:
        """Return `count` outputs; NaN where too many of their samples are masked."""
        # Begin by whole outputs earlier, as many as the filter needs to fill.
        ahead = min(math.ceil(self.margin / self.down), self.start // self.down)
        begin = self.start - ahead * self.down
        skipped = ahead * self.up
        # A channel may end a sample before the grid does.
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
        """Share of the filter's weight that each output has on masked samples, shape (total,)."""
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
        """Bridge masked samples by straight lines; long runs keep the values beside them.

        Nothing further away than the margin has an effect, so the result does not depend on the cutting into pieces.
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
