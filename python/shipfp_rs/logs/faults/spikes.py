"""Spikes of a channel, from a log's beginning to its end: short excursions that stand out from the noise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from shipfp_rs.logs.channel_reader import Rows
from shipfp_rs.support.arrays import Array, Mask
from shipfp_rs.support.calibration import Calibration
from shipfp_rs.support.spans import Spans, joined, marks, runs
from shipfp_rs.support.spikes import bridge, find_spikes
from shipfp_rs.support.threads import require_going

PIECE = 1 << 18
"""Samples that are looked at together."""
SHORTEST = 2
"""Samples of a slow channel that may be a spike, whose longest is shorter."""
BY_A_CLOCK, LONGEST_HELD_S = 0.9, 0.2
"""Part of the changes that come whole periods apart in a held channel, and its longest period [s]."""
BESIDE_S, LEAST_BESIDE = 2.0, 64
"""Seconds and samples beside them that show the noise about the first and the last."""


class SpikeLimits(Protocol):
    """What counts as a spike: longest [s], height in robust standard deviations, and as a share of the median magnitude."""

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
    """Return the spikes of calibrated samples of which some are missing; none in what bridges a long gap.

    A spike may have `shortest` samples however slow the channel is, and is held as long as any value is: a power analyser's
    or a bus's. `steps` says of a channel that it goes in steps by itself, as a set point does.
    """
    filled = bridge(samples, missing)
    held = 1 if steps else held_samples(filled, rate_hz)
    longest_s = max(limits.longest_s, shortest / rate_hz, held / rate_hz)
    # A long bridge has no noise in it and would make its neighbours' noise look like spikes.
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
    """Return the spikes of a long signal, NaN where it is missing; Ctrl-C ends it after each piece."""
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
    """Return how many samples a value stands for before the next one comes; 1 where they do not come by a clock."""
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
    """Return the spikes of a whole channel on its own index.

    Parameters
    ----------
    rows
        The channel.
    lost
        Other faults on the same index, whose samples are no spikes.
    limits
        What counts as a spike.
    noise
        Standard deviation of the channel's noise as recorded: about a level near zero, of which a spike has no share, it is
        as many times higher than this as it is higher than what is around it.
    calibration
        Of the channel, where it is known: the share of the magnitude is one of calibrated values.
    steps
        Whether the channel may go in steps by itself.
    """
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
            own &= (starts > 0) & (stops < count)  # beside the log's ends nothing tells whether it comes back
            stands_out = [not _height(raw, *span) <= limits.threshold * noise for span in spans.tolist()]
            yield low + spans[own & np.array(stands_out, dtype=np.bool_)]

    return joined(found())


def _height(samples: Array, start: int, stop: int) -> float:
    """Return how far a spike goes from what is beside it; NaN where that is missing."""
    level = 0.5 * (samples[max(start - 1, 0)] + samples[min(stop, len(samples) - 1)])
    return float(np.abs(samples[start:stop] - level).max())
