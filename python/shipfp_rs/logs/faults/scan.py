"""Detection of all faults visible in a channel's recorded samples, in one pass."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.logs.faults.clock import same_rows
from shipfp_rs.logs.faults.extremes import BlockExtremes, RepeatScan, repeated_rows
from shipfp_rs.logs.faults.levels import HumScan, LevelLimits, find_level_faults, is_rough
from shipfp_rs.logs.log import Log, Pieces, Rows
from shipfp_rs.support.arrays import Mask, Spans

if TYPE_CHECKING:
    from shipfp_rs.logs.channel import Channel


PIECE, KEPT = 1 << 18, 2
"""Number of samples read at once, and number of such pieces in memory: two, since a row and its copy may be in
different pieces.
"""


def scan(
    channel_rows: Rows,
    first: int,
    stop: int,
    limits: LevelLimits | None = None,
    *,
    mains_hz: float | None = None,
    least_hum: float = 1e-3,
    repeats: bool = False,
) -> dict[str, Spans]:
    """Spans of the faults in samples [first, stop) of an analogue channel, by kind; hum is detected only with `mains_hz`."""
    log, about = channel_rows.log, channel_rows.channel
    limits = limits or LevelLimits()
    extremes = BlockExtremes(limits.block(about.rate_hz))
    hum = None
    if mains_hz is not None and HumScan.tells(about.rate_hz, mains_hz, stop - first):
        hum = HumScan(about.rate_hz, mains_hz)
    prints = RepeatScan() if repeats else None
    for chunk in channel_rows.pieces(first, stop):
        extremes.feed(chunk)
        if hum is not None:
            hum.feed(chunk)
        if prints is not None:
            prints.feed(chunk)
    found = find_level_faults(
        extremes, lambda start, end: channel_rows.read(first + start, first + end), about.rate_hz, limits
    )
    if hum is not None:
        found["D2"] = hum.spans(least_hum * extremes.typical)
    if prints is not None:
        found["repeated"] = _repeated(log, log.channel(about.name), first, stop, prints)
    return {kind: spans + first for kind, spans in found.items() if len(spans)}


def _repeated(log: Log, about: Channel, first: int, stop: int, prints: RepeatScan) -> Spans:
    """Spans of rows written twice in every channel of the same rate, length and start."""
    readers = [
        Pieces(lambda: log, other, PIECE, KEPT).read
        for other in log.channels.values()
        if (other.rate_hz, other.samples, other.start_s) == (about.rate_hz, about.samples, about.start_s)
    ]

    same = same_rows(readers)

    def equal(start: int, end: int, lag: int) -> Mask:
        return same(first + start + lag, first + start, end - start)

    found = repeated_rows(prints.candidates(), equal, stop - first)
    # A channel without noise, such as a quantised set point on a bus, may repeat by chance; a noisy channel does not.
    proven = [any(is_rough(read(first + start, first + end)) for read in readers) for start, end in found]
    return found[np.array(proven, dtype=np.bool_)]
