"""The command line: exit statuses, one-line errors, JSON, and no trace of a traceback."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import cli
from shipfp_rs.errors import IdentificationError, InternalError
from shipfp_rs.experiments.parquet import read_experiments
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.trial import Trial
from shipfp_rs.reproduce import Reproduction, Row
from shipfp_rs.reproduce.fullscale import FILES, best_of
from tests.cli.small_trial import refused
from tests.logger_files import altered


def shipfp(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "shipfp_rs.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
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

    @pytest.mark.parametrize("table", ["", "fullscale", "virtual", "twin"])
    def test_every_table_to_reproduce_has_help(self, table, capsys) -> None:
        assert cli.main(["reproduce", *table.split(), "--help"]) == 0
        assert f"Usage: shipfp reproduce {table}" in capsys.readouterr().out

    def test_without_arguments_it_shows_its_commands(self, capsys) -> None:
        assert cli.main([]) == 0
        assert "reproduce" in capsys.readouterr().out

    def test_the_version_is_the_package_s(self, capsys) -> None:
        from shipfp_rs import __version__

        assert cli.main(["--version"]) == 0
        assert capsys.readouterr().out == f"shipfp {__version__}\n"

    @pytest.mark.parametrize(
        ("error", "status", "words"),
        [
            (KeyboardInterrupt(), 130, "interrupted"),
            (IdentificationError("no start led\n  to a minimum"), 2, "no start led to a minimum"),
            (InternalError("kernel panicked"), 1, "SHIPFP_TRACEBACK=1"),
            (ZeroDivisionError("division by zero"), 1, "internal error: ZeroDivisionError: division by zero"),
            (
                OSError(28, "No space left on device", "/full"),
                2,
                "/full: No space left on device; choose another disk",
            ),
            (
                PermissionError(13, "Permission denied", "a.csv"),
                2,
                "a.csv: Permission denied; give yourself the right",
            ),
            (MemoryError(), 1, "out of memory"),
        ],
    )
    def test_whatever_goes_wrong_costs_one_line(
        self, monkeypatch, tmp_path, capsys, error, status, words
    ) -> None:
        monkeypatch.setattr("shipfp_rs.support.files.write_text_atomically", raising(error))
        assert cli.main(["init", str(tmp_path)]) == status
        assert words in one_line(capsys.readouterr().err)

    def test_the_traceback_is_there_for_those_who_ask(self, monkeypatch, tmp_path, capsys) -> None:
        monkeypatch.setenv("SHIPFP_TRACEBACK", "1")
        monkeypatch.setattr("shipfp_rs.support.files.write_text_atomically", raising(ZeroDivisionError("0")))
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
        assert (done.returncode, done.stderr) == (0, "")


class TestInit:
    def test_the_file_it_writes_is_a_trial(self, tmp_path) -> None:
        from shipfp_rs.processing.trial import Trial

        done = shipfp("init", tmp_path / "new")
        assert (done.returncode, done.stderr) == (0, "")
        assert str(tmp_path / "new" / "TRIAL.toml") in done.stdout.replace("\n", "")
        assert Trial.load(tmp_path / "new" / "TRIAL.toml").windows

    @pytest.mark.parametrize(("torque", "measured"), [("Drehmoment Welle", True), ("Kanal 7", False)])
    def test_a_log_s_channels_are_filled_in_under_their_own_names(self, tmp_path, torque, measured) -> None:
        time = np.arange(0.0, 60.0, 1 / 500)
        channels = {
            "Sollwert": -5.0 + 0.1 * np.sin(np.where((time > 20) & (time < 50), 2 * np.pi * time, 0.0)),
            torque: 1.7 + 0.01 * np.random.default_rng(0).normal(size=time.size),
            'Impuls "4"': 5.0 * (np.sin(2 * np.pi * 20 * time) > 0),
        }
        log = Log.from_arrays(channels, rate_hz=500.0, units={"Sollwert": "V", torque: "mV"})
        log.write(tmp_path / "a log.parquet")
        assert cli.main(["init", str(tmp_path), "--log", str(tmp_path / "a log.parquet")]) == 0
        found = tomllib.loads((tmp_path / "TRIAL.toml").read_text())["channels"]
        asked = {"unit": "V", "calibration": "to be given"}
        assert found.pop("set_point") == {"column": "Sollwert", **asked}
        if measured:
            assert found.pop("torque") == {"column": torque, **asked, "unit": "mV", "location": "gauge"}
        train = {"pulses_per_rev": "to be given", "shaft": "to be given"}
        assert found == {'Impuls "4"': {"column": 'Impuls "4"', **train}}
        text = (tmp_path / "TRIAL.toml").read_text()
        assert re.search(r"(?m)^# Sollwert \[V\], [\d.]+ Hz: set point by its name$", text)
        assert f"# {torque} [mV]" in text
        assert "20 pulses a second" in text

    def test_what_is_recorded_in_rpm_and_knm_needs_no_calibration(self, tmp_path, capsys) -> None:
        """A text log of two lines of figures without time, unit-bearing heads, and nothing but rest in it."""
        rows = "\n".join(f"{1183.8 + 0.1 * (k % 3):.1f};{1.725 + 1e-3 * (k % 5):.3f}" for k in range(6000))
        (tmp_path / "run.csv").write_text(f"n_set [rpm];Torque [kNm]\n{rows}\n".replace(".", ","))
        arguments = ["init", str(tmp_path / "new"), "--log", str(tmp_path / "run.csv")]
        assert "give rate_hz (--rate)" in refused(arguments, capsys)
        assert cli.main([*arguments, "--rate", "100"]) == 0
        told = " ".join(capsys.readouterr().out.split())
        assert "no channel is a pulse train" in told
        assert "nothing but rest" in told
        trial = tomllib.loads((tmp_path / "new" / "TRIAL.toml").read_text())
        assert trial["trial"]["rate_hz"] == 100.0
        assert trial["channels"]["set_point"] == {"column": "n_set", "unit": "rpm"}
        assert trial["channels"]["torque"] == {"column": "Torque", "unit": "kNm", "location": "gauge"}
        assert "windows" not in trial


class TestSimulate:
    @pytest.mark.parametrize("kind", ["chirp", "steps", "multisine", "sines"])
    def test_a_clean_experiment_comes_with_its_truth(self, kind, tmp_path, capsys) -> None:
        out = tmp_path / "sub" / f"{kind}.parquet"
        options = ["--excitation", kind, "--duration", "60", "--amplitude-rpm", "20", "--out", str(out)]
        assert cli.main(["simulate", "stan-launch-804", *options]) == 0
        assert capsys.readouterr().err == ""
        (experiment,) = read_experiments(out)
        assert experiment.duration == pytest.approx(60.0, abs=0.02)
        assert np.abs(experiment.signals["n_set"] - 1300.0).max() == pytest.approx(20.0, rel=0.02)
        truth = json.loads(out.with_suffix(".truth.json").read_text())["parameters"]
        assert truth["tau_n"] == pytest.approx(
            1.513, abs=0.002
        )  # eq. 3.23 with the shaft torque of Table 3.5
        assert truth["vK_p"] == pytest.approx(15.83, abs=0.005)  # eq. 5.1 and Table 3.6

    def test_the_seed_decides_the_noise(self, tmp_path) -> None:
        speeds = []
        for seed in (1, 1, 2):
            out = tmp_path / "noisy.parquet"
            options = f"--noise 0.1 --duration 20 --seed {seed} --force --out".split()
            assert cli.main(["simulate", "stan-tug-1205", *options, str(out)]) == 0
            speeds.append(read_experiments(out)[0].signals["n_e"])
        assert np.array_equal(speeds[0], speeds[1])
        assert not np.array_equal(speeds[0], speeds[2])

    def test_a_raw_log_comes_with_a_trial_that_reads_it(self, tmp_path, capsys) -> None:
        out = tmp_path / "raw.parquet"
        options = ["--raw", "--duration", "5", "--json", "--out", str(out)]
        assert cli.main(["simulate", "stan-tug-1205", *options]) == 0
        told = json.loads(capsys.readouterr().out)
        trial = Trial.load(told["files"]["trial"])
        log = Log.open(trial.trial.log[0])
        assert {channel.rate_hz for channel in log.channels.values()} == {2000.0}
        assert [window.name for window in trial.windows] == [window["name"] for window in told["windows"]]
        assert set(told["faults"]) == {"A", "C", "D1"}

    def test_files_that_are_there_stay(self, tmp_path, capsys) -> None:
        (tmp_path / "log.truth.json").write_text("mine")
        out = str(tmp_path / "log.parquet")
        assert "log.truth.json: exists already" in refused(
            ["simulate", "stan-tug-1205", "--out", out], capsys
        )
        assert [file.name for file in tmp_path.iterdir()] == ["log.truth.json"]


@pytest.fixture(scope="module")
def shown(tmp_path_factory) -> tuple[dict, Path]:
    """Run the demo once; return what it told as JSON, and its folder."""
    out = tmp_path_factory.mktemp("demo") / "shipfp-demo"
    done = shipfp("demo", "--json", "--out", out)
    assert done.stderr == ""
    assert done.returncode == 0
    return json.loads(done.stdout), out


class TestDemo:
    def test_the_folder_holds_the_log_the_settings_and_the_results(self, shown) -> None:
        told, out = shown
        assert told["folder"] == str(out)
        names = "TRIAL.toml experiments.parquet fingerprint.json log.parquet report.html truth.json"
        assert sorted(file.name for file in out.iterdir()) == names.split()
        assert [entry.name for entry in out.parent.iterdir()] == [out.name]

    def test_its_last_line_names_the_page_to_open(self, tmp_path) -> None:
        out = tmp_path / "shown"
        last = shipfp("demo", "--out", out).stdout.splitlines()[-1]
        assert last == f"Open {out / 'report.html'} in a browser."
        assert (out / "report.html").is_file()

    def test_what_the_data_tell_agrees_with_the_truth(self, shown) -> None:
        told, _ = shown
        estimates = {**told["fingerprint"]["parameters"], **told["fingerprint"]["derived"]}
        known = {name: entry for name, entry in estimates.items() if entry["std"] is not None}
        assert {"p", "tau_prop", "(p-g)/tau_n", "vK_p/tau_n", "vK_i/tau_n"} <= set(known)
        for name, entry in known.items():
            if name not in told["truth"]:
                continue  # how late the torque's channel tells
            # 1 % besides the interval: the plant is nonlinear, the model is not.
            allowed = 3.0 * entry["std"] + 0.01 * abs(told["truth"][name])
            assert abs(entry["value"] - told["truth"][name]) < allowed, name

    def test_the_model_that_the_data_chose_stands(self, shown) -> None:
        fingerprint = shown[0]["fingerprint"]
        assert fingerprint["structure"]["kind"] == "ship"
        assert fingerprint["adequate"]["stands"]
        assert fingerprint["usable"].startswith("Usable")
        assert fingerprint["elements"]["dead_time_loop"]["state"] == "off"
        # An inertia behind a gauge is told by the curvature of the propeller's torque alone, and widely.
        assert fingerprint["parameters"]["tau_n"]["std"] > 10.0 * fingerprint["parameters"]["tau_prop"]["std"]

    def test_the_saved_results_are_those_told(self, shown) -> None:
        told, out = shown
        assert Fingerprint.load(out / "fingerprint.json").to_dict() == told["fingerprint"]
        names = [experiment.name for experiment in read_experiments(out / "experiments.parquet")]
        assert names == ["chirp", "multisine"]
        page = (out / "report.html").read_text(encoding="utf-8")
        assert not re.search(r"https?:", page)
        assert str(out.parent) not in page

    def test_every_kind_of_fault_that_was_put_in_was_repaired(self, shown) -> None:
        _, out = shown
        faults = [
            fault
            for experiment in read_experiments(out / "experiments.parquet")
            for fault in experiment.provenance["faults"]
        ]
        assert {fault["kind"] for fault in faults} >= {"A", "C", "D1"}

    def test_the_published_data_follow(self, shown) -> None:
        assert {row["way"] for row in shown[0]["fullscale"]["rows"]} == {"printed", "thesis", "ours"}

    def test_what_is_shown_of_the_published_data_leans_on_nothing_else(self, fullscale) -> None:
        best = best_of(fullscale)
        assert best["tau_n"].status == "unidentifiable"
        assert best["T_set"].value is not None


class TestRun:
    """The demo's trial, spoilt in turn; the search itself is replaced by what the demo found."""

    @pytest.fixture
    def trial(self, shown, tmp_path, monkeypatch) -> Path:
        found = Fingerprint.load(shown[1] / "fingerprint.json")
        self.seeds: list[int] = []

        def identify(*_: object, seed: int, **__: object) -> Fingerprint:
            self.seeds.append(seed)
            return found

        monkeypatch.setattr("shipfp_rs.runs.run.identify", identify)
        monkeypatch.chdir(tmp_path)
        text = (shown[1] / "TRIAL.toml").read_text()
        path = tmp_path / "TRIAL.toml"
        path.write_text(
            text.replace('"log.parquet"', f'"{shown[1] / "log.parquet"}"') + "\n[identify]\nseed = 0\n"
        )
        return path

    def spoil(self, trial: Path, old: str, new: str) -> None:
        text = trial.read_text()
        assert old in text
        trial.write_text(text.replace(old, new))

    def test_the_same_log_gives_the_demo_s_experiments_and_report(
        self, trial, shown, tmp_path, capsys
    ) -> None:
        assert cli.main(["run", str(trial), "--out", "result", "--seed", "7"]) == 0
        assert "Open result/report.html in a browser." in capsys.readouterr().out
        out = tmp_path / "result"
        names = ["TRIAL.toml", "experiments.parquet", "fingerprint.json", "report.html"]
        assert sorted(file.name for file in out.iterdir()) == names
        assert (out / "TRIAL.toml").read_text() == trial.read_text()
        for mine, theirs in zip(
            read_experiments(out / "experiments.parquet"),
            read_experiments(shown[1] / "experiments.parquet"),
            strict=True,
        ):
            assert mine.provenance == theirs.provenance
            np.testing.assert_array_equal(mine.signals["M_g"], theirs.signals["M_g"])
        assert self.seeds == [7]
        # A previous run may be replaced.
        assert cli.main(["run", str(trial), "--out", "result", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["folder"] == "result"
        assert self.seeds == [7, 0]

    def test_a_failure_leaves_nothing_half_written(self, trial, tmp_path, monkeypatch, capsys) -> None:
        monkeypatch.setattr("shipfp_rs.report.write_report", raising(ZeroDivisionError("in the report")))
        assert cli.main(["run", str(trial), "--out", str(tmp_path / "result")]) == 1
        assert "internal error" in one_line(capsys.readouterr().err)
        assert [file.name for file in tmp_path.iterdir()] == ["TRIAL.toml"]

    def test_a_gap_in_the_set_point_is_named_with_its_time(self, trial, shown, tmp_path, capsys) -> None:
        lost = {"U_setpoint": (slice(200_000, 201_000), np.nan)}
        altered(Log.open(shown[1] / "log.parquet"), lost).write(tmp_path / "gap.parquet")
        self.spoil(trial, str(shown[1] / "log.parquet"), "gap.parquet")
        line = refused(["run", str(trial), "--out", "result"], capsys)
        assert "U_setpoint" in line
        assert "from 100 to 100.5 s" in line


def test_the_folder_holds_the_rows_that_are_told_and_the_pictures(
    fullscale, monkeypatch, tmp_path, capsys
) -> None:
    monkeypatch.setattr("shipfp_rs.reproduce.fullscale.reproduce", lambda _: fullscale)
    out = tmp_path / "out"
    assert cli.main(["reproduce", "fullscale", "--json", "--out", str(out)]) == 0
    assert sorted(file.name for file in out.iterdir()) == sorted([*FILES, "fullscale.json"])
    told = capsys.readouterr()
    content = json.loads(told.out)
    assert (told.err, json.loads((out / "fullscale.json").read_text())) == ("", content)
    assert {row["way"] for row in content["rows"]} == {"printed", "thesis", "ours"}
    for row in content["rows"]:
        assert {"table", "case", "way", "structure", "parameters", "fit", "notes"} <= set(row)


class TestReproduceVirtual:
    ROWS = (
        Row("3.5", "1300 rpm", "printed", "plant", {"n_0": 21.677, "vK_p": None}, "[notes]"),
        Row("5.2", "ii", "thesis", "linear", {"tau_n": 1.34862}, fit={"dn": 99.99, "validation dM": 90.7}),
    )

    @pytest.fixture
    def quick(self, monkeypatch) -> None:
        found = Reproduction("Chapters", self.ROWS, ("Known: [tau_n].",), {})
        monkeypatch.setattr("shipfp_rs.reproduce.virtual.reproduce", lambda _: found)
        monkeypatch.setattr("shipfp_rs.reproduce.virtual.responses", None)

    def test_each_table_is_printed_with_its_own_columns(self, quick, capsys) -> None:
        assert cli.main(["reproduce", "virtual"]) == 0
        shown = capsys.readouterr().out
        assert shown.index("Table 3.5") < shown.index("21.677") < shown.index("Table 5.2")
        assert shown.index("validation M [%]") < shown.index("1.3486")
        assert shown.endswith("Known: [tau_n].\n")

    def test_a_result_of_before_is_replaced(self, quick, tmp_path, capsys) -> None:
        for _ in range(2):
            assert cli.main(["reproduce", "virtual", "--json", "--out", str(tmp_path / "out")]) == 0
            assert json.loads((tmp_path / "out" / "virtual.json").read_text()) == json.loads(
                capsys.readouterr().out
            )
