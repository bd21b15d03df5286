"""`init` then `run`, without an editor between: what a log is taken for, and whether the intervals hold the truth.

The study (`pytest -m study -k first_hour -s`) runs all rows and prints one line for each.
"""

from __future__ import annotations

import json
import time
import tomllib
from pathlib import Path

import pytest

import shipfp_rs as fp
from shipfp_rs import cli
from tests.first_hour.logs import QUICK, ROWS, Row, multisine

pytestmark = pytest.mark.filterwarnings("ignore::shipfp_rs.errors.LogWarning")
LEAST_SHARE = 0.7
"""Least share of 95 % intervals that hold the truth; of eight, one or two miss by chance and by the model's roundness."""


def by_name(row: Row) -> str:
    return row.name


def fitted(row: Row, trial: Path) -> dict[str, bool]:
    """Run what init wrote as a user does; return whether each interval holds."""
    assert cli.main(["run", str(trial), "--out", str(trial.parent / "result")]) == 0
    told = json.loads((trial.parent / "result" / "fingerprint.json").read_text(encoding="utf-8"))
    found = {**told["parameters"], **told["derived"], **told["si"]}
    known = {name: found[name]["ci95"] for name in row.truth if found.get(name, {}).get("ci95")}
    return {name: low <= row.truth[name] <= high for name, (low, high) in known.items()}


def assert_channels(row: Row, text: str) -> None:
    """Each channel is taken for what it is, and nothing more is asked for."""
    trial = tomllib.loads(text)
    channels, names = trial["channels"], {signal: name for signal, (name, _) in row.signals.items()}
    roles = {"n_set": "set_point", "command": "command", "M_load": "load", "n_e": names["n_e"]}
    roles |= {"M_g": "torque", "M_b": "torque"}
    assert {key: table["column"] for key, table in channels.items() if "column" in table} == {
        roles[signal]: name for signal, name in names.items() if signal in roles
    }
    if "torque" in channels:
        assert channels["torque"]["location"] == ("gauge" if "M_g" in names else "brake")
    assert "vessel" not in trial["trial"]
    assert "to be given" not in text
    if row.excitation is multisine:
        assert {window["kind"] for window in trial["windows"]} == {"multisine"}
    assert all(f"# {name}" in text for name, _ in row.others)


@pytest.mark.parametrize("row", [row for row in ROWS if row not in QUICK], ids=by_name)
def test_each_channel_is_taken_for_what_it_is_and_read(row: Row, tmp_path: Path):
    path = row.trial(tmp_path)
    assert_channels(row, path.read_text(encoding="utf-8"))
    trial = fp.Trial.load(path)
    (log,) = trial.logs()
    for experiment in fp.process(log, trial):
        assert experiment.duration > 20.0


@pytest.mark.parametrize("row", QUICK, ids=by_name)
def test_init_and_run_find_the_fingerprint_without_an_edit(row: Row, tmp_path: Path):
    path = row.trial(tmp_path)
    assert_channels(row, path.read_text(encoding="utf-8"))
    holds = fitted(row, path)
    assert len(holds) >= min(5, len(row.truth))
    assert sum(holds.values()) >= LEAST_SHARE * len(holds), holds


@pytest.mark.study
@pytest.mark.parametrize("row", ROWS, ids=by_name)
def test_first_hour_of_every_log(row: Row, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    began = time.perf_counter()
    holds = fitted(row, row.trial(tmp_path))
    seconds = time.perf_counter() - began
    missed = ", ".join(name for name, inside in holds.items() if not inside)
    with capsys.disabled():
        told = f"{sum(holds.values())} of {len(holds)} intervals hold"
        print(
            f"{row.name:52} {seconds:6.1f} s  {len(row.answers)} answers  {told}{f', not {missed}' if missed else ''}"
        )
    assert len(row.answers) <= 2
    assert sum(holds.values()) >= LEAST_SHARE * len(holds), holds
