"""One small log in every format that `Log.open` reads, written by the format's own library or by a real logger."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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

Frame = tuple[float, int | None, int, str]
"""Time [s], bus (None: not told), identifier, bytes."""
DBC = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 2348810244 TSC1: 8 ECU
 SG_ EngRequestedSpeed : 8|16@1+ (0.125,0) [0|8031.875] "rpm" ECU
BO_ 2364540158 EEC1: 8 ECU
 SG_ ActualEngPercentTorque : 16|8@1+ (1,-125) [-125|125] "%" ECU
 SG_ EngSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" ECU
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_ "ProtocolType" STRING ;
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_DEF_DEF_ "ProtocolType" "";
BA_ "ProtocolType" "J1939";
BA_ "VFrameFormat" BO_ 2348810244 3;
BA_ "VFrameFormat" BO_ 2364540158 3;
"""


def candump(path: Path, frames: Sequence[Frame]) -> None:
    lines = (f"({1.7e9 + t:.6f}) can{bus} {name:08X}#{data}" for t, bus, name, data in frames)
    path.write_text("\n".join([*lines, ""]))


def console(path: Path, frames: Sequence[Frame]) -> None:
    spaced = [
        (t, bus, name, " ".join(data[k : k + 2] for k in range(0, 16, 2))) for t, bus, name, data in frames
    ]
    lines = (f" ({1.7e9 + t:.6f})  can{bus}  {name:08X}   [8]  {data}" for t, bus, name, data in spaced)
    path.write_text("\n".join([*lines, ""]))


def console_of_steps(path: Path, frames: Sequence[Frame]) -> None:
    steps = np.diff([t for t, *_ in frames], prepend=frames[0][0])
    console(path, [(step - 1.7e9, *frame[1:]) for step, frame in zip(steps, frames, strict=True)])


def relative_asc(path: Path, frames: Sequence[Frame]) -> None:
    steps = np.diff([t for t, *_ in frames], prepend=0.0)
    lines = (f"{step:11.6f} {bus + 1}  {name:X}x       Rx   d 8 {' '.join(data[k : k + 2] for k in range(0, 16, 2))}"
             for step, (_, bus, name, data) in zip(steps, frames, strict=True))  # fmt: skip
    head = ["date Tue Mar 5 09:59:30.000 am 2024", "base hex  timestamps relative", "internal events logged",
            "Begin Triggerblock Tue Mar 5 09:59:30.000 am 2024", "   0.000000 Start of measurement"]  # fmt: skip
    path.write_text("\n".join([*head, *lines, "End TriggerBlock", ""]))


def by_python_can(path: Path, frames: Sequence[Frame]) -> None:
    can = pytest.importorskip("can")
    with can.Logger(path) as writer:
        for time, bus, name, data in frames:
            writer(can.Message(timestamp=1.7e9 + time, arbitration_id=name, is_extended_id=True,
                               data=bytes.fromhex(data), channel=None if bus is None else bus + 1))  # fmt: skip


def mf4(path: Path, frames: Sequence[Frame]) -> None:
    """Frames in the order of their times, with a column of buses where each is told."""
    asammdf = pytest.importorskip("asammdf")
    frames = sorted(frames)
    columns = {"BusChannel": "u1", "ID": "<u4", "IDE": "u1", "DataLength": "u1", "DataBytes": "(8,)u1"}
    rows = [(bus, name, 1, 8, list(bytes.fromhex(data))) for _, bus, name, data in frames]
    if frames[0][1] is None:
        columns.pop("BusChannel")
        rows = [row[1:] for row in rows]
    kinds = [(f"CAN_DataFrame.{name}", kind) for name, kind in columns.items()]
    signal = asammdf.Signal(
        np.array(rows, dtype=kinds), np.array([t for t, *_ in frames]), name="CAN_DataFrame"
    )
    with asammdf.MDF(version="4.10") as file:
        file.append([signal], acq_name="CAN")
        file.save(path, overwrite=True)


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
