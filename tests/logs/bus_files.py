"""Writers of frames of a bus, and a DBC that knows an engine's."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

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
