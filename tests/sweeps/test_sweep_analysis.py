"""Bias, spread, coverage and the length of a trial, from draws whose errors are known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from scipy.stats import norm

from shipfp_rs.sweeps.analysis import summarise
from shipfp_rs.sweeps.draw import schema_of
from shipfp_rs.sweeps.plan import Plan
from tests.sweep_folders import cheap_plan

DRAWS = 4000
DURATIONS = [10.0, 20.0, 40.0, 80.0, 160.0]


def table(plan: Plan, **columns: Any) -> pa.RecordBatch:
    """Return the rows of a plan with the given columns, keys with an underscore for a dot, the rest empty."""
    rows = plan.draws
    given = {name.replace("__", "."): values for name, values in columns.items()}
    given |= {"index": np.arange(rows), "status": given.get("status", ["done"] * rows)}
    for key in plan.factors:
        given[f"factor.{key}"] = [plan.factor_values(index)[key] for index in range(rows)]
    return pa.RecordBatch.from_arrays(
        [
            pa.array(given[field.name], field.type) if field.name in given else pa.nulls(rows, field.type)
            for field in schema_of(plan)
        ],
        schema=schema_of(plan),
    )


def normal_errors(plan: Plan, bias: float, spread: Any, seed: int = 1) -> pa.RecordBatch:
    """Return rows in which tau_n is off by bias + spread z, relative to a truth of 2 s, with its right interval."""
    off = 2.0 * (bias + spread * np.random.default_rng(seed).standard_normal(plan.draws))
    half = 2.0 * np.broadcast_to(1.96 * spread, plan.draws)
    return table(
        plan,
        truth__tau_n=np.full(plan.draws, 2.0),
        estimate__tau_n=2.0 + off,
        low__tau_n=2.0 + off - half,
        high__tau_n=2.0 + off + half,
    )


def test_bias_spread_coverage_and_quantiles_are_those_of_the_errors() -> None:
    plan = cheap_plan(DRAWS)
    batch = normal_errors(plan, 0.02, 0.05)
    found = summarise(plan, [batch.slice(0, 1500), batch.slice(1500)])["parameters"]["tau_n"]
    assert math.isclose(found["bias"], 0.02, abs_tol=5 * 0.05 / math.sqrt(DRAWS))
    assert math.isclose(found["spread"], 0.05, rel_tol=5 / math.sqrt(2 * DRAWS))
    # Interval about an estimate that is off by 0.4 of its deviation.
    assert math.isclose(found["coverage"], norm.cdf(1.56) - norm.cdf(-2.36), abs_tol=0.02)
    size = np.abs(np.array(batch["estimate.tau_n"]) / 2.0 - 1.0)
    # Bins are 2.3 % wide.
    assert math.isclose(found["error_95"], np.quantile(size, 0.95), rel_tol=0.03)
    assert math.isclose(found["median_error"], np.median(size), rel_tol=0.03)


def test_a_factor_that_does_harm_shows_in_its_bins() -> None:
    plan = cheap_plan(DRAWS)
    level = np.array([plan.factor_values(index)["noise.level"] for index in range(DRAWS)])
    bins = summarise(plan, [normal_errors(plan, 0.0, 0.01 * level)])["by_factor"]["noise.level"]
    assert len(bins) == 6
    # Bins of equal shares of draws.
    assert all(abs(row["done"] - DRAWS / 6) <= 2 for row in bins)
    for row in bins:
        middle = row["factors"]["noise.level"]
        assert math.isclose(row["parameters"]["tau_n"]["spread"], 0.01 * middle, rel_tol=0.12)


def test_a_draw_without_an_estimate_is_as_wrong_as_can_be() -> None:
    plan = cheap_plan(100, identify={"noise": "white"})
    truth, value = np.full(100, 1.0), [1.01] * 93 + [None] * 7
    status = ["done"] * 95 + ["failed"] * 4 + ["timed_out"]
    batch = table(
        plan,
        truth__g=truth,
        estimate__g=value,
        status=status,
        error=[None] * 95 + ["SimulationError"] * 4 + ["TimedOut"],
    )
    summary = summarise(plan, [batch])
    found = summary["parameters"]["g"]
    assert found["error_95"] is None
    assert math.isclose(found["median_error"], 0.01, rel_tol=0.03)
    assert math.isclose(found["bias"], 0.01)
    assert summary["draws"] == {"total": 100, "done": 95, "failed": 4, "timed_out": 1, "not_run": 0}
    assert summary["errors"] == {"SimulationError": 4, "TimedOut": 1}


def test_draws_that_are_not_there_yet_are_not_failures() -> None:
    plan = cheap_plan(100)
    summary = summarise(plan, [normal_errors(plan, 0.0, 0.1).slice(0, 30)])
    assert summary["draws"]["not_run"] == 70
    assert summary["failure_rate"] == 0.0


def trial_lengths(accuracy_pct: float, spread: float = 0.2) -> list[dict[str, Any]]:
    """Return the lengths for errors that fall with the root of the duration and with the amplitude."""
    plan = cheap_plan(
        0,
        sweep={"design": "grid", "draws": None, "repeats": 400},
        factors={
            "excitation.duration_s": {"values": DURATIONS},
            "excitation.amplitude_rpm": {"values": [10.0, 20.0]},
        },
    )
    cells = [plan.factor_values(index) for index in range(plan.draws)]
    root = np.sqrt([cell["excitation.duration_s"] / 10.0 for cell in cells])
    size = np.array([cell["excitation.amplitude_rpm"] for cell in cells]) / 10.0
    summary = summarise(plan, [normal_errors(plan, 0.0, spread / (root * size))], accuracy_pct)
    return [row for row in summary["trial_length"] if row["parameter"] == "tau_n"]


def test_the_length_of_a_trial_is_where_95_of_100_errors_are_small_enough() -> None:
    small, large = trial_lengths(20.0)
    assert small["factors"] == {"excitation.amplitude_rpm": 10.0}
    # 1.96 * 0.2 * sqrt(10 / duration) is 0.2 at 38.4 s, and at twice the amplitude at a quarter of that.
    assert math.isclose(small["duration_s"], 38.4, rel_tol=0.25)
    assert large["duration_s"] == 10.0
    assert large["note"] == "10 s or less"


@pytest.mark.parametrize(("accuracy", "note"), [(1000.0, "10 s or less"), (1e-2, "more than 160 s")])
def test_a_length_beyond_those_tried_is_said_to_be_so(accuracy: float, note: str) -> None:
    assert {row["note"] for row in trial_lengths(accuracy)} == {note}
