"""A clock of whole seconds: its jumps are gaps of whole seconds, and a second with fewer rows lacks some."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import LogWarning
from shipfp_rs.logs.time_axis import TimeAxis, time_axis
from tests.logger_files import opened
from tests.logs.test_time_axis import on_grid


def gridded(stamps: np.ndarray) -> tuple[TimeAxis, np.ndarray]:
    """The grid, and which row each of its samples is, NaN for none; every NaN is told."""
    axis = time_axis("log", "time", lambda: [stamps])
    grid = on_grid(axis, np.arange(len(stamps), dtype=np.float64), size=997)
    told = np.zeros(axis.samples, dtype=bool)
    for fault in axis.faults:
        for first, stop in fault.spans:
            told[first:stop] = True
    np.testing.assert_array_equal(np.isnan(grid), told)
    return axis, grid


@pytest.mark.parametrize("rate", [10, 24, 50, 100])
@pytest.mark.parametrize("seed", range(8))
def test_missing_rows_are_a_gap_at_their_place(rate: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    true = np.arange(120 * rate) + int(draw.integers(0, rate))  # in rows
    first, length = int(draw.integers(3 * rate, 100 * rate)), int(draw.integers(1, 6 * rate))
    kept = np.append(true[:first], true[first + length :])
    axis, grid = gridded(kept // rate + 40000.0)
    assert (axis.rate_hz, axis.samples) == (rate, len(true))
    known = np.flatnonzero(np.isfinite(grid))
    np.testing.assert_array_equal(kept[grid[known].astype(int)], true[known])
    assert axis.start_s == pytest.approx(40000.0 + true[0] / rate, abs=1e-6)
    assert length <= np.isnan(grid).sum() <= length + 2 * rate  # no more than the seconds that lack rows
    assert np.isnan(grid[first : first + length]).all()
    if length > 2 * rate:
        assert np.isnan(grid).sum() == length


@pytest.mark.parametrize("rate", [10, 50, 100])
@pytest.mark.parametrize("by_s", [-3600.0, -1.0, -7.0])
@pytest.mark.parametrize("part", [0.0, 0.3])
def test_a_clock_set_back_parts_the_log(rate: int, by_s: float, part: float) -> None:
    stamps = np.floor(np.arange(120 * rate) / rate)
    at = 60 * rate + int(part * rate)
    stamps[at:] += by_s
    axis, grid = gridded(stamps)
    assert [fault.kind for fault in axis.faults] == ["time_jump"]
    ((begin, end),) = axis.faults[0].spans
    assert end - begin == 2 * rate
    np.testing.assert_array_equal(grid[np.isfinite(grid)], np.arange(120 * rate))
    if by_s + part <= -1.0 and (part or by_s < -1.0):
        assert begin == at


def test_a_clock_set_on_by_an_hour_is_a_gap_of_an_hour() -> None:
    stamps = np.floor(np.arange(6000) / 50)
    stamps[3010:] += 3600.0
    axis, _ = gridded(stamps)
    np.testing.assert_array_equal(axis.faults[0].spans, [[3010, 3010 + 3600 * 50]])


@pytest.mark.parametrize("rate", [33.0 + 1 / 3, 99.97, 50.003, 1 / 0.06])
@pytest.mark.parametrize("early", [0.0, 0.9])
def test_a_rate_that_is_no_whole_number_and_late_stamps_lack_no_rows(rate: float, early: float) -> None:
    draw = np.random.default_rng(2)
    true = 0.21 + np.arange(int(200 * rate)) / rate
    stamps = np.floor(np.maximum.accumulate(true + early * draw.uniform(0.0, 1.0, len(true)) / rate))
    axis, _ = gridded(stamps)
    assert not axis.faults
    np.testing.assert_allclose(axis.start_s + np.arange(len(true)) / axis.rate_hz, true, atol=2.0 / rate)


@pytest.mark.parametrize(
    ("jump", "kind", "words"),
    [
        (4.0, "time_gap", "rows missing at samples 3020 to 3219"),
        (-3600.0, "time_jump", "clock set anew at samples 3020"),
    ],
)
def test_texts_of_whole_seconds_jump(tmp_path: Path, jump: float, kind: str, words: str) -> None:
    begin = datetime(2026, 10, 25, 2, 58)  # an hour that comes twice
    values = np.sin(np.arange(6000) / 80.0)
    rows = [
        f"{begin + timedelta(seconds=k // 50 + (jump if k >= 3020 else 0.0)):%Y-%m-%d %H:%M:%S},{values[k]:.9f}"
        for k in range(6000)
    ]
    with pytest.warns(LogWarning) as told:
        log = opened(tmp_path, "Time,u [V]", *rows)
    assert any(words in str(one.message) for one in told)
    assert [fault.kind for fault in log.faults] == [kind]
    samples = log["u"]
    np.testing.assert_allclose(samples[np.isfinite(samples)], values, atol=1e-9)
    assert np.isnan(samples).sum() == (200 if jump > 0.0 else 100)
