"""The low-pass that every channel goes through on its way to the common rate."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import numpy.typing as npt
from scipy import signal

from shipfp_rs.despike import bridge
from shipfp_rs.errors import InputError
from shipfp_rs.log import Channel

Array = npt.NDArray[np.float64]
Source = Callable[[int, int], Array]
"""(first, stop) to samples on a channel's own index, NaN where masked."""

PASSBAND, STOPBAND = 0.3, 0.5
"""Edges of the low-pass as shares of the output's rate; nothing above half of it may fold back."""
ATTENUATION_DB = 80.0
MARGIN_S = 1.0
"""Read before and after each piece, so that running medians and the filter have settled where it counts."""
PIECE = 1 << 19
"""Samples filtered at once; windows may be longer than memory."""
MASKED_SHARE = 0.05
"""Share of the filter's weight on masked samples from which on its output is masked."""


def nearest_rate(channel: Channel, wanted_hz: float) -> float:
    """Return the rate next to the wanted one that is a simple part of a channel's rate [Hz].

    A clock that is off by a few parts in a million then costs nothing: the signals keep the channel's own time.
    """
    if wanted_hz > channel.rate_hz * (1.0 + 1e-3):
        raise InputError(
            f"processing.rate_hz is {wanted_hz:g}, expected no more than the {channel.rate_hz:g} Hz of channel "
            f"{channel.name!r}"
        )
    return channel.rate_hz * float(Fraction(wanted_hz / channel.rate_hz).limit_denominator(100))


class LowPass:
    """Zero-phase FIR low-pass and resampling to the common rate, in pieces, masked samples allowed for."""

    def __init__(self, channel: Channel, rate_hz: float) -> None:
        ratio = Fraction(rate_hz / channel.rate_hz).limit_denominator(4096)
        if ratio > 1 or not math.isclose(ratio, rate_hz / channel.rate_hz, rel_tol=1e-6):
            raise InputError(
                f"channel {channel.name!r}: found {channel.rate_hz:g} Hz, expected {rate_hz:g} Hz or a multiple of "
                "it by a simple ratio; choose another processing.rate_hz"
            )
        self.up, self.down = ratio.numerator, ratio.denominator
        self.samples = channel.samples
        inner_rate = channel.rate_hz * self.up
        nyquist = 0.5 * inner_rate
        taps, beta = signal.kaiserord(ATTENUATION_DB, (STOPBAND - PASSBAND) * rate_hz / nyquist)
        self.taps = signal.firwin(
            taps | 1, 0.5 * (PASSBAND + STOPBAND) * rate_hz, window=("kaiser", beta), fs=inner_rate
        )
        self.weights = np.abs(self.taps) / np.abs(self.taps).sum()
        # Whole multiples of `up` keep each piece on the input's index.
        self.margin = math.ceil(MARGIN_S * rate_hz / self.up) * self.up
        self.piece = max(PIECE // self.down, 1) * self.up

    def __call__(self, source: Source, start: int, count: int) -> Array:
        """Return `count` outputs, the first at sample `start` of the channel."""
        result = np.full(count, np.nan)
        for done in range(0, count, self.piece):
            size = min(self.piece, count - done)
            at = start + done // self.up * self.down
            before = min(self.margin, at // self.down * self.up)
            first = at - before // self.up * self.down
            stop = min(at + math.ceil((size + self.margin) * self.down / self.up), self.samples)
            samples = source(first, stop)
            # A channel may end a sample before the grid does.
            filtered = self._filtered(samples)[before : before + size]
            result[done : done + len(filtered)] = filtered
        return result

    def _filtered(self, samples: Array) -> Array:
        missing = np.isnan(samples)
        result = self._resampled(bridge(samples, missing), self.taps)
        if missing.any():
            share = self._resampled(missing.astype(np.float64), self.weights)
            result[share > MASKED_SHARE] = np.nan
        return result

    def _resampled(self, samples: Array, taps: Array) -> Array:
        return np.asarray(signal.resample_poly(samples, self.up, self.down, window=taps, padtype="edge"))
