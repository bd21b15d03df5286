"""An inspection says which faults it looked for in which channels, and which in none."""

from __future__ import annotations

import json

from shipfp_rs import cli
from shipfp_rs.inspection.channels import describe, looked_for, sentences
from shipfp_rs.processing.trial import Trial
from tests.cli.small_trial import small_log, write_small_trial


def test_breakage_a8_a_log_alone_says_what_was_not_looked_for(tmp_path, capsys):
    write_small_trial(tmp_path)
    assert cli.main(["inspect", str(tmp_path / "log.parquet")]) == 0
    shown = capsys.readouterr().out
    assert "No faults found of those looked for." in shown
    assert (
        "stuck channel, clipped, rows recorded more than once, spikes in set point, speed, torque." in shown
    )
    assert "Not looked for: mains hum on the set point" in shown
    assert cli.main(["inspect", str(tmp_path / "log.parquet"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["checks"]["looked_for"]
    assert "sign" in told["left_out"]
    assert "C" not in told["left_out"]  # a spike of any channel
    assert told["channels"]["torque"] == ["gap", "dropout", "stuck", "clipped", "repeated", "spike"]


def test_breakage_a8_a_trial_names_the_roles(tmp_path):
    write_small_trial(tmp_path)
    told = looked_for(describe(small_log()), Trial.load(tmp_path / "TRIAL.toml"))
    assert "D1" in told["channels"]["set point"]
    assert "C" in told["channels"]["torque"]
    assert "C" not in told["channels"]["speed"]
    lines = sentences(told, trial=True)
    assert len(lines) == 3
    assert not any("Not looked for" in line for line in lines)
