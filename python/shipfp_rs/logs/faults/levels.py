"""Faults of a channel's level: missing samples, a stuck channel, dropouts to zero, clipping, and hum of the mains."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import signal

from shipfp_rs.logs.faults.extremes import BlockExtremes
from shipfp_rs.support.arrays import Array, Spans, apart_from, joined, marks, runs

CYCLES = 10
"""Number of mains cycles in a block. The block (0.2 s at 50 Hz) is the resolution in time."""
SIDE = 3
"""Distance of the two reference frequencies from the mains frequency, in frequency bins of a block."""
ABOVE_SIDES = 4.0
"""Least ratio of the amplitude of hum to the mean amplitude at the two reference frequencies."""
LEAST_BLOCKS = 3
"""Least number of successive blocks with hum. A jump of the signal looks like hum in one or two blocks."""
BATCH = 64
"""Number of blocks processed together. It is fixed, so rounding errors do not depend on the length of the chunks."""
NOTCH_S = 0.5
"""Length of the window that estimates the hum's amplitude and phase [s]. Other content within 4 Hz of the mains
frequency is also removed.
"""


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
        # Subtracting the level, which has no content in these bins, preserves digits in single precision.
        level = np.subtract(blocks, blocks[:, :1], dtype=np.float32)
        return np.asarray((level @ self._weights).astype(np.float64))

    def spans(self, least: float) -> Spans:
        """Stretches of whole blocks with hum of at least this amplitude, shape (K, 2)."""
        whole = len(self._rest) // self.block * self.block
        parts = np.concatenate([*self._parts, self._waves(self._rest[:whole].reshape(-1, self.block))])
        if not np.isfinite(parts).any():
            return np.empty((0, 2), dtype=np.int64)
        amplitude = np.hypot(parts[:, :3], parts[:, 3:])
        hum, sides = amplitude[:, 0], amplitude[:, 1:].mean(axis=1)
        usual = float(np.nanmedian(sides))
        flagged = (hum > least) & (hum > ABOVE_SIDES * np.maximum(sides, usual))
        blocks = joined([runs(flagged)], gap=2)
        return blocks[blocks[:, 1] - blocks[:, 0] >= LEAST_BLOCKS] * self.block


def hum_in(samples: Array, first: int, spans: Spans, rate_hz: float, mains_hz: float = 50.0) -> Array:
    """Hum in samples without gaps, the first of which has index `first`, shape (N,); zero outside the spans."""
    flags = marks(spans, first, first + len(samples))
    turn = np.exp(2j * np.pi * mains_hz / rate_hz * np.arange(len(samples)))
    window = np.hanning(round(NOTCH_S * rate_hz) | 1)
    # The samples are extended at both ends by odd reflection. With zeros instead, a nonzero mean would jump at the ends.
    half = len(window) // 2
    padded = np.pad(samples, half, mode="reflect", reflect_type="odd") if len(samples) > half else samples
    turned = np.exp(2j * np.pi * mains_hz / rate_hz * (np.arange(len(padded)) - half))
    envelope = signal.oaconvolve(
        padded * turned.conj(), window / window.sum(), "valid" if len(samples) > half else "same"
    )
    return np.where(flags, 2.0 * np.real(envelope * turn), 0.0)


Read = Callable[[int, int], Array]
"""Function (first, stop) that returns samples [first, stop) of a channel."""
LEAST_BLOCK, MOST_BLOCK = 8, 128
"""Samples in a block of the first pass. Stuck stretches of twice as many samples are always found."""
LEAST_STILL = 2 * LEAST_BLOCK
"""Shortest stretch of equal samples that counts as stuck."""
PIECE = 1 << 19
"""Samples reread at once."""
NEARBY = 128
"""Number of samples before and after a constant stretch that show whether the channel is otherwise noisy."""
QUANTA = 3.0
"""Sample-to-sample changes below this multiple of a float's resolution are rounding, not noise."""
STEPS = 1.5
"""Changes below this multiple of the channel's smallest step are rounding, too: rounding alone causes changes of one step.
"""
ROUGH = 0.7
"""A signal is noisy if the mean size of its second differences exceeds this multiple of the mean size of its first
differences. The ratio is 1.7 for white noise and near 0 for a smooth signal. A single step affects means less than
root mean squares.
"""
ALONE = 0.25
"""A channel's maximum may be a spike, not the sensor's limit, if it exceeds the second highest block maximum by more
than this fraction of its distance from the median block maximum.
"""
CROWDED = 0.25
"""A clipped signal has at most this ratio between its samples one step below the limit and its samples at the limit."""
LOOKED_AT = 64
"""Largest number of blocks, and of stretches, at a limit that are examined."""
ONE_SIDE = 0.05
"""A channel is searched for dropouts to zero only if at most this fraction of its blocks has the rarer sign."""
NEAR_ZERO = 0.2
"""A channel is searched for dropouts only if the 10 % quantile of its magnitudes is above this fraction of their
median.
"""


@dataclass(frozen=True)
class LevelLimits:
    """Limits of level faults."""

    stuck_s: float = 0.25
    """Shortest stretch of equal samples in an otherwise noisy channel [s]."""
    dropout_s: float = 0.01
    """Shortest stretch at zero [s]."""
    dropout_share: float = 0.01
    """Largest magnitude that counts as zero, relative to the channel's typical level."""
    clipped_samples: int = 8
    """Least number of samples at a channel's extreme value, for it to count as the sensor's limit."""
    spike_s: float = 0.05
    """Longest spike [s]: a shorter stretch at an extreme value is a spike if no other sample is near this value."""

    def still_samples(self, rate_hz: float) -> float:
        """Length of the shortest stuck stretch in samples."""
        return max(self.stuck_s * rate_hz, LEAST_STILL)

    def block(self, rate_hz: float) -> int:
        """Number of samples in a block of the first pass: at most half the shortest stuck stretch."""
        return int(min(max(self.still_samples(rate_hz) // 2, LEAST_BLOCK), MOST_BLOCK))


def find_level_faults(
    extremes: BlockExtremes, read: Read, rate_hz: float, limits: LevelLimits | None = None
) -> dict[str, Spans]:
    """Spans of each kind of level fault; spans, and the samples of `read`, count from the first sample fed to `extremes`."""
    limits = limits or LevelLimits()
    suspects = _Suspects(extremes, read)
    low, high = extremes.low, extremes.high
    odd = ~(np.isfinite(low) & np.isfinite(high))
    found = {"gap": suspects.runs_of(odd, lambda x: ~np.isfinite(x))}
    for block in np.flatnonzero(odd).tolist():
        present = suspects.samples(block)
        present = present[np.isfinite(present)]
        low[block], high[block] = (present.min(), present.max()) if present.size else (np.nan, np.nan)

    known = np.isfinite(low)
    if not known.any():
        return found
    found["dropout"] = _dropouts(suspects, low, high, rate_hz, limits)
    still = suspects.runs_of(known & (low == high), _repeats, beside=1)
    still = still[still[:, 1] - still[:, 0] >= limits.still_samples(rate_hz)]
    # A stuck channel has noise before or after the stretch; a constant set point without noise is not reported.
    # A channel that never changes is always reported.
    never_moves = np.nanmin(low) == np.nanmax(high) and len(still)
    found["stuck"] = apart_from(still if never_moves else suspects.beside_noise(still), found["dropout"])
    clipped = [
        _rail(suspects, sign * values, sign, rate_hz, limits)
        for sign, values in ((1.0, high), (-1.0, low))
        if np.nanmax(high) > np.nanmin(low)
    ]
    found["clipped"] = apart_from(joined(clipped), joined([found["stuck"], found["dropout"]]))
    return found


class _Suspects:
    """Blocks to be examined."""

    def __init__(self, extremes: BlockExtremes, read: Read) -> None:
        self.block, self.count, self.read = extremes.block, extremes.samples, read

    def samples(self, block: int, beside: int = 0) -> Array:
        # A copy, since a view would keep the whole piece in memory.
        first, stop = block * self.block - beside, (block + 1) * self.block + beside
        return self.read(max(first, 0), min(stop, self.count)).copy()

    def runs_of(
        self, odd: npt.NDArray[np.bool_], flag: Callable[[Array], npt.NDArray[np.bool_]], beside: int = 0
    ) -> Spans:
        """Runs of samples for which `flag` is true, in the blocks marked in `odd` and in `beside` blocks on either side."""
        stretches = runs(odd) + np.array([-beside, beside])
        found = [
            first + runs(flag(self.read(first, stop)))
            for first, stop in self._pieces(joined([np.clip(stretches, 0, None) * self.block]))
        ]
        return joined(found)

    def _pieces(self, stretches: Spans) -> Iterator[tuple[int, int]]:
        for first, stop in np.minimum(stretches, self.count).tolist():
            for start in range(first, stop, PIECE):
                # Pieces overlap by one sample, since `flag` may compare successive samples.
                yield start, min(start + PIECE + 1, stop)

    def beside_noise(self, spans: Spans) -> Spans:
        """Select the spans beside noise, unless their end steps and most steps nearby are the smallest step."""

        def noisy(start: int, stop: int) -> bool:
            before = self.read(max(start - NEARBY, 0), start) if start else np.empty(0)
            after = self.read(stop, min(stop + NEARBY, self.count)) if stop < self.count else np.empty(0)
            if not (is_rough(before) or is_rough(after)):
                return False
            around = self.read(max(start - NEARBY, 0), min(stop + NEARBY, self.count)).astype(np.float64)
            steps = np.abs(np.diff(around))
            moved = steps[np.isfinite(steps) & (steps > 0.0)]
            ends = steps[[k for k in (len(before) - 1, len(steps) - len(after)) if 0 <= k < len(steps)]]
            # The crest of a slow, coarsely rounded sine begins and ends with a smallest step, as are most steps beside it.
            usual, smallest = np.quantile(moved, (0.5, 0.1))
            return bool(np.nanmax(ends, initial=usual) > STEPS * smallest) or not np.isfinite(ends).all()

        return spans[[noisy(start, stop) for start, stop in spans.tolist()]] if len(spans) else spans


def _repeats(samples: Array) -> npt.NDArray[np.bool_]:
    """Whether each sample equals its predecessor or successor."""
    same = np.diff(samples) == 0.0
    return np.asarray(np.append(same, False) | np.append(False, same))


def is_rough(samples: Array) -> bool:
    """Whether a signal changes from sample to sample as noise does."""
    samples = samples[np.isfinite(samples)]
    if len(samples) < 8:
        return False
    first = np.diff(samples.astype(np.float64))
    size = float(np.mean(np.abs(first)))
    # Without rounding the smallest change is far below the usual one.
    step = float(np.min(np.abs(first), where=first != 0.0, initial=np.inf))
    quantum = (
        float(np.spacing(np.abs(samples).max().astype(np.float32))) if samples.dtype.kind == "f" else 0.0
    )
    return bool(
        np.count_nonzero(first) > 0.5 * len(first)
        and size > max(QUANTA * quantum, STEPS * step)
        and float(np.mean(np.abs(np.diff(first)))) > ROUGH * size
    )


def _dropouts(suspects: _Suspects, low: Array, high: Array, rate_hz: float, limits: LevelLimits) -> Spans:
    """Stretches at zero in a channel that otherwise stays on one side of zero."""
    magnitude = np.abs(0.5 * (low + high))
    typical = float(np.nanmedian(magnitude))
    near = limits.dropout_share * typical
    touched = (low <= near) & (high >= -near)
    away = magnitude[np.isfinite(magnitude) & ~touched]
    if min(np.mean(high > near), np.mean(low < -near)) > ONE_SIDE:
        return np.empty((0, 2), dtype=np.int64)
    if not away.size or np.quantile(away, 0.1) < NEAR_ZERO * typical:
        return np.empty((0, 2), dtype=np.int64)
    zero = suspects.runs_of(touched, lambda x: np.abs(x) <= near)
    return zero[zero[:, 1] - zero[:, 0] >= limits.dropout_s * rate_hz]


def _rail(suspects: _Suspects, high: Array, sign: float, rate_hz: float, limits: LevelLimits) -> Spans:
    """Stretches at the maximum (with `sign` -1 the minimum) of a clipped signal."""
    top = float(np.nanmax(high))
    at_top = high == top
    runs_at_top = suspects.runs_of(at_top, lambda x: sign * x == top)
    below = high[np.isfinite(high) & ~at_top]
    alone = below.size > 0 and top - below.max() > ALONE * (top - float(np.median(below)))
    if alone:
        length = runs_at_top[:, 1] - runs_at_top[:, 0]
        runs_at_top = runs_at_top[length > limits.spike_s * rate_hz]
    at_rail = int((runs_at_top[:, 1] - runs_at_top[:, 0]).sum())
    # A coarsely rounded signal that is not clipped has as many samples one step below the maximum as at it.
    blocks = np.flatnonzero(at_top)[:LOOKED_AT].tolist()
    near = sign * np.concatenate([suspects.samples(block, NEARBY) for block in blocks]).astype(np.float64)
    next_to_it = near[near < top]
    crowded = next_to_it.size and np.count_nonzero(next_to_it == next_to_it.max()) / np.count_nonzero(
        near == top
    )
    if at_rail < limits.clipped_samples or crowded > CROWDED:
        return runs_at_top[:0]
    return runs_at_top if len(suspects.beside_noise(runs_at_top[:LOOKED_AT])) else runs_at_top[:0]
