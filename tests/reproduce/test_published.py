"""The published tables are whole, and what can be recomputed from them comes out as it should."""

from __future__ import annotations

import itertools

import pytest

from shipfp_rs import published


def test_schedule_holds_four_periods_of_sixteen_frequencies_without_a_gap() -> None:
    schedule = published.virtual_schedule()
    assert len(schedule) == 16
    assert schedule[0].begin_s == 0.0
    for before, after in itertools.pairwise(schedule):
        assert before.end_s == after.begin_s
    for row in schedule:
        assert (row.end_s - row.begin_s) * row.frequency_hz == pytest.approx(4.0, rel=0.01)


def test_sine_fits_are_sixteen_frequencies_of_three_channels() -> None:
    fits = published.sine_fits()
    assert [fit.signal for fit in fits[::16]] == ["setpoint", "shaft_speed", "shaft_torque"]
    frequencies = [fit.input_frequency_hz for fit in fits[:16]]
    assert (
        frequencies
        == [fit.input_frequency_hz for fit in fits[16:32]]
        == [fit.input_frequency_hz for fit in fits[32:]]
    )
    planned = [row.frequency_hz for row in published.full_scale_experiments() if row.kind == "sine"]
    assert frequencies == planned[1:]  # S1 was not fitted


def test_cells_that_were_not_printed_are_none() -> None:
    known, *estimated = published.virtual_results()
    assert known.case == "i"
    assert known.duration_s is None
    assert known.fit_n_pct is None
    assert [row.case for row in estimated] == ["ii", "iii", "iv", "v"]
    assert all(row.fit_n_pct is not None for row in estimated)
    assert published.full_scale_cross_validation()[1].multisine_pct is None


def test_every_table_is_complete() -> None:
    lengths = {
        published.full_scale_experiments: 23,
        published.full_scale_results: 4,
        published.full_scale_cross_validation: 8,
        published.log_faults: 23,
        published.torque_conversion: 14,
        published.virtual_operating_point: 11,
    }
    assert {load: len(load()) for load in lengths} == lengths


def test_both_tables_of_experiments_name_the_same_ones() -> None:
    assert [row.name for row in published.full_scale_experiments()] == [
        row.experiment for row in published.log_faults()
    ]
