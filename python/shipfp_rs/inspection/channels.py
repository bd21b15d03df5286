"""Contents of a log's channels: gaps, levels, noise, pulses; each is read once, in parallel."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from shipfp_rs.inspection.pulse_channels import pulse_rate
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.channel_reader import Rows
from shipfp_rs.logs.log import Log
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.spans import Spans, joined, runs
from shipfp_rs.support.spikes import ROBUST_SIGMA
from shipfp_rs.support.threads import side_by_side


@dataclass(frozen=True)
class ChannelReport:
    """Contents of one channel; gaps are spans (K, 2), `pulses_hz` is None except for a pulse train, whose noise is NaN."""

    channel: Channel
    gaps: Spans
    low: float
    high: float
    noise: float
    pulses_hz: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form; gaps in seconds on the log's clock."""
        channel = self.channel
        times = channel.start_s + self.gaps / channel.rate_hz
        return {
            "name": channel.name,
            "unit": channel.unit,
            "rate_hz": channel.rate_hz,
            "samples": channel.samples,
            "start": channel.start_s,
            "gaps": times.tolist(),
            "low": _or_none(self.low),
            "high": _or_none(self.high),
            "noise": _or_none(self.noise),
            "pulses_hz": self.pulses_hz,
        }


def describe(log: Log) -> list[ChannelReport]:
    """Read every channel once and report its contents."""
    stopped = threading.Event()
    return side_by_side([partial(_described, log, name, stopped) for name in log.channels], stopped)


def _described(log: Log, name: str, stopped: threading.Event) -> ChannelReport:
    rows = Rows(log, name, stopped=stopped)
    channel = rows.channel
    gaps, noises = [], []
    low, high, at = np.inf, -np.inf, 0
    for chunk in rows.pieces(0, channel.samples):
        known = np.isfinite(chunk)
        gaps.append(runs(~known) + at)
        at += len(chunk)
        present = chunk if known.all() else chunk[known]
        if len(present):
            low, high = min(low, float(present.min())), max(high, float(present.max()))
            noises.append(_noise(present[: 1 << 17].astype(np.float64)))
    pulses = pulse_rate(rows)
    return ChannelReport(
        channel,
        joined(gaps),
        low if np.isfinite(low) else math.nan,
        high if np.isfinite(high) else math.nan,
        float(np.median(noises)) if noises and pulses is None else math.nan,
        pulses,
    )


def _noise(samples: Array) -> float:
    if len(samples) < 3:
        return math.nan
    return float(ROBUST_SIGMA * np.median(np.abs(np.diff(samples, 2))) / math.sqrt(6.0))


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None
