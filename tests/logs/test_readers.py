"""Files of real loggers give the facts that are known of them; damaged ones a result or one line."""

import re
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pytest
from scipy.io import savemat

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.log import Log
from tests.cli.small_trial import refused
from tests.logger_files import hdf5_file

LOGS = Path(__file__).parents[1] / "data" / "logs"
START = datetime(2026, 5, 1, 10, tzinfo=UTC)


def test_importing_the_package_loads_no_reader() -> None:
    code = "import sys, shipfp_rs, shipfp_rs.logs.log; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"imctermite", "dwdatareader", "nptdms", "h5py", "asammdf", "pyarrow", "scipy"} & set(
        run.stdout.split()
    )
    assert "shipfp_rs.logs.readers" not in run.stdout


class TestFamos:
    @pytest.fixture(autouse=True)
    def _package(self) -> None:
        pytest.importorskip("imctermite")

    @pytest.mark.parametrize(
        ("file", "name", "unit", "rate_hz", "samples", "dtype"),
        [
            ("sampleA.raw", "pressure_Vacuum", "mbar", 200.0, 2402, "float32"),
            ("datasetA_1.raw", "ACC_long", "G", 200.0, 6000, "float32"),
            ("C1_180deg_strain.raw", "C1_180deg_strain", "µm/m", 100.0, 60_000, "float64"),
            ("EngineSpeed.dat", "EngineSpeed", "rpm", 10.0, 116_888, "float64"),
        ],
    )
    def test_known_facts(
        self, file: str, name: str, unit: str, rate_hz: float, samples: int, dtype: str
    ) -> None:
        log = Log.open(LOGS / "famos" / file)
        channel = log.channels[name]
        assert (channel.unit, channel.samples) == (unit, samples)
        assert channel.rate_hz == pytest.approx(rate_hz)
        read = log.read(name)
        assert (read.dtype, read.shape) == (dtype, (samples,))
        stretch = log.read(name, channel.start_s + 1.0, channel.start_s + 2.0)
        np.testing.assert_array_equal(stretch, read[round(rate_hz) : 2 * round(rate_hz)])

    def test_time_counts_from_1980(self) -> None:
        # The recording's own folder, kept in the file, is named 2023-06-13 17-40-00.
        log = Log.open(LOGS / "famos" / "C1_180deg_strain.raw")
        assert log.start_utc == datetime(2023, 6, 13, 17, 36, 58, tzinfo=UTC)
        assert log.channels["C1_180deg_strain"].start_s == pytest.approx(182.0, abs=0.5)

    def test_strain_is_scaled_as_the_file_says(self) -> None:
        # -5033 counts of 0.05150803287 um/m each
        log = Log.open(LOGS / "famos" / "C1_180deg_strain.raw")
        assert log.read("C1_180deg_strain")[0] == pytest.approx(-5033 * 0.05150803287, rel=1e-12)

    def test_breakage_c5_pairs_of_time_and_value_are_read(self) -> None:
        with pytest.warns(LogWarning, match="clock set back"):
            log = Log.open(LOGS / "famos" / "XY_dataset_example.dat")
        (channel,) = log.channels.values()
        assert (channel.samples, channel.start_s) == (13094, pytest.approx(67.855759))
        assert channel.rate_hz == pytest.approx(40.0, rel=1e-3)


class TestTdms:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        tdms = pytest.importorskip("nptdms")
        path = tmp_path / "log.tdms"
        facts = {
            "wf_increment": 0.01,
            "wf_start_time": np.datetime64("2026-05-01T10:00:00"),
            "unit_string": "V",
        }
        with tdms.TdmsWriter(path) as writer:
            for dtype in ("float32", "float64", "int16", "int32"):
                samples = np.arange(500).astype(dtype)
                writer.write_segment([tdms.ChannelObject("a", dtype, samples, facts)])
            late = {**facts, "wf_increment": 0.5, "wf_start_time": np.datetime64("2026-05-01T10:00:02")}
            writer.write_segment([tdms.ChannelObject("b", "slow", np.arange(7.0), late)])
        return path

    def test_gives_back_what_was_written(self, file: Path) -> None:
        log = Log.open(file)
        assert log.start_utc == datetime(2026, 5, 1, 10, tzinfo=UTC)
        for dtype in ("float32", "float64", "int16", "int32"):
            assert (log.channels[dtype].unit, log.channels[dtype].rate_hz) == ("V", 100.0)
            np.testing.assert_array_equal(log.read(dtype), np.arange(500).astype(dtype), strict=True)
        slow = log.channels["slow"]
        assert (slow.samples, slow.rate_hz, slow.start_s) == (7, 2.0, 2.0)

    @pytest.mark.parametrize("stamp", [{"wf_start_time": np.datetime64("2026-05-01T10:00:00")}, {}])
    def test_a_channel_that_some_segments_lack_resumes_beside_the_others(
        self, stamp: dict[str, np.datetime64], tmp_path: Path
    ) -> None:
        tdms = pytest.importorskip("nptdms")
        facts = {"wf_increment": 0.01, **stamp}
        with tdms.TdmsWriter(tmp_path / "log.tdms") as writer:
            for names, first in (("ab", 0), ("a", 10), ("ab", 20)):
                values = np.arange(first, first + 10.0)
                writer.write_segment([tdms.ChannelObject("G", name, values, facts) for name in names])
        with pytest.warns(LogWarning, match="'b'.*rows missing at samples 10 to 19"):
            log = Log.open(tmp_path / "log.tdms")
        np.testing.assert_array_equal(log.read("b")[[0, 9, 20, 29]], [0.0, 9.0, 20.0, 29.0])
        assert any("3 segments of a are joined" in note for note in log.notes) == (not stamp)
        assert (np.isfinite(log.read("a")).all(), np.isnan(log.read("b")[10:20]).all()) == (True, True)


class TestDewesoft:
    FILE = LOGS / "dewesoft" / "Example_Drive01.d7d"

    def test_undecoded_can_is_left_out_and_the_rest_read(self) -> None:
        pytest.importorskip("dwdatareader")
        with pytest.warns(LogWarning) as told:
            log = Log.open(self.FILE)
        assert re.search("left out.*ENG_RPM", " ".join(str(warning.message) for warning in told))
        assert log.start_utc is not None
        assert log.start_utc.replace(microsecond=0) == datetime(2003, 10, 9, 21, 27, 46, tzinfo=UTC)
        speed = log.channels["GPSvel"]
        assert (speed.unit, speed.rate_hz, speed.samples, speed.stop_s) == ("kph", 100.0, 9580, 95.8)
        assert "ENG_RPM" not in log.channels
        assert log.read("GPSvel")[0] == pytest.approx(89.2578125)


class TestMdf:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        asammdf = pytest.importorskip("asammdf")
        path = tmp_path / "log.mf4"
        fast, slow = np.arange(500) / 100, 2.0 + np.arange(7) / 2
        volts = {"a": 0.5, "b": 10.0}
        with asammdf.MDF(version="4.10") as mdf:
            mdf.header.start_time = START
            mdf.append(
                [
                    asammdf.Signal(
                        np.arange(500, dtype=np.int16), fast, name="counts", conversion=volts, unit="V"
                    ),
                    asammdf.Signal(np.arange(500, dtype=np.float32), fast, name="torque", unit="Nm"),
                    asammdf.Signal(np.array([b"x"] * 500), fast, name="note", encoding="utf-8"),
                ]
            )
            mdf.append([asammdf.Signal(np.arange(7.0), slow, name="torque", unit="kNm")])
            mdf.append([asammdf.Signal(np.arange(7.0), np.arange(7.0) ** 2, name="events")])
            mdf.save(path, compression=2)
        return path

    def test_groups_have_their_own_time_base(self, file: Path) -> None:
        with pytest.warns(LogWarning) as told:
            log = Log.open(file)
        said = " ".join(str(warning.message) for warning in told)
        assert "left out, no numbers or no uniform time base: note" in said
        assert "time of group 2' is not uniform, steps of 1 to 9 s: resampled" in said
        assert log.start_utc == START
        assert list(log.channels) == ["counts", "torque 0", "torque 1", "events"]
        np.testing.assert_allclose(log.read("events")[[0, 1, 4, 9, 16, 25, 36]], np.arange(7.0))
        slow = log.channels["torque 1"]
        assert (slow.unit, slow.rate_hz, slow.samples, slow.start_s) == ("kNm", 2.0, 7, 2.0)
        np.testing.assert_array_equal(log.read("counts"), 10.0 + 0.5 * np.arange(500))
        np.testing.assert_array_equal(
            log.read("torque 0", 1.0, 2.0), np.arange(100, 200, dtype=np.float32), strict=True
        )

    def test_a_file_without_samples_is_refused(self, tmp_path: Path) -> None:
        asammdf = pytest.importorskip("asammdf")
        with asammdf.MDF(version="4.10") as mdf:
            mdf.save(tmp_path / "log.mf4")
        with pytest.raises(InputError, match="no samples in it"):
            Log.open(tmp_path / "log.mf4")


class TestHdf5:
    @pytest.fixture
    def path(self, tmp_path: Path) -> Path:
        pytest.importorskip("h5py")
        return tmp_path / "log.h5"

    def test_channels_have_the_unit_rate_and_start_that_stand_nearest(self, path: Path) -> None:
        with hdf5_file(path) as file:
            file.attrs["sample_rate"] = 100.0
            file.create_dataset("bridge/torque", data=np.arange(300, dtype=np.float32)).attrs["units"] = "V"
            slow = file.create_dataset("engine/speed [rpm]", data=np.arange(30, dtype=np.int16))
            slow.attrs.update({"dt": 0.1, "start_utc": "2026-05-01T12:00:02+02:00"})
            file["bridge"].attrs["start_utc"] = START.isoformat()
            file["picture"] = np.zeros((3, 4))
        with pytest.warns(LogWarning, match="no numbers along one axis: picture"):
            log = Log.open(path)
        assert log.start_utc == START
        assert dict(log.channels) == {
            "bridge/torque": Channel("bridge/torque", "V", 100.0, 300, 0.0),
            "engine/speed": Channel("engine/speed", "rpm", 10.0, 30, 2.0),
        }
        np.testing.assert_array_equal(
            log.read("engine/speed", 3.0, 4.0), np.arange(10, 20, dtype=np.int16), strict=True
        )

    def test_a_time_beside_the_channels_is_their_base(self, path: Path) -> None:
        with hdf5_file(path) as file:
            file["time"] = 500.0 + 20.0 * np.arange(50)
            file["time"].attrs["units"] = "milliseconds since 2026-05-01 10:00:00"
            file["u"] = np.arange(50.0)
            file["late/time"] = 1.0 + np.arange(50) / 10
            file["late/u"] = np.arange(50.0)
            file["stamped/time"] = START.timestamp() + np.arange(50) / 5
            file["stamped/u"] = np.arange(50.0)
        file_log = Log.open(path)
        assert file_log.channels["late/u"].rate_hz == pytest.approx(10.0)
        assert (file_log.channels["u"].rate_hz, file_log.channels["u"].start_s) == pytest.approx((50.0, 0.5))
        stamped = file_log.channels["stamped/u"]
        assert (stamped.rate_hz, stamped.start_s) == pytest.approx((5.0, 0.0))
        assert file_log.start_utc == START

    def test_fields_of_a_table_are_channels(self, path: Path) -> None:
        table = np.zeros(20, [("time", "f8"), ("u", "i4")])
        table["time"], table["u"] = np.arange(20) / 4, np.arange(20)
        with hdf5_file(path) as file:
            file["table"] = table
        log = Log.open(path)
        assert log.channels["table/u"].rate_hz == 4.0
        np.testing.assert_array_equal(log.read("table/u"), np.arange(20, dtype=np.int32), strict=True)

    def test_a_compression_that_h5py_lacks_is_named(self, path: Path) -> None:
        h5py = pytest.importorskip("h5py")
        layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        layout.set_chunk((100,))
        layout.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))  # Zstandard, a plugin
        with h5py.File(path, "w") as file:
            space = h5py.h5s.create_simple((100,))
            raw = h5py.h5d.create(file.id, b"u", h5py.h5t.NATIVE_DOUBLE, space, layout)
            raw.write_direct_chunk((0,), b"compressed")
            file.attrs["fs"] = 10.0
        log = Log.open(path)
        with pytest.raises(
            InputError, match=r"'/u' is compressed with filter 32015.*which h5py lacks; pack it again"
        ):
            log.read("u")


class TestMatlab:
    def test_a_vector_of_times_is_the_base_of_those_of_its_length(self, tmp_path: Path) -> None:
        path = tmp_path / "log.mat"
        savemat(path, {"t": 3.0 + np.arange(40) / 20, "u": np.arange(40, dtype=np.int16), "title": "trial"})
        with pytest.warns(LogWarning, match="left out, no vectors of numbers: title"):
            log = Log.open(path)
        assert dict(log.channels) == {"u": Channel("u", "", 20.0, 40, 3.0)}
        np.testing.assert_array_equal(log.read("u", 4.0, 4.5), np.arange(20, 30, dtype=np.int16), strict=True)


@pytest.mark.parametrize(
    ("suffix", "content", "message"),
    [
        (".h5", {"u": np.arange(5.0)}, "no time base for 'u'"),
        (".h5", {"picture": np.zeros((3, 4))}, "no numbers along one axis: picture"),
        (".h5", {}, "no samples in it"),
        (".mat", {"u": np.arange(5.0)}, "no time base for 'u'"),
        (".mat", {"s": "text"}, "no vectors of numbers: s"),
        (".mat", {}, "no variables"),
    ],
)
def test_what_holds_no_channel_is_refused(tmp_path: Path, suffix: str, content: dict, message: str) -> None:
    path = tmp_path / f"log{suffix}"
    if suffix == ".mat":
        savemat(path, content)
    else:
        with hdf5_file(path) as file:
            file.update(content)
    with pytest.raises(InputError, match=message):
        Log.open(path)


@pytest.mark.parametrize(
    "suffix", [".mf4", ".mdf", ".h5", ".mat", ".tdms", ".raw", ".d7d", ".parquet", ".feather", ".csv"]
)
@pytest.mark.parametrize(
    ("content", "message"), [(b"", "the file is empty"), (b"This is a letter, not a log.\n" * 40, "")]
)
def test_what_holds_something_else_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str, content: bytes, message: str
) -> None:
    path = tmp_path / f"log{suffix}"
    path.write_bytes(content)
    error = refused(["convert", str(path), str(tmp_path / "out.parquet")], capsys)
    assert str(path) in error
    assert message in error


def test_a_cut_or_encrypted_parquet_file_is_refused_with_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    Log.from_arrays({"u": np.arange(9.0)}, rate_hz=1.0).write(path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    with pytest.raises(InputError, match=r"has no footer.*cut short"):
        Log.open(path)
    path.write_bytes(b"PARE" + whole[4:-4] + b"PARE")
    with pytest.raises(InputError, match="is encrypted"):
        Log.open(path)


def test_an_arrow_file_without_its_footer_gives_its_whole_batches(tmp_path: Path) -> None:
    path = tmp_path / "log.feather"
    table = pa.table({"time": np.arange(1000) / 10, "u": np.arange(1000.0)})
    pa.feather.write_feather(table, path, chunksize=100)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.warns(LogWarning, match=r"cut short.*read its \d whole record batches of \d00 rows"):
        log = Log.open(path)
    read = log.read("u")
    assert 300 <= len(read) <= 600
    np.testing.assert_array_equal(read, np.arange(len(read)))
