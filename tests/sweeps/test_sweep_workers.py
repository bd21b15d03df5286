"""Workers that are killed, and draws that kill them, cost a sweep nothing but time and one failed row."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from shipfp_rs.sweeps import Progress, dispatch, sweep
from shipfp_rs.sweeps.draw import run_draws
from shipfp_rs.sweeps.pools import pool_of
from tests.sweep_folders import DEADLY, DeadlyPlan, cheap_plan, results, rows

DRAWS = 8


class KillOne:
    """Progress function that kills one process of the pool once some draws are done."""

    def __init__(self) -> None:
        self.killed = 0

    def __call__(self, state: Progress) -> None:
        children = multiprocessing.active_children()
        if state.made and not self.killed and children:
            self.killed = children[0].pid or 0
            os.kill(self.killed, signal.SIGKILL)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a sweep that nothing happened to."""
    folder = tmp_path_factory.mktemp("whole") / "sweep"
    sweep(cheap_plan(DRAWS), folder, executor="threads", workers=1)
    return folder


@pytest.mark.slow
def test_a_process_that_is_killed_costs_nothing(whole: Path, tmp_path: Path) -> None:
    kill = KillOne()
    sweep(cheap_plan(DRAWS), tmp_path, workers=2, draws_per_task=1, progress=kill)
    assert kill.killed
    assert results(tmp_path) == results(whole)


def blas_threads() -> set[int]:
    """Return how many threads each BLAS of this process has."""
    return {row["num_threads"] for row in threadpool_info() if row["user_api"] == "blas"}


@pytest.mark.parametrize("kind", ["processes", "threads"])
def test_a_draw_has_one_blas_thread_whatever_the_environment_says(kind, monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with threadpool_limits(limits=2):
        if kind == "processes":
            with pool_of("processes", 1, None) as pool:
                assert pool.submit(blas_threads).result() == {1}
        else:
            seen = set()
            plan = cheap_plan(1)
            monkeypatch.setattr(
                dispatch, "run_draws", lambda *given: seen.update(blas_threads()) or run_draws(*given)
            )
            sweep(plan, tmp_path, executor="threads", workers=1)
            assert seen == {1}


def test_a_draw_that_kills_its_process_is_one_failed_row(whole: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(dispatch, "ATTEMPTS", 1)
    plan = cheap_plan(DRAWS, kind=DeadlyPlan)
    summary = sweep(plan, tmp_path, workers=1, draws_per_task=2).summary
    assert summary["errors"] == {"WorkerLost": 1}
    before, after = rows(whole), rows(tmp_path)
    assert after[DEADLY]["status"] == "failed"
    assert after[DEADLY]["seed"] == before[DEADLY]["seed"]
    assert [row for row in after if row["index"] != DEADLY] == [
        row for row in before if row["index"] != DEADLY
    ]


@pytest.mark.slow
def test_a_dask_worker_that_is_killed_costs_nothing(whole: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    kill = KillOne()
    sweep(cheap_plan(DRAWS), tmp_path, executor="dask", workers=2, draws_per_task=1, progress=kill)
    assert kill.killed
    assert results(tmp_path) == results(whole)


def test_no_scheduler_at_an_address_costs_one_line(tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("distributed")
    from shipfp_rs.errors import InputError
    from shipfp_rs.sweeps import pools

    monkeypatch.setattr(pools, "CONNECT_S", 0.2)
    with pytest.raises(InputError, match=r"127\.0\.0\.1:9: no Dask scheduler answers at this address"):
        sweep(cheap_plan(DRAWS), tmp_path, executor="dask", address="127.0.0.1:9")


DRIVER = """
import os, time
from shipfp_rs.sweeps.pools import pool_of
if __name__ == "__main__":
    with pool_of("processes", 1, None) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(600)
"""


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="tells living processes by /proc")
def test_workers_end_with_a_sweep_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "driver.py"
    script.write_text(DRIVER)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None
        worker = int(driver.stdout.readline())
        assert is_alive(worker)
        driver.kill()
    patience = time.monotonic() + 60.0
    while is_alive(worker):
        assert time.monotonic() < patience
        time.sleep(0.05)


def is_alive(process: int) -> bool:
    """Whether a process is there; one that ended and waits for its parent is not."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"
