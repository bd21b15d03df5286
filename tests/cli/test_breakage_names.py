"""Names, numbers and files that can't be meant cost one line and status 2, at every command (BREAKAGE D)."""

from __future__ import annotations

import json
import os
import resource
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.support.files import json_text, read_json, replacing_folder
from tests.cli.small_trial import SMALL, refused, write_small_trial

LONG = "x" * 5000
SHIP = "stan-launch-804"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with a small trial, a loop of links and a pipe that nobody writes to."""
    monkeypatch.chdir(tmp_path)
    write_small_trial(tmp_path)
    (tmp_path / "one").symlink_to("two")
    (tmp_path / "two").symlink_to("one")
    # A page that is served after all ends at once, with status 0.
    ended = threading.Event()
    ended.set()
    monkeypatch.setattr("shipfp_rs.view.server.end_asked_for", lambda: ended)
    os.mkfifo(tmp_path / "pipe.toml")
    os.mkfifo(tmp_path / "pipe.csv")
    return tmp_path


@pytest.mark.parametrize("name", [LONG, "", "one", "one/in", "log.parquet/in", "/proc/in", "a\nb"])
@pytest.mark.parametrize(
    "command",
    [
        ["run", "TRIAL.toml", "--out"],
        ["demo", "--out"],
        ["design", SHIP, "--duration", "100", "--out"],
        ["inspect", "log.parquet", "--out"],
        ["sweep", "SWEEP.toml", "--out"],
        ["init"],
        ["reproduce", "twin", "--out"],
    ],
)
def test_breakage_d2_no_folder_of_this_name_can_be_made(folder, command, name, capsys):
    refused([*command, name], capsys)


@pytest.mark.parametrize(
    "name", [LONG + ".parquet", "", "/proc/in.parquet", "log.parquet/in.parquet", "one/in.parquet"]
)
@pytest.mark.parametrize(
    "command", [["simulate", SHIP, "--duration", "5", "--out"], ["convert", "log.parquet"]]
)
def test_breakage_d2_no_file_of_this_name_can_be_written(folder, command, name, capsys):
    refused([*command, name], capsys)


@pytest.mark.parametrize(
    "name", [LONG, "", "one", "pipe.toml", "/dev/null", ".", "log.parquet", "\N{ZERO WIDTH SPACE}"]
)
@pytest.mark.parametrize(
    "command",
    [
        ["run"],
        ["check"],
        ["sweep"],
        ["simulate"],
        ["design", "--duration", "60"],
        ["compare", "a.json"],
        ["view", "--no-browser"],
    ],
)
def test_breakage_d2_what_is_no_description_is_not_read(folder, command, name, capsys):
    if command[0] == "view" and name in (".", "log.parquet", "/dev/null"):
        pytest.skip("a folder and a log can be looked at")
    refused([*command, name], capsys)


@pytest.mark.parametrize("name", [LONG + ".csv", "", "one", "pipe.csv", "/dev/null", "."])
@pytest.mark.parametrize(
    "command", [["inspect"], ["convert", "--force"], ["init", "--log"], ["view", "--no-browser"]]
)
def test_breakage_d2_d4_what_is_no_log_is_not_read(folder, command, name, capsys):
    if command[0] == "view" and name == ".":
        pytest.skip("a folder can be looked at")
    told = refused([*command, name, *(["out.parquet"] if command[0] == "convert" else [])], capsys)
    assert "no such log" not in told or name.startswith("x")


@contextmanager
def disk_of(size: int) -> Iterator[None]:
    """Let no file grow beyond a size: what a full disk does, without filling one."""
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["run", "TRIAL.toml", "--out", "out"], "out/fingerprint.json: can't be written, File too large"),
        (["simulate", SHIP, "--duration", "60", "--out", "s.parquet"], "s.parquet: can't be written"),
        (["convert", "log.parquet", "again.parquet"], "again.parquet: can't be written"),
        (["sweep", "SWEEP.toml", "--out", "sw"], "can't be written"),
        (["design", SHIP, "--duration", "100", "--out", "plan"], "plan: can't be written"),
    ],
)
def test_breakage_d2_a_full_disk_is_told_with_the_name_that_was_given(folder, arguments, named, capsys):
    before = sorted(path.name for path in folder.iterdir())
    with disk_of(1024):
        told = refused(arguments, capsys)
    assert named in told
    assert sorted(path.name for path in folder.iterdir()) == before, "nothing is left"


def test_breakage_d2_other_errors_of_files_keep_their_own_name(tmp_path):
    with pytest.raises(FileNotFoundError, match="elsewhere"), replacing_folder(tmp_path / "out", marker="m"):
        (tmp_path / "elsewhere").read_text()


@pytest.mark.parametrize("option", ["--rate", "--cq"])
@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf", "1e300", "", "a", "1e-400"])
def test_breakage_d3_numbers_of_options_are_positive(folder, option, value, capsys):
    assert option in refused(["inspect", "log.parquet", option, value], capsys)


def test_breakage_d3_json_has_no_numbers_without_end(tmp_path):
    nan = float("nan")
    assert json.loads(json_text({"a": [1.0, nan, float("inf")], "b": (nan,)})) == {
        "a": [1.0, None, None],
        "b": [None],
    }
    for text in (
        '{"a": NaN}',
        '{"a": -Infinity}',
        '{"a": 1e999}',
        "[" * 100_000,
        "{",
        "\udcff",
        '{"a": ' + "9" * 5000 + "}",
    ):
        (tmp_path / "x.json").write_bytes(text.encode("utf-8", "surrogateescape"))
        with pytest.raises(InputError, match=r"x\.json: .*expected") as caught:
            read_json(tmp_path / "x.json", "a fingerprint")
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 300


def test_breakage_d1_toml_without_end_is_refused(tmp_path, capsys):
    for text in (
        "a = " + "[" * 5000 + "]" * 5000,
        "a = " + "{b=" * 300 + "1" + "}" * 300,
        "a." * 3000 + "a = 1",
        SMALL + "\n[x]\n" * 2,
    ):
        (tmp_path / "TRIAL.toml").write_text(text)
        refused(["run", str(tmp_path / "TRIAL.toml"), "--out", str(tmp_path / "out")], capsys)
