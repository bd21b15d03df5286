"""Mains hum of a channel: detection by block and removal."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import signal

from shipfp_rs.support.arrays import Array, Spans, joined, marks, runs

CYCLES = 10
"""Mains cycles in a block: 0.2 s at 50 Hz, the resolution in time."""
SIDE = 3
"""Distance of the two reference frequencies from that of the mains, in bins of a block."""
ABOVE_SIDES = 4.0
"""Least ratio of the amplitude of hum to that at the two reference frequencies."""
LEAST_BLOCKS = 3
"""Least number of successive blocks with hum. A jump of the signal looks like hum in one or two."""
BATCH = 64
"""Blocks processed together. A fixed number, since rounding depends on it and must not depend on the chunks fed."""
NOTCH_S = 0.5
"""Window for the hum's amplitude and phase [s]. All other content within 4 Hz is removed, too."""


class HumScan:
    """Amplitude at mains frequency in each block of a channel, fed in chunks of any length."""

    @staticmethod
    def tells(rate_hz: float, mains_hz: float, samples: int) -> bool:
        """Whether hum can be detected: the sample rate covers the reference frequencies, and the channel fills a block."""
        return rate_hz > 2.0 * mains_hz * (1.0 + SIDE / CYCLES) and samples * mains_hz >= CYCLES * rate_hz

    def __init__(self, rate_hz: float, mains_hz: float = 50.0) -> None:
        self.rate_hz = rate_hz
        self.block = round(CYCLES / mains_hz * rate_hz)
        index = np.arange(self.block)
        window = np.hanning(self.block + 1)[:-1]
        bins = mains_hz * (1.0 + np.array([0.0, -SIDE, SIDE]) / CYCLES)
        turns = np.outer(index, bins / rate_hz)
        waves = np.concatenate([np.cos(2.0 * np.pi * turns), np.sin(2.0 * np.pi * turns)], axis=1)
        self._weights = (waves * (2.0 / window.sum()) * window[:, None]).astype(np.float32)
        self._rest: npt.NDArray[Any] = np.empty(0)
        self._parts: list[Array] = []

    def feed(self, chunk: npt.NDArray[Any]) -> None:
        """Add the next samples."""
        chunk = np.concatenate([self._rest, chunk]) if len(self._rest) else chunk
        whole = len(chunk) // (BATCH * self.block) * (BATCH * self.block)
        self._rest = chunk[whole:].copy()
        for batch in chunk[:whole].reshape(-1, BATCH, self.block):
            self._parts.append(self._waves(batch))

    @np.errstate(invalid="ignore")  # blocks with missing samples count as free of hum
    def _waves(self, blocks: npt.NDArray[Any]) -> Array:
        # The level, which has no content in these bins, is subtracted to keep digits in single precision.
        level = np.subtract(blocks, blocks[:, :1], dtype=np.float32)
        return np.asarray((level @ self._weights).astype(np.float64))

    def spans(self, least: float) -> Spans:
        """Stretches of whole blocks with hum of at least this amplitude, shape (K, 2)."""
        whole = len(self._rest) // self.block * self.block
        parts = np.concatenate([*self._parts, self._waves(self._rest[:whole].reshape(-1, self.block))])
        if not len(parts):
            return np.empty((0, 2), dtype=np.int64)
        amplitude = np.hypot(parts[:, :3], parts[:, 3:])
        hum, sides = amplitude[:, 0], amplitude[:, 1:].mean(axis=1)
        usual = float(np.nanmedian(sides))
        flagged = (hum > least) & (hum > ABOVE_SIDES * np.maximum(sides, usual))
        blocks = joined([runs(flagged)], gap=2)
        return blocks[blocks[:, 1] - blocks[:, 0] >= LEAST_BLOCKS] * self.block


def hum_in(samples: Array, first: int, spans: Spans, rate_hz: float, mains_hz: float = 50.0) -> Array:
    """Hum in finite samples that start at index `first`, shape (N,); zero outside the spans."""
    flags = marks(spans, first, first + len(samples))
    turn = np.exp(2j * np.pi * mains_hz / rate_hz * np.arange(len(samples)))
    window = np.hanning(round(NOTCH_S * rate_hz) | 1)
    # Samples are extrapolated by straight lines, so that the level is not a jump at the ends.
    half = len(window) // 2
    padded = np.pad(samples, half, mode="reflect", reflect_type="odd") if len(samples) > half else samples
    turned = np.exp(2j * np.pi * mains_hz / rate_hz * (np.arange(len(padded)) - half))
    envelope = signal.oaconvolve(
        padded * turned.conj(), window / window.sum(), "valid" if len(samples) > half else "same"
    )
    return np.where(flags, 2.0 * np.real(envelope * turn), 0.0)
