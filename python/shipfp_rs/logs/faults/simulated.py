"""Faults of sensors and loggers put into sound samples, each with the samples that it changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from shipfp_rs.support.arrays import Array
from shipfp_rs.support.spans import Spans, runs

LOSSES: tuple[Literal["gap", "dropout", "stuck"], ...] = ("gap", "dropout", "stuck")


def lose(samples: Array, kind: str, spans: Sequence[tuple[int, int]]) -> Array:
    """Return samples of which each [start, stop) is NaN ("gap"), zero ("dropout") or stays as it was ("stuck")."""
    lost = samples.copy()
    for start, stop in spans:
        lost[start:stop] = {"gap": np.nan, "dropout": 0.0, "stuck": samples[max(start - 1, 0)]}[kind]
    return lost


def clip(samples: Array, share: float) -> tuple[Array, Spans]:
    """Return samples of which the given share lies beyond the sensor's range, and where they were cut."""
    limit = float(np.nanquantile(samples, 1.0 - share))
    return np.minimum(samples, limit), runs(samples > limit)


def hum(samples: Array, rate_hz: float, mains_hz: float, amplitude: float, start: int, stop: int) -> Array:
    """Return samples with mains hum on [start, stop)."""
    humming = samples.copy()
    time = np.arange(start, stop) / rate_hz
    humming[start:stop] += amplitude * np.sin(2.0 * np.pi * mains_hz * time)
    return humming


def write_twice(channels: Mapping[str, Array], start: int, count: int, *, over: bool) -> dict[str, Array]:
    """Return channels in which `count` rows from `start` on are written a second time.

    The second copy takes the place of what followed (`over`), or pushes it back.
    """
    stop = start + count
    rest = stop + count if over else stop
    return {
        name: np.concatenate([samples[:stop], samples[start:stop], samples[rest:]])
        for name, samples in channels.items()
    }
