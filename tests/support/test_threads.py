"""Jobs on threads: order, jobs of jobs, and an end for those that nobody waits for."""

import threading
import time

import pytest

from shipfp_rs.support import threads
from shipfp_rs.support.threads import require_going, side_by_side


@pytest.fixture(autouse=True)
def two_processors(monkeypatch):
    monkeypatch.setattr(threads, "available_workers", lambda: 2)


def test_results_come_in_order_and_no_jobs_give_none():
    def late():
        time.sleep(0.05)
        return 1

    assert side_by_side([late, lambda: 2, lambda: 3]) == [1, 2, 3]
    assert side_by_side([]) == []


def test_jobs_of_a_job_run_on_its_own_thread():
    def job():
        inner = side_by_side([threading.get_ident, threading.get_ident, threading.get_ident])
        return {threading.get_ident(), *inner}

    assert [len(found) for found in side_by_side([job, job])] == [1, 1]


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
        side_by_side([fails, works_on])
    assert time.monotonic() - began < 30.0


def test_outside_of_jobs_work_goes_on():
    require_going()
