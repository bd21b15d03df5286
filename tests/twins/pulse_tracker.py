"""Reference of the pulse tracker: every rule said once, plainly, over all that was seen so far."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d

from shipfp_rs._core import pulse_levels

Array = npt.NDArray[np.float64]

BLOCK, STRETCH = 32, 128
NEAR, GROUP, LEAST = 8, 18, 4


@dataclass
class Level:
    centre: int
    span: tuple[int, int]
    bottom: float
    top: float
    noise: float

    @property
    def height(self) -> float:
        return self.top - self.bottom

    @property
    def middle(self) -> float:
        return 0.5 * (self.bottom + self.top)


def noises(samples: Array, stretches: int) -> list[float]:
    """Of each stretch the least of three medians of differences."""
    size = min(STRETCH, len(samples))
    count = 1 if size < STRETCH else min(stretches, len(samples) // size)
    found = []
    for k in range(count):
        first = (len(samples) - size) * k // max(count - 1, 1)
        stretch = samples[first : first + size]
        stretch = stretch[np.abs(stretch) <= np.finfo(float).max / 4]
        if len(stretch) >= 16:
            medians = []
            for order in (2, 4, 6):
                stretch = stretch[:-2] - 2 * stretch[1:-1] + stretch[2:]
                magnitude = np.sort(np.abs(stretch))
                gain = 0.6744897501960817 * math.sqrt(math.comb(2 * order, order))
                medians.append(magnitude[len(magnitude) // 2] / gain)
            found.append(min(medians) / 0.91)
    return found


def quarter(values: list[float]) -> float:
    """The value that a quarter are below."""
    return sorted(values)[len(values) // 4] if values else 0.0


def extremes(samples: Array) -> list[tuple[float, float]]:
    """Least and greatest finite sample of each block; None for both where there is none."""
    blocks = (samples[k : k + BLOCK] for k in range(0, len(samples), BLOCK))
    finite = (block[np.isfinite(block)] for block in blocks)
    return [(block.min(), block.max()) if len(block) else (np.nan, np.nan) for block in finite]


def reversal(blocks: list[tuple[float, float]], noise: float) -> float:
    """By how much the signal must turn back."""
    ranges = sorted(high - low for low, high in blocks if low <= high)
    if not ranges:
        return 0.0
    usual, rare = ranges[len(ranges) // 2], ranges[len(ranges) - 1 - len(ranges) // 500]
    least = 10 * noise
    if usual > 0.5 * rare:
        least = min(least, 0.35 * usual)
    return max(least, 0.01 * rare)


def swings(blocks: list[tuple[int, float, float, float]]) -> list[tuple[int, float]]:
    """Turning points of blocks (first sample, least, greatest, reversal)."""
    turns: list[tuple[int, float]] = []
    direction = 0
    low = high = before = (0, math.nan)
    for at, least, most, back in blocks:
        if math.isnan(least):
            continue
        before_low, before_high = before
        before = (least, most)
        lower = direction <= 0 and not low[1] <= least
        higher = direction >= 0 and not high[1] >= most
        if lower:
            low = (at, least)
        if higher:
            high = (at, most)
        if direction == 0:
            if high[1] - low[1] > back:
                direction = 1 if low[0] <= high[0] else -1
                turns.append(low if direction == 1 else high)
        elif direction == 1:
            if least < high[1] - back and not (higher and least > before_low):
                turns.append(high)
                direction, low = -1, (at, least)
        elif most > low[1] + back and not (lower and most < before_high):
            turns.append(low)
            direction, high = 1, (at, most)
    return turns


def large(turns: list[tuple[int, float]], *, surely: bool = False) -> list[tuple[int, float]]:
    """Turning points of swings that are no smaller than 0.35 of the largest of sixteen others about them.

    Surely: only those that no later turn can change.
    """
    compared = len(turns) - NEAR if surely else len(turns)
    if compared < 2:
        return []
    sizes = np.abs(np.diff([value for _, value in turns]))
    least = 0.35 * maximum_filter1d(sizes, 2 * NEAR + 1)
    taken, held = [turns[0]], turns[1]
    up = turns[1][1] > turns[0][1]
    for turn, size in zip(turns[2:compared], least[1:], strict=False):
        further = turn[1] - held[1] if up else held[1] - turn[1]
        if further > 0:
            held = turn
        elif -further > size:
            taken.append(held)
            held, up = turn, not up
    return taken if surely else [*taken, held]


def levels(turns: list[tuple[int, float]], *, closed: bool = False) -> list[Level]:
    """Medians of both kinds of turning points, nine by nine; a silence ends a group as well."""
    groups: list[list[tuple[int, float]]] = [[]]
    for turn in turns:
        group = groups[-1]
        if len(group) == GROUP:
            groups.append([])
        elif len(group) >= LEAST:
            usual = (group[-1][0] - group[0][0]) / (len(group) - 1)
            if turn[0] - group[-1][0] > 8 * max(usual, BLOCK):
                groups.append([])
        groups[-1].append(turn)
    if closed and len(groups[-1]) < GROUP:
        groups.pop()
    found = []
    for group in groups:
        if len(group) >= LEAST:
            one, other = (float(np.median([value for _, value in group[k::2]])) for k in (0, 1))
            first, last = group[0][0], group[-1][0]
            found.append(
                Level((first + last) // 2 + 16, (first, last + BLOCK), min(one, other), max(one, other), 0.0)
            )
    return found


def track(
    windows: list[Array], threshold: float | None = None, hysteresis: float | None = None
) -> tuple[Array, Array]:
    """Crossings and heights of a train in windows."""
    starts = np.cumsum([0, *(len(window) for window in windows)]).tolist()
    sigmas: list[float] = []
    pool: list[float] = []
    for window in windows:
        of_window = noises(window, max(4, 64 - len(pool)))
        pool = [*pool, *sorted(of_window)][-64:]
        own, pooled = quarter(of_window), quarter(pool)
        sigmas.append(pooled if own < 1.5 * pooled and pooled < 1.5 * own else own)
    blocks: list[tuple[int, float, float, float]] = []
    turns_after: list[list[tuple[int, float]]] = []
    closed_in: list[float] = []
    for start, window, sigma in zip(starts, windows, sigmas, strict=False):
        of_window = extremes(window)
        back = reversal(of_window, sigma)
        blocks += [(start + BLOCK * k, *pair, back) for k, pair in enumerate(of_window)]
        turns_after.append(swings(blocks))
        closed = levels(large(turns_after[-1], surely=True), closed=True)
        closed_in += [sigma] * (len(closed) - len(closed_in))
    times: list[float] = []
    heights: list[float] = []
    counted = 0
    state = {"armed": False, "previous": math.nan, "crossing": math.nan, "middle": 0.0}
    for w, window in enumerate(windows):
        turns = turns_after[min(w + 1, len(windows) - 1)]
        closed = len(levels(large(turns, surely=True), closed=True))
        known = levels(large(turns))
        for k, level in enumerate(known):
            level.noise = closed_in[k] if k < closed else sigmas[w]
        known = [level for level in known if _thresholds(level, level, 0, threshold, hysteresis)]
        if not known:
            bottom, top = pulse_levels(window)
            if None not in (threshold, hysteresis) or top - bottom > 14 * sigmas[w]:
                level = Level(starts[w], (starts[w], starts[w + 1]), bottom, top, sigmas[w])
                known = [level] if _thresholds(level, level, 0, threshold, hysteresis) else []
        pieces = _pieces(known, starts[w], starts[w + 1], threshold, hysteresis)
        stops = [*(start for start, _ in pieces[1:]), starts[w + 1]]
        for (first, piece), stop in zip(pieces, stops, strict=False):
            _cross(window, starts[w], first, stop, piece, state, times, heights)
        if threshold is None or hysteresis is None:
            for k in range(counted, len(times)):
                told = any(_tells_of(level, times[k]) for level in known)
                heights[k] = _height_at(times[k], known) if told else 0.0
        counted = len(times)
        if not pieces:
            state |= {"armed": False, "previous": float(window[-1]), "middle": 0.0}
    return np.array(times), np.array(heights)


def _tells_of(level: Level, time: float) -> bool:
    beside = 0.375 * (level.span[1] - level.span[0]) + BLOCK
    return level.span[0] - beside <= time <= level.span[1] + beside


def _height_at(time: float, known: list[Level]) -> float:
    at = max(sum(level.centre <= time for level in known) - 1, 0)
    here = known[at]
    between = here.centre <= time and at + 1 < len(known)
    other = at + 1 if between or at == 0 else at - 1
    if other == len(known):
        return here.height
    there = known[other]
    if max(here.height / there.height, there.height / here.height) > 2.0:
        late = between and time >= (here.span[1] + there.span[0]) // 2
        return there.height if late else here.height
    line = here.height + (time - here.centre) * (there.height - here.height) / (there.centre - here.centre)
    return line if between else min(max(line, 0.0), here.height)


def _pieces(known, first, end, threshold, hysteresis):
    behind = [k for k, level in enumerate(known) if level.centre < first]
    known = known[behind[-1] if behind else 0 :]
    if not known:
        return []
    held = known[0]
    found: dict[int, tuple] = {}

    def put(start, one, other):
        start = max(start, first)
        if start < end:
            for later in [at for at in found if at >= start]:
                del found[later]
            found[start] = _thresholds(one, other, start, threshold, hysteresis)

    put(first, held, held)
    for one, other in pairwise(known):
        if other.centre <= first:
            held = other
            put(first, other, other)
            continue
        if one.centre >= end:
            break
        if (
            abs(other.middle - held.middle) <= 0.5 * held.noise
            and abs(other.height - held.height) <= 0.05 * held.height
        ):
            continue
        if max(other.height / one.height, one.height / other.height) <= 2.0:
            put(one.centre, one, other)
            put(other.centre, other, other)
        else:
            put((one.span[1] + other.span[0]) // 2, other, other)
        held = other
    return sorted(found.items())


def _thresholds(one, other, start, threshold, hysteresis):
    """Low, high, middle at a sample, slope, that sample, height."""
    bottom, top = 0.5 * (one.bottom + other.bottom), 0.5 * (one.top + other.top)
    height, sigma = top - bottom, max(one.noise, other.noise)
    centre = 0.5 * (bottom + top) if threshold is None else threshold
    width = 0.4 * height if hysteresis is None else hysteresis
    if hysteresis is None and height >= 14 * sigma:
        width = max(width, min(8.4 * sigma, 0.6 * height))
    if threshold is not None and hysteresis is not None:
        low, high = centre - 0.5 * width, centre + 0.5 * width
    elif not bottom < centre < top:
        return None
    else:
        low, high = centre - 0.5 * min(width, centre - bottom), centre + 0.5 * min(width, top - centre)
    length = other.centre - one.centre
    if threshold is None and length > 0:
        ends = np.clip([one.middle, other.middle], 0.5 * (low + centre), 0.5 * (centre + high))
        return low, high, ends[0], (ends[1] - ends[0]) / length, one.centre, height
    return low, high, centre, 0.0, start, height


def _cross(window, offset, first, stop, piece, state, times, heights):
    low, high, middle, slope, origin, height = piece

    def middle_at(k):
        return middle + slope * (k - origin)

    if state["previous"] < state["middle"] and state["previous"] >= middle_at(first - 1):
        state["crossing"] = float(first - 1)
    for k in range(first, stop):
        x = float(window[k - offset])
        if math.isnan(x):
            state["armed"] = False
        below, here = middle_at(k - 1), middle_at(k)
        if state["previous"] < below and x >= here:
            rise = (x - state["previous"]) - (here - below)
            state["crossing"] = k - (x - here) / rise if math.isfinite(rise) else float(k)
        if x <= low:
            state["armed"] = True
        elif state["armed"] and x >= high:
            times.append(state["crossing"])
            heights.append(height)
            state["armed"] = False
        state["previous"] = x
    state["middle"] = middle_at(stop - 1)
