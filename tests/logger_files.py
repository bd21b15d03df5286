"""One small log in every format that `Log.open` reads, written by the format's own library or by a real logger."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.feather
import pyarrow.ipc
import pyarrow.parquet
import pytest

from shipfp_rs.logs.log import Log

REAL = Path(__file__).parent / "data" / "logs"
RATE_HZ = 100.0
START = datetime(2026, 5, 1, 10, tzinfo=UTC)

WHOLE = tuple(f"{sign}int{bits}" for bits in (8, 16, 32, 64) for sign in ("", "u"))
TYPES = ("bool", *WHOLE, "float16", "float32", "float64")

Arrays = dict[str, npt.NDArray[np.generic]]
Units = Mapping[str, str]
NO_UNITS: Units = {}
"""Each is in volts."""


def extremes(dtype: str, count: int = 300) -> npt.NDArray[np.generic]:
    """Values of a type with its ends among them."""
    draw = np.random.default_rng(TYPES.index(dtype))
    if dtype == "bool":
        return draw.integers(0, 2, count).astype(bool)
    if np.dtype(dtype).kind in "iu":
        ends = np.iinfo(dtype)
        edges = np.array([ends.min, ends.max, ends.max - 1, 0], dtype)
        return np.concatenate([edges, draw.integers(ends.min, ends.max, count - 4, dtype)])
    ends = np.finfo(dtype)
    special = np.array(
        [ends.min, ends.max, ends.tiny, ends.smallest_subnormal, -0.0, np.inf, -np.inf, np.nan], dtype
    )
    return np.concatenate([special, draw.standard_normal(count - len(special)).astype(dtype)])


def opened(folder: Path, *lines: str, name: str = "log.csv") -> Log:
    """Write the lines of a text log, and open it."""
    (folder / name).write_text("\n".join([*lines, ""]), encoding="utf-8")
    return Log.open(folder / name)


def altered(log: Log, changes: Mapping[str, tuple[slice, float]]) -> Log:
    """Return a log of one rate with other samples in some of its channels."""
    arrays = {name: log.read(name).copy() for name in log.channels}
    for name, (samples, value) in changes.items():
        arrays[name][samples] = value
    units = {name: channel.unit for name, channel in log.channels.items()}
    (rate_hz,) = {channel.rate_hz for channel in log.channels.values()}
    return Log.from_arrays(arrays, rate_hz=rate_hz, units=units)


def _piece(arrays: Arrays) -> int:
    """Rows that are stored together: several pieces in a short log, of a common size in a long one."""
    return max(100, len(next(iter(arrays.values()))) // 50)


def write_parquet(path: Path, arrays: Arrays, rate_hz: float = RATE_HZ) -> None:
    time = np.arange(len(next(iter(arrays.values())))) / rate_hz
    pa.parquet.write_table(pa.table({"time": time, **arrays}), path, row_group_size=_piece(arrays))


def write_feather(path: Path, arrays: Arrays, rate_hz: float = RATE_HZ) -> None:
    time = np.arange(len(next(iter(arrays.values())))) / rate_hz
    pa.feather.write_feather(pa.table({"time": time, **arrays}), path, chunksize=_piece(arrays))


def write_arrow(path: Path, arrays: Arrays, rate_hz: float = RATE_HZ) -> None:
    time = np.arange(len(next(iter(arrays.values())))) / rate_hz
    table = pa.table({"time": time, **arrays})
    with pa.ipc.new_stream(path, table.schema) as writer:
        writer.write_table(table, max_chunksize=_piece(arrays))


def write_csv(path: Path, arrays: Arrays) -> None:
    names = [f"{name} [V]" for name in arrays]
    columns = [
        [str(x).lower() if a.dtype.kind == "b" else repr(x.item()) for x in a] for a in arrays.values()
    ]
    lines = [",".join(["time [s]", *names])]
    lines += [",".join([f"{k / RATE_HZ:.2f}", *row]) for k, row in enumerate(zip(*columns, strict=True))]
    path.write_text("\n".join(lines) + "\n")


def write_tdms(path: Path, arrays: Arrays, rate_hz: float = RATE_HZ, units: Units = NO_UNITS) -> None:
    tdms = pytest.importorskip("nptdms")
    facts = {"wf_increment": 1 / rate_hz, "wf_start_time": np.datetime64(START.replace(tzinfo=None))}
    rows, piece = len(next(iter(arrays.values()))), _piece(arrays)
    with tdms.TdmsWriter(path) as writer:
        for start in range(0, rows, piece):
            writer.write_segment(
                [
                    tdms.ChannelObject(
                        "a", name, array[start : start + piece], facts | {"unit_string": units.get(name, "V")}
                    )
                    for name, array in arrays.items()
                ]
            )


def write_mdf(
    path: Path,
    arrays: Arrays,
    rate_hz: float = RATE_HZ,
    units: Units = NO_UNITS,
    version: str = "4.10",
    compression: int = 0,
) -> None:
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version=version) as file:
        file.header.start_time = START
        for name, array in arrays.items():
            time, unit = np.arange(len(array)) / rate_hz, units.get(name, "V")
            file.append([asammdf.Signal(array, time, name=name, unit=unit)])
        file.save(path, overwrite=True, compression=compression)


def hdf5_file(path: Path) -> Any:
    """Begin an HDF5 file; skip the test where its package is missing."""
    return pytest.importorskip("h5py").File(path, "w")


def write_hdf5(path: Path, arrays: Arrays, rate_hz: float = RATE_HZ, units: Units = NO_UNITS) -> None:
    with hdf5_file(path) as file:
        file.attrs["rate_hz"] = rate_hz
        file.attrs["start_utc"] = START.isoformat()
        for name, array in arrays.items():
            dataset = file.create_dataset(name, data=array, chunks=(_piece(arrays),), compression="gzip")
            dataset.attrs["unit"] = units.get(name, "V")


def write_mat_7_3(path: Path, arrays: Arrays) -> None:
    """As MATLAB lays it out: 512 bytes of its own in front, vectors as one-row matrices with their class."""
    h5py = pytest.importorskip("h5py")
    classes = {"float64": "double", "float32": "single", "bool": "logical"}
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in {**arrays, "fs": np.array([RATE_HZ])}.items():
            stored = array.astype(np.uint8) if array.dtype.kind == "b" else array
            dataset = file.create_dataset(name, data=stored.reshape(1, -1))
            dataset.attrs["MATLAB_class"] = np.bytes_(classes.get(str(array.dtype), str(array.dtype)))
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")


def write_mat_5(path: Path, arrays: Arrays, rate_hz: float = RATE_HZ, compress: bool = True) -> None:
    from scipy.io import savemat

    savemat(path, {**arrays, "fs": rate_hz}, do_compression=compress, oned_as="column")


WRITERS: dict[str, tuple[str, Callable[[Path, Arrays], None]]] = {
    "Parquet": (".parquet", write_parquet),
    "Feather": (".feather", write_feather),
    "Arrow stream": (".arrows", write_arrow),
    "CSV": (".csv", write_csv),
    "TDMS": (".tdms", write_tdms),
    "MDF 4": (".mf4", write_mdf),
    "MDF 4, compressed": (".mf4", lambda path, arrays: write_mdf(path, arrays, compression=2)),
    "MDF 3": (".mdf", lambda path, arrays: write_mdf(path, arrays, version="3.30")),
    "HDF5": (".h5", write_hdf5),
    "MATLAB 7.3": (".mat", write_mat_7_3),
    "MATLAB 5": (".mat", write_mat_5),
    "MATLAB 5, plain": (".mat", lambda path, arrays: write_mat_5(path, arrays, compress=False)),
}

REAL_FILES = {
    "imc FAMOS": REAL / "famos" / "sampleA.raw",
    "imc FAMOS, int16": REAL / "famos" / "datasetA_1.raw",
    "DEWESoft": REAL / "dewesoft" / "Example_Drive01.d7d",
}

NEEDS = {
    "TDMS": "nptdms",
    "MDF": "asammdf",
    "HDF5": "h5py",
    "MATLAB 7.3": "h5py",
    "imc": "imctermite",
    "DEWESoft": "dwdatareader",
}


def sample_file(kind: str, folder: Path) -> Path:
    """Give a whole file of a format; skip the test where its package is missing."""
    for start, package in NEEDS.items():
        if kind.startswith(start):
            pytest.importorskip(package)
    if kind in REAL_FILES:
        return REAL_FILES[kind]
    suffix, write = WRITERS[kind]
    path = folder / f"whole{suffix}"
    draw = np.random.default_rng(0)
    torque = draw.standard_normal(2000)
    write(
        path, {"torque": torque, "speed": (100 * torque).astype(np.int16), "level": torque.astype(np.float32)}
    )
    return path
