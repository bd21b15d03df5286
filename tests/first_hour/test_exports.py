"""What instruments' texts say in places of their own: names, units, times, and one value a row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import LogWarning
from shipfp_rs.logs.log import Log
from tests.first_hour.exports import catman, edges, labview, long_table, tektronix, yokogawa
from tests.logger_files import opened

COLUMNS = {
    ("Speed demand", "rpm"): 900.0 + np.round(np.sin(0.1 * np.arange(300)), 3),
    ("Torque", "kNm"): 2.0 + np.round(np.cos(0.1 * np.arange(300)), 3),
}


@pytest.mark.parametrize(
    ("write", "start_s"),
    [(tektronix, -5.0), (labview, 0.0), (catman, 0.0), (yokogawa, -2.0), (long_table, 0.0)],
)
def test_names_units_and_times_are_found_where_instruments_put_them(write, start_s, tmp_path: Path) -> None:
    write(tmp_path / "log.csv", 50.0, COLUMNS)
    log = Log.open(tmp_path / "log.csv")
    assert {(name, channel.unit) for name, channel in log.channels.items()} == set(COLUMNS)
    for (name, _), values in COLUMNS.items():
        channel = log.channel(name)
        assert (round(channel.rate_hz, 6), round(channel.start_s, 6)) == (50.0, start_s)
        np.testing.assert_allclose(log.read(name), values, atol=1e-6)


def test_records_of_a_trace_without_times_are_found_below_lines_of_figures(tmp_path: Path) -> None:
    yokogawa(tmp_path / "all.csv", 50.0, COLUMNS)
    lines = (tmp_path / "all.csv").read_text().split("\n")
    rows = [line if line[:1] in ('"', "") else line[line.index(",") :] for line in lines]
    log = opened(tmp_path, *rows[:-1])
    assert {(name, channel.unit, channel.rate_hz) for name, channel in log.channels.items()} == {
        (*key, 50.0) for key in COLUMNS
    }


def test_a_name_without_a_time_base_is_left_out_of_a_long_table(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    long_table(path, 50.0, COLUMNS)
    path.write_text(path.read_text() + "2026-05-01T10:00:06.000000Z,Alarm,1,\n")
    with pytest.warns(LogWarning, match="left out, no time base in rows of their own: Alarm"):
        log = Log.open(path)
    assert len(log.channels) == 2


def test_changes_of_a_state_keep_their_times_between_two_samples(tmp_path: Path) -> None:
    rises = np.cumsum(np.random.default_rng(4).uniform(0.006, 0.01, 500))
    edges(tmp_path / "log.csv", "Tacho", rises, rises + 0.002)
    log = Log.open(tmp_path / "log.csv")
    channel, state = log.channel("Tacho"), log.read("Tacho")
    np.testing.assert_array_equal(np.concatenate(list(log.chunks("Tacho", 77))), state)
    before = np.flatnonzero((state[:-1] < 0.5) & (state[1:] >= 0.5))
    part = (0.5 - state[before]) / (state[before + 1] - state[before])
    np.testing.assert_allclose(channel.start_s + (before + part) / channel.rate_hz, rises, atol=1e-8)
