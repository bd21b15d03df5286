"""An engine on a bus becomes an experiment; what is not available stays out; a bus without a DBC says what to give."""

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import signals, simulate
from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.log import Log
from shipfp_rs.logs.readers.can_signals import Signal
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.vessel.vessel import Vessel

DATA = Path(__file__).parents[1] / "data" / "logs"
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


def mf4(path: Path, frames: list[tuple[float, int, bytes]]) -> None:
    asammdf = pytest.importorskip("asammdf")
    frames = sorted(frames, key=lambda frame: frame[0])
    kinds = [("CAN_DataFrame.ID", "<u4"), ("CAN_DataFrame.IDE", "u1"), ("CAN_DataFrame.DataLength", "u1"),
             ("CAN_DataFrame.DataBytes", "(8,)u1")]  # fmt: skip
    rows = np.zeros(len(frames), dtype=kinds)
    rows["CAN_DataFrame.ID"] = [identifier for _, identifier, _ in frames]
    rows["CAN_DataFrame.IDE"], rows["CAN_DataFrame.DataLength"] = 1, 8
    rows["CAN_DataFrame.DataBytes"] = np.array([list(data) for *_, data in frames], dtype=np.uint8)
    times = np.array([time for time, *_ in frames])
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(rows, times, name="CAN_DataFrame")], acq_name="CAN")
        file.save(path, overwrite=True)


def test_an_engine_on_j1939_becomes_an_experiment(tmp_path: Path) -> None:
    tug = Vessel.load("stan-tug-1205")
    chirp = signals.chirp(0.1, 0.5, 20.0, 60.0, rate_hz=100.0)
    truth = simulate(tug, chirp)
    jitter = np.random.default_rng(1).normal(0.0, 2e-4, len(truth.signals["n_e"]))
    frames = []
    for k, (n_set, n_e) in enumerate(zip(truth.signals["n_set"], truth.signals["n_e"], strict=True)):
        time = k / truth.rate_hz + 1.0 + jitter[k]
        asked = b"\xfd" + round(n_set / 0.125).to_bytes(2, "little") + b"\xe1" + b"\xff" * 4
        told = b"\xff\x7d\xa0" + round(n_e / 0.125).to_bytes(2, "little") + b"\x00\xff\x7d"
        frames += [(time, 0x0C000003, asked), (time + 1e-3, 0x0CF00400, told)]
    mf4(tmp_path / "bus.mf4", frames)
    (tmp_path / "engine.dbc").write_text(DBC)
    (tmp_path / "TRIAL.toml").write_text(
        '[trial]\nname = "bus"\nvessel = "stan-tug-1205"\nlog = "bus.mf4"\nnames = "engine.dbc"\n'
        '[channels.set_point]\ncolumn = "EngRequestedSpeed"\nunit = "rpm"\ncalibration = { scale = 1.0 }\n'
        '[channels.speed]\ncolumn = "EngSpeed"\nunit = "rpm"\ndelay_s = 0.001\n'
        "[operating_point]\nn_e_rpm = 1183.8\n[processing]\nrate_hz = 20.0\nspeed = 'fused'\n"
        "[[windows]]\nname = 'C1'\nstart_s = 4.0\nstop_s = 18.0\n"
    )
    trial = Trial.load(tmp_path / "TRIAL.toml")
    (log,) = trial.logs()
    assert log.channels["EngSpeed"].resolution == 0.125
    (experiment,) = process(log, trial)
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
    mf4(tmp_path / "bus.mf4", [(k / 10, 0x18FFAA00, bytes(8)) for k in range(20)])
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
