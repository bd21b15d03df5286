"""Whatever is killed when, a sweep comes to the same bits: it, its workers, its scheduler.

The study (`pytest -m study -k kills -s`) runs 1000 draws on a Dask cluster of several processes and kills driver, workers
and scheduler 20 times at random moments; KILLS_DRAWS and KILLS set other numbers.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.sweeps import sweep
from tests.sweep_folders import results, sweep_toml


def start(*arguments: object, log: Path) -> subprocess.Popen[bytes]:
    with log.open("ab") as output:
        return subprocess.Popen([sys.executable, "-m", *map(str, arguments)], stdout=output, stderr=output)


def draws_in(folder: Path) -> int:
    with contextlib.suppress(FileNotFoundError):
        size = json.loads((folder / "manifest.json").read_text())["part_draws"]
        return int(size) * len(list(folder.glob("parts/*/0*.parquet")))
    return 0


def test_a_killed_sweep_comes_to_the_bits_of_one_that_never_was(tmp_path: Path) -> None:
    draws, path, folder = 8, tmp_path / "SWEEP.toml", tmp_path / "killed"
    path.write_text(sweep_toml(sweep={"vessel": "stan-launch-804", "draws": draws}))
    sweep(path, tmp_path / "whole", executor="threads", workers=1)
    command = ("shipfp_rs.cli", "sweep", path, "--out", folder, "--executor", "threads", "--no-figures")
    chance = np.random.default_rng(3)
    for part in np.sort(chance.choice(np.arange(1, 6), 1, replace=False)):
        with start(*command, log=tmp_path / "log") as run:
            while draws_in(folder) < part:
                assert run.poll() is None, (tmp_path / "log").read_text()
                time.sleep(0.005)
            time.sleep(chance.uniform(0.0, 0.03))
            run.kill()
        assert run.returncode == -signal.SIGKILL
        assert part <= draws_in(folder) < draws
    assert start(*command, log=tmp_path / "log").wait() == 0
    assert results(folder) == results(tmp_path / "whole")
    assert not list(folder.rglob(".*.*.*"))


class Cast:
    """Scheduler, workers and driver of a sweep, each a process of its own, started anew when it is gone."""

    def __init__(self, folder: Path, path: Path, out: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        address = f"127.0.0.1:{port}"
        quiet = ("--no-dashboard", "--host", "127.0.0.1")
        worker = (
            "distributed.cli.dask_worker",
            address,
            *quiet,
            "--nthreads",
            "1",
            "--no-nanny",
            "--local-directory",
            folder,
        )
        self.commands = {
            "scheduler": ("distributed.cli.dask_scheduler", *quiet, "--port", port),
            "worker 1": worker,
            "worker 2": worker,
            "driver": ("shipfp_rs.cli", "sweep", path, "--out", out, "--address", address, "--no-figures"),
        }
        self.folder = folder
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def keep(self) -> bool:
        """Start what is not there; whether the driver has come to its end."""
        for name, command in self.commands.items():
            process = self.running.get(name)
            if process is None or process.poll() is not None:
                if name == "driver" and process is not None and process.returncode == 0:
                    return True
                self.running[name] = start(*command, log=self.folder / f"{name}.log")
        return False

    def end(self) -> None:
        """End all."""
        for process in self.running.values():
            process.kill()
            process.wait()


@contextlib.contextmanager
def cast(folder: Path, path: Path, out: Path) -> Iterator[Cast]:
    players = Cast(folder, path, out)
    try:
        yield players
    finally:
        players.end()


@pytest.mark.study
def test_twenty_kills_at_random_moments_leave_no_trace_in_the_table(tmp_path: Path) -> None:
    draws, kills = int(os.environ.get("KILLS_DRAWS", "1000")), int(os.environ.get("KILLS", "20"))
    path, out = tmp_path / "SWEEP.toml", tmp_path / "killed"
    path.write_text(sweep_toml(sweep={"vessel": "stan-launch-804", "draws": draws}))
    began = time.monotonic()
    sweep(path, tmp_path / "whole", executor="threads", workers=1)
    print(f"\n{draws} draws in one thread, {time.monotonic() - began:.0f} s")
    chance, killed = np.random.default_rng(20), Counter[str]()
    # Kills are spread over the draws: each strikes at some moment after so many draws are safe.
    moments = np.sort(chance.uniform(0.0, 0.95 * draws, kills))
    began = time.monotonic()
    with cast(tmp_path, path, out) as players:
        for moment in moments:
            while draws_in(out) < moment:
                assert not players.keep()
                time.sleep(0.02)
            time.sleep(chance.uniform(0.0, 0.5))
            victim = str(chance.choice(list(players.running)))
            players.running[victim].kill()
            players.running[victim].wait()
            killed[victim] += 1
        while not players.keep():
            time.sleep(0.1)
    print(f"killed {dict(sorted(killed.items()))}, then done, {time.monotonic() - began:.0f} s")
    same = results(out) == results(tmp_path / "whole")
    print(f"results.parquet is the same to the bit: {same}")
    assert sum(killed.values()) == kills
    assert same
