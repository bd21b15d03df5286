"""`shipfp convert` loses nothing and fails in one line."""

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import cli
from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log
from tests.cli.small_trial import refused

FAMOS = Path(__file__).parents[1] / "data" / "logs" / "famos"


def test_prints_what_it_wrote(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("imctermite")
    out = tmp_path / "out.parquet"
    assert cli.main(["convert", str(FAMOS / "sampleA.raw"), str(out)]) == 0
    assert "pressure_Vacuum [mbar]: 2402 samples at 200 Hz" in capsys.readouterr().out
    before, after = Log.open(FAMOS / "sampleA.raw"), Log.open(out)
    assert after.start_utc == before.start_utc is not None
    assert after.channels == before.channels
    np.testing.assert_array_equal(after.read("pressure_Vacuum"), before.read("pressure_Vacuum"), strict=True)


def test_breakage_c6_convert_asks_before_it_replaces(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "in.parquet", tmp_path / "out.parquet"
    Log.from_arrays({"a": np.arange(9.0)}, rate_hz=1.0).write(source)
    out.write_text("precious")
    assert "out.parquet: exists already" in refused(["convert", str(source), str(out)], capsys)
    assert out.read_text() == "precious"
    assert cli.main(["convert", str(source), str(out), "--force"]) == 0
    assert len(Log.open(out).read("a")) == 9


@pytest.mark.parametrize("linked", [False, True])
def test_breakage_c6_a_log_is_never_written_over_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], linked: bool
) -> None:
    source, out = tmp_path / "in.parquet", tmp_path / "in.parquet"
    Log.from_arrays({"a": np.arange(9.0)}, rate_hz=1.0).write(source)
    if linked:
        out = tmp_path / "link.parquet"
        out.symlink_to(source)
    before = source.read_bytes()
    assert "is the log itself" in refused(["convert", str(source), str(out), "--force"], capsys)
    with pytest.raises(InputError, match="is the log itself"):
        Log.open(source).write(out)
    assert source.read_bytes() == before
