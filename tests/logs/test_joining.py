"""Pieces of one recording are one log; logs of one clock stand side by side."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.joining import join
from shipfp_rs.logs.log import Log

U = np.random.default_rng(0).standard_normal(300)
BEGAN = datetime(2026, 5, 1, 10, tzinfo=UTC)


def piece(path: Path, first: int, stop: int, start: float) -> None:
    rows = "".join(f"{start + (k - first) / 10:.1f},{U[k]:.17g}\n" for k in range(first, stop))
    path.write_text("time [s],u [V]\n" + rows)


@pytest.mark.parametrize(("counts_on", "told"), [(True, "3 files as one"), (False, "back to back")])
def test_breakage_c5_pieces_are_one_log_by_their_times_or_else_by_their_names(
    counts_on: bool, told: str, tmp_path: Path
) -> None:
    for number, first in ((2, 100), (10, 200), (1, 0)):
        piece(tmp_path / f"run_{number}.csv", first, first + 100, first / 10 if counts_on else 0.0)
    log = Log.open(tmp_path / "run_*.csv")
    np.testing.assert_array_equal(log.read("u"), U)
    np.testing.assert_array_equal(log.read("u", 9.0, 11.0), U[90:110])
    assert told in log.notes[0]


def test_breakage_c5_a_missing_piece_is_a_gap(tmp_path: Path) -> None:
    piece(tmp_path / "run_1.csv", 0, 100, 0.0)
    piece(tmp_path / "run_3.csv", 200, 300, 20.0)
    log = Log.open(tmp_path / "run_*.csv")
    samples = log.read("u")
    np.testing.assert_array_equal(np.isnan(samples).nonzero()[0], np.arange(100, 200))
    assert [fault.spans.tolist() for fault in log.faults] == [[[100, 200]]]
    np.testing.assert_array_equal(samples[200:], U[200:])


def test_faults_of_the_pieces_are_told_at_their_places_in_the_whole(tmp_path: Path) -> None:
    for number, first in ((1, 0), (2, 100)):
        piece(tmp_path / f"run_{number}.csv", first, first + 100, first / 10)
        rows = (tmp_path / f"run_{number}.csv").read_text().splitlines(keepends=True)
        (tmp_path / f"run_{number}.csv").write_text("".join(rows[:41] + rows[51:]))
    with pytest.warns(LogWarning):
        log = Log.open(tmp_path / "run_*.csv")
    assert [fault.spans.tolist() for fault in log.faults] == [[[40, 50]], [[140, 150]]]
    assert np.isnan(log.read("u")).nonzero()[0].tolist() == [*range(40, 50), *range(140, 150)]


def test_breakage_c5_pieces_that_differ_are_refused(tmp_path: Path) -> None:
    piece(tmp_path / "run_1.csv", 0, 100, 0.0)
    (tmp_path / "run_2.csv").write_text("time [s],w [V]\n10.0,1\n10.1,2\n")
    with pytest.raises(InputError, match="channels u, w are in only one of"):
        Log.open(tmp_path / "run_*.csv")
    with pytest.raises(InputError, match="no file of this pattern"):
        Log.open(tmp_path / "none_*.csv")


def test_breakage_c5_logs_of_one_clock_are_merged_by_their_stamps(tmp_path: Path) -> None:
    for name, late in (("a", 0.0), ("b", 2.5)):
        rows = "".join(f"{(BEGAN + timedelta(seconds=late + k / 10)).isoformat()},{k}\n" for k in range(100))
        (tmp_path / f"{name}.csv").write_text(f"timestamp,u\n{rows}")
    log = Log.merge(*(Log.open(tmp_path / f"{name}.csv") for name in "ab"))
    assert list(log.channels) == ["a/u", "b/u"]
    assert log.start_utc == BEGAN
    np.testing.assert_array_equal(log.read("b/u", 2.5, 3.0), np.arange(5))
    with pytest.raises(InputError, match="has no date, but"):
        Log.merge(log, Log.from_arrays({"x": U}, rate_hz=10.0))


def overlapping(path: Path, samples: np.ndarray, first: int, stop: int, dated: bool) -> None:
    """A piece of two channels: the second has gaps."""
    rows = [
        f"{(BEGAN + timedelta(seconds=k / 10)).isoformat() if dated else f'{k / 10:.1f}'},{samples[k]:.17g},"
        f"{'' if k % 7 == 3 else samples[k] ** 2}\n"
        for k in range(first, stop)
    ]
    path.write_text(("timestamp" if dated else "time [s]") + ",u [V],w [V]\n" + "".join(rows))


@pytest.mark.parametrize("dated", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_what_two_pieces_hold_alike_counts_once(tmp_path: Path, seed: int, dated: bool) -> None:
    draw = np.random.default_rng(seed)
    cuts = np.sort(draw.choice(np.arange(30, 270), 3, replace=False))
    begins = np.append(0, np.maximum(cuts - draw.integers(1, 29, 3), 1))
    for number, (first, stop) in enumerate(zip(begins, np.append(cuts, 300), strict=True)):
        overlapping(tmp_path / f"run_{number}.csv", U, int(first), int(stop), dated)
    overlapping(tmp_path / "run_9.csv", U, 10, 20, dated)  # wholly inside
    log = Log.open(tmp_path / "run_*.csv")
    np.testing.assert_array_equal(log["u"], U)
    np.testing.assert_array_equal(log["w"], np.where(np.arange(300) % 7 == 3, np.nan, U**2))
    at = int(cuts[1])
    np.testing.assert_array_equal(log.read("u", (at - 5) / 10, (at + 5) / 10), U[at - 5 : at + 5])
    np.testing.assert_array_equal(np.concatenate(list(log.chunks("w", 7))), log["w"])
    assert "that two of them hold alike count once" in log.notes[0]
    assert {(fault.kind, fault.excluded) for fault in log.faults} == {("repeated", False)}


@pytest.mark.parametrize("dated", [False, True])
def test_the_first_sample_that_differs_is_told(tmp_path: Path, dated: bool) -> None:
    overlapping(tmp_path / "run_1.csv", U, 0, 100, dated)
    other = U.copy()
    other[93:] += 1e-12
    overlapping(tmp_path / "run_2.csv", other, 85, 200, dated)
    with pytest.raises(
        InputError, match=r"run_2.csv: begins 1.5 s before the end of the previous piece"
    ) as told:
        Log.open(tmp_path / "run_*.csv")
    text = str(told.value)
    assert f"and 0.8 s after it begins channel 'u' is {other[93]}, but {U[93]} in run_1.csv; expected" in text
    assert "cut one of them" in text
    assert "\n" not in text


def test_an_overlap_between_the_samples_is_refused() -> None:
    one = Log.from_arrays({"u": np.ones(100)}, rate_hz=10.0, name="one")
    two = Log.from_arrays({"u": np.ones(100)}, rate_hz=10.0, start_s=8.04, name="two")
    with pytest.raises(
        InputError, match=r"channel 'u' lies 0\.4 of a sample beside those of one; .* cut one"
    ):
        join([one, two])
    late = Log.from_arrays({"u": np.arange(100.0)}, rate_hz=10.0, start_s=9.9, name="late")
    assert len(join([one, late])["u"]) == 200  # a sample early by its clock, and not the same: it follows


def test_a_long_overlap_is_compared_in_blocks() -> None:
    values = np.random.default_rng(1).standard_normal(400_000)
    parts = {"one": slice(0, 300_000), "two": slice(50_000, 400_000)}
    logs = [
        Log.from_arrays({"u": values[at]}, rate_hz=1000.0, start_s=at.start / 1000, name=name)
        for name, at in parts.items()
    ]
    np.testing.assert_array_equal(join(logs)["u"], values)
    np.testing.assert_array_equal(join(logs[::-1])["u"], values)
