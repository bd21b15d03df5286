"""Files of real loggers give the facts that are known of them; damaged ones a result or one line."""

import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.log import Log

LOGS = Path(__file__).parent / "data" / "logs"


def damaged(source: Path, target: Path, count: int) -> None:
    """Read `count` truncated or altered copies of a file: each must give a log or InputError."""
    draw = np.random.default_rng(1)
    whole = np.fromfile(source, np.uint8)
    for index in range(count):
        content = whole.copy()
        if index % 3 == 0:
            content = content[: draw.integers(len(whole))]
        else:  # most damage to the header, where the structure is
            stop = min(len(whole), 2000) if index % 3 == 1 else len(whole)
            content[draw.integers(0, stop, 8)] = draw.integers(0, 256, 8)
        content.tofile(target)
        try:
            log = Log.open(target)
            for name in log.channels:
                for _ in log.chunks(name):
                    pass
        except InputError as error:
            assert str(target) in str(error)  # noqa: PT017
            assert "\n" not in str(error)  # noqa: PT017


def test_importing_the_package_loads_no_reader() -> None:
    code = "import sys, shipfp_rs, shipfp_rs.log; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"imctermite", "dwdatareader", "nptdms", "h5py"} & set(run.stdout.split())
    assert "shipfp_rs.readers" not in run.stdout


def test_a_missing_package_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imctermite", None)
    with pytest.raises(InputError, match=r"pip install 'shipfp_rs\[famos\]'"):
        Log.open(LOGS / "famos" / "sampleA.raw")


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
            ("EngineSpeed.dat", "EngineSpeed", "RPM", 10.0, 116_888, "float64"),
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

    def test_pairs_are_refused_with_a_word(self) -> None:
        with pytest.raises(InputError, match="pairs of x and y"):
            Log.open(LOGS / "famos" / "XY_dataset_example.dat")

    def test_damage(self, tmp_path: Path) -> None:
        damaged(LOGS / "famos" / "sampleA.raw", tmp_path / "a.raw", 20)  # each in a process of its own


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

    def test_damage(self, file: Path, tmp_path: Path) -> None:
        damaged(file, tmp_path / "damaged.tdms", 200)


class TestDewesoft:
    FILE = LOGS / "dewesoft" / "Example_Drive01.d7d"

    def test_undecoded_can_is_left_out_and_the_rest_read(self) -> None:
        pytest.importorskip("dwdatareader")
        with pytest.warns(UserWarning, match="left out.*ENG_RPM"):
            log = Log.open(self.FILE)
        assert log.start_utc is not None
        assert log.start_utc.replace(microsecond=0) == datetime(2003, 10, 9, 21, 27, 46, tzinfo=UTC)
        speed = log.channels["GPSvel"]
        assert (speed.unit, speed.rate_hz, speed.samples, speed.stop_s) == ("kph", 100.0, 9580, 95.8)
        assert "ENG_RPM" not in log.channels
        assert log.read("GPSvel")[0] == pytest.approx(89.2578125)

    @pytest.mark.filterwarnings("ignore:.*left out")
    def test_damage(self, tmp_path: Path) -> None:
        pytest.importorskip("dwdatareader")
        damaged(self.FILE, tmp_path / "a.d7d", 5)  # each in a process of its own
