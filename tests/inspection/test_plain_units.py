"""A drive with one speed in units of its own is checked and inspected without calibrations and without a vessel."""

import re

import pytest

from shipfp_rs import cli
from tests.cli.small_trial import SMALL, small_log


@pytest.mark.parametrize("command", [["check", "TRIAL.toml"], ["inspect", "log.parquet", "TRIAL.toml"]])
def test_neither_calibration_nor_vessel_nor_rest_is_wanted(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    small_log().write("log.parquet")
    bare = re.sub("(?m)^(vessel|calibration) = .*\n", "", SMALL)
    (tmp_path / "TRIAL.toml").write_text(bare)
    assert cli.main(command) == 0, capsys.readouterr().err
    told = capsys.readouterr().out
    assert ("speed of the engine" if command[0] == "check" else "Nothing rests for 8 s") in " ".join(
        told.split()
    )
