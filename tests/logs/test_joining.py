"""Pieces of one recording are one log; logs of one clock stand side by side."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log

U = np.random.default_rng(0).standard_normal(300)


def piece(path: Path, first: int, stop: int, start: float) -> None:
    rows = "".join(f"{start + (k - first) / 10:.1f},{U[k]:.17g}\n" for k in range(first, stop))
    path.write_text("time [s],u [V]\n" + rows)


def test_breakage_c5_pieces_are_one_log(tmp_path: Path) -> None:
    for number, first in ((2, 100), (10, 200), (1, 0)):
        piece(tmp_path / f"run_{number}.csv", first, first + 100, first / 10)
    log = Log.open(tmp_path / "run_*.csv")
    np.testing.assert_array_equal(log.read("u"), U)
    np.testing.assert_array_equal(log.read("u", 9.0, 11.0), U[90:110])
    assert "3 files as one" in log.notes[0]


def test_breakage_c5_pieces_that_count_for_themselves_follow_their_names(tmp_path: Path) -> None:
    for number, first in ((2, 100), (10, 200), (1, 0)):
        piece(tmp_path / f"run_{number}.csv", first, first + 100, 0.0)
    log = Log.open(tmp_path / "run_*.csv")
    np.testing.assert_array_equal(log.read("u"), U)
    assert "back to back" in log.notes[0]


def test_breakage_c5_a_missing_piece_is_a_gap(tmp_path: Path) -> None:
    piece(tmp_path / "run_1.csv", 0, 100, 0.0)
    piece(tmp_path / "run_3.csv", 200, 300, 20.0)
    log = Log.open(tmp_path / "run_*.csv")
    samples = log.read("u")
    np.testing.assert_array_equal(np.isnan(samples).nonzero()[0], np.arange(100, 200))
    assert [fault.spans.tolist() for fault in log.faults] == [[[100, 200]]]
    np.testing.assert_array_equal(samples[200:], U[200:])


def test_breakage_c5_pieces_that_differ_are_refused(tmp_path: Path) -> None:
    piece(tmp_path / "run_1.csv", 0, 100, 0.0)
    (tmp_path / "run_2.csv").write_text("time [s],w [V]\n10.0,1\n10.1,2\n")
    with pytest.raises(InputError, match="channels u, w are not in both"):
        Log.open(tmp_path / "run_*.csv")
    with pytest.raises(InputError, match="no file of this pattern"):
        Log.open(tmp_path / "none_*.csv")


def test_breakage_c5_logs_of_one_clock_are_merged_by_their_stamps(tmp_path: Path) -> None:
    start = datetime(2026, 5, 1, 10, tzinfo=UTC)
    for name, late in (("a", 0.0), ("b", 2.5)):
        rows = "".join(f"{(start + timedelta(seconds=late + k / 10)).isoformat()},{k}\n" for k in range(100))
        (tmp_path / f"{name}.csv").write_text(f"timestamp,u\n{rows}")
    log = Log.merge(*(Log.open(tmp_path / f"{name}.csv") for name in "ab"))
    assert list(log.channels) == ["a/u", "b/u"]
    assert log.start_utc == start
    np.testing.assert_array_equal(log.read("b/u", 2.5, 3.0), np.arange(5))
    with pytest.raises(InputError, match="tells no date where"):
        Log.merge(log, Log.from_arrays({"x": U}, rate_hz=10.0))
