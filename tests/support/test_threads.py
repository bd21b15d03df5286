"""Jobs on threads: order, jobs of jobs, and an end for those that nobody waits for."""

import contextlib
import threading
import time

import pytest

from shipfp_rs.support import threads
from shipfp_rs.support.threads import require_going, side_by_side, where_alone


@pytest.fixture(autouse=True)
def two_processors(monkeypatch):
    monkeypatch.setattr(threads, "available_workers", lambda: 2)


def test_results_come_in_order_and_no_jobs_give_none():
    def late():
        time.sleep(0.05)
        return 1

    assert where_alone([late, lambda: 2, lambda: 3]) == [1, 2, 3]
    assert where_alone([]) == []


def idents(patience_s=0.2):
    """Threads on which the jobs of this thread run; where there are two, the second one begins within the patience."""
    met = threading.Barrier(2, timeout=patience_s)

    def job():
        with contextlib.suppress(threading.BrokenBarrierError):
            met.wait()
        return threading.get_ident()

    return {threading.get_ident(), *where_alone([job, job])}


def test_jobs_of_the_main_thread_have_threads_of_their_own_and_those_of_others_have_not():
    assert len(idents(patience_s=30.0)) == 3
    found = side_by_side([idents, idents], threading.Event())
    assert [len(one) for one in found] == [1, 1]


def test_the_others_end_once_a_job_has_failed():
    begun = threading.Event()

    def fails():
        begun.wait(10.0)
        raise ValueError("the first one")

    def works_on():
        begun.set()
        until = time.monotonic() + 60.0
        while time.monotonic() < until:
            require_going()
            time.sleep(0.001)

    began = time.monotonic()
    with pytest.raises(ValueError, match="the first one"):
        where_alone([fails, works_on])
    assert time.monotonic() - began < 30.0


def test_outside_of_jobs_work_goes_on():
    require_going()
