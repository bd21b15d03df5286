"""Sweeps: one row a draw, whatever happens in it; the same bits from any workers; going on where a run stopped."""

from __future__ import annotations

import json
import math
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.sweeps import Plan, Progress, draw, sweep
from shipfp_rs.sweeps.draw import TimedOut, within
from shipfp_rs.sweeps.store import MANIFEST
from tests.sweep_folders import KNOWN, cheap_plan, results, rows, sweep_toml

DRAWS = 8


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a sweep made by one thread."""
    folder = tmp_path_factory.mktemp("reference") / "sweep"
    sweep(cheap_plan(DRAWS), folder, executor="threads", workers=1)
    return folder


class TestRows:
    def test_there_is_one_row_a_draw_with_all_it_takes_to_repeat_it(self, reference: Path) -> None:
        table, plan = rows(reference), cheap_plan(DRAWS)
        assert [row["index"] for row in table] == list(range(DRAWS))
        assert [row["seed"] for row in table] == [plan.seed_of(index) for index in range(DRAWS)]
        assert {row["status"] for row in table} == {"done"}
        for row in table:
            assert row["factor.noise.level"] == plan.factor_values(row["index"])["noise.level"]
            assert row["low.tau_n"] < row["estimate.tau_n"] < row["high.tau_n"]
            # The truth of the published virtual ship by eq. 3.23.
            assert math.isclose(row["truth.tau_n"], 1.5142, rel_tol=1e-4)
            assert abs(row["estimate.tau_n"] / row["truth.tau_n"] - 1.0) < 0.1

    def test_a_row_can_be_repeated_by_hand(self, reference: Path) -> None:
        plan, row = cheap_plan(DRAWS), rows(reference)[3]
        ship = fp.Vessel.load("stan-launch-804")
        chirp = fp.signals.chirp(0.2, 4.0, 10.0, 40.0, rate_hz=20.0)
        clean = fp.simulate(ship, chirp)
        noise = {
            name: (
                row["factor.noise.level"]
                * getattr(plan.noise, name)
                * clean.operating_point[name]
                / np.std(clean.signals[name])
            )
            for name in ("n_e", "M_b")
        }
        experiment = fp.simulate(ship, chirp, noise=noise, seed=row["seed"])
        found = fp.identify(
            experiment, fp.Structure.ship().with_fixed(**KNOWN), noise="white", seed=row["seed"]
        )
        assert math.isclose(found["tau_n"].value or 0.0, row["estimate.tau_n"], rel_tol=1e-9)

    def test_noise_is_a_share_of_the_operating_point_whatever_the_amplitude(self, tmp_path: Path) -> None:
        plan = cheap_plan(
            4,
            factors={"excitation.amplitude_rpm": {"values": [10.0, 80.0]}},
            noise={"n_e": 2e-4, "M_b": 1e-3},
        )
        sweep(plan, tmp_path / "sweep", executor="threads", workers=1)
        widths = {10.0: [], 80.0: []}
        for row in rows(tmp_path / "sweep"):
            # Ten seconds leave a slow integral open, and where it is none g and vK_p are told together only.
            widths[row["factor.excitation.amplitude_rpm"]].append(row["std.tau_n"])
        # Eight times the amplitude, an eighth of the uncertainty, as far as the ship is linear.
        assert 5.0 < np.median(widths[10.0]) / np.median(widths[80.0]) < 12.0

    def test_a_raw_log_with_faults_goes_through_the_same_chain(self, tmp_path: Path) -> None:
        plan = cheap_plan(
            1,
            sweep={"chain": "log", "vessel": "stan-tug-1205"},
            excitation={
                "kind": "chirp",
                "duration_s": 60.0,
                "start_hz": 0.03,
                "stop_hz": 1.5,
                "amplitude_rpm": 40.0,
            },
            noise={},
            sensors={"rate_hz": 1000.0, "steady_s": 30.0},
            faults={"A": 6.0, "C": 3.0},
            identify={"starts": 1},
            factors={"sensors.torque_noise_V": {"values": [0.02]}},
        )
        sweep(plan, tmp_path / "sweep", executor="threads", workers=1)
        (row,) = rows(tmp_path / "sweep")
        assert row["status"] == "done", row["message"]
        assert abs(row["estimate.p"] / row["truth.p"] - 1.0) < 0.05
        # Behind a gauge only the curvature of the propeller's torque tells it.
        assert row["low.tau_n"] < row["truth.tau_n"] < row["high.tau_n"]
        assert row["std.tau_n"] > 10.0 * row["std.tau_prop"]

    def test_a_poisoned_draw_is_a_row_and_sinks_nothing(self, tmp_path: Path, monkeypatch: Any) -> None:
        plan = cheap_plan(4)
        identified = draw.identify

        def poisoned(*arguments: Any, **options: Any) -> Any:
            if options["seed"] == plan.seed_of(1):
                raise SimulationError("the shaft\nturns backwards")
            if options["seed"] == plan.seed_of(2):
                raise ZeroDivisionError("division by zero")
            return identified(*arguments, **options)

        monkeypatch.setattr(draw, "identify", poisoned)
        summary = sweep(plan, tmp_path / "sweep", executor="threads", workers=1).summary
        table = rows(tmp_path / "sweep")
        assert [row["status"] for row in table] == ["done", "failed", "failed", "done"]
        assert [row["error"] for row in table] == [None, "SimulationError", "ZeroDivisionError", None]
        assert table[1]["message"] == "the shaft turns backwards"
        assert table[1]["estimate.tau_n"] is None
        assert summary["draws"] == {"total": 4, "done": 2, "failed": 2, "timed_out": 0, "not_run": 0}
        assert summary["failure_rate"] == 0.5

    def test_a_draw_that_takes_too_long_is_told_from_one_that_failed(
        self, tmp_path: Path, monkeypatch: Any
    ) -> None:
        plan = cheap_plan(3, sweep={"time_limit_s": 1.0})

        def slow(*_: Any, **options: Any) -> Any:
            while options["seed"] == plan.seed_of(1):
                time.sleep(0.01)
            raise SimulationError("the others fail at once")

        monkeypatch.setattr(draw, "identify", slow)
        summary = sweep(plan, tmp_path / "sweep", executor="threads", workers=1).summary
        assert [row["status"] for row in rows(tmp_path / "sweep")] == ["failed", "timed_out", "failed"]
        assert summary["draws"]["timed_out"] == 1


class TestTimeLimit:
    def test_work_within_its_limit_is_left_alone(self) -> None:
        assert within(60.0, lambda: 3) == 3
        assert not [
            thread
            for thread in threading.enumerate()
            if isinstance(thread, threading.Timer) and not thread.finished.is_set()
        ]

    def test_no_handler_of_ordinary_errors_takes_it(self) -> None:
        def stubborn() -> None:
            while True:
                try:
                    time.sleep(0.01)
                except Exception:
                    continue

        with pytest.raises(TimedOut):
            within(0.05, stubborn)


class TestWorkers:
    def test_the_table_is_the_same_to_the_bit_on_any_number_of_threads(
        self, reference: Path, tmp_path: Path
    ) -> None:
        sweep(cheap_plan(DRAWS), tmp_path / "sweep", executor="threads", workers=3, draws_per_task=2)
        assert results(tmp_path / "sweep") == results(reference)

    def test_an_executor_of_one_s_own_serves_and_stays_open(self, reference: Path, tmp_path: Path) -> None:
        with ThreadPoolExecutor(2) as executor:
            sweep(cheap_plan(DRAWS), tmp_path / "sweep", executor=executor)
            assert executor.submit(lambda: 3).result() == 3
        assert results(tmp_path / "sweep") == results(reference)

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"workers": 0}, "workers is 0, expected 1 to 1024"),
            ({"executor": "proceses"}, "executor is 'proceses', expected 'processes', 'threads' or 'dask'"),
            ({"executor": "threads", "address": "127.0.0.1:1"}, "expected executor 'dask'"),
            ({"draws_per_task": 0}, "draws_per_task is 0"),
            ({"accuracy_pct": 0.0}, "accuracy_pct is 0.0"),
        ],
    )
    def test_what_cannot_be_is_refused(self, tmp_path: Path, options: dict[str, Any], words: str) -> None:
        with pytest.raises(InputError, match=words):
            sweep(cheap_plan(2), tmp_path / "sweep", **options)


class Stop(Exception):
    """A run is interrupted."""


def stopping_after(draws: int):
    def progress(state: Progress) -> None:
        if state.made >= draws:
            raise Stop

    return progress


class TestGoingOn:
    def test_an_interrupted_sweep_goes_on_to_the_same_bits_and_makes_a_damaged_part_again(
        self, reference: Path, tmp_path: Path
    ) -> None:
        folder, plan = tmp_path / "sweep", cheap_plan(DRAWS)
        for made in (1, 2):
            with pytest.raises(Stop):
                sweep(
                    plan,
                    folder,
                    executor="threads",
                    workers=2,
                    draws_per_task=1,
                    progress=stopping_after(made),
                )
        draws = json.loads((folder / "summary.json").read_text())["draws"]
        assert draws["done"] + draws["not_run"] == DRAWS
        assert 3 <= draws["done"] < DRAWS
        victim, *_ = sorted(folder.glob("parts/*/*.parquet"))
        victim.write_bytes(victim.read_bytes()[:100])
        seen: list[Progress] = []
        sweep(plan, folder, executor="threads", workers=2, progress=seen.append)
        assert seen[0].done == draws["done"] - 1
        assert seen[-1].made == draws["not_run"] + 1
        assert results(folder) == results(reference)
        left = {path.name for path in folder.iterdir()}
        assert left == {"results.parquet", "summary.json", MANIFEST, ".lock"}

    def test_a_finished_sweep_is_not_run_again(self, reference: Path, monkeypatch: Any) -> None:
        before = results(reference)
        monkeypatch.setattr(draw, "identify", None)
        (reference / "parts" / "000000").mkdir(parents=True)  # killed before it had removed them
        again = sweep(cheap_plan(DRAWS), reference)
        assert not (reference / "parts").exists()
        assert results(reference) == before
        assert again.summary["draws"]["done"] == DRAWS
        assert again.table().num_rows == DRAWS

    @pytest.mark.parametrize(
        ("changed", "words"),
        [
            (cheap_plan(DRAWS, sweep={"seed": 4}), "started with sweep.seed = 0, found 4"),
            (cheap_plan(DRAWS, noise={"n_e": 0.002, "M_b": 0.005}), "noise.n_e = 0.001, found 0.002;"),
            (cheap_plan(DRAWS, sweep={"vessel": "stan-tug-1205"}), "started with ship."),
        ],
    )
    def test_a_changed_plan_is_refused_with_what_changed(
        self, reference: Path, changed: Plan, words: str
    ) -> None:
        with pytest.raises(InputError) as caught:
            sweep(changed, reference)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_somebody_else_s_folder_is_left_alone(self, tmp_path: Path) -> None:
        (tmp_path / "thesis.txt").write_text("mine")
        with pytest.raises(InputError, match="not empty and has no sweep"):
            sweep(cheap_plan(2), tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]

    def test_two_runs_do_not_share_a_folder(self, tmp_path: Path) -> None:
        folder, plan = tmp_path / "sweep", cheap_plan(2)

        def second(_: Progress) -> None:
            with pytest.raises(InputError, match="a sweep is running in this folder"):
                sweep(plan, folder, executor="threads", workers=1)

        sweep(plan, folder, executor="threads", workers=1, progress=second)


class TestCommand:
    def test_it_prints_tables_and_writes_figures(self, tmp_path: Path, capsys: Any) -> None:
        from shipfp_rs import cli

        path, out = tmp_path / "SWEEP.toml", tmp_path / "out"
        path.write_text(
            sweep_toml(
                sweep={"vessel": "stan-launch-804", "design": "grid", "repeats": 2},
                factors={"excitation.duration_s": {"values": [5.0, 10.0]}},
                excitation={"start_hz": 0.2, "rate_hz": 20.0},
                identify={"noise": "white", "fixed": {"g": -0.583}},
            )
        )
        arguments = ["sweep", str(path), "--out", str(out), "--executor", "threads", "--workers", "1"]
        assert cli.main([*arguments, "--accuracy", "5"]) == 0
        printed = capsys.readouterr()
        assert "4 draws, 4 identified, 0 failed, 0 timed out" in printed.out
        assert "in summary.json: by excitation.duration_s" in printed.out
        assert len(printed.out.splitlines()) <= 30
        assert "95 of 100 estimates are within 5 % of the truth" in printed.out
        assert printed.err == ""
        for figure in ("scatter_matrix", "errors", "trial_length"):
            assert (out / "figures" / f"{figure}.png").read_bytes().startswith(b"\x89PNG")
        assert cli.main([*arguments, "--json", "--no-figures"]) == 0
        assert json.loads(capsys.readouterr().out)["draws"]["done"] == 4
        assert cli.main([*arguments, "--seed", "1"]) == 2
        assert "started with sweep.seed = 0, found 1" in capsys.readouterr().err

    def test_a_template_comes_from_init(self, tmp_path: Path, capsys: Any) -> None:
        from shipfp_rs import cli

        assert cli.main(["init", str(tmp_path), "--sweep"]) == 0
        assert Plan.load(tmp_path / "SWEEP.toml").draws == 1000
        assert "shipfp sweep" in capsys.readouterr().out
