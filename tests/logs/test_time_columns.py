"""Columns go with the time column that is named after them, or with the last one to their left."""

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.logs.log import Log
from tests.logger_files import hdf5_file, opened

SPEED = 1500.0 + np.arange(400) % 3
TORQUE = 820.0 + np.arange(80) % 5
ROWS = [
    [f"{k:g}", f"{SPEED[k]:g}", *((f"{5 * k:g}", f"{TORQUE[k]:g}") if k < 80 else ("", ""))]
    for k in range(400)
]
TWINCAT = """Name\tScope YT Project
File\tC:\\scope.svdx

Name\tSpeed\tName\tTorque
SymbolComment\t\tSymbolComment\t
Data-Type\tREAL64\tData-Type\tREAL64
SampleTime[ms]\t1\tSampleTime[ms]\t5
VariableSize\t8\tVariableSize\t8
SymbolName\tGVL.fSpeed\tSymbolName\tGVL.fTorque
Port\t851\tPort\t851
Offset\t0\tOffset\t0
ScaleFactor\t1\tScaleFactor\t1
BitMask\t0xFFFFFFFFFFFFFFFF\tBitMask\t0xFFFFFFFFFFFFFFFF
"""


@pytest.mark.parametrize(
    ("head", "order"),
    [("Time [ms]\tSpeed\tTime [ms]\tTorque", (0, 1, 2, 3)), (TWINCAT, (0, 1, 2, 3)), (TWINCAT[:-1], (0, 1, 2, 3)),
     ("Zeit  1 - Standardrate [ms]\tSpeed\tZeit  2 - langsame Rate [ms]\tTorque", (0, 1, 2, 3)),
     ("Speed_Time [ms]\tSpeed\tTorque_Time [ms]\tTorque", (0, 1, 2, 3)),
     ("t_Speed [ms]\tt_Torque [ms]\tSpeed\tTorque", (0, 2, 1, 3))],
)  # fmt: skip
def test_each_time_column_is_that_of_its_own_columns(
    head: str, order: tuple[int, ...], tmp_path: Path
) -> None:
    rows = ("\t".join(row[k] for k in order) for row in ROWS)
    log = opened(tmp_path, head, *rows, name="log.txt")
    assert [(name, round(c.rate_hz, 6), c.samples) for name, c in log.channels.items()] == [
        ("Speed", 1000.0, 400),
        ("Torque", 200.0, 80),
    ]
    np.testing.assert_array_equal(log.read("Speed"), SPEED)
    np.testing.assert_array_equal(log.read("Torque"), TORQUE)


def test_stamps_may_stand_beside_each_column(tmp_path: Path) -> None:
    rows = [f"2026-03-14 09:12:{0.05 * k:06.3f};{SPEED[k]:g};" + (
        f"2026-03-14 09:12:{0.25 * k + 0.1:06.3f};{TORQUE[k]:g}" if k < 80 else ";") for k in range(400)]  # fmt: skip
    log = opened(tmp_path, "Timestamp;Speed;Timestamp;Torque", *rows)
    assert log.channel("Torque").start_s == pytest.approx(0.1)
    np.testing.assert_array_equal(log.read("Torque"), TORQUE)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_times_named_after_their_channel_win_over_a_stated_rate(version: str, tmp_path: Path) -> None:
    held = {"Data1_Set": SPEED[:80], "Data1_time_Set": 0.02 * np.arange(80), "Data1_Pickup": SPEED,
            "Data1_time_Pickup": 0.001 * np.arange(400), "Sample_rate": 1000.0}  # fmt: skip
    path = tmp_path / "log.mat"
    if version == "5":
        from scipy.io import savemat

        savemat(path, held)
    else:
        with hdf5_file(path) as file:
            for name, values in held.items():
                file[name] = np.atleast_1d(values)
    log = Log.open(path)
    assert {name: round(c.rate_hz, 6) for name, c in log.channels.items()} == {
        "Data1_Set": 50.0,
        "Data1_Pickup": 1000.0,
    }
