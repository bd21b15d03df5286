"""A sweep computed in parts, as by an array of jobs, is the whole one to the bit, whatever was killed on the way."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from shipfp_rs.cli import main
from shipfp_rs.errors import InputError
from shipfp_rs.sweeps import Plan, Sweep, sweep
from shipfp_rs.sweeps.store import share_of
from tests.sweep_folders import cheap_plan, results, rows, sweep_toml

DRAWS, PARTS = 8, 3
QUICK = ("--executor", "threads", "--workers", "1", "--no-figures")


def merge(plan: Plan, folders: list[Path], out: Path) -> Sweep:
    """Return the sweep of some parts."""
    return sweep(plan, out, merge=folders)


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the parts 1, 2 and 3 of a sweep, and the whole."""
    folder = tmp_path_factory.mktemp("sweep")
    plan = cheap_plan(DRAWS)
    sweep(plan, folder / "whole", executor="threads", workers=1)
    for number in range(1, PARTS + 1):
        sweep(plan, folder / f"{number}", executor="threads", workers=1, part=f"{number}/{PARTS}")
    return folder


def test_parts_of_which_one_was_killed_and_repeated_merge_to_the_bits_of_the_whole(tmp_path: Path) -> None:
    path = tmp_path / "SWEEP.toml"
    path.write_text(sweep_toml(sweep={"vessel": "stan-launch-804", "draws": DRAWS}))
    assert main(["sweep", str(path), "--out", str(tmp_path / "whole"), *QUICK]) == 0
    folders = [str(tmp_path / f"part-{number}") for number in range(1, PARTS + 1)]
    for number, folder in enumerate(folders, 1):
        command = ["sweep", str(path), "--out", folder, "--part", f"{number}/{PARTS}", *QUICK]
        if number == 2:
            with subprocess.Popen([sys.executable, "-m", "shipfp_rs.cli", *command]) as run:
                while not list(Path(folder).glob("parts/*/0*.parquet")):
                    assert run.poll() is None
                    time.sleep(0.005)
                run.kill()
            assert run.returncode == -signal.SIGKILL
            assert not (Path(folder) / "results.parquet").exists()
        assert main(command) == 0
    merged = tmp_path / "merged"
    assert main(["sweep", str(path), "--merge", *folders, "--out", str(merged), "--no-figures"]) == 0
    for file in ("results.parquet", "summary.json", "manifest.json"):
        equal = (merged / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()
        print(
            f"{file} of {PARTS} parts, part 2 killed and repeated: {'the bits' if equal else 'NOT the bits'} of the whole"
        )
        assert equal


def test_the_parts_share_all_draws_and_their_order_does_not_matter(parts: Path, tmp_path: Path) -> None:
    shares = [[row["index"] for row in rows(parts / f"{number}")] for number in (1, 2, 3)]
    assert shares == [[0, 1], [2, 3, 4], [5, 6, 7]]
    whole = merge(cheap_plan(DRAWS), [parts / "3", parts / "1", parts / "2"], tmp_path / "merged")
    assert results(whole.folder) == results(parts / "whole")
    assert json.loads((parts / "2" / "summary.json").read_text())["draws"]["not_run"] == DRAWS - 3
    for count in (1, 7, 20):
        ranges = [share_of(f"{number}/{count}", 23) for number in range(1, min(count, 23) + 1)]
        assert [index for one in ranges for index in one] == [*range(23)]


def _unfinished(folder: Path) -> None:
    (folder / "2" / "results.parquet").unlink()


def _cut(folder: Path) -> None:
    path = folder / "2" / "results.parquet"
    path.write_bytes(path.read_bytes()[:-100])


def _swapped(folder: Path) -> None:
    shutil.copy(folder / "3" / "results.parquet", folder / "2" / "results.parquet")


@pytest.mark.parametrize(
    ("damage", "given", "draws", "said"),
    [
        pytest.param(None, "13", DRAWS, r"no folder of part 2/3; expected all 3 parts", id="missing"),
        pytest.param(None, "1233", DRAWS, r"has part 3/3, as .*3 has; give each part once", id="twice"),
        pytest.param(None, ["1", "2", "whole"], DRAWS, r"whole: has the whole sweep", id="whole"),
        pytest.param(None, "123", DRAWS + 1, r"1: started with sweep.draws = 8, found 9", id="other-sweep"),
        pytest.param(_unfinished, "123", DRAWS, r"2: part 2/3 is not finished; repeat", id="unfinished"),
        pytest.param(_cut, "123", DRAWS, r"2: part 2/3 is not finished; repeat", id="cut"),
        pytest.param(_swapped, "123", DRAWS, r"not the draws of part 2/3", id="swapped"),
        pytest.param(None, "", DRAWS, r"merge: found no folder, expected", id="none"),
    ],
)
def test_parts_that_are_not_a_whole_are_refused_and_nothing_is_written(
    damage: Callable[[Path], None] | None, given: str, draws: int, said: str, parts: Path, tmp_path: Path
) -> None:
    folder = parts
    if damage is not None:
        folder = Path(shutil.copytree(parts, tmp_path / "parts"))
        damage(folder)
    with pytest.raises(InputError, match=said):
        merge(cheap_plan(draws), [folder / name for name in given], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_parts_of_different_divisions_overlap(parts: Path, tmp_path: Path) -> None:
    sweep(cheap_plan(DRAWS), tmp_path / "half", executor="threads", workers=1, part="1/8")
    with pytest.raises(InputError, match=r"parts 1/8 and 2/3 divide the sweep differently"):
        merge(cheap_plan(DRAWS), [tmp_path / "half", parts / "2"], tmp_path / "merged")


@pytest.mark.parametrize("part", ["0/3", "4/3", "3", "a/b", "-1/3", "1/9"])
def test_a_part_that_is_none_is_refused(part: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"part: found '.*expected"):
        sweep(cheap_plan(DRAWS), tmp_path / "part", executor="threads", workers=1, part=part)
    assert not (tmp_path / "part").exists()


def test_a_folder_of_one_part_takes_no_other(parts: Path) -> None:
    for part, found in (("3/3", "3/3"), (None, "the whole")):
        with pytest.raises(InputError, match=f"started with part = 2/3, found {found}"):
            sweep(cheap_plan(DRAWS), parts / "2", executor="threads", workers=1, part=part)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--merge"], "one of --merge and DIR"),
        (["part-1"], "one of --merge and DIR"),
        (["--merge", "part-1", "--part", "1/2"], "--part: found '1/2' beside"),
    ],
)
def test_the_command_wants_folders_with_merge_only(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "SWEEP.toml"
    path.write_text(sweep_toml(sweep={"vessel": "stan-launch-804", "draws": DRAWS}))
    assert main(["sweep", str(path), *words]) == 2
    assert said in capsys.readouterr().err
