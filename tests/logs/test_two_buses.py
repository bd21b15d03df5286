"""A channel of a bus log is told apart by interface, address, message and signal; a request counts while it is made."""

from pathlib import Path

import pytest

from shipfp_rs.logs.log import Log
from tests.logger_files import by_python_can, candump, console, console_of_steps, mf4, relative_asc

EEC1, TSC1 = 0x0CF00400, 0x0C000027
PORT, STARBOARD = "F1FFA5E02E00FFFF", "F1FFC3602200FFFF"
TWO_BUSES = [
    frame for k in range(50) for frame in ((0.02 * k, 0, EEC1, PORT), (0.02 * k + 0.007, 1, EEC1, STARBOARD))
]


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
