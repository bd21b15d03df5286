"""What `inspect` holds at a time does not depend on the length of a log, nor on how often it repeats itself."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest

from shipfp_rs import inspection
from shipfp_rs.inspection import channels
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


@pytest.mark.slow
def test_memory_does_not_grow_with_a_log_that_repeats_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inspection, "STRETCH_BYTES", 1 << 22)
    # Read side by side, two channels have more or fewer stretches in memory at once, as chance has it.
    monkeypatch.setattr(channels, "side_by_side", lambda jobs, _: [job() for job in jobs])
    short, long = peak_mib(80), peak_mib(140)
    # A few numbers for each block of samples grow.
    assert long < short + 2.0, (short, long)
