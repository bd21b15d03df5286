"""A channel of a bus log is told apart by interface, address, message and signal; a request counts while it is made."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.logs.log import Log

EEC1, TSC1 = 0x0CF00400, 0x0C000027
PORT, STARBOARD = "F1FFA5E02E00FFFF", "F1FFC3602200FFFF"
Frame = tuple[float, int, int, str]
"""Time [s], bus, identifier, bytes."""
TWO_BUSES = [
    frame for k in range(50) for frame in ((0.02 * k, 0, EEC1, PORT), (0.02 * k + 0.007, 1, EEC1, STARBOARD))
]


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
                               data=bytes.fromhex(data), channel=bus + 1))  # fmt: skip


def mf4(path: Path, frames: Sequence[Frame]) -> None:
    asammdf = pytest.importorskip("asammdf")
    kinds = [("CAN_DataFrame.BusChannel", "u1"), ("CAN_DataFrame.ID", "<u4"), ("CAN_DataFrame.IDE", "u1"),
             ("CAN_DataFrame.DataLength", "u1"), ("CAN_DataFrame.DataBytes", "(8,)u1")]  # fmt: skip
    rows = np.array(
        [(bus, name, 1, 8, list(bytes.fromhex(data))) for _, bus, name, data in frames], dtype=kinds
    )
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(rows, np.array([t for t, *_ in frames]), name="CAN_DataFrame")])
        file.save(path, overwrite=True)


@pytest.mark.parametrize(
    ("write", "suffix"),
    [(candump, ".log"), (console, ".log"), (console_of_steps, ".log"), (relative_asc, ".asc"),
     (by_python_can, ".asc"), (by_python_can, ".blf"), (by_python_can, ".trc"), (mf4, ".mf4")],
)  # fmt: skip
def test_an_engine_on_each_of_two_buses_is_two_engines(write, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"bus{suffix}"
    write(path, TWO_BUSES)
    log = Log.open(path)
    assert len(log.channels) == 4
    speeds = [name for name in log.channels if name.endswith(".EngSpeed")]
    torques = [name for name in log.channels if name.endswith(".ActualEngPercentTorque")]
    assert [set(log.read(name)) for name in speeds + torques] == [{1500.0}, {1100.0}, {40.0}, {70.0}]
    assert all(channel.rate_hz == pytest.approx(50.0, rel=1e-3) for channel in log.channels.values())


def test_a_bus_that_was_heard_twice_is_one(tmp_path: Path) -> None:
    frames = [(0.02 * k + late, bus, EEC1, f"F1FFA5{0xE0 + 8 * (k % 4):02X}2E00FFFF")
              for k in range(50) for bus, late in ((0, 0.0), (1, 3e-4))]  # fmt: skip
    candump(tmp_path / "bus.log", frames)
    log = Log.open(tmp_path / "bus.log")
    assert set(log.channels) == {"EngSpeed", "ActualEngPercentTorque"}
    assert log.channel("EngSpeed").rate_hz == pytest.approx(50.0)


def test_requests_to_two_engines_are_two_set_points(tmp_path: Path) -> None:
    frames = [(0.02 * k + 0.001 * engine, 0, TSC1 + 0x100 * engine, f"F1{speed}FFFFFFFFFF")
              for k in range(50) for engine, speed in ((0, "E02E"), (1, "6022"))]  # fmt: skip
    candump(tmp_path / "bus.log", frames)
    log = Log.open(tmp_path / "bus.log")
    assert {name: set(log.read(name)) for name in log.channels} == {
        "TSC1>0.EngRequestedSpeed": {1500.0},
        "TSC1>1.EngRequestedSpeed": {1100.0},
    }


@pytest.mark.parametrize(
    ("mode", "name", "value"),
    [
        (1, "EngRequestedSpeed", 1500.0),
        (2, "EngRequestedTorque", 40.0),
        (3, "EngRequestedSpeedLimit", 1500.0),
    ],
)
def test_a_request_counts_while_its_override_asks_for_it(
    mode: int, name: str, value: float, tmp_path: Path
) -> None:
    frames = [(0.02 * k, 0, TSC1, f"F{mode if k < 50 else 0}E02EA5FFFFFFFF") for k in range(100)]
    candump(tmp_path / "bus.log", frames)
    log = Log.open(tmp_path / "bus.log")
    assert set(log.channels) == {name} | ({"EngRequestedTorqueLimit"} if mode == 3 else set())
    channel = log.channel(name)
    assert (channel.samples, set(log.read(name))) == (50, {value})
