"""A log whose clock jumps is two stretches, each with its own times, and nothing spans both."""

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.process import process
from shipfp_rs.processing.windows import proposed
from tests.processing.test_speed_sources import trial

ROWS = 4000
SWING = 800.0 + 20.0 * np.sin(2 * np.pi * np.arange(ROWS) / 437.0)


def logged(path: Path, time: np.ndarray) -> Path:
    rows = "".join(f"{t:.6f},{x:.6f},{x:.6f}\n" for t, x in zip(time, SWING, strict=True))
    path.write_text("time [s],set point [rpm],speed [rpm]\n" + rows)
    return path


def jumping(by_s: float, uneven: bool, twice: bool = False) -> np.ndarray:
    steps = np.random.default_rng(3).uniform(0.006, 0.014, ROWS) if uneven else np.full(ROWS, 0.01)
    steps[1500] += by_s
    steps[3000] += by_s if twice else 0.0
    return np.cumsum(steps)


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("by_s", [-1.5, -12.0, 1.7e9])
def test_cases_a_clock_set_anew_parts_a_log(tmp_path: Path, by_s: float, uneven: bool) -> None:
    time = jumping(by_s, uneven)
    with pytest.warns(LogWarning) as told:
        log = Log.open(logged(tmp_path / "log.csv", time))
    (line,) = [str(one.message) for one in told if "clock set anew" in str(one.message)]
    words = line.split()
    by, after, later = (float(words[words.index(word) + 1]) for word in ("by", "after", "on"))
    np.testing.assert_allclose([by, after], [time[1500] - time[1499], time[1499]], rtol=0.0, atol=2e-3)
    assert "no window spans both" in line
    (fault,) = log.faults
    channel = log.channels["set point"]
    begin, end = (channel.start_s + fault.spans[0] / channel.rate_hz).tolist()
    assert end - begin == pytest.approx(2.0, abs=0.03)
    samples = log.read("set point")
    np.testing.assert_array_equal(
        np.flatnonzero(np.isnan(samples)), np.arange(fault.spans[0, 0], fault.spans[0, 1])
    )
    later_s = end - time[1500]
    np.testing.assert_allclose(later, later_s, rtol=0.0, atol=0.03)
    own = np.append(time[:1500], time[1500:] + later_s)
    grid = channel.start_s + np.arange(channel.samples) / channel.rate_hz
    known = np.isfinite(samples)
    np.testing.assert_allclose(samples[known], np.interp(grid[known], own, SWING), atol=2.0)


def test_cases_two_jumps_are_told_in_one_line(tmp_path: Path) -> None:
    time = jumping(-12.0, uneven=False, twice=True)
    with pytest.warns(LogWarning, match=r"by -11.99, -11.99 s after 15, 18 s.* 14, 28 s are added"):
        log = Log.open(logged(tmp_path / "log.csv", time))
    np.testing.assert_array_equal(log.faults[0].spans, [[1500, 1700], [3200, 3400]])
    np.testing.assert_allclose(log.read("speed", 16.99, 18.01)[2:102], SWING[1500:1600], atol=1e-6)


@pytest.mark.parametrize("by_s", [-3.0, 1.7e9])
def test_cases_a_clock_that_is_off_for_a_while_parts_nothing(tmp_path: Path, by_s: float) -> None:
    time = np.arange(ROWS) * 0.01
    time[1500:1520] += by_s
    with pytest.warns(LogWarning, match="clock set back at samples 1500 to 1519"):
        log = Log.open(logged(tmp_path / "log.csv", time))
    np.testing.assert_allclose(log.read("speed"), SWING, atol=1e-6)


@pytest.mark.filterwarnings("ignore::shipfp_rs.errors.LogWarning")
def test_cases_no_window_spans_a_jump_of_the_clock(tmp_path: Path) -> None:
    log = Log.open(logged(tmp_path / "log.csv", jumping(-12.0, uneven=False)))
    windows = proposed(log, ["set point"], "set point")
    assert all(window.stop_s <= 15.02 or window.start_s >= 16.99 for window in windows)
    described = trial(
        tmp_path,
        'column = "speed"\nunit = "rpm"\nkind = "speed"',
        n_e_rpm=800.0,
        rate_hz=50.0,
        window=(5.0, 35.0),
        speed="best",
        set_point="set point",
        more="[processing.faults]\nlongest_bridge_s = 5.0\n",
    )
    with pytest.raises(InputError, match=r"window 'W': the clock was reset within it; .* before 15.01 s"):
        process(log, described)
