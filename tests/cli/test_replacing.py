"""No command replaces a file that it was not told to replace, and none its own input."""

from __future__ import annotations

import json

import pytest

from shipfp_rs import cli
from tests.cli.small_trial import refused
from tests.gallery.inputs import KEPT


@pytest.mark.parametrize(
    "arguments",
    [
        ("inspect", "log.parquet", "--out", "."),
        ("inspect", "log.parquet", "--out", "vessel.toml"),
        ("compare", "fingerprint.json", "fingerprint.json", "--out", "vessel.toml"),
        ("compare", "fingerprint.json", "fingerprint.json", "--out", "fingerprint.json", "--force"),
        ("simulate", "vessel.toml", "--duration", "5", "--out", "log.parquet"),
        ("design", "vessel.toml", "--duration", "100", "--out", "."),
        ("run", "TRIAL.toml", "--out", "."),
        ("reproduce", "fullscale", "--out", "."),
        ("sweep", "SWEEP.toml", "--out", "."),
        ("init", "."),
    ],
    ids=" ".join,
)
def test_what_is_there_stays(folder, monkeypatch, capsys, arguments):
    monkeypatch.chdir(folder)
    before = {name: (folder / name).read_bytes() for name in KEPT}
    refused(list(arguments), capsys)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_an_inspection_replaces_its_own_pictures(folder, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(folder)
    arguments = ["inspect", "log.parquet", "--out", str(tmp_path / "found")]
    assert cli.main(arguments) == 0
    content = json.loads((tmp_path / "found" / "inspection.json").read_text(encoding="utf-8"))
    assert content["log"] == "log.parquet"
    assert cli.main(arguments) == 0
    (tmp_path / "found" / "notes.txt").write_text("mine")
    capsys.readouterr()
    assert "found notes.txt" in refused(arguments, capsys)
    assert cli.main([*arguments, "--force"]) == 0
    assert (tmp_path / "found" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["12:30 file:x #1 [%20]"])
def test_names_of_any_kind_are_names(folder, monkeypatch, tmp_path, name):
    monkeypatch.chdir(tmp_path)
    for wanted in ("log.parquet", "SWEEP.toml"):
        (tmp_path / wanted).write_bytes((folder / wanted).read_bytes())
    assert cli.main(["convert", "log.parquet", f"{name}.parquet"]) == 0
    assert cli.main(["inspect", f"{name}.parquet"]) == 0
    options = ("--executor", "threads", "--no-figures", "--workers", "1")
    assert cli.main(["sweep", "SWEEP.toml", "--out", name, *options]) == 0
    assert cli.main(["convert", "log.parquet", f"{name}/again.parquet"]) == 0
