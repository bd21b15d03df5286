"""Checks and runs that a page begins: what they tell, and what is left when they are stopped or their server is killed."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.logs.log import Log
from shipfp_rs.view.draft import Draft, written
from shipfp_rs.view.jobs import Jobs
from shipfp_rs.view.pyramid import stored
from tests.view.serving import served, write_csv

TRIAL = {
    "name": "Tug",
    "channels": [
        {"column": "n_set", "role": "set_point", "unit": "rpm", "calibration": {"scale": 1.0}},
        {"column": "shaft torque", "role": "torque", "unit": "Nm", "calibration": {"scale": 1.0}},
        {"column": "PTM_e", "role": "train", "pulses_per_rev": 1, "shaft": "engine"},
    ],
    "steady_s": [2.0, 38.0],
    "windows": [{"name": "C1", "kind": "chirp", "start_s": 40.0, "stop_s": 90.0}],
}


@pytest.fixture
def folder(tmp_path) -> Path:
    write_csv(tmp_path / "my.csv")
    (tmp_path / "TRIAL.toml").write_text(written(Draft.model_validate(TRIAL), None, "my.csv"))
    return tmp_path


def wait_until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def follow(caller, job: dict, seconds: float = 120.0) -> dict:
    """Ask for a job until it has ended."""
    end = time.monotonic() + seconds
    while (told := caller.get("job", id=job["id"]))["state"] in ("working", "stopping"):
        assert time.monotonic() < end, told
        time.sleep(0.05)
    return told


def test_a_trial_that_is_wrong_fails_in_a_line(folder):
    text = (folder / "TRIAL.toml").read_text()
    (folder / "TRIAL.toml").write_text(text.replace('column = "PTM_e"', 'column = "PTM_x"'))
    with served(folder) as caller:
        told = follow(caller, caller.post("job", {"kind": "check", "file": "TRIAL.toml"}))
    assert told["state"] == "failed"
    assert "no channel 'PTM_x'" in told["error"]


def test_a_stopped_run_leaves_nothing(folder):
    with served(folder) as caller:
        job = caller.post("job", {"kind": "run", "file": "TRIAL.toml"})
        wait_until(lambda: any(folder.glob(".shipfp-run.*")))
        assert caller.post("stop", {"id": job["id"]})["state"] == "stopping"
        assert follow(caller, job)["state"] == "stopped"
    assert sorted(path.name for path in folder.iterdir()) == ["TRIAL.toml", "my.csv"]


def test_two_jobs_at_once_are_all_there_are(folder):
    with served(folder) as caller:
        jobs = [caller.post("job", {"kind": "run", "file": "TRIAL.toml"}) for _ in range(2)]
        assert "under way" in caller.post("job", {"kind": "check", "file": "TRIAL.toml"})["error"]
        folders = {caller.server.desk.jobs.job(job["id"]).folder.name for job in jobs}
        assert folders == {"shipfp-run", "shipfp-run-2"}
        for job in jobs:
            caller.post("stop", {"id": job["id"]})


@contextlib.contextmanager
def begun_server(path: Path) -> Iterator[tuple[subprocess.Popen, str, str]]:
    """`shipfp view` as a user begins it, its origin and its secret; killed in the end."""
    with subprocess.Popen(
        [sys.executable, "-m", "shipfp_rs.cli", "view", str(path), "--no-browser"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        address = next(word for word in process.stdout.readline().split() if word.startswith("http"))
        try:
            yield process, *address.rsplit("/", 2)[:2]
        finally:
            process.kill()


def test_after_ctrl_c_nothing_listens(folder):
    with begun_server(folder) as (process, origin, _):
        port = int(origin.split(":")[2])
        socket.create_connection(("127.0.0.1", port), 5).close()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
        assert process.stderr.read() == ""
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), 5)


def test_a_killed_server_leaves_no_half_file_and_no_process(folder):
    """Killed in the middle of a run: the child sees that nobody wants it any more."""
    with begun_server(folder) as (process, origin, token):
        request = urllib.request.Request(
            f"{origin}/{token}/api/job",
            json.dumps({"kind": "run", "file": "TRIAL.toml"}).encode(),
            {"Origin": origin, "Content-Type": "application/json"},
        )
        with urllib.request.urlopen(request) as answer:
            assert json.load(answer)["state"] == "working"
        wait_until(lambda: any(folder.glob(".shipfp-run.*")))
        os.kill(process.pid, signal.SIGKILL)
    wait_until(lambda: not any(folder.glob(".*")), 30.0)
    assert sorted(path.name for path in folder.iterdir()) == ["TRIAL.toml", "my.csv"]


def test_killed_while_it_reads_a_log_it_leaves_no_half_overview(tmp_path):
    channels = {f"c{k}": np.zeros(2_000_000, np.float32) for k in range(4)}
    Log.from_arrays(channels, rate_hz=1e3).write(tmp_path / "l.parquet")
    with begun_server(tmp_path / "l.parquet") as (process, origin, token):
        urllib.request.urlopen(f"{origin}/{token}/api/document?doc=0").close()
        time.sleep(0.1)
        process.kill()
    left = {path.name for path in tmp_path.iterdir()} - {"l.parquet"}
    assert left <= {"l.parquet.shipfp-pyramid"}
    assert not left or stored(tmp_path / "l.parquet") is not None


@pytest.mark.parametrize(("given", "threads"), [(None, "1"), ("3", "3")])
def test_a_job_has_one_blas_thread_unless_the_environment_says_how_many(folder, monkeypatch, given, threads):
    if given is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    else:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", given)
    begun = []

    def popen(*_, env, **__):
        begun.append(env)
        raise OSError("not begun")

    monkeypatch.setattr(subprocess, "Popen", popen)
    with pytest.raises(OSError, match="not begun"):
        Jobs().begin("check", folder / "TRIAL.toml")
    assert begun[0]["OPENBLAS_NUM_THREADS"] == threads


def test_a_set_point_that_is_not_the_speed_leads_the_verdict(tmp_path):
    """A governor with an integral part leaves no difference, so one of the two calibrations is wrong."""
    write_csv(tmp_path / "my.csv")
    wrong = [TRIAL["channels"][0] | {"calibration": {"scale": 1.04}}, *TRIAL["channels"][1:]]
    (tmp_path / "TRIAL.toml").write_text(
        written(Draft.model_validate(TRIAL | {"channels": wrong}), None, "my.csv")
    )
    with served(tmp_path) as caller:
        told = follow(caller, caller.post("job", {"kind": "run", "file": "TRIAL.toml"}))
        assert told["state"] == "done", told
        assert told["done"]["verdict"][0].startswith("Set point and speed differ")
        (run,) = caller.get("results")["results"]
        assert run["verdict"] == told["done"]["verdict"][0]
