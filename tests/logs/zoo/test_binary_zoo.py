"""Binary logs, buses and standards, made by the formats' own libraries: read to the samples, units and times they hold."""

import json
import warnings
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers import child_process
from tests.logger_files import START, by_python_can, hdf5_file, mf4, write_arrow, write_feather, write_mdf

RATE_HZ, ROWS = 20.0, 60
TIME = np.arange(ROWS) / RATE_HZ
M = np.round(1500.0 + 400.0 * np.sin(TIME), 3)
N = np.round((1184.0 + 20.0 * np.sin(TIME)) / 0.125) * 0.125
TORQUE_AND_SPEED = {"M [Nm]": M, "n [rpm]": N}
DATA = Path(__file__).parents[2] / "data" / "logs"
DBC = DATA / "j1939" / "CSS-Electronics-SAE-J1939-DEMO.dbc"


def parquet(path: Path, time: str = "time", values: object = None, **options: object) -> None:
    pa.parquet.write_table(
        pa.table({time: TIME if values is None else values, **TORQUE_AND_SPEED}), path, **options
    )


def stamps(unit: str) -> pa.Array:
    first = int(START.timestamp() * 1e9)
    return pa.array(first + np.rint(TIME * 1e9).astype(np.int64), pa.timestamp("ns")).cast(pa.timestamp(unit))


def mat(path: Path, content: dict[str, object], **options: object) -> None:
    from scipy.io import savemat

    savemat(path, content, **options)


def hdf5(path: Path, build: Callable[[object], None]) -> None:
    with hdf5_file(path) as file:
        build(file)


def tdms(path: Path, waveform: bool, stamped: bool = False) -> None:
    nptdms = pytest.importorskip("nptdms")
    facts = {"wf_increment": 1 / RATE_HZ} if waveform else {}
    time = (
        np.datetime64(START.replace(tzinfo=None)) + np.rint(TIME * 1e6).astype("m8[us]") if stamped else TIME
    )
    channels = [] if waveform else [nptdms.ChannelObject("g", "Time", time)]
    channels += [
        nptdms.ChannelObject("g", name, v, {"unit_string": u, **facts})
        for name, v, u in (("M", M, "Nm"), ("n", N, "1/min"))
    ]
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)


def mdf(path: Path, version: str) -> None:
    write_mdf(path, {"M": M, "n": N}, RATE_HZ, {"M": "Nm", "n": "U/min"}, version)


EEC1 = [
    (t, None, 0x0CF00400, f"FF7D82{int(n / 0.125).to_bytes(2, 'little').hex()}FFFF7D")
    for t, n in zip(TIME, N, strict=True)
]


def bus(path: Path) -> None:
    by_python_can(path, EEC1)


def n2k(path: Path, as_json: bool) -> None:
    lines = []
    for time, n in zip(TIME, N, strict=True):
        stamp = (START + timedelta(seconds=float(time))).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"
        raw = ",".join(f"{byte:02x}" for byte in int(n / 0.25).to_bytes(2, "little"))
        plain = f"{stamp},2,127488,5,255,8,00,{raw},ff,ff,7f,ff,ff"
        fields = {"Instance": 0, "Speed": float(n // 0.25 * 0.25)}
        told = {"timestamp": stamp, "prio": 2, "src": 5, "dst": 255, "pgn": 127488, "fields": fields}
        lines.append(json.dumps(told) if as_json else plain)
    path.write_text("\n".join(lines) + "\n")


def iso(path: Path, form: str) -> None:
    when = [(START + timedelta(seconds=float(t))).isoformat().replace("+00:00", "Z") for t in TIME]
    if form == "json":
        rows = [
            {"TimeStamp": t, "Value": [str(m), str(n)], "Quality": ["0", "0"]}
            for t, m, n in zip(when, M, N, strict=True)
        ]
        table = {"DataChannelID": ["M", "n"], "DataSet": rows}
        path.write_text(json.dumps({"Package": {"TimeSeriesData": [{"TabularData": [table]}]}}))
    elif form == "xml":
        rows = "".join(
            f'<DataSet timeStamp="{t}"><Value>{m}</Value><Value>{n}</Value></DataSet>'
            for t, m, n in zip(when, M, N, strict=True)
        )
        names = "<DataChannelID>M</DataChannelID><DataChannelID>n</DataChannelID>"
        path.write_text(
            f"<Package><TimeSeriesData><TabularData>{names}{rows}</TabularData></TimeSeriesData></Package>"
        )
    else:
        rows = "".join(f"{t},{m},{n}\n" for t, m, n in zip(when, M, N, strict=True))
        path.write_text(f"ShipID,IMO1234567\nTimeStamp,M,n\n{rows}")


TABLE = np.column_stack([TIME, M, N])
NAMES = np.array(["time", "M", "n"], dtype=object)
MADE: dict[str, tuple[str, Callable[[Path], None], dict[str, object], tuple[str, str]]] = {
    **{f"Parquet, time {unit}": (".parquet", lambda p, u=unit: parquet(p, "stamp", stamps(u)), {}, ("M", "n")) for unit in ("ms", "us", "ns")},
    "Parquet": (".parquet", parquet, {}, ("M", "n")),
    "Parquet, snappy": (".pq", lambda p: parquet(p, compression="snappy"), {}, ("M", "n")),
    "Parquet, small groups": (".parquet", lambda p: parquet(p, row_group_size=7), {}, ("M", "n")),
    "Parquet, time [ms]": (".parquet", lambda p: parquet(p, "Zeit [ms]", TIME * 1e3), {}, ("M", "n")),
    "Parquet, named time": (".parquet", lambda p: parquet(p, "foo"), {"time": "foo"}, ("M", "n")),
    "Parquet, rate": (
        ".parquet", lambda p: pa.parquet.write_table(pa.table(TORQUE_AND_SPEED), p), {"rate_hz": 20.0}, ("M", "n"),
    ),
    "Parquet, texts as time": (".parquet", lambda p: parquet(p, "Zeit", [f"05.11.2019 10:00:{t:06.3f}" for t in TIME]), {}, ("M", "n")),
    "Feather": (".feather", lambda p: write_feather(p, TORQUE_AND_SPEED, RATE_HZ), {}, ("M", "n")),
    "Arrow": (".arrow", lambda p: write_feather(p, TORQUE_AND_SPEED, RATE_HZ), {}, ("M", "n")),
    "Arrow stream": (".arrows", lambda p: write_arrow(p, TORQUE_AND_SPEED, RATE_HZ), {}, ("M", "n")),
    "MATLAB vectors": (".mat", lambda p: mat(p, {"time": TIME, "M": M, "n": N}), {}, ("M", "n")),
    "MATLAB columns": (".mat", lambda p: mat(p, {"t": TIME, "M": M, "n": N}, oned_as="column"), {}, ("M", "n")),
    "MATLAB fs": (".mat", lambda p: mat(p, {"fs": 20.0, "M": M, "n": N}), {}, ("M", "n")),
    "MATLAB dt": (".mat", lambda p: mat(p, {"dt": 0.05, "M": M, "n": N}), {}, ("M", "n")),
    "MATLAB compressed": (".mat", lambda p: mat(p, {"time": TIME, "M": M, "n": N}, do_compression=True), {}, ("M", "n")),
    "MATLAB 4": (".mat", lambda p: mat(p, {"time": TIME, "M": M, "n": N}, format="4"), {}, ("M", "n")),
    "MATLAB struct": (".mat", lambda p: mat(p, {"log": {"time": TIME, "M": M, "n": N}}), {}, ("log/M", "log/n")),
    "MATLAB struct, fs": (".mat", lambda p: mat(p, {"log": {"fs": 20.0, "M": M, "n": N}}), {}, ("log/M", "log/n")),
    "MATLAB struct, time outside": (".mat", lambda p: mat(p, {"time": TIME, "log": {"M": M, "n": N}}), {}, ("log/M", "log/n")),
    "MATLAB struct a channel": (".mat", lambda p: mat(p, {k: {"data": v, "fs": 20.0, "unit": u} for k, v, u in (("M", M, "Nm"), ("n", N, "1/min"))}), {}, ("M", "n")),
    "MATLAB nested structs": (".mat", lambda p: mat(p, {"a": {"b": {"time": TIME, "M": M, "n": N}}}), {}, ("a/b/M", "a/b/n")),
    "MATLAB matrix, names": (".mat", lambda p: mat(p, {"data": TABLE, "names": NAMES}), {}, ("M", "n")),
    "MATLAB matrix, lying": (".mat", lambda p: mat(p, {"data": TABLE.T, "colheaders": NAMES}), {}, ("M", "n")),
    "MATLAB matrix in a struct": (".mat", lambda p: mat(p, {"log": {"data": TABLE, "labels": NAMES}}), {}, ("log/M", "log/n")),
    "MATLAB matrix without names": (".mat", lambda p: mat(p, {"data": TABLE}), {}, ("data 2", "data 3")),
    "HDF5 time": (".h5", lambda p: hdf5(p, lambda f: [f.create_dataset(k, data=v) for k, v in (("time", TIME), ("M", M), ("n", N))]), {}, ("M", "n")),
    "HDF5 rate": (".hdf5", lambda p: hdf5(p, lambda f: [f.attrs.update(rate_hz=20.0), f.create_dataset("M", data=M), f.create_dataset("n", data=N)]), {}, ("M", "n")),
    "HDF5 gzip": (".h5", lambda p: hdf5(p, lambda f: [f.create_dataset(k, data=v, compression="gzip") for k, v in (("time", TIME), ("M", M), ("n", N))]), {}, ("M", "n")),
    "HDF5 groups": (".h5", lambda p: hdf5(p, lambda f: [f.create_dataset(k, data=v) for k, v in (("g/time", TIME), ("g/M", M), ("g/n", N))]), {}, ("g/M", "g/n")),
    "HDF5 matrix": (".h5", lambda p: hdf5(p, lambda f: f.create_dataset("data", data=TABLE).attrs.update(columns=["time", "M", "n"])), {}, ("M", "n")),
    "TDMS waveform": (".tdms", lambda p: tdms(p, True), {}, ("M", "n")),
    "TDMS time channel": (".tdms", lambda p: tdms(p, False), {}, ("M", "n")),
    "TDMS stamps": (".tdms", lambda p: tdms(p, False, True), {}, ("M", "n")),
    "MDF 4": (".mf4", lambda p: mdf(p, "4.10"), {}, ("M", "n")),
    "MDF 3": (".mdf", lambda p: mdf(p, "3.30"), {}, ("M", "n")),
    "CAN in MF4, DBC": (".mf4", lambda p: mf4(p, EEC1), {"names": DBC}, ("", "EngineSpeed")),
    "CAN in MF4, J1939": (".mf4", lambda p: mf4(p, EEC1), {}, ("", "EngSpeed")),
    **{f"CAN {suffix}": (suffix, bus, {"names": DBC}, ("", "EngineSpeed")) for suffix in (".blf", ".asc", ".trc", ".log")},
    "CAN .blf, J1939": (".blf", bus, {}, ("", "EngSpeed")),
    "NMEA 2000, raw": (".raw", lambda p: n2k(p, False), {}, ("", "Engine Speed")),
    "NMEA 2000, raw in .txt": (".txt", lambda p: n2k(p, False), {}, ("", "Engine Speed")),
    "NMEA 2000, JSON": (".json", lambda p: n2k(p, True), {}, ("", "Engine Speed")),
    "ISO 19848, JSON": (".json", lambda p: iso(p, "json"), {}, ("M", "n")),
    "ISO 19848, XML": (".xml", lambda p: iso(p, "xml"), {}, ("M", "n")),
    "ISO 19848, CSV": (".csv", lambda p: iso(p, "csv"), {}, ("M", "n")),
}  # fmt: skip


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that is busy with other work is no damaged file."""
    monkeypatch.setattr(child_process, "LIMIT_S", 300.0)


def test_the_zoo_is_large() -> None:
    assert len(MADE) >= 40


@pytest.mark.parametrize("kind", MADE)
def test_breakage_c5_binary_layouts(kind: str, tmp_path: Path) -> None:
    suffix, make, options, (torque, speed) = MADE[kind]
    path = tmp_path / f"log{suffix}"
    make(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        log = Log.open(path, **options)  # type: ignore[arg-type]
    channel = log.channels[speed]
    # A bus, or its logger's clock, is resampled; NMEA 2000 tells a quarter of a turn.
    within = 0.26 if kind.startswith(("NMEA", "CAN")) else 1e-9
    assert channel.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    np.testing.assert_allclose(log.read(speed)[: ROWS - 1], N[: ROWS - 1], atol=within)
    assert channel.unit in ("rpm", "")
    if torque:
        np.testing.assert_allclose(log.read(torque)[: ROWS - 1], M[: ROWS - 1], rtol=1e-9)
