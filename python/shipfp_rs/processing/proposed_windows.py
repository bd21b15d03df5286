"""Windows acceptable to a trial: within the log, without gaps that a run rejects, with motion, and long enough."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shipfp_rs.logs.log import Log
from shipfp_rs.processing.coarse import mean_pieces
from shipfp_rs.processing.trial_tables import Faults
from shipfp_rs.processing.windows import COARSE_HZ, FoundWindow, numbered
from shipfp_rs.support.spans import runs
from shipfp_rs.support.units import QUANTITIES, told

SHORTEST_S = 20.5
"""Shortest window [s], slightly longer than a fit requires for a slow ship; a shorter log is of a fast drive."""
LEAST_SWING = 2e-3
"""Smallest standard deviation of a window, relative to its level, for units of speed, torque or power; else it is a rest."""


def proposed(log: Log, drives: Sequence[str], mover: str, found: Sequence[FoundWindow]) -> list[FoundWindow]:
    """Adapt detected windows: divide at gaps, extend short ones into adjacent rests, make those without motion rests."""
    whole = _whole(log, drives)
    least_s = min(SHORTEST_S, max((stop - start for start, stop in whole), default=0.0))
    cut = [
        replace(window, start_s=max(window.start_s, start), stop_s=min(window.stop_s, stop))
        for window in found
        for start, stop in whole
        if min(window.stop_s, stop) - max(window.start_s, start) > 1.0
    ]
    known = [window if _swings(log, mover, window) else _rest(window) for window in cut]
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


def _rest(window: FoundWindow) -> FoundWindow:
    return replace(window, kind="steady", frequency_hz=None)


def _whole(log: Log, drives: Sequence[str]) -> list[tuple[float, float]]:
    """Stretches of a log in which no input of the model is missing for longer than can be bridged [s]."""
    channels = [log.channel(name) for name in drives]
    start_s, stop_s = max(one.start_s for one in channels), min(one.stop_s for one in channels)
    lost = []
    for channel in channels:
        block = max(math.floor(channel.rate_hz / COARSE_HZ), 1)
        missing = np.isnan(np.concatenate([np.empty(0), *mean_pieces(log, channel.name, block)]))
        spans = channel.start_s + runs(missing) * block / channel.rate_hz
        lost += [(first, last) for first, last in spans.tolist() if last - first > Faults().longest_bridge_s]
    edges = [(start_s, start_s), *sorted(lost), (stop_s, stop_s)]
    return [(before[1], after[0]) for before, after in itertools.pairwise(edges) if after[0] > before[1]]


def _swings(log: Log, mover: str, window: FoundWindow) -> bool:
    """Whether a window has enough motion for a fit; always true for volts, whose zero may be anywhere."""
    known = any(told(log.channel(mover).unit) in quantity.factors for quantity in QUANTITIES.values())
    if window.kind == "steady" or not known:
        return window.kind != "steady"
    spread = float(np.nanstd(np.asarray(log.read(mover, window.start_s, window.stop_s), dtype=np.float64)))
    return not spread < LEAST_SWING * abs(window.level)
