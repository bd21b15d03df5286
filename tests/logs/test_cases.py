"""Logs after troubles that people report in public are read with every sample at its own time."""

import shutil
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.inspection import inspect_log
from shipfp_rs.inspection.pictures import draw
from shipfp_rs.logs.channel import Channel, in_blocks
from shipfp_rs.logs.log import Log
from tests.logger_files import hdf5_file, opened

CASES = Path(__file__).parents[1] / "data" / "cases"


def test_cases_invalid_samples_of_mdf_are_gaps_at_their_place() -> None:
    pytest.importorskip("asammdf")
    log = Log.open(CASES / "inval.mf4")
    rpm = log.read("rpm")
    expected = 900.0 + 50.0 * np.sin(log.channel("rpm").start_s + np.arange(2000) * 0.01)
    expected[300:330] = np.nan
    np.testing.assert_allclose(rpm, expected, atol=0.01)  # the stamps jitter
    np.testing.assert_array_equal(np.concatenate(list(log.chunks("rpm", 64))), rpm)
    assert inspect_log(log).channels


def test_cases_a_block_shorter_than_asked_for_is_an_error() -> None:
    short = in_blocks(lambda name: 10, lambda name, first, stop: np.zeros(stop - first - (first == 4)))
    log = Log("log", [Channel("u", "V", 1.0, 10)], short)
    with pytest.raises(InputError, match="channel 'u' gives 3 samples from sample 4 on, expected 4"):
        list(log.chunks("u", 4))


def test_cases_a_channel_that_ends_early_is_an_error() -> None:
    log = Log("log", [Channel("u", "V", 1.0, 10)], lambda name, first, size: iter([np.zeros(9 - first)]))
    with pytest.raises(InputError, match="log: channel 'u' gives 9 samples from sample 0 on, expected 10"):
        log.read("u")


def test_cases_segments_of_tdms_keep_their_own_times() -> None:
    pytest.importorskip("nptdms")
    with pytest.warns(LogWarning, match="between segments of the file"):
        log = Log.open(CASES / "restart.tdms")
    assert log.start_utc == datetime(2015, 11, 20, 20, 13, 43, 596313, UTC)
    torque = log.read("Torque")
    assert len(torque) == 20_300
    known = np.flatnonzero(np.isfinite(torque))
    np.testing.assert_array_equal(known, [k + 10_000 * part for part in range(3) for k in range(300)])
    joined = Log.open(CASES / "restart.tdms", rate_hz=1000.0)
    np.testing.assert_array_equal(joined.read("Torque"), torque[known])


def test_cases_a_channel_of_zeros_is_drawn_without_a_warning(tmp_path: Path) -> None:
    log = Log.open(CASES / "zero.csv")
    inspection = inspect_log(log)
    assert "Sync" in inspection.spectra
    assert len(draw(inspection, log, tmp_path)) == 2


@pytest.mark.parametrize(
    ("name", "expected", "rate_hz"),
    [
        ("units_min.csv", {"SecL": "sec", "RPM": "rpm", "MAP": "kPa"}, 14.925),
        ("units_min2.csv", {"Engine speed": "rpm", "Shaft torque": "kNm", "Fuel": "g/s"}, 10.0),
        ("ts.msl", {"SecL": "sec", "RPM": "rpm", "MAP": "kPa", "Engine": ""}, 14.925),
    ],
)
def test_cases_names_stand_above_units_whatever_these_are(
    name: str, expected: dict[str, str], rate_hz: float
) -> None:
    log = Log.open(CASES / name)
    assert {channel.name: channel.unit for channel in log.channels.values()} == expected
    assert {channel.start_s for channel in log.channels.values()} == {0.0}
    np.testing.assert_allclose([channel.rate_hz for channel in log.channels.values()], rate_hz, rtol=1e-4)


@pytest.mark.parametrize(
    ("heading", "expected"),
    [
        ("x-axis,1,2\nsecond,Volt,Volt", {"1": "V", "2": "V"}),
        ("Time,A,B\ns,AFR,lambda", {"A": "AFR", "B": "lambda"}),
        ("Time,A,B\nsec,Volts,knots", {"A": "V", "B": "kn"}),
        ("Time,A,B\n-,Percent,psig", {"A": "%", "B": "psig"}),
        ("Run,7,x\nTime,RPM,Fuel", {"RPM": "", "Fuel": ""}),
        (
            "Ship,Start,t0,Day,Ok\nTug,true,10:00:00,2024-03-05,true\nTime,A,B\ns,V,psig",
            {"A": "V", "B": "psig"},
        ),
    ],
)
def test_cases_unknown_units_are_kept_as_text(tmp_path: Path, heading: str, expected: dict[str, str]) -> None:
    log = opened(tmp_path, heading, *(f"{0.01 * k:.2f},{k % 7},{k % 5}" for k in range(40)))
    assert {channel.name: channel.unit for channel in log.channels.values()} == expected


def test_cases_a_time_base_beside_the_headings_is_found() -> None:
    log = Log.open(CASES / "rigol_min.csv")
    assert dict(log.channels) == {name: Channel(name, "V", 50_000.0, 40, -0.002) for name in ("CH1", "CH2")}
    np.testing.assert_allclose(log.read("CH2")[:4], [0.0, 0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    "heading",
    [
        "Model,TDS,,\nSample Interval,2e-5,,\nXzero,-0.002,,\n\nCH1,CH2",
        "XIncrement,2e-5,s,,\nXOrigin,-0.002,s,,\nCH1,CH2",
        "CH1,CH2,t0 =-2.0e-03s, tInc = 2.0e-05s,",
        "X,CH1,CH2,Start,Increment\nSequence,Volt,Volt,-0.002,2e-5",
    ],
)
def test_cases_a_time_base_in_wider_lines_is_found(tmp_path: Path, heading: str) -> None:
    counted = heading.startswith("X,")
    rows = [f"{f'{k},' if counted else ''}{0.1 * (k % 7):.1f},{k % 5}" for k in range(40)]
    log = opened(tmp_path, heading, *rows)
    assert list(log.channels) == ["CH1", "CH2"]
    assert {(round(c.rate_hz, 6), c.start_s) for c in log.channels.values()} == {(50_000.0, -0.002)}


@pytest.mark.filterwarnings("ignore::shipfp_rs.errors.LogWarning")
@pytest.mark.parametrize("suffix", [".dat", ".raw", ".log", ".txt"])
@pytest.mark.parametrize("name", ["inval.mf4", "sl_one.mat"])
def test_cases_first_bytes_decide_under_a_suffix_of_other_formats(
    tmp_path: Path, name: str, suffix: str
) -> None:
    if name.endswith("mf4"):
        pytest.importorskip("asammdf")
    other = (tmp_path / "log").with_suffix(suffix)
    shutil.copyfile(CASES / name, other)
    assert Log.open(other).channels == Log.open(CASES / name).channels


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("sl_one.mat", {"ScopeData/signals/values 1": (1000, 100.0), "ScopeData/signals/values 2": (1000, 100.0)}),
        ("sl_3d.mat", {"out/signals": (1000, 100.0)}),
        ("robometry.mat", {"robot/shaft_speed": (1000, 100.0), "robot/shaft_torque": (1000, 100.0)}),
        ("pu.mat", {"N15_M07_F10_K001_1/Y/speed": (250, 25.0), "N15_M07_F10_K001_1/Y/vibration_1": (1000, 100.0)}),
    ],
)  # fmt: skip
def test_cases_vectors_that_are_no_channels_are_left_out_of_matlab(
    name: str, expected: dict[str, tuple[int, float]]
) -> None:
    with pytest.warns(LogWarning, match="left out"):
        log = Log.open(CASES / name)
    found = {key: (channel.samples, round(channel.rate_hz, 3)) for key, channel in log.channels.items()}
    assert found == expected
    first = log.read(next(iter(expected)))
    np.testing.assert_allclose(first[0], 900.0)


def test_cases_a_time_of_another_run_is_not_taken(tmp_path: Path) -> None:
    with hdf5_file(tmp_path / "log.h5") as file:
        file["one/time"] = np.arange(50) * 0.1
        file["one/n"] = np.arange(50.0)
        file["two/n"] = np.arange(50.0)
    with pytest.warns(LogWarning, match="left out, no time base: two/n"):
        log = Log.open(tmp_path / "log.h5")
    assert list(log.channels) == ["one/n"]


@pytest.mark.filterwarnings("ignore::shipfp_rs.errors.LogWarning")
def test_cases_two_states_are_held_between_rows() -> None:
    log = Log.open(CASES / "pv5.csv")
    assert log.channels["CH_A"] == Channel("CH_A", "", 1.0, 8, 1.0)
    np.testing.assert_array_equal(log.read("CH_A"), [0, 1, 0, 1, 1, 0, 1, 0])
    np.testing.assert_array_equal(np.concatenate(list(log.chunks("CH_A", 3))), log.read("CH_A"))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_cases_channels_with_rows_of_their_own_go_by_these(tmp_path: Path, suffix: str) -> None:
    path = CASES / "sparse_min.csv"
    if suffix == ".parquet":
        pa.parquet.write_table(pa.csv.read_csv(path), path := tmp_path / "log.parquet")
    log = Log.open(path)
    told = {name: (c.start_s, round(c.rate_hz, 6), c.unit) for name, c in log.channels.items()}
    assert told == {
        "Set point": (0.003, 10.0, "rpm"),
        "Torque": (0.007, 50.0, "Nm"),
        "Speed": (0.0, 50.0, "rpm"),
    }
    np.testing.assert_array_equal(log.read("Torque")[:4], [200, 201, 202, 200])
    np.testing.assert_array_equal(np.concatenate(list(log.chunks("Speed", 7))), log.read("Speed"))


def test_cases_vectors_beside_an_object_of_matlab_are_read() -> None:
    with pytest.warns(LogWarning, match="left out, no vectors of numbers; save tables .* an object"):
        log = Log.open(CASES / "mcos_beside_vectors.mat")
    channel = log.channel("speed")
    assert (channel.rate_hz, channel.samples) == (pytest.approx(10.0), 200)
