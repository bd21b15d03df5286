"""Finds the windows of a trial in its log: stretches at rest, and excitations by kind."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.time_axis import finer
from shipfp_rs.processing.conditioning import mean_pieces, whole_blocks
from shipfp_rs.processing.trial import Faults
from shipfp_rs.support.arrays import Array, runs
from shipfp_rs.support.spikes import ROBUST_SIGMA, bridge
from shipfp_rs.support.units import QUANTITIES, told

Kind = Literal["steady", "sine", "sines", "multisine", "chirp", "squares", "prbs", "steps", "other"]

CROSSED = 0.35
"""Hysteresis of the crossings that determine frequencies, relative to the amplitude."""
JUMPED = 1.5
"""A sample is a jump of the signal generator's relay if its distance from the mean exceeds this many amplitudes."""
SAME_FREQUENCY = 1.15
"""Largest ratio between the first and last periods of an excitation with a single frequency, or its inverse."""
SWEPT, GROWTHS, REFINED = 0.1, np.geomspace(0.3, 12.0, 30), 3
"""Largest deviation of a sweep's crossings from their fit [turns], logarithms of the frequency ratios that are tried,
and number of refinements of these.
"""

IN_BAND = 0.95
"""Fraction of an excitation's power that defines its band."""
LINE_BINS, BETWEEN_LINES = 16, 0.4
"""In ranges of this many bins, the median power of a multisine is below this fraction of the mean, since there is no power
between its lines. For a swept frequency the two are similar, and for noise the median is 0.7 of the mean.
"""
SAME_LINES = 0.8
"""Least correlation between the spectral amplitudes of a window's two halves; a multisine has the same lines in both."""
REPEATS = 0.95
"""Least autocorrelation at one period of a periodic excitation."""
AT_LEVELS = 0.8
"""Least fraction of samples near one of the extremes in an excitation with two levels."""
IN_RUNS, SHORTEST_RUN = 0.75, 3
"""An excitation consists of several successive sines if more than this fraction of its half periods is in runs of
equal half periods; least number of half periods in a run.
"""


def kind_of(deviation: Array, rate_hz: float, *, swings: bool) -> tuple[Kind, tuple[float, float] | None]:
    """Kind of an excitation, and its first and last frequency [Hz] (None if it hardly crosses its middle)."""
    crossings = _crossings(deviation) / rate_hz
    halves = np.diff(crossings)
    if len(halves) < 2:
        return "other", None
    count = max(len(halves) // 8, 1)
    early, late = (float(np.median(part)) for part in (halves[:count], halves[-count:]))
    frequencies, ratio = (0.5 / early, 0.5 / late), max(early / late, late / early)
    alike = np.quantile(halves, 0.9) < 1.3 * np.quantile(halves, 0.1)
    if _has_two_levels(deviation):
        return "squares" if alike or _come_in_runs(halves) else "prbs", frequencies
    if ratio < SAME_FREQUENCY and alike:
        mean = 0.5 * len(halves) / float(crossings[-1] - crossings[0])
        return "sine", (mean, mean)
    # A stair rests most of the time, so `swings` is false; it has no spectral lines.
    if swings and (band := _lines(deviation, rate_hz)) is not None:
        return "multisine", band
    if _come_in_runs(halves):
        return "sines", frequencies
    # The periods of a chirp change monotonically.
    logs = np.log(halves)
    order = np.corrcoef(np.arange(len(logs)), logs)[0, 1] if len(logs) > 2 else 1.0
    if ratio < SAME_FREQUENCY or abs(order) <= 0.5:
        return "other", frequencies
    return "chirp", _swept(crossings, len(deviation) / rate_hz) or frequencies


def _swept(crossings: Array, duration_s: float) -> tuple[float, float] | None:
    """First and last frequency [Hz] of a linear or exponential sweep with these crossings [s]; None if it is not a sweep."""
    turns = 0.5 * np.arange(len(crossings))
    time = crossings / duration_s

    def fitted(terms: Array, slopes: Array) -> tuple[float, Array]:
        weights = np.linalg.lstsq(terms, turns, rcond=None)[0]
        rates = slopes @ weights / duration_s
        miss = float(np.sqrt(np.mean((terms @ weights - turns) ** 2)))
        return miss if rates.min() > 0.0 else math.inf, rates

    def grown(growth: float) -> tuple[float, Array]:
        slopes = np.column_stack([np.zeros(2), growth * np.exp([0.0, growth])])
        return fitted(np.column_stack([np.ones_like(time), np.exp(growth * time)]), slopes)

    tried = [fitted(np.vander(time, 3), np.array([[0.0, 1.0, 0.0], [2.0, 1.0, 0.0]]))]
    growths = np.concatenate([-GROWTHS[::-1], GROWTHS])
    for _ in range(REFINED):
        found = [grown(float(growth)) for growth in growths]
        best = int(np.argmin([miss for miss, _ in found]))
        tried.append(found[best])
        near = growths[[max(best - 1, 0), min(best + 1, len(growths) - 1)]]
        growths = np.linspace(near[0], near[1], len(GROWTHS))
    miss, rates = min(tried, key=lambda one: one[0])
    return (float(rates[0]), float(rates[1])) if miss < SWEPT else None


def _has_two_levels(samples: Array) -> bool:
    """Whether most samples are near one of the extremes."""
    extremes = np.quantile(samples, [0.02, 0.98])
    near = np.abs(samples[:, None] - extremes).min(axis=1) < 0.1 * float(np.ptp(extremes))
    return bool(near.mean() > AT_LEVELS)


def _come_in_runs(halves: Array) -> bool:
    """Whether half periods form two or more runs, each with a single frequency."""
    logs, same = np.log(halves), math.log(SAME_FREQUENCY)
    parts = np.split(logs, np.flatnonzero(np.abs(np.diff(logs)) > same) + 1)
    runs_ = [len(part) for part in parts if len(part) >= SHORTEST_RUN and abs(part[-1] - part[0]) < same]
    return len(runs_) > 1 and sum(runs_) > IN_RUNS * len(halves)


def _lines(samples: Array, rate_hz: float) -> tuple[float, float] | None:
    """Lowest and highest frequency of a sum of sines [Hz]; None for other signals."""
    deviation = samples - samples.mean()
    power = np.abs(np.fft.rfft(deviation * np.hanning(len(samples)))) ** 2
    power[:1] = 0.0
    if not power.sum() > 0.0:
        return None
    held = np.cumsum(power) / power.sum()
    low, high = (
        int(np.searchsorted(held, share)) for share in (0.5 * (1.0 - IN_BAND), 0.5 * (1.0 + IN_BAND))
    )
    blocks = power[low : low + (high - low) // LINE_BINS * LINE_BINS].reshape(-1, LINE_BINS)
    # Ranges without a line have little power, and so little weight.
    between = np.median(blocks, axis=1).sum() / blocks.mean(axis=1).sum() if len(blocks) > 1 else 1.0
    if _repeats(deviation) or (between < BETWEEN_LINES and _stays(deviation, low // 2, high // 2 + 1)):
        return low * rate_hz / len(samples), high * rate_hz / len(samples)
    return None


def _stays(deviation: Array, low: int, high: int) -> bool:
    """Whether both halves of a signal have the same amplitudes in a band, given in bins of a half's spectrum."""
    half = len(deviation) // 2
    halves = (deviation[:half], deviation[half : 2 * half])
    early, late = (np.abs(np.fft.rfft(part * np.hanning(half)))[low:high] for part in halves)
    with np.errstate(all="ignore"):
        return bool(np.corrcoef(early, late)[0, 1] > SAME_LINES)


def _repeats(deviation: Array) -> bool:
    """Whether a signal is periodic."""
    count = len(deviation)
    spectrum = np.fft.rfft(deviation, 2 * count)
    products = np.fft.irfft(np.abs(spectrum) ** 2)[:count]
    energy = np.concatenate([[0.0], np.cumsum(deviation**2)])
    lags = np.arange(count // 2)
    scale = np.sqrt(energy[count - lags] * (energy[-1] - energy[lags]))
    alike = products[lags] / np.maximum(scale, 1e-300)
    apart = np.flatnonzero(alike < 0.0)
    return bool(apart.size and alike[apart[0] :].max() > REPEATS)


def _crossings(deviation: Array) -> Array:
    """Indices at which a signal crosses zero, shape (K,)."""
    amplitude = float(np.quantile(np.abs(deviation), 0.9))
    side = np.where(np.abs(deviation) > CROSSED * amplitude, np.sign(deviation), 0.0)
    side[np.abs(deviation) > JUMPED * amplitude] = 0.0
    known = np.flatnonzero(side)
    turns = np.flatnonzero(np.diff(side[known]))
    # A crossing is midway between the last sample on one side and the first on the other side.
    return np.asarray(0.5 * (known[turns] + known[turns + 1]), dtype=np.float64)


SHORTEST_S = 20.5
"""Shortest window [s], slightly longer than the fit of a slow ship requires. In a short log, windows may be shorter."""
LEAST_SWING = 2e-3
"""Smallest standard deviation of an excitation, relative to its level, for units of speed, torque or power."""


def proposed(
    log: Log, drives: Sequence[str], mover: str, start_s: float = -math.inf, stop_s: float = math.inf
) -> list[FoundWindow]:
    """Find windows, cut them at gaps, extend short ones into adjacent rests, and turn those without motion into rests."""
    whole = _whole(log, drives, start_s, stop_s)
    least_s = min(SHORTEST_S, max((stop - start for start, stop in whole), default=0.0))
    cut = [
        replace(window, start_s=max(window.start_s, start), stop_s=min(window.stop_s, stop))
        for window in find_windows(log, mover, start_s, stop_s)
        for start, stop in whole
        if min(window.stop_s, stop) - max(window.start_s, start) > 1.0
    ]
    known = [
        one if _swings(log, mover, one) else replace(one, kind="steady", frequency_hz=None) for one in cut
    ]
    grown: list[FoundWindow] = []
    for window in (one for one in known if one.kind != "steady"):
        start, stop = next(one for one in whole if one[0] <= window.start_s and window.stop_s <= one[1])
        if stop - start < least_s:
            continue
        more = max(least_s - (window.stop_s - window.start_s), 0.0)
        first = min(max(window.start_s - 0.5 * more, start), stop - least_s if more else math.inf)
        last = max(window.stop_s, first + least_s)
        before = grown[-1] if grown else None
        if before is not None and first < before.stop_s and before.start_s >= start:
            kind = window.kind if window.kind == before.kind else "other"
            grown[-1] = replace(before, kind=kind, stop_s=max(last, before.stop_s), frequency_hz=None)
        else:
            grown.append(replace(window, start_s=first, stop_s=last))
    return numbered([*grown, *(one for one in known if one.kind == "steady")])


def _whole(log: Log, drives: Sequence[str], start_s: float, stop_s: float) -> list[tuple[float, float]]:
    """Parts of a stretch [s] in which no input of the model has a gap too long to be bridged."""
    channels = [log.channel(name) for name in drives]
    start_s = max(start_s, *(one.start_s for one in channels))
    stop_s = min(stop_s, *(one.stop_s for one in channels))
    last, whole, lost = start_s, [], []
    for channel in channels:
        block = max(math.floor(channel.rate_hz / COARSE_HZ), 1)
        missing = np.isnan(np.concatenate([np.empty(0), *mean_pieces(log, channel.name, block)]))
        spans = channel.start_s + runs(missing) * block / channel.rate_hz
        long = np.diff(spans)[:, 0] > Faults().longest_bridge_s
        lost += np.clip(spans[long], start_s, stop_s).tolist()
    for first, stop in [*sorted(lost), (stop_s, stop_s)]:
        if first > last:
            whole.append((last, first))
        last = max(last, stop)
    return whole


def _swings(log: Log, mover: str, window: FoundWindow) -> bool:
    """Whether a window has enough motion for a fit; always true for volts, whose zero is arbitrary."""
    known = any(told(log.channel(mover).unit) in quantity.factors for quantity in QUANTITIES.values())
    if window.kind == "steady" or not known:
        return window.kind != "steady"
    spread = float(np.nanstd(np.asarray(log.read(mover, window.start_s, window.stop_s), dtype=np.float64)))
    return not spread < LEAST_SWING * abs(window.level)


COARSE_HZ = 200.0
"""Rate to which the set point is averaged [Hz]; it preserves sines of 30 Hz."""
BLOCK_S, BLOCK_SAMPLES = 0.5, 5
"""Least length [s] and number of samples of a block, whose median is a level; a jump of a relay is much shorter."""
LEAST_REST_S, REST_BLOCKS = 10.0, 8
"""Shortest stretch of the set point at rest [s], and least number of its blocks. The crest of a slow sine is level for
a shorter time, or visibly curved.
"""
AT_REST = 6.0
"""Largest deviation of a block's median from the level of a stretch at rest, in standard deviations."""
BEND = 2.5
"""Largest coefficient of a line or parabola through a stretch at rest [standard deviations]; it is larger at the crest
of a slow sine.
"""
SWINGS = 1.5
"""If a block's spread exceeds the noise by this factor, the set point oscillates faster than blocks can resolve."""
STEP_BLOCKS = 3
"""Longest change between two levels that counts as a step [blocks]."""
STAIR, RISERS = 0.75, 0.2
"""A signal is a stair if the fraction `RISERS` of its blocks, those with the largest changes, has more than the
fraction `STAIR` of the total change. Stairs have 0.8 and more; sines, chirps and noise have at most half.
"""
LONG_HOLD = 2.5
"""A series of steps ends if no step follows within this multiple of the usual time between its steps."""
LONGEST_S = 4.0 * 3600.0
"""Longest excitation [s]; longer motion without a stretch at rest is the ship's normal operation."""
_LETTERS: Mapping[Kind, str] = {
    "steady": "R", "sine": "S", "sines": "S", "multisine": "M", "chirp": "C", "squares": "Q", "prbs": "P", "steps": "St",
    "other": "X",
}  # fmt: skip


@dataclass(frozen=True)
class FoundWindow:
    """Stretch of one kind of motion."""

    name: str
    """Letter of the kind and a number: R at rest, S one or more sines, M multisine, C chirp, Q square waves, P pseudo-random
    steps, St steps, X anything else.
    """
    kind: Kind
    start_s: float
    stop_s: float
    level: float
    """Mean of the set point, as recorded."""
    frequency_hz: tuple[float, float] | None = None
    """First and last frequency [Hz], of a multisine lowest and highest; equal for a sine, None at rest and for steps."""


def find_windows(
    log: Log, set_point: str, start_s: float = -math.inf, stop_s: float = math.inf
) -> list[FoundWindow]:
    """Find the stretches at rest and the excitations of a set point or a load, and the kind of each; in order of time.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> time = np.arange(60_000) / 500.0
    >>> volts = -5.0 + 0.15 * np.sin(2 * np.pi * 0.5 * (time - 30.0)) * ((time >= 30.0) & (time < 90.0))
    >>> log = Log.from_arrays({"U": volts + rng.normal(0.0, 0.004, len(time))}, rate_hz=500.0)
    >>> [(found.kind, round(found.start_s), round(found.stop_s)) for found in find_windows(log, "U")]
    [('steady', 0, 30), ('sine', 30, 90), ('steady', 90, 120)]
    """
    # The set point is at rest where the medians of half seconds are constant within the noise of the whole channel.
    # Between two stretches at rest there is a step if the level changes at once, else one excitation.
    trace = _Trace.of(log, set_point).part(start_s, stop_s)
    rests = trace.rests()
    found = [FoundWindow("", "steady", *trace.times(rest), trace.level(rest)) for rest in rests]
    found += _steps(trace, rests)
    # Every stretch between two stretches at rest is an excitation, unless it is as short as a step.
    borders = [(0, 0), *rests, (len(trace.medians), len(trace.medians))]
    for (_, stop), (start, _) in itertools.pairwise(borders):
        if start - stop > STEP_BLOCKS:
            found.append(trace.excitation(stop, start))
    return numbered(found)


def numbered(found: Iterable[FoundWindow]) -> list[FoundWindow]:
    """Windows in order of time, numbered by kind."""
    counts = dict.fromkeys(_LETTERS.values(), 0)
    named = []
    for window in sorted(found, key=lambda window: (window.start_s, -window.stop_s)):
        letter = _LETTERS[window.kind]
        counts[letter] += 1
        named.append(replace(window, name=f"{letter}{counts[letter]}"))
    return named


def longest_rest(windows: Sequence[FoundWindow]) -> FoundWindow | None:
    """Longest stretch at rest near the level about which most excitations oscillate; None if nothing rests."""
    rests = [window for window in windows if window.kind == "steady"]
    if not rests:
        return None
    centres = [window.level for window in windows if window.kind not in ("steady", "steps", "other")]
    if not centres:
        return max(rests, key=lambda rest: rest.stop_s - rest.start_s)
    centre = float(np.median(centres))
    nearest = min(abs(rest.level - centre) for rest in rests)
    spread = 0.1 * float(np.ptp([rest.level for rest in rests]))
    near = [rest for rest in rests if abs(rest.level - centre) <= nearest + spread]
    return max(near, key=lambda rest: rest.stop_s - rest.start_s)


@dataclass(frozen=True)
class _Trace:
    """Medians and spreads of a set point's blocks, at a coarse rate; the samples stay in the log."""

    log: Log
    channel: Channel
    ratio: int
    medians: Array
    spreads: Array
    noise: float
    first: int = 0
    """Index in the channel of the first block."""

    @classmethod
    def of(cls, log: Log, name: str) -> _Trace:
        channel = log.channel(name)
        if is_held(channel):
            channel, blocks = finer(channel, log.raw_blocks, BLOCK_SAMPLES / BLOCK_S, held=True)
            log = Log(log.name, [channel], blocks)
        ratio = max(math.floor(channel.rate_hz / COARSE_HZ), 1)
        block = _block(channel, ratio)
        if channel.samples < max(LEAST_REST_S * channel.rate_hz, REST_BLOCKS * block):
            raise InputError(
                f"{log.name}: channel {name!r} has {channel.samples} samples at {channel.rate_hz:g} Hz, expected "
                f"{LEAST_REST_S:g} s and {REST_BLOCKS * BLOCK_SAMPLES} samples or more to find windows in"
            )
        medians, spreads, largest = _levels(mean_pieces(log, name, ratio), block)
        known = np.isfinite(medians)
        if not known.any():
            raise InputError(f"{log.name}: channel {name!r} holds no finite sample")
        # The spread of a block has a relative standard deviation of 1.17 / sqrt(samples).
        # The 10 % quantile of normally distributed spreads is 1.28 standard deviations below the mean.
        quiet = float(np.quantile(spreads[known], 0.1)) / (1.0 - 1.28 * 1.17 / math.sqrt(block))
        noise = max(quiet, 8.0 * float(np.spacing(largest)))
        return cls(log, channel, ratio, bridge(medians), spreads, noise)

    def part(self, start_s: float, stop_s: float) -> _Trace:
        """Whole blocks of a stretch."""
        edges = (np.array([start_s, stop_s]) - self.channel.start_s) / self.block_s
        first, stop = np.clip(np.round(edges), 0, len(self.medians)).astype(int).tolist()
        return replace(self, medians=self.medians[first:stop], spreads=self.spreads[first:stop], first=first)

    @property
    def rate_hz(self) -> float:
        return self.channel.rate_hz / self.ratio

    @property
    def block(self) -> int:
        return _block(self.channel, self.ratio)

    @property
    def block_s(self) -> float:
        """Length of a block [s]."""
        return self.block / self.rate_hz

    @property
    def least_rest(self) -> int:
        """Least number of blocks in a stretch at rest."""
        return max(math.ceil(LEAST_REST_S / self.block_s - 1e-6), REST_BLOCKS)

    @property
    def level_noise(self) -> float:
        """Standard deviation of a block's median."""
        return 1.2533 * self.noise / math.sqrt(self.block)

    def times(self, blocks: tuple[int, int]) -> tuple[float, float]:
        start_s = self.channel.start_s
        first, stop = (start_s + (self.first + index) * self.block / self.rate_hz for index in blocks)
        return first, stop

    def samples(self, blocks: tuple[int, int]) -> Array:
        """Samples of a stretch at the coarse rate, with gaps bridged; empty if all are missing."""
        start_s, stop_s = self.times(blocks)
        stop_s = min(stop_s, self.channel.stop_s)
        found = np.concatenate([*mean_pieces(self.log, self.channel.name, self.ratio, start_s, stop_s)])
        return bridge(found) if np.isfinite(found).any() else np.empty(0)

    def level(self, blocks: tuple[int, int]) -> float:
        return float(np.median(self.medians[slice(*blocks)]))

    def rests(self) -> list[tuple[int, int]]:
        """Stretches of blocks at one level."""
        still = self.spreads < SWINGS * self.noise + self.level_noise
        # A jump of the relay affects one or two blocks.
        still[1:-1] |= still[:-2] & still[2:]
        found = []
        for first, stop in runs(still).tolist():
            while first < stop:
                end = self._rest_from(first, stop)
                if end - first >= self.least_rest and not self._bends(first, end):
                    found.append((first, end))
                    first = end
                else:
                    first += 1
        return found

    def _rest_from(self, first: int, stop: int) -> int:
        """End of the run of blocks at the level of the first blocks."""
        least = self.least_rest
        if stop - first < least:
            return first
        values = self.medians[first:stop]
        level = float(np.median(values[:least]))
        limit = AT_REST * self.level_noise
        beyond = np.abs(values - level) > limit
        away = np.flatnonzero(beyond & np.append(beyond[1:], True))
        if np.count_nonzero(beyond[:least]) > 1:
            return first
        return stop if not away.size else first + int(away[0])

    def _bends(self, first: int, stop: int) -> bool:
        """Whether the levels of a stretch follow a line or a parabola, instead of being constant."""
        time = np.linspace(-1.0, 1.0, stop - first)
        _, slope, bend = np.polynomial.legendre.legfit(time, self.medians[first:stop], 2)
        return bool(max(abs(slope), 1.5 * abs(bend)) > BEND * self.level_noise)

    def excitation(self, first: int, stop: int) -> FoundWindow:
        """Make the window between two stretches at rest."""
        start_s, stop_s = self.times((first, stop))
        samples = self.samples((first, stop)) if stop_s - start_s <= LONGEST_S else np.empty(0)
        if not samples.size:
            return FoundWindow("", "other", start_s, stop_s, self.level((first, stop)))
        # A stair is constant most of the time, so it does not swing.
        swings = np.mean(self.spreads[first:stop] > SWINGS * self.noise + self.level_noise) > 0.5
        level = 0.5 * float(np.quantile(samples, 0.02) + np.quantile(samples, 0.98))
        kind, frequency_hz = kind_of(samples - level, self.rate_hz, swings=bool(swings))
        # A stair of levels too short for stretches at rest counts as steps.
        if not swings and kind in ("sine", "sines", "chirp", "other") and self._is_stair(first, stop):
            kind, frequency_hz = "steps", None
        return FoundWindow("", kind, start_s, stop_s, level, frequency_hz)

    def _is_stair(self, first: int, stop: int) -> bool:
        """Whether the set point is a staircase: constant levels with sudden changes between them."""
        changes = np.sort(np.abs(np.diff(self.medians[max(first - 1, 0) : stop + 1])))
        risers = max(round(RISERS * len(changes)), 1)
        return bool(changes[-risers:].sum() > STAIR * changes.sum())


def is_held(channel: Channel) -> bool:
    """Whether a sample lasts as long as a rest, as in a log of set points that are recorded on change."""
    return channel.rate_hz * LEAST_REST_S <= 1.0


def _block(channel: Channel, ratio: int) -> int:
    """Number of samples in a block, at the coarse rate."""
    return max(round(BLOCK_S * channel.rate_hz / ratio), BLOCK_SAMPLES)


def _levels(pieces: Iterable[Array], block: int) -> tuple[Array, Array, float]:
    """Median and robust spread of each block, and the largest magnitude; NaN and zero for an empty block."""
    medians, spreads, largest = [np.empty(0)], [np.empty(0)], 0.0
    for rows in whole_blocks(pieces, block):
        known = np.isfinite(rows)
        middle = np.full(len(rows), np.nan)
        spread = np.zeros(len(rows))
        some, full = known.any(axis=1), known.all(axis=1)
        for chosen, median in ((full, np.median), (some & ~full, np.nanmedian)):
            middle[chosen] = median(rows[chosen], axis=1)
            # The median of absolute deviations is insensitive to jumps of the relay, which are rare.
            spread[chosen] = ROBUST_SIGMA * median(np.abs(rows[chosen] - middle[chosen, None]), axis=1)
        medians.append(middle)
        spreads.append(spread)
        largest = max(largest, float(np.abs(rows[known]).max(initial=0.0)))
    return np.concatenate(medians), np.concatenate(spreads), largest


def _steps(trace: _Trace, rests: list[tuple[int, int]]) -> list[FoundWindow]:
    """Windows of steps: successive stretches at rest at different levels, without an excitation between them."""
    series: list[list[int]] = [[]]
    ends: list[tuple[int, int]] = []
    for before, after in itertools.pairwise(rests):
        apart = after[0] - before[1]
        if (
            apart <= STEP_BLOCKS
            and abs(trace.level(after) - trace.level(before)) > AT_REST * trace.level_noise
        ):
            series[-1].append(len(ends))
            ends.append((before[1], after[1]))
        else:
            series.append([])
    found = []
    for steps in series:
        edges = np.array([ends[step][0] for step in steps])
        hold = np.median(np.diff(edges)) if len(edges) > 1 else np.inf
        # A pause much longer than the usual time between steps separates two series.
        for part in np.split(edges, np.flatnonzero(np.diff(edges) > LONG_HOLD * hold) + 1):
            if part.size:
                # A window of steps ends after the last step by the usual time between two steps.
                stop = dict(ends)[int(part[-1])]
                stretch = (int(part[0]), int(min(part[-1] + hold, stop)))
                found.append(FoundWindow("", "steps", *trace.times(stretch), trace.level(stretch)))
    return found
