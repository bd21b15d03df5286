"""Every number type keeps every bit through every format, and through `shipfp convert`."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from shipfp_rs import cli
from shipfp_rs.logs.log import Log
from shipfp_rs.support.files import finite
from tests.logger_files import TYPES, WRITERS, extremes, write_tdms

LACKS = {
    # What the format, or the library that writes it here, can't hold.
    "CSV": {"float16"},
    "TDMS": {"float16"},
    "MDF 3": {"bool", "float16"},
    "MATLAB 7.3": {"float16"},
    "MATLAB 5": {"float16"},
}
READ_AS = {
    # Text has no types: the narrowest of these that holds the column.
    "CSV": {"float32": "float64", **{t: "int64" for t in TYPES if "int" in t and t != "uint64"}},
    "MDF 4": {"bool": "uint8"},
}


def expected(kind: str, dtype: str) -> np.ndarray | None:
    family = kind.split(",")[0]
    if dtype in LACKS.get(family, ()):
        return None
    return extremes(dtype).astype(READ_AS.get(family, {}).get(dtype, dtype))


@pytest.mark.parametrize("kind", WRITERS)
def test_every_type_survives_reading_and_converting(kind: str, tmp_path: Path) -> None:
    suffix, write = WRITERS[kind]
    source, out = tmp_path / f"in{suffix}", tmp_path / "out.parquet"
    wanted = {dtype: array for dtype in TYPES if (array := expected(kind, dtype)) is not None}
    write(source, {dtype: extremes(dtype) for dtype in wanted})
    assert cli.main(["convert", str(source), str(out)]) == 0
    before, after = Log.open(source), Log.open(out)
    assert dict(after.channels) == dict(before.channels)
    assert after.start_utc == before.start_utc
    for dtype, array in wanted.items():
        for log in (before, after):
            read = log.read(dtype)
            assert read.dtype == array.dtype, (log, dtype)
            # NaN has many bit patterns; all numbers, and the sign of zero, must be the same.
            np.testing.assert_array_equal(read, array)
            if array.dtype.kind == "f":
                np.testing.assert_array_equal(np.signbit(read), np.signbit(array))


def test_an_array_of_no_dimension_is_a_number_of_json() -> None:
    assert finite([np.array(7.0), np.float64("nan"), np.int64(2)]) == [7.0, None, 2]


@pytest.mark.parametrize("dtype", ["int64", "uint64"])
def test_gaps_cost_the_integers_beside_them_no_bit(dtype: str, tmp_path: Path) -> None:
    ends = np.iinfo(dtype)
    column = pa.array([ends.max, None, ends.min, ends.max - 1], type=pa.from_numpy_dtype(dtype))
    pa.parquet.write_table(pa.table({"count": column}), tmp_path / "in.parquet")
    out = Log.open(tmp_path / "in.parquet", rate_hz=1.0).write(tmp_path / "out.parquet")
    assert pa.parquet.read_table(out).column("count").combine_chunks() == column
    np.testing.assert_array_equal(Log.open(out).read("count")[[0, 1]], [float(ends.max), np.nan])


def test_strings_among_the_channels_are_left_out(tmp_path: Path) -> None:
    tdms = pytest.importorskip("nptdms")
    path = tmp_path / "log.tdms"
    write_tdms(path, {"a": np.arange(5.0)})
    with tdms.TdmsWriter(path, "a") as writer:
        writer.write_segment([tdms.ChannelObject("a", "note", ["x", "y"], {"wf_increment": 1.0})])
    with pytest.warns(UserWarning, match="left out.*note"):
        assert list(Log.open(path).channels) == ["a"]
