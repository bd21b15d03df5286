"""Rows of a channel come the same however they are read, and each is decoded once; jobs fail in a fixed order."""

import threading
import time
from collections import Counter

import numpy as np
import pytest

from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.log import KEPT, Log, Rows, Stopped
from shipfp_rs.support.threads import side_by_side

COUNT = 3 * KEPT


def counted() -> tuple[Log, Counter]:
    """Return a log whose samples are their own rows, and how often each block of a thousand was read."""
    seen: Counter = Counter()

    def blocks(_, first, size):
        for start in range(first, COUNT, size):
            block = np.arange(start, min(start + size, COUNT))
            seen.update(np.unique(block // 1000).tolist())
            yield block

    return Log("counted", [Channel("rows", "", 2000.0, COUNT, 1.0)], blocks), seen


@pytest.mark.parametrize("size", [1000, 4096, 1 << 20])
def test_stretches_that_overlap_are_read_once(size):
    log, seen = counted()
    rows = Rows(log, "rows", size=size)
    for first in range(0, COUNT - 20_000, 15_000):
        np.testing.assert_array_equal(rows.read(first, first + 20_000), np.arange(first, first + 20_000))
    if size == 1000:
        assert set(seen.values()) == {1}


def test_going_far_back_reads_again():
    log, _ = counted()
    rows = Rows(log, "rows", size=1000)
    rows.read(COUNT - 10, COUNT)
    np.testing.assert_array_equal(rows.read(0, 5), np.arange(5))


def test_a_late_channel_is_taken_to_be_older():
    log, _ = counted()
    late = Rows(log, "rows", delay_s=0.1)
    assert late.channel.start_s == pytest.approx(0.9)
    assert late.within(2.0, 3.0) == (2200, 4200)
    assert Rows(log, "rows").within(2.0, 3.0) == (2000, 4000)


def test_a_stopped_reader_ends():
    stopped = threading.Event()
    rows = Rows(counted()[0], "rows", size=1000, stopped=stopped)
    rows.read(0, 1000)
    stopped.set()
    with pytest.raises(Stopped):
        rows.read(1000, 2000)


def test_the_first_job_in_order_tells_what_went_wrong():
    stopped = threading.Event()

    def slow() -> None:
        time.sleep(0.05)
        raise ValueError("first in order")

    def quick() -> None:
        raise ValueError("first in time")

    with pytest.raises(ValueError, match="first in order"):
        side_by_side([slow, quick], stopped)
    assert stopped.is_set()
    assert side_by_side([lambda: 1, lambda: 2], threading.Event()) == [1, 2]
