"""An engine on a bus becomes an experiment; what is not available stays out; a bus without a DBC says what to give."""

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import signals, simulate
from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers.can_signals import Signal
from shipfp_rs.processing.process import process
from shipfp_rs.vessel.vessel import Vessel
from tests.logger_files import DBC, mf4
from tests.processing.test_speed_sources import trial

DATA = Path(__file__).parents[1] / "data" / "logs"


def test_an_engine_on_j1939_becomes_an_experiment(tmp_path: Path) -> None:
    tug = Vessel.load("stan-tug-1205")
    chirp = signals.chirp(0.1, 0.5, 20.0, 60.0, rate_hz=100.0)
    truth = simulate(tug, chirp)
    jitter = np.random.default_rng(1).normal(0.0, 2e-4, len(truth.signals["n_e"]))
    frames = []
    for k, (n_set, n_e) in enumerate(zip(truth.signals["n_set"], truth.signals["n_e"], strict=True)):
        time = k / truth.rate_hz + 1.0 + jitter[k]
        asked, told = (round(rpm / 0.125).to_bytes(2, "little").hex() for rpm in (n_set, n_e))
        frames += [
            (time, None, 0x0C000003, f"FD{asked}E1FFFFFFFF"),
            (time + 1e-3, None, 0x0CF00400, f"FF7DA0{told}00FF7D"),
        ]
    mf4(tmp_path / "bus.mf4", frames)
    (tmp_path / "engine.dbc").write_text(DBC)
    log = Log.open(tmp_path / "bus.mf4", names=tmp_path / "engine.dbc")
    assert log.channels["EngSpeed"].resolution == 0.125
    table = 'column = "EngSpeed"\nunit = "rpm"\ndelay_s = 0.001'
    described = trial(tmp_path, table, n_e_rpm=1183.8, window=(4.0, 18.0), set_point="EngRequestedSpeed")
    (experiment,) = process(log, described)
    time = 4.0 - 1.0 + np.arange(len(experiment.signals["n_e"])) / experiment.rate_hz
    for name in ("n_set", "n_e"):
        expected = np.interp(time, np.arange(len(truth.signals[name])) / truth.rate_hz, truth.signals[name])
        assert np.nanstd(experiment.signals[name] - expected) < 0.3
    assert experiment.provenance["speed"]["std_rpm"] >= 0.125 / np.sqrt(12.0) * 0.99


def test_a_real_engine_idles() -> None:
    pytest.importorskip("asammdf")
    pytest.importorskip("cantools")
    folder = DATA / "j1939"
    log = Log.open(folder / "engine_idle.MF4", names=folder / "CSS-Electronics-SAE-J1939-DEMO.dbc")
    speed = log.channels["EngineSpeed"]
    assert (speed.unit, speed.resolution) == ("rpm", 0.125)
    assert speed.rate_hz == pytest.approx(100.0, rel=1e-3)
    assert 640.0 < np.nanmedian(log.read("EngineSpeed")) < 700.0


def test_a_real_yacht_runs_its_engine() -> None:
    log = Log.open(DATA / "nmea2000" / "susteranna-actisense-serial.raw")
    speed = log.channels["Engine Speed"]
    assert (speed.unit, speed.resolution) == ("rpm", 0.25)
    assert 780.0 < np.nanmedian(log.read("Engine Speed")) < 820.0


def test_a_rate_that_a_bus_has_no_use_for_is_told() -> None:
    with pytest.warns(LogWarning, match="a rate of 1e-09 Hz is given but not used"):
        Log.open(DATA / "nmea2000" / "susteranna-actisense-serial.raw", rate_hz=1e-9)


def test_a_channel_list_names_the_channels() -> None:
    folder = DATA / "iso19848"
    log = Log.open(folder / "TimeSeriesData.json", names=folder / "DataChannelList.json")
    channel = log.channels["M/E #1 Air Cooler CFW OUT Temp"]
    assert channel.unit == "°C"
    np.testing.assert_allclose(log.read(channel.name)[:2], [100.0, 100.5])


def test_a_bus_that_no_dbc_knows_says_what_to_give(tmp_path: Path) -> None:
    mf4(tmp_path / "bus.mf4", [(k / 10, None, 0x18FFAA00, "00" * 8) for k in range(20)])
    with pytest.raises(
        InputError, match=r"0x18FFAA00\) is known without a DBC; give one \(--names FILE.dbc\)"
    ):
        Log.open(tmp_path / "bus.mf4")
    (tmp_path / "engine.dbc").write_text(DBC)
    with pytest.raises(InputError, match=r"stands in engine\.dbc; give the DBC of this bus"):
        Log.open(tmp_path / "bus.mf4", names=tmp_path / "engine.dbc")


def test_values_that_are_not_available_are_gaps() -> None:
    speed = Signal("EngSpeed", "rpm", 24, 16, 0.125)
    data = np.array([[0, 0, 0, 0x00, 0x25, 0, 0, 0], [0, 0, 0, 0xFF, 0xFF, 0, 0, 0]], dtype=np.uint8)
    np.testing.assert_array_equal(speed.values(data, j1939=True), [1184.0, np.nan])


@pytest.mark.parametrize("little", [True, False])
def test_bits_are_taken_as_cantools_takes_them(little: bool) -> None:
    cantools = pytest.importorskip("cantools")
    draw = np.random.default_rng(2)
    order = "little_endian" if little else "big_endian"
    for length in (1, 3, 8, 12, 16, 27, 33):
        for signed in (False, True):
            start = (
                int(draw.integers(0, 64 - length))
                if little
                else 7 + 8 * int(draw.integers(0, (64 - length) // 8 + 1))
            )
            conversion = cantools.database.conversion.BaseConversion.factory(0.5, -3)
            theirs = cantools.database.can.Signal("s", start, length, order, signed, conversion=conversion)
            message = cantools.database.can.Message(1, "m", 8, [theirs])
            ours = Signal("s", "", start, length, 0.5, -3.0, little, signed)
            data = draw.integers(0, 256, (50, 8), dtype=np.uint8)
            expected = [message.decode(bytes(row))["s"] for row in data]
            np.testing.assert_array_equal(ours.values(data, j1939=False), expected)
