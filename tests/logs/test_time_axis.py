"""Times that are not even are resampled without aliases, gaps stay gaps, and coarse clocks are seen through."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import LogWarning
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.time_axis import TimeAxis, time_axis

DRAW = np.random.default_rng(5)


def written(path: Path, time: np.ndarray, values: np.ndarray) -> Path:
    rows = "".join(f"{t:.9f},{v:.9f}\n" for t, v in zip(time, values, strict=True))
    path.write_text("time [s],u [V]\n" + rows)
    return path


def on_grid(axis: TimeAxis, samples: np.ndarray, size: int = 1 << 16) -> np.ndarray:
    """Samples at the times of an axis, on its grid; they are read in blocks of a size."""

    def blocks(name: str, first: int, size: int) -> Iterator[np.ndarray]:
        for start in range(first, len(samples), size):
            yield samples[start : start + size]

    return np.concatenate(list(axis.on_grid(blocks)("u", 0, size)))


def test_breakage_c5_a_log_of_uneven_steps_is_resampled(tmp_path: Path) -> None:
    time = np.cumsum(DRAW.uniform(0.002, 0.018, 3000))
    path = written(tmp_path / "log.csv", time, np.sin(2 * np.pi * 0.5 * time))
    with pytest.warns(LogWarning, match="is not uniform, steps of .* resampled at .* by straight lines"):
        log = Log.open(path)
    channel = log.channels["u"]
    grid = channel.start_s + np.arange(channel.samples) / channel.rate_hz
    np.testing.assert_allclose(
        log.read("u"), np.sin(2 * np.pi * 0.5 * grid), atol=4.1e-4
    )  # h^2/8 of the longest step
    assert channel.stop_s == pytest.approx(time[-1], abs=1.1 / channel.rate_hz)


def test_breakage_c5_blocks_of_any_size_are_the_same_samples(tmp_path: Path) -> None:
    time = np.cumsum(DRAW.uniform(0.002, 0.018, 2000))
    path = written(tmp_path / "log.csv", time, DRAW.standard_normal(2000))
    with pytest.warns(LogWarning):
        log = Log.open(path)
    whole = log.read("u")
    np.testing.assert_allclose(np.concatenate(list(log.chunks("u", 97))), whole, rtol=1e-9, atol=1e-12)
    # A part counts its time from its own begin: the same but for rounding.
    part = whole[slice(*log.rows("u", 2.0, 3.0))]
    np.testing.assert_allclose(log.read("u", 2.0, 3.0), part, rtol=1e-9, atol=1e-12)


def test_breakage_c5_gaps_stay_gaps(tmp_path: Path) -> None:
    time = np.cumsum(DRAW.uniform(0.008, 0.012, 3000))
    time += np.linspace(0.0, 3.0, 3000) ** 2  # a rate that falls by and by
    time[1500:] += 5.0
    path = written(tmp_path / "log.csv", time, np.ones(3000))
    with pytest.warns(LogWarning, match=r"masked: steps of more than|is not uniform"):
        log = Log.open(path)
    samples = log.read("u")
    assert np.isnan(samples).sum() / log.channels["u"].rate_hz == pytest.approx(5.0, abs=0.05)
    (fault,) = log.faults
    assert fault.kind == "time_gap"
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(samples))[[0, -1]] + [0, 1], fault.spans[0])


def test_breakage_c5_what_is_denser_than_the_grid_is_averaged() -> None:
    """Bursts of 100 samples at 10 kHz among ones at 100 Hz: their hiss is not folded into the coarser grid."""
    burst = np.tile([*[1e-2] * 400, *[1e-4] * 100], 20)
    time = np.cumsum(burst)
    hiss = np.where(burst < 1e-3, np.where(np.arange(len(time)) % 2, 1.0, -1.0), 0.0)

    axis = time_axis("log", "time", lambda: [time])
    assert axis.rate_hz < 2e3
    assert axis.samples <= 8 * len(time) + 1
    grid = on_grid(axis, hiss)
    inside = np.interp(axis.start_s + np.arange(axis.samples) / axis.rate_hz, time, burst) < 2e-4
    assert inside.sum() > 100
    assert np.std(grid[inside]) < 0.1


def test_breakage_c5_a_rate_that_drifts_is_not_taken_as_even() -> None:
    steps = np.linspace(0.01, 0.0125, 4000)  # each within half a step of the first
    time = np.cumsum(steps)
    axis = time_axis("log", "time", lambda: [time])
    grid = on_grid(axis, time)
    at = axis.start_s + np.arange(axis.samples) / axis.rate_hz
    np.testing.assert_allclose(grid, at, atol=1e-9)
