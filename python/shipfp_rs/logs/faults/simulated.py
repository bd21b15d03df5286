"""Simulated faults of sensors and loggers, each with the samples that it changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from shipfp_rs.support.arrays import Array, Spans, runs

LOSSES: tuple[Literal["gap", "dropout", "stuck"], ...] = ("gap", "dropout", "stuck")


def lose(samples: Array, kind: str, spans: Sequence[tuple[int, int]]) -> Array:
    """Replace samples in each [start, stop) by NaN ("gap"), zero ("dropout") or the value before ("stuck")."""
    lost = samples.copy()
    for start, stop in spans:
        lost[start:stop] = {"gap": np.nan, "dropout": 0.0, "stuck": samples[max(start - 1, 0)]}[kind]
    return lost


def clip(samples: Array, share: float) -> tuple[Array, Spans]:
    """Clip the highest samples, the fraction `share` of all, and return their spans."""
    limit = float(np.nanquantile(samples, 1.0 - share))
    return np.minimum(samples, limit), runs(samples > limit)


def hum(samples: Array, rate_hz: float, mains_hz: float, amplitude: float, start: int, stop: int) -> Array:
    """Add mains hum on [start, stop)."""
    humming = samples.copy()
    time = np.arange(start, stop) / rate_hz
    humming[start:stop] += amplitude * np.sin(2.0 * np.pi * mains_hz * time)
    return humming


def write_twice(channels: Mapping[str, Array], start: int, count: int, *, over: bool) -> dict[str, Array]:
    """Repeat `count` rows from `start` on in all channels; the copy replaces the following rows (`over`) or delays them."""
    stop = start + count
    rest = stop + count if over else stop
    return {
        name: np.concatenate([samples[:stop], samples[start:stop], samples[rest:]])
        for name, samples in channels.items()
    }
