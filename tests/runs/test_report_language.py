"""The language of a run's report: the trial's own, or what the command line asks for."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest

from shipfp_rs import cli
from shipfp_rs.processing.trial import Report
from shipfp_rs.runs import run
from tests.cli.small_trial import refused


@pytest.mark.parametrize(
    ("options", "asked", "written"),
    [([], None, "de"), (["--language", "en"], "en", "en"), (["--language", "de"], "de", "de")],
)
def test_the_command_line_stands_above_the_trial(options, asked, written, monkeypatch, tmp_path) -> None:
    told = {}

    def pretend(*_, **given):
        told.update(given)
        return SimpleNamespace(fingerprint=SimpleNamespace(to_dict=dict))

    monkeypatch.setattr(run, "run", pretend)
    monkeypatch.setattr(sys.modules["shipfp_rs.cli.run"], "print_fingerprint", lambda *_: None)
    assert cli.main(["run", str(tmp_path / "TRIAL.toml"), "--out", str(tmp_path), *options]) == 0
    assert told["language"] == asked
    assert (told["language"] or Report(language="de").language) == written


def test_another_language_is_refused_in_one_line(tmp_path, capsys) -> None:
    assert "fr" in refused(["run", str(tmp_path / "TRIAL.toml"), "--language", "fr"], capsys)
