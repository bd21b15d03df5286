"""What `inspect` holds at a time does not depend on the length of a log, nor on how often it repeats itself."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest

from shipfp_rs import inspection
from shipfp_rs.logs.log import Channel, Log

PERIOD = 60_000


def repeated(turns: int) -> Log:
    """A log of two noisy channels that hold one stretch so many times over, made while it is read."""
    once = {
        name: np.random.default_rng(k).standard_normal(PERIOD).astype(np.float32)
        for k, name in enumerate("ab")
    }

    def blocks(channel: str, first: int, size: int) -> Iterator[np.ndarray]:
        for start in range(first, turns * PERIOD, size):
            rows = np.arange(start, min(start + size, turns * PERIOD))
            yield once[channel][rows % PERIOD]

    return Log("repeated", [Channel(name, "V", 2000.0, turns * PERIOD) for name in once], blocks)


def peak_mib(turns: int) -> float:
    tracemalloc.start()
    try:
        found = inspection.inspect_log(repeated(turns))
        assert [report.channel.samples for report in found.channels] == 2 * [turns * PERIOD]
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()


def test_memory_does_not_grow_with_a_log_that_repeats_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inspection, "STRETCH_BYTES", 1 << 22)
    # Two channels are read side by side; how many of their stretches of 4 MiB meet at the peak is a matter of chance.
    short = max(peak_mib(80) for _ in range(3))
    long = min(peak_mib(140) for _ in range(3))
    # The longer one has 27 MiB more samples.
    assert long < short + 8.0, (short, long)
