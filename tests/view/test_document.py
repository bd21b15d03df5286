"""What the page is told of a log: the faults of `inspect`, windows, spectra, processed signals."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.cli import main
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log, trial_toml
from shipfp_rs.vessel.vessel import Vessel
from shipfp_rs.view.document import Document
from shipfp_rs.view.results import FINER


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A trial of the tug with faults of every other kind."""
    folder = tmp_path_factory.mktemp("trial")
    sensors = Sensors(rate_hz=1000.0)
    chirp = signals.chirp(0.02, 1.5, 100.0, 40.0, rate_hz=1000.0, name="chirp")
    kinds = ("A", "C", "D1", "gap", "stuck", "dropout")
    log, truth = simulate_raw_log(Vessel.load("stan-tug-1205"), chirp, sensors=sensors, faults=kinds, seed=3)
    log.write(folder / "log.parquet")
    (folder / "TRIAL.toml").write_text(trial_toml("stan-tug-1205", "log.parquet", sensors, truth))
    return folder


@pytest.mark.parametrize("with_trial", [False, True])
def test_the_layer_of_faults_is_the_list_of_inspect(folder, capsys, with_trial):
    trial = folder / "TRIAL.toml" if with_trial else None
    assert main(["inspect", str(folder / "log.parquet"), *([str(trial)] if trial else []), "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["faults"]
    document = Document(folder / "log.parquet", trial=trial)
    layer = document.faults.wait()["faults"]
    assert len(layer) == len(listed) > 0
    for drawn, fault in zip(layer, listed, strict=True):
        assert {key: drawn[key] for key in fault} == fault
        rate_hz = document.log().channel(fault["channel"]).rate_hz
        np.testing.assert_allclose(drawn["times"], np.array(fault["spans"]) / rate_hz)


def test_windows_and_the_steady_stretch_are_found(folder):
    document = Document(folder / "log.parquet")
    assert document.windows("U_setpoint").wait()[0] == "U_setpoint"
    told = document.told_windows("U_setpoint")
    kinds = [window["kind"] for window in told["windows"]]
    assert "chirp" in kinds
    assert told["rest"][0] == pytest.approx(0.0, abs=2.0)
    assert told["rest"][1] == pytest.approx(60.0, abs=5.0)


def test_a_stretch_tells_what_it_holds(folder):
    main_window = Document(folder / "log.parquet").within("U_setpoint", None, 40.0, 175.0)["main"]
    assert main_window["kind"] == "chirp"
    assert main_window["frequency_hz"][0] < 0.2
    assert main_window["frequency_hz"][1] == pytest.approx(1.5, rel=0.15)


def test_the_processed_signals_are_those_of_process(folder):
    document = Document(folder / "log.parquet", trial=folder / "TRIAL.toml")
    trial = Trial.load(folder / "TRIAL.toml")
    document.raw.wait()
    document.process(trial)
    assert document._processed.wait()
    (experiment,) = process(document.log(), trial)
    drawn = {one.channel.name: one for one in document.processed}
    assert set(drawn) == {f"{name} in chirp" for name in ("n_set", "n_e", "M_g")}
    for name in ("n_set", "n_e", "M_g"):
        series = drawn[f"{name} in chirp"]
        np.testing.assert_allclose(series.read(0, len(experiment)), experiment.signals[name], rtol=1e-6)
        assert series.channel.start_s == pytest.approx(trial.windows[0].start_s)
    facts = document.facts()
    assert [one["layer"] for one in facts["series"]][-3:] == [
        "processed n_set",
        "processed n_e",
        "processed M_g",
    ]


def test_a_sine_shows_with_its_amplitude_in_the_spectrum(tmp_path):
    time = np.arange(60_000) / 500.0
    samples = 3.0 * np.sin(2 * np.pi * 12.523 * time) + np.random.default_rng(0).normal(0.0, 0.1, len(time))
    path = Log.from_arrays({"torque": samples}, rate_hz=500.0).write(tmp_path / "log.parquet")
    found = Document(path).spectrum(0, 20.0, 100.0)  # the sine lies between two lines
    highest = int(np.argmax(found["amplitude"]))
    assert found["frequency"][highest] == pytest.approx(12.523, abs=0.1)
    assert found["amplitude"][highest] == pytest.approx(3.0, rel=0.02)
    assert [peak["frequency_hz"] for peak in found["peaks"]] == [pytest.approx(12.523, abs=0.01)]
    assert found["peaks"][0]["amplitude"] == pytest.approx(3.0, rel=0.02)


def test_a_channel_without_a_number_is_one_gap(tmp_path):
    channels = {"full": np.arange(5000.0) % 5, "empty": np.full(5000, np.nan)}
    document = Document(Log.from_arrays(channels, rate_hz=100.0).write(tmp_path / "log.parquet"))
    document.raw.wait()
    full, empty = document.facts()["series"]
    assert (full["gaps"], empty["gaps"]) == ([], [[0.0, 50.0]])


def test_the_samples_under_the_finest_stored_tile_are_read_ahead(folder):
    series = Document(folder / "log.parquet").series()[0]
    pieces = series.read.__self__
    series.tile(FINER + 1, 0)
    assert not pieces._held
    series.tile(FINER, 0)
    for _ in range(100):
        if 0 in pieces._held:
            break
        time.sleep(0.05)
    assert 0 in pieces._held


@pytest.mark.parametrize("rate_hz", [1000.0, 50.0, 10.0])
def test_faults_that_the_eye_sees_are_listed_by_page_and_inspect_alike_at_any_rate(tmp_path, capsys, rate_hz):
    """Spikes of a sample or two, a flat stretch and clipped tops of channels that nobody has named, and no others."""
    random = np.random.default_rng(0)
    count = round(max(120.0 * rate_hz, 3000))
    noise = random.normal(0.0, 1.0, (4, count))
    swing = 20.0 * np.sin(2.0 * np.pi * np.arange(count) / (0.1 * count))
    channels = {
        "spiky": 100.0 + noise[0],
        "flat": noise[1].copy(),
        "clipped": np.minimum(100.0 + swing + noise[2], 115.0),
        "sound": noise[3],
        "rounded": np.round(50.0 + noise[0]),
        "wandering": np.cumsum(noise[3]),
    }
    places = [count // 5, count // 3, count // 2]
    for place in places:
        channels["spiky"][place : place + max(round(0.02 * rate_hz), 2)] += random.choice([-30.0, 30.0])
    still = slice(count // 4, count // 4 + max(round(0.5 * rate_hz), 20))
    channels["flat"][still] = channels["flat"][still.start]
    path = Log.from_arrays(channels, rate_hz=rate_hz).write(tmp_path / "log.parquet")
    assert main(["inspect", str(path), "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["faults"]
    layer = Document(path).faults.wait()["faults"]
    assert [{key: drawn[key] for key in fault} for drawn, fault in zip(layer, listed, strict=True)] == listed
    found = {(fault["channel"], fault["kind"]): fault["spans"] for fault in listed}
    assert [start for start, _ in found["spiky", "spike"]] == places
    assert found["flat", "stuck"] == [[still.start, still.stop]]
    assert ("clipped", "clipped") in found
    assert {channel for channel, _ in found} == {"spiky", "flat", "clipped"}


def test_a_train_of_many_pulses_is_told_as_pulses_a_second(tmp_path):
    time = np.arange(0.0, 200.0, 1e-3)
    turns = np.cumsum(np.where(time < 100.0, 10.0, 20.0)) * 1e-3
    log = Log.from_arrays({"P": np.where(turns % 1.0 < 0.4, 5.0, 0.0)}, rate_hz=1000.0)
    document = Document(log.write(tmp_path / "p.parquet"))
    told = document.pulses(0, 0.0, 200.0)
    assert 200 < len(told["time"]) <= 400
    for at, rate in zip(told["time"], told["rate"], strict=True):
        if abs(at - 100.0) > 1.0:
            assert rate == pytest.approx(10.0 if at < 100.0 else 20.0, rel=0.01)
    assert document.pulses(0, 10.0, 12.0) == {"time": [], "rate": []}  # few enough to be seen one by one
