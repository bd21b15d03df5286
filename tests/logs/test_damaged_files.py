"""Any bytes give a log or one line, in bounded time and memory; a reader that crashes takes nothing with it."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import cli
from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers import child_process
from tests.damage import KINDS as DAMAGES
from tests.damage import Tally, damaged, try_damaged
from tests.logger_files import RATE_HZ, REAL_FILES, WRITERS, sample_file

KINDS = (*WRITERS, *REAL_FILES)
SPARE = 200_000_000


@pytest.fixture(autouse=True)
def _short_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that hangs is ended; these files are small enough to wait less for it."""
    monkeypatch.setattr(child_process, "LIMIT_S", 15.0)


def check(tally: Tally, whole: Path) -> None:
    assert not tally.faults, tally.faults.most_common(5)
    assert tally.copies["read"] + tally.copies["refused"] == tally.copies["tried"]
    assert tally.worst_bytes <= 3 * whole.stat().st_size + SPARE


@pytest.mark.parametrize("kind", KINDS)
def test_damage_gives_a_log_or_one_line(kind: str, tmp_path: Path) -> None:
    whole = sample_file(kind, tmp_path)
    check(try_damaged(whole, tmp_path, 2 if kind == "DEWESoft" else 12), whole)


@pytest.mark.filterwarnings("always::shipfp_rs.errors.LogWarning")
@pytest.mark.parametrize("kind", ["Parquet", "CSV", "MDF 4"])
def test_the_command_line_answers_damage_in_lines_of_its_own(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = sample_file(kind, tmp_path)
    content, draw = np.fromfile(whole, np.uint8), np.random.default_rng(3)
    source, out = tmp_path / f"damaged{whole.suffix}", tmp_path / "out.parquet"
    for damage in DAMAGES:
        damaged(content, damage, draw).tofile(source)
        status = cli.main(["convert", str(source), str(out)])
        error = capsys.readouterr().err
        assert (status, out.exists()) in ((0, True), (2, False)), error
        assert all(line.startswith(("shipfp: error: ", "shipfp: warning: ")) for line in error.splitlines())
        assert error.count("shipfp: error: ") == (status == 2)
        out.unlink(missing_ok=True)


@pytest.mark.parametrize("kind", KINDS)
def test_of_a_cut_file_only_what_was_written_is_read_and_the_loss_is_told(kind: str, tmp_path: Path) -> None:
    whole = sample_file(kind, tmp_path)
    content = whole.read_bytes()
    cut = tmp_path / f"cut{whole.suffix}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)  # DEWESoft channels that are never decoded
        written = samples(whole)
    for part in (0.4, 0.8, 0.999) if kind != "DEWESoft" else (0.5, 0.999):
        cut.write_bytes(content[: int(part * len(content))])
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                read = samples(cut)
            except InputError:
                continue
        assert set(read) <= set(written)
        for name, values in read.items():
            np.testing.assert_array_equal(values, written[name][: len(values)])
        lost = set(read) < set(written) or any(len(read[name]) < len(written[name]) for name in read)
        assert (
            any("lost" in str(warning.message) or "left out" in str(warning.message) for warning in told)
            >= lost
        )


def samples(path: Path) -> dict[str, np.ndarray]:
    log = Log.open(path, rate_hz=RATE_HZ)
    return {name: log.read(name) for name, channel in log.channels.items() if channel.samples}


@pytest.mark.study
@pytest.mark.parametrize("kind", KINDS)
def test_study_of_damaged_files(kind: str, tmp_path: Path) -> None:
    whole = sample_file(kind, tmp_path)
    # A fifth of DEWESoft's crash the vendor's library and one in fifteen hangs it: half an hour on a busy machine.
    tally = try_damaged(whole, tmp_path, 2000, seed=2)
    print(f"\n{'':20s} {Tally.HEADER}\n{kind:20s} {tally}")
    check(tally, whole)
