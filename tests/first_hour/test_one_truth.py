"""What data can tell is the same in `check`, `run`, `inspect`, `design`, on the page and in Python."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import shipfp_rs as fp
from shipfp_rs import Fingerprint, cli
from shipfp_rs.designs import Subject, predict
from shipfp_rs.designs.subject import sensors_of
from tests.cli.small_trial import SMALL, small_log
from tests.runs.test_loaded_trial import TRUTH, write_loaded_trial
from tests.view.serving import served
from tests.view.test_jobs import follow

WELL_TOLD, HARDLY_TOLD = 0.05, 0.3
"""Standard deviations over the value."""


@dataclass(frozen=True)
class Told:
    """What the commands say of one trial."""

    folder: Path
    check: dict[str, Any]
    fingerprint: Fingerprint


def write_tug(folder: Path) -> None:
    small_log().write(folder / "log.parquet")
    chosen, _ = SMALL.split("[identify]")
    (folder / "TRIAL.toml").write_text(chosen, encoding="utf-8")


@pytest.fixture(scope="module", params=["tug", "genset"])
def told(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Told:
    folder = tmp_path_factory.mktemp(request.param)
    (write_tug if request.param == "tug" else write_loaded_trial)(folder)
    trial = str(folder / "TRIAL.toml")
    with pytest.MonkeyPatch.context() as patch:
        printed: list[str] = []
        patch.setattr("builtins.print", lambda *words, **_: printed.append(str(words[0])))
        assert cli.main(["check", trial, "--json"]) == 0
    check = json.loads("".join(printed))
    assert cli.main(["run", trial, "--out", str(folder / "out")]) == 0
    return Told(folder, check, Fingerprint.load(folder / "out" / "fingerprint.json"))


def relative(estimate: dict[str, Any]) -> float:
    """Standard deviation over the value; infinite where there is none."""
    value, std = estimate["value"], estimate["std"]
    return std / abs(value) if value and std is not None else float("inf")


def test_check_expects_what_run_finds(told: Told) -> None:
    found = {name: one.to_dict() for name, one in told.fingerprint.items()}
    expected = {**told.check["parameters"], **told.check["derived"]}
    assert set(expected) <= set(found)
    assert told.check["outputs"] == told.fingerprint.structure["outputs"]
    well = {name for name in expected if relative(found[name]) < WELL_TOLD}
    assert well
    for name in well:
        assert relative(expected[name]) < HARDLY_TOLD, name
    for name in expected:
        if relative(expected[name]) < WELL_TOLD:
            assert relative(found[name]) < HARDLY_TOLD, name


def test_check_reads_every_channel(told: Told) -> None:
    trial = (told.folder / "TRIAL.toml").read_text()
    assert all(f'"{channel["column"]}"' in trial for channel in told.check["channels"])
    assert ("load = {" in trial) == any("load" in channel["what"] for channel in told.check["channels"])


def test_inspect_accepts_what_run_accepts(told: Told) -> None:
    assert cli.main(["inspect", str(told.folder / "log.parquet"), str(told.folder / "TRIAL.toml")]) == 0


def test_python_finds_what_run_finds(told: Told) -> None:
    experiments = fp.read_experiments(told.folder / "out" / "experiments.parquet")
    place = told.fingerprint.structure["torque"]
    again = fp.identify(experiments, torque=place)
    for name, one in told.fingerprint.items():
        if one.std and relative(one.to_dict()) < WELL_TOLD:
            assert abs(again[name].value - one.value) < 0.1 * one.std, name


def test_design_expects_what_run_found(told: Told) -> None:
    subject = Subject.of(told.fingerprint, None, None)
    chirp = fp.signals.chirp(0.05, 1.5, 60.0, 0.03 * subject.operating_point["n_set"], rate_hz=50.0)
    if told.check["trial"] == "Load steps":
        with pytest.raises(fp.InputError, match="load"):
            predict(subject, chirp, sensors_of(None, subject.signals))
        return
    predicted = predict(subject, chirp, sensors_of(None, subject.signals))
    assert set(predicted.parameters) <= set(told.fingerprint.parameters)
    unknown = {name for name, one in predicted.parameters.items() if one.status == "unidentifiable"}
    assert not {name for name in unknown if relative(told.fingerprint[name].to_dict()) < WELL_TOLD}


@pytest.mark.parametrize("told", ["tug"], indirect=True)
def test_the_page_checks_as_the_command_does(told: Told) -> None:
    with served(told.folder) as caller:
        job = follow(caller, caller.post("job", {"kind": "check", "file": "TRIAL.toml"}))
    assert job["done"] == told.check
    assert not list(told.folder.glob("*-run*"))


def test_a_measured_load_drives_the_fingerprint(told: Told) -> None:
    if told.check["trial"] != "Load steps":
        assert "k_L" not in told.fingerprint
        return
    fingerprint = told.fingerprint
    assert fingerprint.elements["load"]["state"] == "on"
    assert fingerprint.adequate["stands"]
    truth = {**TRUTH, "k_L": 1.0}
    # What straight ramps leave over looks like a lag of ten milliseconds: its sum with the dead time is told.
    late = truth.pop("T_d")
    lag = fingerprint["tau_act"].value if "tau_act" in fingerprint.parameters else 0.0
    assert fingerprint["T_d"].value + lag == pytest.approx(late, rel=0.1)
    for name, value in truth.items():
        estimate = fingerprint[name]
        assert estimate.value == pytest.approx(value, rel=0.1), name
        assert abs(estimate.value - value) < 4.0 * estimate.std, name
