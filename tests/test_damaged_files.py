"""Any bytes give a log or one line, in bounded time and memory; a reader that crashes takes nothing with it."""

from pathlib import Path

import pytest

from shipfp_rs.readers import isolation
from tests.damage import Tally, try_damaged
from tests.logger_files import REAL_FILES, WRITERS, sample_file

KINDS = (*WRITERS, *REAL_FILES)
SPARE = 200_000_000


@pytest.fixture(autouse=True)
def _short_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that hangs is ended; these files are small enough not to wait half a minute for it."""
    monkeypatch.setattr(isolation, "LIMIT_S", 2.0)


def check(tally: Tally, whole: Path) -> None:
    assert not tally.faults, tally.faults.most_common(5)
    assert tally.read + tally.refused == tally.tried
    assert tally.worst_bytes <= 3 * whole.stat().st_size + SPARE


@pytest.mark.parametrize("kind", KINDS)
def test_damage_gives_a_log_or_one_line(kind: str, tmp_path: Path) -> None:
    whole = sample_file(kind, tmp_path)
    check(try_damaged(whole, tmp_path, 6 if kind == "DEWESoft" else 50), whole)


@pytest.mark.study
@pytest.mark.parametrize("kind", KINDS)
def test_study_of_damaged_files(kind: str, tmp_path: Path) -> None:
    whole = sample_file(kind, tmp_path)
    tally = try_damaged(whole, tmp_path, 400 if kind == "DEWESoft" else 2000, seed=2)
    print(f"\n{'':20s} {Tally.HEADER}\n{kind:20s} {tally}")
    check(tally, whole)
