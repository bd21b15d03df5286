"""Clocks of other makes, rows that are written twice, and values that are recorded when they change."""

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.log import Log
from tests.logger_files import opened


def test_a_packed_clock_counts_on_over_the_hour(tmp_path: Path) -> None:
    seconds = 35998.0 + 0.05 * np.arange(80)
    rows = [f"8,{int(t // 3600):02d}{int(t // 60 % 60):02d}{t % 60:05.2f},{1500 + k % 4}"
            for k, t in enumerate(np.round(seconds, 2))]  # fmt: skip
    log = opened(tmp_path, "sats,time,Engine_Speed (rpm)", *rows)
    channel = log.channel("Engine_Speed")
    assert (round(channel.rate_hz, 6), channel.start_s, channel.samples) == (20.0, 35998.0, 80)
    np.testing.assert_array_equal(log.read("Engine_Speed"), 1500 + np.arange(80) % 4)


def test_a_clock_with_a_gap_wins_over_the_rate_of_a_comment(tmp_path: Path) -> None:
    clock = "095557.00 095558.00 095559.00 095600.00 095959.00 100000.00 100001.00 100002.00"
    rows = [f"008 {time} {1500 + k}" for k, time in enumerate(clock.split())]
    head = "[comments]\nLog Rate (Hz) : 1.00\n\n[column names]\nsats time Engine_Speed\n\n[data]"
    with pytest.warns(LogWarning, match="rows missing at samples 4 to 241"):
        log = opened(tmp_path, head, *rows, name="log.txt")
    speed = log.read("Engine_Speed")
    assert log.channel("Engine_Speed").rate_hz == 1.0
    np.testing.assert_array_equal(speed[[0, 3, 242, 245]], [1500, 1503, 1504, 1507])
    assert np.isnan(speed[4:242]).all()


@pytest.mark.parametrize("times", [1, 2, 3, 5])
def test_a_line_that_is_written_twice_is_one(times: int, tmp_path: Path) -> None:
    lines = [f"2024-03-05T09:59:{10 + k // 10}.{k % 10}00Z,2,127488,5,255,8,00,{0x70 + 4 * (k % 8):02x},17,ff,ff,7f,ff,ff"
             for k in range(40) for _ in range(times)]  # fmt: skip
    log = opened(tmp_path, *lines, name="bus.raw")
    assert log.channel("Engine Speed").rate_hz == pytest.approx(10.0)
    np.testing.assert_array_equal(log.read("Engine Speed"), 1500.0 + np.arange(40) % 8)
    assert [fault.kind for fault in log.faults] == ["repeated"] * (times > 1)


@pytest.mark.parametrize("times", [2, 3])
@pytest.mark.parametrize("blanks", [False, True])
@pytest.mark.parametrize("step_s", [0.1, 0.137])
def test_a_row_that_is_written_again_is_one_and_told(
    step_s: float, blanks: bool, times: int, tmp_path: Path
) -> None:
    """Also where its channels stand in rows of their own."""
    rows = [
        f"{step_s * k:.3f},{'' if blanks and k % 2 else 1500 + k % 7},{'' if blanks and not k % 2 else 40 + k % 3}"
        for k in range(200)
    ]
    text = "\n".join(["Time (s),Speed (rpm),Torque (Nm)", *(row for row in rows for _ in range(times)), ""])
    (tmp_path / "log.csv").write_text(text)
    with pytest.warns(LogWarning, match=r"rows recorded more than once at samples 0 to .*; copies left out"):
        log = Log.open(tmp_path / "log.csv")
    faults = [fault for fault in log.faults if fault.kind == "repeated"]
    every = 2 if blanks else 1
    assert [fault.spans.tolist() for fault in faults] == [[[0, 200 // every]]] * every
    for name, first in (("Speed", 1500 + np.arange(200) % 7), ("Torque", 40 + np.arange(200) % 3)):
        assert log.channel(name).rate_hz == pytest.approx(1.0 / step_s / every, rel=1e-4)
        expected = first[every - 1 if name == "Torque" else 0 :: every]
        np.testing.assert_allclose(log.read(name), expected, atol=0.02)


def test_rows_of_one_time_that_differ_are_no_copies(tmp_path: Path) -> None:
    rows = [f"{k // 10},{1500 + k % 7},{40 + k % 3}" for k in range(400)]
    with pytest.warns(LogWarning, match="one time for several rows: taken as even at 10 Hz"):
        log = opened(tmp_path, "Time (s),Speed (rpm),Torque (Nm)", *rows)
    assert (log.channel("Speed").samples, log.faults) == (400, ())


def test_rows_written_again_under_a_clock_of_whole_seconds_count_once(tmp_path: Path) -> None:
    rows = [f"{k // 10},{1500 + k % 7},{40 + k % 3}" for k in range(400) for _ in range(3)]
    with (
        pytest.warns(LogWarning, match="rows recorded more than once at samples 0 to 399"),
        pytest.warns(LogWarning, match="taken as even at 10 Hz"),
    ):
        log = opened(tmp_path, "Time (s),Speed (rpm),Torque (Nm)", *rows)
    np.testing.assert_array_equal(log.read("Speed"), 1500 + np.arange(400) % 7)


def test_rows_that_an_even_clock_lacks_here_and_there_are_missing(tmp_path: Path) -> None:
    lost = np.arange(20, 980, 25)
    rows = [f"{0.02 * k:.2f},{1500 + k % 7}" for k in range(1000) if k not in lost]
    with pytest.warns(LogWarning, match="rows missing at samples 20 to 20, 45 to 45"):
        speed = opened(tmp_path, "Time (s),Speed (rpm)", *rows).read("Speed")
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(speed)), lost)


def test_a_value_recorded_on_change_is_held_at_the_rate_of_its_scan(tmp_path: Path) -> None:
    moved = np.sort(np.random.default_rng(1).choice(np.arange(1, 1199), 200, replace=False))
    at = np.concatenate([[0], moved, [1199]])
    level = 50.0 + np.cumsum(np.resize([1.0, -2.0, 1.5, -0.25], len(at)))
    rows = [(0.05 * k, f"{0.05 * k:.3f};Setpoint [%];{x:.2f}") for k, x in zip(at, level, strict=True)]
    rows += [(0.05 * k + 0.013, f"{0.05 * k + 0.013:.3f};Speed [rpm];{600 + k % 7}") for k in range(1200)]
    with pytest.warns(LogWarning, match="Setpoint is recorded on change: held at 20 Hz"):
        log = opened(tmp_path, "t [s];Variable;Value", *(row for _, row in sorted(rows)))
    expected = level[np.searchsorted(at, np.arange(1200), side="right") - 1]
    np.testing.assert_allclose(log.read("Setpoint"), expected, atol=1e-9)


@pytest.mark.parametrize("suffix", ["mf4", "tdms", "mat", "h5"])
def test_rows_of_other_formats_that_are_written_again_count_once(suffix: str, tmp_path: Path) -> None:
    path, time = tmp_path / f"log.{suffix}", np.repeat(0.02 * np.arange(200), 3)
    speed = np.repeat(1500.0 + np.arange(200) % 7, 3)
    if suffix == "mf4":
        asammdf = pytest.importorskip("asammdf")
        file = asammdf.MDF(version="4.10")
        file.append([asammdf.Signal(speed, time, name="Speed", unit="rpm")])
        file.save(path)
    elif suffix == "tdms":
        tdms = pytest.importorskip("nptdms")
        with tdms.TdmsWriter(path) as writer:
            writer.write_segment(
                [tdms.ChannelObject("G", "time", time), tdms.ChannelObject("G", "Speed", speed)]
            )
    elif suffix == "mat":
        pytest.importorskip("scipy.io").savemat(path, {"time": time, "Speed": speed})
    else:
        with pytest.importorskip("h5py").File(path, "w") as file:
            file["time"], file["Speed"] = time, speed
    with pytest.warns(LogWarning, match="rows recorded more than once at samples 0 to 199; copies left out"):
        log = Log.open(path)
    (channel,) = log.channels.values()
    assert (channel.rate_hz, [fault.of for fault in log.faults]) == (pytest.approx(50.0), [channel.name])
    np.testing.assert_array_equal(log.read(channel.name), speed[::3])


@pytest.mark.filterwarnings("ignore:.*are no numbers")
def test_headings_written_again_amid_the_rows_are_named(tmp_path: Path) -> None:
    rows = [f"{0.02 * k:.2f},{1500 + k % 7}" for k in range(200)]
    with pytest.raises(InputError, match="has no time in row 201, such as headings written again"):
        opened(tmp_path, "Time (s),Speed (rpm)", *rows, "Time (s),Speed (rpm)", *rows)
