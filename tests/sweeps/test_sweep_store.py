"""A sweep's folder: the table does not depend on its parts, and memory not on the number of draws."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shipfp_rs.sweeps import dispatch, store, sweep
from shipfp_rs.sweeps.draw import lost_row, schema_of
from shipfp_rs.sweeps.store import opened
from tests.sweep_folders import cheap_plan, results

DRAWS = 23


def empty_rows(plan: Any, indices: Any) -> pa.RecordBatch:
    """Return the rows of draws that were never made."""
    batches = [lost_row(plan, index, "not made") for index in indices]
    return pa.Table.from_batches(batches).combine_chunks().to_batches()[0]


def finished(folder: Path, part_draws: int, order: Any) -> Path:
    """Fill a folder with parts in some order and make the table of them."""
    plan = cheap_plan(DRAWS)
    with opened(folder, plan.record(), schema_of(plan), range(DRAWS), part_draws) as opening:
        for part in order(list(opening.to_do())):
            opening.add(part, empty_rows(plan, opening.draws_of(part)))
        opening.finish()
    return folder


@pytest.mark.parametrize("part_draws", [1, 2, 5, 23, 50])
@pytest.mark.parametrize("order", [sorted, reversed])
def test_the_table_is_the_same_to_the_bit_whatever_its_parts_were(
    tmp_path: Path, monkeypatch: Any, part_draws: int, order: Any
) -> None:
    monkeypatch.setattr(store, "ROWS_PER_GROUP", 7)
    ours = finished(tmp_path / "ours", part_draws, order)
    assert results(ours) == results(finished(tmp_path / "whole", DRAWS, sorted))
    with pq.ParquetFile(ours / "results.parquet") as file:
        # No more rows than a group are ever in memory for it.
        assert [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)] == [7, 7, 7, 2]
        assert file.read()["index"].to_pylist() == list(range(DRAWS))


class Counting(Executor):
    """Does each task at once, and notes how many were handed out and not yet taken back at a time."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.submitted, self.most = folder, 0, 0

    def submit(self, work: Any, /, *arguments: Any, **options: Any) -> Future[Any]:
        self.submitted += 1
        kept = sum(1 for _ in self.folder.glob("parts/*/[0-9]*.parquet"))
        self.most = max(self.most, self.submitted - kept)
        future: Future[Any] = Future()
        future.set_result(work(*arguments, **options))
        return future


def test_no_more_tasks_are_out_than_the_workers_need(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(dispatch, "run_draws", empty_rows)
    executor = Counting(tmp_path)
    sweep(cheap_plan(200), tmp_path, executor=executor, workers=3, draws_per_task=2)
    assert executor.submitted == 100
    assert executor.most <= dispatch.AHEAD * 3
