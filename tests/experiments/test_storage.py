"""Experiments survive the way to a file and back, and folders appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.experiments.parquet import read_experiments, write_experiments
from shipfp_rs.support.files import replacing_folder


def experiment(name: str, rate_hz: float, **signals: np.ndarray) -> Experiment:
    return Experiment(
        name=name,
        rate_hz=rate_hz,
        signals=signals,
        operating_point={"n_set": 1183.8},
        hold="zero",
        kind="steps",
        provenance={"log": "trial.parquet", "masked": {"M_g": 1}},
    )


@pytest.fixture
def trial() -> tuple[Experiment, Experiment]:
    torque = np.array([1725.0, np.nan, 1730.0])
    return (
        experiment("Trial 1 [astern]", 50.0, n_set=np.array([1180.0, 1184.0, 1190.0]), M_g=torque),
        experiment("Trial 2", 20.0, n_set=1180.0 + np.arange(5.0), n_e=1180.1 + np.arange(5.0)),
    )


def test_experiments_come_back_as_they_were_with_masked_samples_and_missing_signals(tmp_path, trial) -> None:
    back = read_experiments(write_experiments(tmp_path / "experiments.parquet", trial))
    for before, after in zip(trial, back, strict=True):
        assert list(after.signals) == list(before.signals)
        for name in before.signals:
            np.testing.assert_array_equal(after.signals[name], before.signals[name])
        for attribute in ("name", "rate_hz", "operating_point", "hold", "kind", "provenance"):
            assert getattr(after, attribute) == getattr(before, attribute)


def test_a_file_of_experiments_states_its_units_to_other_readers(tmp_path, trial) -> None:
    schema = pq.read_schema(write_experiments(tmp_path / "experiments.parquet", trial))
    assert {field.name: field.metadata[b"unit"] for field in schema if field.metadata} == {
        "time_s": b"s",
        "n_set": b"rpm",
        "n_e": b"rpm",
        "M_g": b"Nm",
    }


def test_experiments_that_share_a_name_are_refused(tmp_path, trial) -> None:
    with pytest.raises(InputError, match="each name once"):
        write_experiments(tmp_path / "experiments.parquet", [trial[0], trial[0]])
    assert not list(tmp_path.iterdir())


def test_a_foreign_parquet_file_is_refused(tmp_path) -> None:
    import pyarrow as pa

    pq.write_table(pa.table({"a": [1]}), tmp_path / "other.parquet")
    with pytest.raises(InputError, match="holds no experiments"):
        read_experiments(tmp_path / "other.parquet")
    with pytest.raises(InputError, match=r"missing\.parquet"):
        read_experiments(tmp_path / "missing.parquet")


def write(out: Path, text: str, force: bool = False) -> None:
    with replacing_folder(out, marker="fingerprint.json", others=["report.html"], force=force) as folder:
        (folder / "fingerprint.json").write_text(text)
        (folder / "report.html").write_text(text)


def test_a_folder_appears_whole_and_a_previous_result_is_replaced(tmp_path) -> None:
    out = tmp_path / "deep" / "run"
    write(out, "first")
    write(out, "second")
    assert {file.name: file.read_text() for file in out.iterdir()} == {
        "fingerprint.json": "second",
        "report.html": "second",
    }
    assert [entry.name for entry in out.parent.iterdir()] == ["run"]


def test_an_error_leaves_neither_a_folder_nor_a_trace(tmp_path) -> None:
    def fail() -> None:
        with replacing_folder(tmp_path / "run", marker="fingerprint.json") as folder:
            (folder / "fingerprint.json").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("present", [["notes.txt"], ["fingerprint.json", "notes.txt"], ["report.html"]])
def test_a_folder_with_other_files_is_refused_unless_forced_and_then_keeps_them(tmp_path, present) -> None:
    out = tmp_path / "run"
    out.mkdir()
    for name in present:
        (out / name).write_text("mine")
    with pytest.raises(InputError, match="not a previous result"):
        write(out, "new")
    assert {file.name: file.read_text() for file in out.iterdir()} == dict.fromkeys(present, "mine")
    write(out, "new", force=True)
    found = {file.name: file.read_text() for file in out.iterdir()}
    assert found.pop("notes.txt", "mine") == "mine"
    assert found == {"fingerprint.json": "new", "report.html": "new"}


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path) -> None:
    (tmp_path / "run").write_text("a file")
    with pytest.raises(InputError, match="is a file"):
        write(tmp_path / "run", "new", force=True)


@pytest.mark.parametrize(("name", "value"), [("n_e", 3000.0), ("n_e", 1e12), ("M_g", 1e12), ("M_g", 3.0)])
def test_breakage_a_an_operating_point_far_from_the_signal_is_refused(trial, name, value) -> None:
    signals = {**trial[0].signals, "n_e": np.array([1180.0, 1184.0, 1190.0])}
    with pytest.raises(
        InputError, match=f"signal '{name}' is .* expected an operating point near the signal"
    ):
        Experiment("Trial", 50.0, signals, {"n_set": 1184.0, name: value})
