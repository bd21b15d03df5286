"""The command line: exit statuses, one-line errors, JSON, and no trace of a traceback."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from shipfp_rs import cli
from shipfp_rs.errors import IdentificationError, InternalError
from shipfp_rs.reproduce import Reproduction, Row


def shipfp(
    *arguments: object, folder: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "shipfp_rs.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, **environment},
        check=False,
    )


def one_line(stderr: str) -> str:
    """Return the line, which must be the only one."""
    assert stderr.startswith("shipfp: ")
    assert stderr.count("\n") == 1
    assert "Traceback" not in stderr
    return stderr.rstrip("\n")


def raising(error: BaseException):
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


class TestFrame:
    def test_help_is_quick_because_nothing_heavy_is_loaded(self) -> None:
        code = (
            "import sys; from shipfp_rs.cli import main; assert main(['--help']) == 0; "
            "print(*sorted({m.split('.')[0] for m in sys.modules}))"
        )
        loaded = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
        assert not {"matplotlib", "scipy", "pyarrow", "pydantic"} & set(loaded.split("\n")[-2].split())

    def test_every_subcommand_has_help(self, capsys) -> None:
        for command in (["init"], ["reproduce"], ["reproduce", "fullscale"]):
            assert cli.main([*command, "--help"]) == 0
            assert "Usage: shipfp " + " ".join(command) in capsys.readouterr().out

    def test_without_arguments_it_shows_its_commands(self, capsys) -> None:
        assert cli.main([]) == 0
        assert "reproduce" in capsys.readouterr().out

    def test_the_version_is_the_package_s(self, capsys) -> None:
        from shipfp_rs import __version__

        assert cli.main(["--version"]) == 0
        assert capsys.readouterr().out == f"shipfp {__version__}\n"

    @pytest.mark.parametrize("arguments", [["inti"], ["init", "a", "b"], ["init", "--speed"]])
    def test_a_slip_of_usage_costs_one_line_and_status_2(self, arguments, capsys) -> None:
        assert cli.main(arguments) == 2
        assert "shipfp --help" in one_line(capsys.readouterr().err)

    @pytest.mark.parametrize(
        ("error", "status", "words"),
        [
            (KeyboardInterrupt(), 130, "interrupted"),
            (IdentificationError("no start led\n  to a minimum"), 1, "no start led to a minimum"),
            (InternalError("kernel panicked"), 1, "SHIPFP_TRACEBACK=1"),
            (ZeroDivisionError("division by zero"), 1, "internal error: ZeroDivisionError: division by zero"),
            (OSError(28, "No space left on device", "/full"), 1, "/full: No space left on device"),
            (MemoryError(), 1, "out of memory"),
        ],
    )
    def test_whatever_goes_wrong_costs_one_line(
        self, monkeypatch, tmp_path, capsys, error, status, words
    ) -> None:
        monkeypatch.setattr("shipfp_rs.files.write_text_atomically", raising(error))
        assert cli.main(["init", str(tmp_path)]) == status
        assert words in one_line(capsys.readouterr().err)

    def test_the_traceback_is_there_for_those_who_ask(self, monkeypatch, tmp_path, capsys) -> None:
        monkeypatch.setenv("SHIPFP_TRACEBACK", "1")
        monkeypatch.setattr("shipfp_rs.files.write_text_atomically", raising(ZeroDivisionError("0")))
        assert cli.main(["init", str(tmp_path)]) == 1
        assert "Traceback" in capsys.readouterr().err

    def test_a_reader_that_leaves_the_pipe_is_no_disaster(self) -> None:
        reader, writer = os.pipe()
        os.close(reader)
        done = subprocess.run(
            [sys.executable, "-m", "shipfp_rs.cli", "--version"],
            stdout=writer,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
        os.close(writer)
        assert (done.returncode, done.stderr) == (1, "")


class TestInit:
    def test_the_file_it_writes_is_a_trial(self, tmp_path) -> None:
        from shipfp_rs.trial import Trial

        done = shipfp("init", tmp_path / "new")
        assert (done.returncode, done.stderr) == (0, "")
        assert str(tmp_path / "new" / "TRIAL.toml") in done.stdout.replace("\n", "")
        assert Trial.load(tmp_path / "new" / "TRIAL.toml").windows

    def test_it_never_overwrites(self, tmp_path, capsys) -> None:
        (tmp_path / "TRIAL.toml").write_text("mine")
        assert cli.main(["init", str(tmp_path)]) == 2
        assert "TRIAL.toml: is there already" in one_line(capsys.readouterr().err)
        assert (tmp_path / "TRIAL.toml").read_text() == "mine"


@pytest.fixture(scope="module")
def refitted(tmp_path_factory) -> tuple[subprocess.CompletedProcess[str], Path]:
    out = tmp_path_factory.mktemp("reproduce") / "out"
    return shipfp("reproduce", "fullscale", "--json", "--out", out), out


class TestReproduceFullscale:
    def test_json_holds_rows_of_the_agreed_form_and_nothing_else(self, refitted) -> None:
        done, _ = refitted
        assert (done.returncode, done.stderr) == (0, "")
        rows = json.loads(done.stdout)["rows"]
        assert {row["way"] for row in rows} == {"printed", "thesis", "ours"}
        for row in rows:
            assert {"table", "case", "way", "structure", "parameters", "fit", "notes"} <= set(row)

    def test_the_folder_holds_the_same_rows_and_a_picture(self, refitted) -> None:
        done, out = refitted
        assert sorted(file.name for file in out.iterdir()) == ["fullscale.json", "response.svg"]
        assert json.loads((out / "fullscale.json").read_text()) == json.loads(done.stdout)

    def test_the_table_shows_rows_and_verdict(self, monkeypatch, capsys) -> None:
        row = Row("7.1", "ii", "printed", "thesis", {"tau_n": 0.275, "vK_p": None}, {"dn": 66.64}, "[notes]")
        found = Reproduction("Table [7.1]", (row,), ("Known: [tau_n].",), {})
        monkeypatch.setattr("shipfp_rs.reproduce.fullscale.reproduce", lambda _: found)
        assert cli.main(["reproduce", "fullscale"]) == 0
        shown = capsys.readouterr().out
        assert "Table [7.1]" in shown
        assert next(line for line in shown.splitlines() if "ii" in line).split()[-2:] == ["0.275", "66.64"]
        assert shown.endswith("Known: [tau_n].\n")

    def test_a_folder_of_something_else_is_left_alone(self, monkeypatch, tmp_path, capsys) -> None:
        monkeypatch.setattr("shipfp_rs.reproduce.fullscale.reproduce", lambda _: Reproduction("", (), (), {}))
        (tmp_path / "notes.txt").write_text("mine")
        assert cli.main(["reproduce", "fullscale", "--out", str(tmp_path)]) == 2
        assert "notes.txt" in one_line(capsys.readouterr().err)
