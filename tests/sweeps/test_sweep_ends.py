"""Ctrl-C and SIGTERM end a command within a second and leave nothing behind; a sweep without an estimate is an error."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.small_trial import SWEEP, refused, write_small_trial

LONG_DRAWS = SWEEP.replace("draws = 2", "draws = 100000").replace("duration_s = 10.0", "duration_s = 300.0")
ENDS = [(signal.SIGINT, 130), (signal.SIGTERM, 143)]


def started(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start a command in a group of its own, so that what it leaves running can be told."""
    return subprocess.Popen(
        [sys.executable, "-m", "shipfp_rs.cli", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def ended(process: subprocess.Popen[str], number: signal.Signals) -> tuple[float, str]:
    """End a command and return how long that took, and its lines; nothing of its group is left."""
    began = time.monotonic()
    process.send_signal(number)
    _, told = process.communicate(timeout=30.0)
    took = time.monotonic() - began
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:  # until the system has taken note
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return took, told
        time.sleep(0.05)
    raise AssertionError("processes are left")


# One executor and one end of it; the others come at night.
@pytest.mark.parametrize(
    ("executor", "number", "status"),
    [
        ("processes", *ENDS[0]),
        *(
            pytest.param(*other, marks=pytest.mark.slow)
            for other in (("processes", *ENDS[1]), ("threads", *ENDS[0]), ("threads", *ENDS[1]))
        ),
    ],
)
def test_breakage_d5_a_sweep_does_not_wait_for_its_draws(tmp_path, executor, number, status):
    (tmp_path / "SWEEP.toml").write_text(LONG_DRAWS)
    # A task of 10,000 draws takes a quarter of an hour; ten seconds are those of a machine with much else to do.
    options = ("--executor", executor, "--workers", "2", "--draws-per-task", "10000")
    process = started(tmp_path, "sweep", "SWEEP.toml", "--out", "out", *options)
    while not (tmp_path / "out" / "manifest.json").exists():
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    time.sleep(0.5)
    took, told = ended(process, number)
    assert process.returncode == status
    assert "completed draws are in out" in told
    assert "leaked" not in told
    assert "Traceback" not in told
    assert took < 10.0


def test_breakage_d5_a_run_leaves_no_temporary_folder(tmp_path):
    write_small_trial(tmp_path)
    process = started(tmp_path, "run", "TRIAL.toml", "--out", "out")
    while not list(tmp_path.glob(".out.*")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    _, told = ended(process, signal.SIGTERM)
    assert process.returncode == 143
    assert told.count("\n") == 1
    assert not list(tmp_path.glob(".*"))
    assert not (tmp_path / "out").exists()


def test_breakage_d3_a_sweep_without_an_estimate_is_status_2(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("SWEEP.toml").write_text(SWEEP.replace("draws = 2", "draws = 2\ntime_limit_s = 1e-6"))
    told = refused(["sweep", "SWEEP.toml", "--out", "out", "--executor", "threads"], capsys)
    assert "none of 2 draws was identified, the first error: " in told
