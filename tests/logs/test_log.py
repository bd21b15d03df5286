"""Logs give back what the logger wrote, in bounded memory, or say in one line why they can't."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet
import pytest

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs import log as log_module
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers import parquet

RATE_HZ = 2000.0
TIME = np.arange(5000) / RATE_HZ
TORQUE = np.sin(TIME) + 1.6
PULSES = (np.arange(5000) % 97 < 20).astype(np.int16) * 1000


def table(**extra: Any) -> pa.Table:
    return pa.table({"time": TIME + 10.0, "torque [V]": TORQUE, "PTM_1": PULSES, **extra})


def write(path: Path) -> Path:
    match path.suffix:
        case ".parquet":
            pa.parquet.write_table(table(), path, row_group_size=1234)
        case ".feather":
            pa.feather.write_feather(table(), path, chunksize=777)
        case ".csv":
            rows = zip(TIME + 10.0, TORQUE.tolist(), PULSES, strict=True)
            lines = (f"{t:.4f},{u!r},{p}\n" for t, u, p in rows)
            path.write_text("time [s],torque [V],PTM_1\n" + "".join(lines))
    return path


@pytest.fixture(params=["run.parquet", "run.feather", "run.csv"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return write(tmp_path / request.param)


def test_every_format_tells_the_same_channels_and_samples(path: Path) -> None:
    log = Log.open(path)
    assert list(log.channels) == ["torque", "PTM_1"]
    torque = log.channel("torque")
    assert (torque.unit, torque.samples, torque.start_s) == ("V", 5000, 10.0)
    assert torque.rate_hz == pytest.approx(RATE_HZ, rel=1e-9)
    assert log.channel("PTM_1").unit == ""
    np.testing.assert_array_equal(log.read("torque"), TORQUE)
    np.testing.assert_array_equal(log.read("PTM_1"), PULSES)
    with pytest.raises(InputError, match="no channel 'tork', found torque, PTM_1; did you mean 'torque'"):
        log.read("tork")


@pytest.mark.parametrize(("start_s", "stop_s"), [(10.0, 12.5), (10.6, 11.9), (11.2345, 11.235), (12.0, 12.5)])
def test_a_stretch_is_the_same_slice_in_every_format(path: Path, start_s: float, stop_s: float) -> None:
    first, last = round((start_s - 10.0) * RATE_HZ), round((stop_s - 10.0) * RATE_HZ)
    np.testing.assert_array_equal(Log.open(path).read("torque", start_s, stop_s), TORQUE[first:last])


@pytest.mark.parametrize("size", [1, 100, 1234, 9999])
def test_chunks_are_never_longer_than_asked_and_miss_nothing(path: Path, size: int) -> None:
    chunks = list(Log.open(path).chunks("PTM_1", size, start_s=10.3, stop_s=10.9))
    assert max(map(len, chunks)) <= size
    np.testing.assert_array_equal(np.concatenate(chunks), PULSES[600:1800])


def test_a_written_log_reads_back_with_units_rate_and_start(tmp_path: Path, path: Path) -> None:
    log = Log.open(path)
    again = Log.open(log.write(tmp_path / "copy.parquet"))
    assert dict(again.channels) == dict(log.channels)
    for name in log.channels:
        np.testing.assert_array_equal(again.read(name), log.read(name))


def test_channels_of_different_rates_share_one_parquet_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (log_module, parquet):
        monkeypatch.setattr(module, "BLOCK", 64)
    fast = Log.from_arrays({"u": np.arange(1000, dtype=np.int16)}, rate_hz=2000.0, units={"u": "mV"})
    slow = Log.from_arrays({"w": np.array([1.0, np.nan, 3.0])}, rate_hz=5.0, start_s=0.1)
    both = Log(
        "both",
        [*fast.channels.values(), *slow.channels.values()],
        lambda name, first, size: (fast if name == "u" else slow)._blocks(name, first, size),
    )
    again = Log.open(both.write(tmp_path / "both.parquet"))
    assert dict(again.channels) == dict(both.channels)
    np.testing.assert_array_equal(again.read("w"), [1.0, np.nan, 3.0])
    assert again.read("u").dtype == np.int16
    np.testing.assert_array_equal(again.read("u"), np.arange(1000))


def test_integers_with_gaps_survive_being_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (log_module, parquet):
        monkeypatch.setattr(module, "BLOCK", 4)
    counts = pa.array([1, 2, 3, 4, None, 6, 7], type=pa.int16())
    pa.parquet.write_table(pa.table({"counts": counts}), tmp_path / "run.parquet")
    log = Log.open(tmp_path / "run.parquet", rate_hz=1.0)
    again = Log.open(log.write(tmp_path / "copy.parquet"))
    np.testing.assert_array_equal(again.read("counts"), [1, 2, 3, 4, np.nan, 6, 7])


def test_timestamps_are_a_time_base_and_a_rate_that_contradicts_them_is_told(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    stamps = pa.array((TIME * 1e6).round().astype(np.int64), type=pa.timestamp("us"))
    pa.parquet.write_table(pa.table({"Time": stamps, "u": TORQUE}), path)
    assert Log.open(path).channel("u").rate_hz == pytest.approx(RATE_HZ)
    with pytest.warns(LogWarning, match="a rate of 1e-09 Hz is given, but the column of time tells 2000 Hz"):
        assert Log.open(path, rate_hz=1e-9).channel("u").rate_hz == 1e-9


def test_a_given_rate_is_trusted_above_a_coarse_time_column(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,u\n" + "".join(f"{t:.2f},{u:.4f}\n" for t, u in zip(TIME + 3.0, TORQUE, strict=True)))
    with pytest.warns(LogWarning, match="one time for several rows: taken as even at 2000 Hz"):
        assert Log.open(path).channel("u").rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    channel = Log.open(path, rate_hz=RATE_HZ).channel("u")
    assert (channel.rate_hz, channel.start_s) == (RATE_HZ, 3.0)


def test_nothing_is_left_behind_when_writing_fails(tmp_path: Path) -> None:
    def broken(name: str, first: int, size: int) -> Any:
        yield np.zeros(3)
        raise InputError("the logger's file ends here")

    log = Log("broken", list(Log.from_arrays({"u": np.zeros(9)}, rate_hz=1.0).channels.values()), broken)
    with pytest.raises(InputError, match="ends here"):
        log.write(tmp_path / "out.parquet")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,u\n", "empty"),
        ("time,u\n0,1\n1,2\n2,3\n,4\n4,5\n", "no time in row 4"),
        ("time,u\n2,1\n1,2\n", "does not increase"),
        ("time [Nm],u\n1,1\n2,2\n", "'time' is in 'Nm', expected timestamps or a number of s, ms"),
        ("time,u,u\n0,1,1\n1,2,2\n", "'u' appears twice"),
        ("\xff\xfet\0i\0m\0e\0\n\0", "without rows of numbers"),
        ("t\0\0\0i\0\0m\0e\0\n\0", "not a text file, since it contains zero bytes"),
        ("time,u\n0,1\n1,2\n2,3,4\n", "line 4.*Expected 2 columns, got 3"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=message) as caught:
        Log.open(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("start_s", "stop_s"), [(0.0, 11.0), (11.0, 13.0), (11.0, 11.0), (12.0, 11.0)])
def test_stretches_outside_the_log_are_refused(path: Path, start_s: float, stop_s: float) -> None:
    with pytest.raises(InputError, match=r"runs from 10 to 12\.5 s"):
        Log.open(path).read("torque", start_s, stop_s)


@pytest.mark.parametrize("start_s", [10.00001, 12.49999])
def test_a_stretch_between_two_samples_is_refused(path: Path, start_s: float) -> None:
    with pytest.raises(InputError, match="channel 'torque' has no sample in this stretch"):
        Log.open(path).read("torque", start_s, start_s + 1e-6)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("missing.parquet", "no such file, expected a log file"),
        ("run.xyz", "unknown log format '.xyz', expected one of .parquet"),
    ],
)
def test_paths_that_are_no_log_are_refused(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Log.open(tmp_path / name)


def test_an_empty_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    pa.parquet.write_table(table().slice(0, 0), path)
    with pytest.raises(InputError, match="no samples"):
        Log.open(path, rate_hz=1.0)
