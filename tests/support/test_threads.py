"""Jobs on threads: order, jobs of jobs, an end for those that nobody waits for, one thread of BLAS."""

import contextlib
import threading
import time

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import shipfp_rs as fp
from shipfp_rs.assessment.profile_likelihood import profile_likelihood
from shipfp_rs.assessment.validation import cross_validation
from shipfp_rs.identification.identify import foresee
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.support import threads
from shipfp_rs.support.threads import (
    one_blas_thread,
    require_going,
    side_by_side,
    where_alone,
    with_one_blas_thread,
)


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


def blas_threads():
    return max(row["num_threads"] for row in threadpool_info() if row["user_api"] == "blas")


@pytest.fixture
def three_blas_threads():
    with threadpool_limits(limits=3):
        if blas_threads() != 3:
            pytest.skip("a BLAS of one thread")
        yield


@pytest.mark.usefixtures("three_blas_threads")
def test_blas_has_one_thread_until_the_last_caller_is_through():
    first, second = one_blas_thread(), one_blas_thread()
    first.__enter__()
    second.__enter__()
    assert blas_threads() == 1
    # They end in the order in which they began, as calls in threads of their own do.
    first.__exit__(None, None, None)
    assert blas_threads() == 1
    second.__exit__(None, None, None)
    assert blas_threads() == 3


@pytest.mark.usefixtures("three_blas_threads")
def test_a_call_that_fails_gives_the_threads_back():
    @with_one_blas_thread
    def fails():
        assert blas_threads() == 1
        raise ValueError("a fit")

    with pytest.raises(ValueError, match="a fit"):
        fails()
    assert blas_threads() == 3


@pytest.mark.usefixtures("three_blas_threads")
@pytest.mark.parametrize("fit", ["identify", "foresee", "profile_likelihood", "cross_validation"])
def test_every_fit_keeps_to_one_blas_thread(fit, monkeypatch):
    seen = []

    products = Likelihood.products

    def record(likelihood, *arguments):
        seen.append(blas_threads())
        return products(likelihood, *arguments)

    monkeypatch.setattr(Likelihood, "products", record)
    excitation = fp.signals.chirp(0.1, 1.0, 25.0, 40.0, rate_hz=20.0)
    noise = {"n_e": 0.01, "M_b": 0.01}
    data = fp.simulate(fp.Vessel.load("stan-launch-804"), excitation, noise=noise, seed=1)
    structure = fp.Structure.linear(products=True)
    calls = {
        "identify": lambda: fp.identify(data, structure, intervals="symmetric"),
        "foresee": lambda: foresee([data], structure),
        "profile_likelihood": lambda: profile_likelihood(data, structure, ["g"], noise="white"),
        "cross_validation": lambda: cross_validation([data], structure, intervals="symmetric"),
    }
    calls[fit]()
    assert set(seen) == {1}
    assert blas_threads() == 3
