"""Logs as people have them: a format, channel names of a language, units, a drive, and what was done with it.

A row of `ROWS` is a log. A new kind of trial adds rows here, and, where it needs them, a drive or a format.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import shipfp_rs as fp
from shipfp_rs import _core, cli
from shipfp_rs.structures.ship import commanded
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.units import TO_NM, TO_RPM, TO_W, told
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.vessel import Vessel
from tests.first_hour import exports
from tests.logger_files import (
    DBC,
    candump,
    mf4,
    relative_asc,
    write_hdf5,
    write_mat_5,
    write_mdf,
    write_parquet,
    write_tdms,
)
from tests.twins.ship import vector

Columns = Mapping[tuple[str, str], np.ndarray]
"""Name and unit to samples."""

FINER = 10
"""Steps of the simulation to a sample of the log: no logger's clock is that of the steps."""
FULL_NM = 400.0
"""Torque of an engine on a bus of which it tells per cent [Nm]."""
NOISE = {"n_e": 0.01, "M_g": 0.02, "M_b": 0.02}
"""Standard deviations over those of the clean signals."""


def parquet(path: Path, rate_hz: float, columns: Columns) -> None:
    named = {f"{name} [{unit}]" if unit else name: values for (name, unit), values in columns.items()}
    write_parquet(path, named, rate_hz)


def matlab(path: Path, rate_hz: float, columns: Columns) -> None:
    write_mat_5(path, {name: values for (name, _), values in columns.items()}, rate_hz, compress=False)


def tdms(path: Path, rate_hz: float, columns: Columns) -> None:
    write_tdms(path, {name: values for (name, _), values in columns.items()}, rate_hz, dict(columns.keys()))


def mdf(path: Path, rate_hz: float, columns: Columns) -> None:
    write_mdf(path, {name: values for (name, _), values in columns.items()}, rate_hz, dict(columns.keys()))


def hdf5(path: Path, rate_hz: float, columns: Columns) -> None:
    write_hdf5(path, {name: values for (name, _), values in columns.items()}, rate_hz, dict(columns.keys()))


SUFFIXES: Mapping[Callable[..., None], str] = {
    parquet: ".parquet",
    matlab: ".mat",
    tdms: ".tdms",
    mdf: ".mf4",
    hdf5: ".h5",
    exports.labview: ".lvm",
    exports.catman: ".asc",
    mf4: ".mf4",
    candump: ".log",
    relative_asc: ".asc",
}
"""Of formats other than .csv."""


def tug() -> Vessel:
    return Vessel.load("stan-tug-1205")


def launch() -> Vessel:
    return Vessel.load("stan-launch-804")


def lab_drive() -> Vessel:
    """A motor of 12 Nm at 900 rpm and a fan on its shaft."""
    return _direct(n_e_rpm=900.0, M_b_Nm=12.0, inertia=0.09, exponent=2.0, g=-0.1, K_p=4.0, K_i=6.0)


def genset() -> Vessel:
    """A diesel of 800 Nm at 1500 rpm, and an alternator whose load hardly goes with the speed."""
    return _direct(n_e_rpm=1500.0, M_b_Nm=800.0, inertia=4.0, exponent=0.5, g=-0.4, K_p=6.0, K_i=8.0)


def _direct(*, n_e_rpm: float, M_b_Nm: float, inertia: float, exponent: float, **loop: float) -> Vessel:
    """A drive without a gearbox; what is not given here is the launch's, and far from any limit."""
    content = launch().model_dump()
    content["engine"] = {**content["engine"], "envelope": None, "rated_speed_rpm": 2.0 * n_e_rpm}
    content["engine"]["rated_power_kW"] = 2.0 * M_b_Nm * n_e_rpm * np.pi / 30e3
    content["gearbox"] = {"ratio": 1.0, "efficiency": 1.0}
    content["shaft"] = {"inertia_kg_m2": inertia, "propeller_side_inertia_kg_m2": 0.3 * inertia}
    content["propeller"] = {**content["propeller"], "torque_exponent": exponent}
    content["governor"] = {"K_p": loop["K_p"], "K_i": loop["K_i"]}
    content["operating_point"] = {
        "n_e_rpm": n_e_rpm, "X_0_mm": 10.0, "M_b_Nm": M_b_Nm, "v": 1.0 - loop["g"], "g": loop["g"],
    }  # fmt: skip
    return Vessel.model_validate({**content, "name": "A drive"})


def sines(rate_hz: float, rpm: float) -> fp.Excitation:
    return fp.signals.sine_sequence([0.05, 0.15, 0.4, 1.0], 4, rpm, rate_hz=rate_hz)


def chirp(rate_hz: float, rpm: float) -> fp.Excitation:
    return fp.signals.chirp(0.03, 1.5, 90.0, rpm, law="logarithmic", rate_hz=rate_hz)


def multisine(rate_hz: float, rpm: float) -> fp.Excitation:
    return fp.signals.multisine(np.geomspace(0.05, 1.5, 10), 40.0, 1.5 * rpm, periods=3, rate_hz=rate_hz)


def steps(rate_hz: float, rpm: float) -> fp.Excitation:
    heights = rpm * np.array([1.0, -1.0, -0.6, 1.2, 0.4, -1.0, 0.6, 0.0])
    return fp.signals.steps(np.diff(heights, prepend=0.0), 14.037, rate_hz=rate_hz)


def answer(path: Path, answers: Mapping[str, str]) -> None:
    """Write into a trial what a person gives in place of what `init` left."""
    text = path.read_text(encoding="utf-8")
    for question, given in answers.items():
        assert text.count(question) == 1
        text = text.replace(question, given)
    path.write_text(text, encoding="utf-8")


@dataclass(frozen=True)
class Row:
    """A log and what it must be taken for.

    Parameters
    ----------
    name
        Of the row.
    write
        Writer of the format.
    drive, excitation, rate_hz
        What was driven, how, and how often it was recorded.
    signals
        Signal of `recorded` to name and unit of its channel: n_set or command, n_e, M_g or M_b; n_s for a second shaft,
        M_load for the power of a load.
    others
        Channels beside: name and unit to a mean, noise about it.
    share
        Size of the excitation over the operating point.
    answers
        What `init` leaves to be answered to what a person writes in its place.
    """

    name: str
    write: Callable[..., None]
    drive: Callable[[], Vessel]
    excitation: Callable[[float, float], fp.Excitation]
    rate_hz: float
    signals: Mapping[str, tuple[str, str]]
    others: Mapping[tuple[str, str], float] = field(default_factory=dict)
    share: float = 0.03
    answers: Mapping[str, str] = field(default_factory=dict)

    @property
    def truth(self) -> dict[str, float]:
        """True parameters and ratios of them, by the names of a fingerprint."""
        told = dataclasses.asdict(linearise(self.drive()))
        v = told.pop("v")
        told |= {"vK_p": v * told.pop("K_p"), "vK_i": v * told.pop("K_i")}
        ratios = {f"{gain}/tau_n": told[gain] / told["tau_n"] for gain in ("vK_p", "vK_i")}
        return {**told, **ratios, "(p-g)/tau_n": (told["p"] - told["g"]) / told["tau_n"]}

    def recorded(self) -> Mapping[str, np.ndarray]:
        """Return the signals at `FINER` times the rate of the log, in rpm, rev/s, Nm and W."""
        vessel = self.drive()
        rpm = self.share * vessel.operating_point.n_e_rpm
        asked = self.excitation(FINER * self.rate_hz, rpm).settled(25.0, 10.0)
        noise = {signal: NOISE[signal] for signal in self.signals if signal in NOISE}
        return fp.simulate(vessel, asked, noise=noise, seed=len(self.name)).signals

    def trial(self, folder: Path) -> Path:
        """Write the log and let `init` write its trial; return that, with a person's answers."""
        logs = [part for path in self.written(folder) for part in ("--log", str(path))]
        assert cli.main(["init", str(folder), *logs, *self.options(folder)]) == 0
        path = folder / "TRIAL.toml"
        asked = path.read_text(encoding="utf-8").count('"to be given"')
        assert asked == sum("to be given" in question for question in self.answers)
        answer(path, self.answers)
        return path

    def options(self, folder: Path) -> list[str]:
        """Return options of `init` beside the log."""
        return []

    def columns(self) -> dict[tuple[str, str], Any]:
        """Return what a logger records, by name and unit."""
        recorded, draw = self.recorded(), np.random.default_rng(len(self.name))
        columns: dict[tuple[str, str], Any] = {}
        for signal, (name, unit) in self.signals.items():
            factor = {**TO_RPM, **TO_NM, **TO_W, "V": 1.0, "%": FULL_NM / 100.0}[told(unit) or "deg/s"]
            rpm_a_unit = 60.0 if signal == "n_s" else 1.0
            columns[name, unit] = recorded[signal][FINER // 2 :: FINER] * rpm_a_unit / factor
        count = len(next(iter(columns.values())))
        columns |= {
            key: mean * (1.0 + 1e-3 * draw.standard_normal(count)) for key, mean in self.others.items()
        }
        return columns

    def written(self, folder: Path) -> list[Path]:
        """Write the log; return its path, or those of each logger."""
        path = folder / f"log{SUFFIXES.get(self.write, '.csv')}"
        self.write(path, self.rate_hz, self.columns())
        return [path]


LEVELS = (1.0, 0.6, 0.9, 0.3, 1.1, 0.7, 0.2, 0.8)
"""Of a load, over the operating point's."""


@dataclass(frozen=True)
class Loaded(Row):
    """A row whose load moves, in steps of a tenth of a second; the set point rests, or has the excitation's share.

    Parameters
    ----------
    levels
        Of the load, over the operating point's, before the first step and after each.
    idles
        Part of the torque that is there without it.
    """

    levels: tuple[float, ...] = (1.0, *LEVELS[1:])
    idles: float = 0.3

    @property
    def truth(self) -> dict[str, float]:
        """What does not depend on the torque that others are over."""
        told, point = super().truth, self.drive().operating_point
        assert point.M_b_Nm is not None
        inertia = told["tau_n"] * point.M_b_Nm / (2.0 * np.pi * point.n_e_rpm / 60.0)
        return {name: told[name] for name in ("vK_p/tau_n", "vK_i/tau_n", "(p-g)/tau_n")} | {
            "inertia": inertia
        }

    def recorded(self) -> Mapping[str, np.ndarray]:
        point, random, rate_hz = self.drive().operating_point, np.random.default_rng(3), FINER * self.rate_hz
        ship = {**dataclasses.asdict(linearise(self.drive())), "load_gain": 1.0 - self.idles}
        starts = 40.0 + 11.3 * np.arange(len(self.levels) - 1)
        time = np.arange(0.0, starts[-1] + 12.0, 1.0 / rate_hz)
        at = np.column_stack([starts, starts + 0.1]).ravel()
        levels = np.interp(time, at, np.repeat(self.levels, 2)[1:-1])
        asked = 1.0 + self.share * np.interp(
            time, at - 4.1, np.repeat([0.0, *np.resize([1.0, -1.0, 0.4, -0.7], len(starts))], 2)[1:-1]
        )
        outputs = [_core.SHIP_OUTPUTS.index(name) for name in ("dn", "dM_b")]
        moved = _core.simulate_ship(vector(**ship), asked, levels - 1.0, 1.0 / rate_hz, 0, "first", outputs)
        late = time >= 20.0  # it began at the operating point, under load
        speed, torque = (1.0 + row[late] for row in moved)
        noisy = lambda row, part: row * (1.0 + part * random.standard_normal(len(row)))  # noqa: E731
        power = (1.0 - self.idles) * point.M_b_Nm * levels[late] * 2.0 * np.pi * point.n_e_rpm / 60.0 * speed
        return {
            "n_set": point.n_e_rpm * asked[late],
            "n_e": noisy(point.n_e_rpm * speed, 5e-4),
            "M_b": noisy(point.M_b_Nm * torque, 5e-3),
            "M_load": noisy(power, 1e-3),
        }


@dataclass(frozen=True)
class TwoLoggers(Loaded):
    """Set point and speed stand in one log, torque and load in another one, on the same clock."""

    def written(self, folder: Path) -> list[Path]:
        columns = list(self.columns().items())
        paths = [folder / f"{name}{SUFFIXES.get(self.write, '.csv')}" for name in ("speed", "load")]
        for path, part in zip(paths, (columns[:2], columns[2:]), strict=True):
            self.write(path, self.rate_hz, dict(part))
        return paths


@dataclass(frozen=True)
class Encoder(Row):
    """A row whose speed is a train of pulses, and whose torque is in volts: a raw log of the measuring system.

    Parameters
    ----------
    pulses
        Of a turn of the engine.
    nm_a_volt
        Scale of the torque.
    swing
        Of the speed within a turn, over its mean.
    """

    pulses: int = 8
    nm_a_volt: float = 200.0
    swing: float = 0.0

    def recorded(self) -> Mapping[str, np.ndarray]:
        signals = super().recorded()
        turns = np.cumsum(signals["n_e"]) / (60.0 * FINER * self.rate_hz)
        turns = turns + self.swing * np.sin(2.0 * np.pi * turns) / (2.0 * np.pi)
        high = (self.pulses * turns) % 1.0 < 0.4
        return {
            **signals,
            "n_e": 0.1 + 4.8 * high + 0.02 * np.random.default_rng(5).standard_normal(len(turns)),
            "M_b": signals["M_b"] / self.nm_a_volt,
        }


@dataclass(frozen=True)
class Edges(Encoder):
    """An encoder whose changes alone a logic analyser recorded, beside a table of the rest on the same clock."""

    def recorded(self) -> Mapping[str, np.ndarray]:
        return Row.recorded(self)

    def written(self, folder: Path) -> list[Path]:
        columns, rpm = self.columns(), self.recorded()["n_e"][FINER // 2 :]
        name = self.signals["n_e"][0]
        turns = self.pulses * (np.cumsum(rpm) - 0.5 * rpm) / (60.0 * FINER * self.rate_hz)
        rises, falls = (
            np.interp(
                np.arange(1.0, turns[-1] - 1.0) + part, turns, np.arange(len(turns)) / (FINER * self.rate_hz)
            )
            for part in (0.0, 0.4)
        )
        exports.edges(folder / "digital.csv", name, rises, falls)
        self.write(
            folder / "rest.csv", self.rate_hz, {key: x for key, x in columns.items() if key[0] != name}
        )
        return [folder / "digital.csv", folder / "rest.csv"]


@dataclass(frozen=True)
class Bus(Row):
    """A row of an engine's bus by SAE J1939: its torque is in per cent of one that is to be given.

    Parameters
    ----------
    beside
        Whether an engine that idles is on a second bus.
    """

    beside: bool = False

    def options(self, folder: Path) -> list[str]:
        (folder / "engine.dbc").write_text(DBC)
        return ["--names", str(folder / "engine.dbc")]

    def written(self, folder: Path) -> list[Path]:
        told, frames = self.recorded(), []
        for k in range(len(told["n_e"]) // FINER):
            asked, speed = (
                round(told[name][k * FINER] / 0.125).to_bytes(2, "little") for name in ("n_set", "n_e")
            )
            torque = bytes([round(100.0 * told["M_b"][k * FINER] / FULL_NM) + 125])
            at_s = k / self.rate_hz
            frames.append((at_s, 0, 0x0C000003, f"FD{asked.hex()}E1FFFFFFFF"))
            frames.append((at_s, 0, 0x0CF00400, f"FF7D{torque.hex()}{speed.hex()}00FF7D"))
            if self.beside:
                frames.append((at_s, 1, 0x0CF00400, f"FF7D9B{0xC0 + k * k % 7:02X}1500FF7D"))
        path = folder / f"bus{SUFFIXES.get(self.write, '.csv')}"
        self.write(path, frames)
        return [path]


@dataclass(frozen=True)
class Commanded(Row):
    """A row of a drive in open loop: steps of its command.

    Parameters
    ----------
    own
        What the drive's torque does with the speed and the command, and how late.
    command
        The command at the operating point, in its unit; None: the torque.
    """

    own: Mapping[str, float] = field(default_factory=lambda: {"g": 0.0, "v": 1.0, "tau_act": 0.03})
    command: float | None = None
    share: float = 0.15

    @property
    def truth(self) -> dict[str, float]:
        point, linear = self.drive().operating_point, linearise(self.drive())
        assert point.M_b_Nm is not None
        inertia = linear.tau_n * point.M_b_Nm / (2.0 * np.pi * point.n_e_rpm / 60.0)
        return {"inertia": inertia, "tau_act": self.own["tau_act"]}

    def recorded(self) -> Mapping[str, np.ndarray]:
        vessel, random = self.drive(), np.random.default_rng(6)
        point, linear, rate_hz = vessel.operating_point, linearise(vessel), FINER * self.rate_hz
        time = np.arange(0.0, 100.0, 1.0 / rate_hz)
        at = 20.0 + np.cumsum(random.uniform(3.0, 7.0, 14))
        levels = np.append(0.0, np.repeat(random.uniform(-self.share, self.share, 14), 2)[:-1])
        asked = 1.0 + np.interp(time, np.column_stack([at, at + 0.1]).ravel(), levels)
        bare = fp.Experiment("x", rate_hz, {"command": asked}, {"command": 1.0})
        drive = {"tau_n": linear.tau_n, "p": linear.p, "T_d": 0.0, **self.own}
        speed, torque = 1.0 + commanded(Structure).equations.simulate(drive, bare)
        speed, torque = (row * (1.0 + 2e-3 * random.standard_normal(len(time))) for row in (speed, torque))
        return {
            "command": (self.command or point.M_b_Nm) * asked,
            "n_e": point.n_e_rpm * speed,
            "M_b": point.M_b_Nm * torque,
        }


ENGINE = {"n_set": ("Speed demand", "rpm"), "n_e": ("Engine speed", "rpm"), "M_b": ("Engine torque", "Nm")}
GENERATING_SET = {"n_set": ("Speed set point", "rpm"), "n_e": ("Engine speed", "rpm"), "M_b": ("Engine torque", "Nm"),
                  "M_load": ("Generator power", "kW")}  # fmt: skip
ROWS = (
    Row("German text, sines of a tug", exports.csv_with_commas, tug, sines, 50.0,
        {"n_set": ("Sollgeschwindigkeit", "U/min"), "n_e": ("Istgeschwindigkeit", "U/min"), "M_g": ("Wellenmoment", "kNm")},
        {("Öltemperatur", "°C"): 74.0}),
    Row("English text, chirp of a launch", exports.csv_with_units, launch, chirp, 50.0,
        {"n_set": ("Speed set point", "rpm"), "n_e": ("Encoder", "rpm"), "M_b": ("Motor torque", "Nm")},
        {("Engine load", "%"): 61.0, ("Fuel pressure", "bar"): 4.0}),
    Row("MATLAB, multisine of a laboratory drive", matlab, lab_drive, multisine, 50.0,
        {"n_set": ("MotorVelocitySet_deg_s", ""), "n_e": ("feedback_deg_s", ""), "M_b": ("MotorTorque_Nm", "Nm")}),
    Row("French text, steps of a generating set", exports.csv_with_a_line_of_units, genset, steps, 100.0,
        {"n_set": ("Consigne vitesse", "tr/min"), "n_e": ("Vitesse moteur", "tr/min"), "M_b": ("Couple moteur", "N m")},
        {("Charge", "%"): 45.0}),
    Row("Norwegian Parquet, multisine of a tug", parquet, tug, multisine, 20.0,
        {"n_set": ("Settpunkt turtall", "o/min"), "n_e": ("Turtall", "o/min"), "M_g": ("Akselmoment", "kN m")},
        {("Fart", "kn"): 0.3}),
    Row("Dutch TDMS, chirp of a launch", tdms, launch, chirp, 50.0,
        {"M_g": ("Askoppel", "N·m"), "n_e": ("Gemeten toerental", "omw/min"), "n_set": ("Gewenst toerental", "omw/min")},
        {("Watertemperatuur", "°C"): 14.0}),
    Row("MDF of a bus, steps of a laboratory drive", mdf, lab_drive, steps, 100.0,
        {"n_set": ("MotSpdReq", "1/min"), "n_e": ("MotSpd", "1/min"), "M_b": ("MotTrq", "Nm")},
        {("MotTemp", "°C"): 51.0, ("DcLinkVoltage", "V"): 540.0}),
    Row("Spanish HDF5, multisine of a generating set", hdf5, genset, multisine, 50.0,
        {"n_e": ("Velocidad medida", "rad/s"), "n_set": ("Consigna de velocidad", "rad/s"), "M_b": ("Par motor", "N m")},
        {("Frecuencia de red", "Hz"): 50.0}),
    Row("German text, multisine of a tug without torque", exports.csv_with_commas, tug, multisine, 50.0,
        {"n_set": ("Drehzahl Soll", "1/min"), "n_e": ("Drehzahl Ist", "1/min")}),
    Row("Two speeds with a gear between, chirp of a launch", parquet, launch, chirp, 50.0,
        {"n_set": ("Engine speed demand", "rpm"), "n_e": ("Engine speed", "rpm"), "n_s": ("Shaft speed", "rpm"),
         "M_g": ("Shaft torque", "lbf ft")},
        {("Speed over ground", "kn"): 0.2, ("Throttle position", "%"): 55.0}),
    Loaded("Load steps of a generating set at a set point that rests", exports.csv_with_units, genset, steps, 50.0,
        GENERATING_SET, share=0.0),
    Loaded("German load steps beside a set point that moves", exports.csv_with_commas, genset, steps, 50.0,
        {"n_set": ("Drehzahl Soll", "1/min"), "n_e": ("Drehzahl Ist", "1/min"), "M_b": ("Motormoment", "Nm"),
         "M_load": ("Generator Leistung", "kW")}, share=0.02),
    Loaded("A load from zero on an engine that idles", parquet, genset, steps, 50.0,
        GENERATING_SET, share=0.0, levels=(0.0, *LEVELS), idles=0.1),
    TwoLoggers("Load steps in two logs on one clock", parquet, genset, steps, 50.0,
        GENERATING_SET, share=0.02),
    Commanded("Torque steps of a laboratory drive in open loop", exports.csv_with_units, lab_drive, steps, 50.0,
        {"command": ("Torque command", "Nm"), "n_e": ("Motor speed", "rpm")}),
    Commanded("Voltage steps beside a torque, in open loop", hdf5, lab_drive, steps, 50.0,
        {"command": ("Torque demand", "V"), "n_e": ("Motor speed", "rpm"), "M_b": ("Motor torque", "Nm")},
        own={"g": -0.8, "v": 1.6, "tau_act": 0.06}, command=4.0),
    Loaded("Load steps of a generating set whose set point no logger recorded", exports.csv_with_units, genset, steps,
        50.0, {"n_e": ("Engine speed", "rpm"), "M_b": ("Engine torque", "Nm"), "M_load": ("Generator power", "kW")},
        share=0.0),
    Encoder("An encoder's pulses and a torque in volts, at 1 kHz", parquet, launch, chirp, 1000.0,
        {"n_set": ("Speed demand", "rpm"), "n_e": ("Encoder track A", "V"), "M_b": ("Engine torque", "V")},
        answers={'calibration = "to be given"': "calibration = { scale = 200.0, offset = 0.0 }"}),
    Bus("An engine's bus, its torque in per cent", mf4, launch, multisine, 50.0,
        {"n_set": ("EngRequestedSpeed", "rpm"), "n_e": ("EngSpeed", "rpm"), "M_b": ("ActualEngPercentTorque", "%")},
        answers={'rated_torque_Nm = "to be given"': "rated_torque_Nm = 400.0"}),
    Commanded("German torque steps of a laboratory drive in open loop", exports.csv_with_commas, lab_drive, steps, 50.0,
        {"command": ("Motormoment Sollwert", "Nm"), "n_e": ("Motordrehzahl", "1/min"),
         "M_b": ("Motormoment Istwert", "Nm")}),
    TwoLoggers("German load steps by two loggers, one for the load", tdms, genset, steps, 50.0,
        {"n_set": ("Solldrehzahl", "1/min"), "n_e": ("Istdrehzahl", "1/min"), "M_b": ("Motormoment", "Nm"),
         "M_load": ("Generatorleistung", "kW")}, share=0.0),
    Row("Tektronix text with labels, chirp of a launch", exports.tektronix, launch, chirp, 100.0, ENGINE),
    Row("PicoScope text, multisine of a laboratory drive", exports.picoscope, lab_drive, multisine, 100.0,
        {"n_e": ("Channel A", "rpm"), "n_set": ("Channel B", "rpm"), "M_g": ("Channel C", "Nm")}),
    Row("LabVIEW text, sines of a laboratory drive", exports.labview, lab_drive, sines, 100.0,
        {"n_set": ("Speed setpoint", "rad/s"), "n_e": ("Speed", "rad/s"), "M_b": ("Motor torque", "Nm")}),
    Row("German catman text, sines of a tug", exports.catman, tug, sines, 50.0,
        {"n_set": ("Solldrehzahl", "1/min"), "n_e": ("Istdrehzahl", "1/min"), "M_g": ("Wellenmoment", "kNm")},
        {("Öltemperatur", "°C"): 71.0}),
    Loaded("Yokogawa text, load steps of a generating set", exports.yokogawa, genset, steps, 100.0,
        {"n_set": ("Speed reference", "rpm"), "n_e": ("Engine speed", "rpm"), "M_b": ("Engine torque", "Nm"),
         "M_load": ("Generator power", "kW")}, share=0.02),
    Edges("A tachometer's edges beside a table, chirp of a launch", exports.csv_with_units, launch, chirp, 50.0,
        {"n_set": ("Speed demand", "rpm"), "n_e": ("Tacho", ""), "M_b": ("Engine torque", "Nm")}),
    Row("Italian text of two rates, multisine of a tug", exports.two_rates, tug, multisine, 100.0,
        {"n_set": ("Velocità richiesta", "giri/min"), "n_e": ("Velocità motore", "giri/min"),
         "M_g": ("Coppia albero", "kNm")}),
    Row("One signal a row, multisine of a generating set", exports.long_table, genset, multisine, 20.0,
        {"n_set": ("DG1_SPEED_REF", "rpm"), "n_e": ("DG1_SPEED_ACT", "rpm"), "M_b": ("DG1_ENGINE_TORQUE", "kNm")},
        {("DG1_OIL_TEMP", "°C"): 82.0}),
    Row("German controller's held values, steps of a launch", exports.controller, launch, steps, 50.0,
        {"n_set": ("Drehzahl Sollwert", "1/min"), "n_e": ("Drehzahl Istwert", "1/min"), "M_b": ("Motormoment", "%")},
        answers={'rated_torque_Nm = "to be given"': "rated_torque_Nm = 400.0"}),
    Bus("Engines on two buses, one of which idles", candump, launch, multisine, 50.0,
        {"n_set": ("EngRequestedSpeed", "rpm"), "n_e": ("can0.EngSpeed", "rpm"),
         "M_b": ("can0.ActualEngPercentTorque", "%")},
        answers={'rated_torque_Nm = "to be given"': "rated_torque_Nm = 400.0"}, beside=True),
    Bus("A bus whose clock tells steps", relative_asc, launch, multisine, 50.0,
        {"n_set": ("EngRequestedSpeed", "rpm"), "n_e": ("EngSpeed", "rpm"), "M_b": ("ActualEngPercentTorque", "%")},
        answers={'rated_torque_Nm = "to be given"': "rated_torque_Nm = 400.0"}),
    Row("A historian's columns of status, multisine of a tug", exports.statuses, tug, multisine, 50.0,
        {"n_set": ("Speed setpoint", "rpm"), "n_e": ("Engine speed", "rpm"), "M_g": ("Shaft torque", "kNm")}),
    Row("A time for each channel, chirp of a launch", exports.times_of_each, launch, chirp, 50.0, ENGINE),
    Row("A clock as one number over the hour, sines of a tug", exports.packed_clock, tug, sines, 20.0,
        {"n_set": ("Solldrehzahl", "1/min"), "n_e": ("Istdrehzahl", "1/min"), "M_g": ("Wellenmoment", "kNm")}),
    Row("Each row twice, multisine of a laboratory drive", exports.twice, lab_drive, multisine, 50.0,
        {"n_set": ("Speed reference", "rpm"), "n_e": ("Motor speed", "rpm"), "M_b": ("Motor torque", "Nm")}),
    Row("Lines that end in CR alone, multisine of a generating set", exports.carriage_returns, genset, multisine, 50.0,
        {"n_set": ("Speed reference", "rpm"), "n_e": ("Engine speed", "rpm"), "M_b": ("Engine torque", "Nm")}),
    Row("A set point recorded on change, chirp of a launch", exports.on_change, launch, chirp, 50.0, ENGINE),
    Row("A unit in each cell, chirp of a laboratory drive", exports.with_units, lab_drive, chirp, 50.0,
        {"n_set": ("Speed setpoint", "rpm"), "n_e": ("Motor speed", "rpm"), "M_b": ("Motor torque", "Nm")}),
    Encoder("Twelve teeth on an uneven engine, at 4 kHz", parquet, launch, chirp, 4000.0,
        {"n_set": ("Speed demand", "rpm"), "n_e": ("Encoder track A", "V"), "M_b": ("Engine torque", "V")},
        answers={'calibration = "to be given"': "calibration = { scale = 200.0, offset = 0.0 }"}, pulses=12, swing=0.3),
)  # fmt: skip
QUICK = tuple(ROWS[number] for number in (2, 8, 13, 15, 26))
"""Rows that are fitted in every run of the tests."""
