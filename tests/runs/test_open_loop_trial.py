"""Torque steps of a motor without a speed controller, from the log's command to its inertia in SI units."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import shipfp_rs as fp
from shipfp_rs import cli
from shipfp_rs.processing.process import process
from tests.cli.small_trial import refused
from tests.first_hour.logs import Commanded, lab_drive, parquet, steps

INERTIA, SPEED_RPM, TORQUE_NM = 0.09, 900.0, 12.0
CHANNELS = {"command": ("Torque command", "Nm"), "n_e": ("Motor speed", "rpm")}
DRIVE = Commanded("torque steps", parquet, lab_drive, steps, 50.0, CHANNELS)
TRIAL = """windows = [{ name = "S1", kind = "steps", start_s = 18.0, stop_s = 98.0 }]
[trial]
name = "Torque steps"
log = "log.parquet"
[channels]
command = { column = "Torque command", unit = "Nm" }
speed = { column = "Motor speed", unit = "rpm" }
"""
STEADY = "[operating_point]\nsteady_s = [1.0, 11.0]\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log and its trial."""
    folder = tmp_path_factory.mktemp("open")
    DRIVE.written(folder)
    (folder / "TRIAL.toml").write_text(TRIAL)
    (folder / "STEADY.toml").write_text(TRIAL + STEADY)
    return folder


def experiment(folder: Path, name: str) -> fp.Experiment:
    (found,) = process(folder / name)
    return found


def test_a_command_is_over_a_steady_stretch_or_the_mean(folder: Path) -> None:
    steady, mean = (experiment(folder, name) for name in ("STEADY.toml", "TRIAL.toml"))
    assert steady.operating_point["command"] == pytest.approx(TORQUE_NM, rel=1e-3)
    assert steady.operating_point["n_e"] == pytest.approx(SPEED_RPM, rel=1e-3)
    for name in ("command", "n_e"):
        assert mean.operating_point[name] == pytest.approx(mean.signals[name].mean())


def test_check_says_what_would_be_fitted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", str(folder / "STEADY.toml")]) == 0
    told = capsys.readouterr().out
    assert "Would be fitted: a drive in open loop, outputs dn." in told
    assert "overnor" not in told
    assert "tried" not in told


def test_inspect_compares_no_set_point(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["inspect", str(folder / "log.parquet"), str(folder / "STEADY.toml")]) == 0
    told = capsys.readouterr()
    assert "Set point and speed" not in told.out
    assert "Nothing rests" not in told.out
    assert told.err == ""


def test_run_tells_the_inertia_and_speaks_of_no_governor(folder: Path, tmp_path: Path) -> None:
    assert cli.main(["run", str(folder / "STEADY.toml"), "--out", str(tmp_path / "result")]) == 0
    told = json.loads((tmp_path / "result" / "fingerprint.json").read_text(encoding="utf-8"))
    low, high = told["si"]["inertia"]["ci95"]
    assert low <= INERTIA <= high
    assert high - low < 0.1 * INERTIA
    low, high = told["parameters"]["p"]["ci95"]
    assert low <= DRIVE.drive().propeller.torque_exponent <= high
    report = (tmp_path / "result" / "report.html").read_text(encoding="utf-8")
    assert "overnor" not in report[report.index("<body") :]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("command =", 'set_point = { column = "a", unit = "rpm" }\ncommand ='), "found command as well"),
        (('command = { column = "Torque command", unit = "Nm" }\n', ""), "channels.set_point: found nothing"),
        (("[channels]", "[identify]\nnoise = \"white\"\n[channels]"), "a declared ship beside channels.command"),
    ],
)  # fmt: skip
def test_what_open_loop_can_not_have_is_refused(
    change: tuple[str, str], said: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "TRIAL.toml").write_text(TRIAL.replace(*change))
    assert said in refused(["check", str(tmp_path / "TRIAL.toml")], capsys)
