"""Channel tables of a TRIAL.toml: calibrations, set point, torque, rack, load and sources of speed."""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from shipfp_rs.support.hints import nearest
from shipfp_rs.support.toml import TO_BE_GIVEN, FilePath, Name, Section, unexpected
from shipfp_rs.support.units import (
    ELECTRIC,
    FREQUENCIES,
    QUANTITIES,
    TO_NM,
    TO_REV,
    TO_RPM,
    TO_W,
    Calibration,
    told,
)

Positive = Annotated[float, Field(gt=0.0)]
Rate = Annotated[float, Field(gt=0.0, le=1e8)]
"""Sample rate [Hz], in a range that covers every logger."""
Delay = Annotated[float, Field(ge=-60.0, le=60.0)]
"""Delay of a channel [s], at most a minute; a longer delay would mean a different clock."""
Accuracy = Annotated[float, Field(ge=0.0, le=0.2)]
"""Standard deviation of a calibrated channel's systematic relative error, which varies slowly with frequency."""
Pair = Annotated[tuple[float, float], Field(strict=False)]
KEYS_OF_KIND: Mapping[str, Set[str]] = {
    "pulses": {"pulses_per_rev", "missing", "quadrature", "threshold", "hysteresis", "unit"},
    "edges": {"file", "level", "time_std_s", "pulses_per_rev", "missing"},
    "angle": {"unit", "counts_per_rev", "calibration", "std"},
    "speed": {"unit", "calibration", "std", "mean_s", "pole_pairs"},
}
"""Keys of each kind of source of speed, in addition to the common ones."""
CALIBRATED = {"%", *ELECTRIC} - {"", "counts"}
"""Units of a speed source's readings that a calibration can convert to rpm."""
KEYS_OF_ALL = {"kind", "column", "shaft", "delay_s"}
SIGNAL_OF_LOCATION = {"gauge": "M_g", "brake": "M_b", "shaft": "M_s"}


class Line(Section):
    """A calibration: scale and offset, or a table of readings and values for a fit."""

    scale: float | None = None
    """Calibrated units per unit of the reading."""
    offset: float = 0.0
    """Calibrated value at a reading of 0."""
    table: Annotated[tuple[Pair, ...], Field(strict=False, min_length=2)] | None = None
    """Pairs of reading and value to which a line is fitted; given instead of `scale`."""

    @model_validator(mode="after")
    def _is_one_line(self) -> Self:
        if (self.scale is None) == (self.table is None):
            raise unexpected("scale", "neither or both of scale and table", "one of the two")
        if self.scale == 0.0:
            raise unexpected("scale", "0", "a scale not zero")
        if self.table is not None and len({reading for reading, _ in self.table}) < 2:
            raise unexpected("table", "one reading only", "at least two different readings")
        return self

    def calibration(self, unit: str) -> Calibration:
        """Calibration by this line; `unit` is the unit of its values."""
        if self.table is not None:
            readings, values = zip(*self.table, strict=True)
            return Calibration.from_table(readings, values, unit)
        assert self.scale is not None
        return Calibration(self.scale, self.offset, unit)


def wanted_line(unit: str, to: str) -> str:
    """Text of error messages: the calibration needed from one unit to another."""
    reading = unit or "reading"
    return (
        f"from {reading} to {to}: {{ scale = {to} per {reading}, offset = {to} at 0 }}, or "
        f"{{ table = [[{reading}, {to}], [{reading}, {to}]] }}"
    )


PolePairs = Annotated[int, Field(ge=1, le=200)]
"""Number of pole pairs of the machine whose electric frequency is recorded; the frequency is divided by it."""
SCALING: Mapping[str, tuple[Set[str], str]] = {
    "pole_pairs": ({*FREQUENCIES}, "a whole number, the pairs of poles: 2 where 50 Hz are 1500 rpm"),
    "rated_torque_Nm": ({"%"}, "the torque at 100 % [Nm]"),
    "efficiency": ({*TO_W}, "the share of the shaft's power that the channel shows, such as 0.95"),
}
"""Keys that convert a unit to a quantity of the shaft, each with its valid units and its meaning."""
RESTING = "set point at rest"
"""Name of the channel of a constant set point that was not recorded."""
MOST_RPM = 1e6


class Level(Section):
    """A channel with a linear calibration, which may be omitted if the unit is one of the channel's quantity."""

    a: ClassVar[str] = ""
    """Name of the channel's quantity in `QUANTITIES`; its units need no calibration."""

    column: Name
    """Name of the channel in the log."""
    unit: str
    """Unit of the readings."""
    calibration: Line
    """Calibration of the readings; by default the factor of their unit."""
    delay_s: Delay = 0.0
    """Delay of the channel, including filters of telemetry and amplifiers [s]; processing removes it."""

    @model_validator(mode="before")
    @classmethod
    def _unit_calibrates(cls, content: Any) -> Any:
        """Insert the factor of a known unit; for other units, raise an error that names the keys to give."""
        if not isinstance(content, dict):
            return content
        column, unit = content.get("column"), content.get("unit")
        if column == TO_BE_GIVEN:
            raise unexpected("column", repr(column), "the name of a channel of the log")
        line = content.get("calibration", TO_BE_GIVEN)
        for key in SCALING.keys() & cls.model_fields.keys() & content.keys():
            _require_use(key, content, told(unit) if isinstance(unit, str) else "")
            if line != TO_BE_GIVEN:
                raise unexpected(
                    key, "calibration as well", "one of the two: a calibration leads all the way"
                )
        if line != TO_BE_GIVEN or not (isinstance(column, str) and isinstance(unit, str)):
            return content
        factor, to = cls.factor(told(unit), content)
        if factor is not None:
            return {**content, "calibration": {"scale": factor}}
        if told(unit) == "%" and "rated_torque_Nm" in cls.model_fields and to == "Nm":
            raise unexpected(
                "rated_torque_Nm", "nothing", f"{SCALING['rated_torque_Nm'][1]}, of channel {column!r}"
            )
        raise unexpected(
            "calibration",
            repr(content["calibration"]) if "calibration" in content else "nothing",
            f"channel {column!r} {wanted_line(unit, to)}",
        )

    @classmethod
    def factor(cls, unit: str, content: Mapping[str, Any]) -> tuple[float | None, str]:
        """Factor of a unit (None if unknown) and the resulting unit; `content` has the other keys of the channel's table."""
        known = QUANTITIES[content["quantity"] if content.get("quantity") in QUANTITIES else cls.a]
        scaled = {key: content[key] for key in SCALING if isinstance(content.get(key), int | float)}
        if unit == "%" and known.unit == "Nm" and "rated_torque_Nm" in scaled:
            return 0.01 * scaled["rated_torque_Nm"], known.unit
        factor = known.factors.get(unit)
        if factor is not None:
            # Values out of range are rejected later, when the keys are validated.
            factor /= abs(scaled.get("pole_pairs", 1.0) * scaled.get("efficiency", 1.0)) or 1.0
        return factor, known.unit


def _require_use(key: str, content: Mapping[str, Any], unit: str) -> None:
    """Reject a key whose value is still the template's placeholder, or that has no effect for a channel's unit."""
    units, what = SCALING[key]
    if content[key] == TO_BE_GIVEN:
        raise unexpected(key, repr(TO_BE_GIVEN), f"{what}, of channel {content.get('column')!r}")
    if unit not in units:
        raise unexpected(key, f"a value with unit = {unit!r}", f"one only with {' or '.join(sorted(units))}")


class SetPoint(Level):
    """The channel of the engine-speed set point, calibrated to rpm; if none was recorded, its constant value."""

    a = "speed"

    pole_pairs: PolePairs = 1
    """Number of pole pairs of the generator whose frequency the channel records: 2 if 50 Hz are 1500 rpm."""
    rpm: Annotated[float, Field(gt=0.0, lt=MOST_RPM)] | None = None
    """Constant set point [rpm], given instead of a channel if the load excites the ship."""

    held: bool = False
    """Whether the engine holds each sample until the next one, as with a set point from a bus. The set point is then
    late by half a sample period on average, which is not part of `delay_s`. A torque recorded at this rate shows the
    stairs.
    """

    @model_validator(mode="before")
    @classmethod
    def _may_rest(cls, content: Any) -> Any:
        if not isinstance(content, dict) or "rpm" not in content:
            return content
        if content["rpm"] == TO_BE_GIVEN:
            raise unexpected("rpm", repr(TO_BE_GIVEN), "the shaft's speed at rest [rpm]")
        if "column" in content:
            raise unexpected("rpm", "column as well", "one of the two: a set point that rests has no channel")
        return {"unit": "rpm", "calibration": {"scale": 1.0}, **content, "column": RESTING}

    @property
    def late(self) -> float:
        """Delay of the held set point, as a fraction of the sample period."""
        return 0.5 if self.held else 0.0


class Command(Level):
    """The command of an open-loop drive: torque, current, voltage or fuel, in any unit, 0 for no torque.

    Only its ratio to the operating point matters; torques are converted to Nm.
    """

    @classmethod
    def factor(cls, unit: str, content: Mapping[str, Any]) -> tuple[float | None, str]:
        """Factor 1 for any unit except those of torque."""
        return TO_NM.get(unit, 1.0), ""


class Torque(Level):
    """The torque channel, calibrated to Nm."""

    a = "torque"

    rated_torque_Nm: Annotated[float, Field(gt=0.0, lt=1e9)] | None = None
    """Rated torque [Nm], for a channel in per cent of it."""
    location: Literal["gauge", "brake", "shaft"]
    """"gauge": strain gauge between the inertias (M_g); "brake": engine brake torque (M_b); "shaft": M_s."""
    gauge_accuracy: Accuracy | None = None
    """Relative accuracy of the sensor; by default that of the likelihood, 0.003."""

    @property
    def place(self) -> Literal["gauge", "brake"]:
        """Location of the torque in the equations, relative to the inertias."""
        return "gauge" if self.location == "gauge" else "brake"


class Rack(Level):
    """Position of the fuel rack, or fuel signal of a CAN bus; it must be proportional to the fuel.

    The signal is the one that acts on the torque, after the actuator's dead time T_d and lag tau_act, not the command
    before them. Only its ratio to the operating point matters, so per cent or mg per stroke need no calibration to mm.
    For a bus, half of its repetition period is part of `delay_s`.
    """

    gauge_accuracy: Accuracy | None = None
    """Relative accuracy of the sensor, as for the torque."""

    @classmethod
    def factor(cls, unit: str, content: Mapping[str, Any]) -> tuple[float | None, str]:
        """Factor 1 for any unit except electric ones."""
        return None if unit in ELECTRIC else 1.0, "mm"


class Load(Level):
    """The load of a dynamometer, a generator or a hydraulic brake: torque of the shaft behind a gearbox, or power."""

    quantity: Literal["torque", "power", "other"]
    """Torque [Nm]; power [W], which is divided by the shaft's speed; or another cause of load, such as a propeller's
    pitch, in any unit and relative to its operating value. The gain of another cause is estimated, which needs a
    measured torque.
    """
    a = "torque"
    rated_torque_Nm: Annotated[float, Field(gt=0.0, lt=1e9)] | None = None
    """Rated torque [Nm], for a torque in per cent of it."""
    efficiency: Annotated[float, Field(ge=0.2, le=1.0)] = 1.0
    """Efficiency of a generator: ratio of electric power to shaft power."""

    @classmethod
    def factor(cls, unit: str, content: Mapping[str, Any]) -> tuple[float | None, str]:
        """Factor of a unit and the resulting unit; the factor is 1 for a load that is neither torque nor power."""
        return (1.0, "") if content.get("quantity") == "other" else super().factor(unit, content)


class Tacho(Section):
    """A source of speed: a pulse train, a list of its edges, an encoder's angle, or a recorded speed.

    The kind follows from the keys: `counts_per_rev` or a unit of angle means an encoder; a unit of speed, per cent, or
    another reading with a calibration means a recorded speed; `file` means a list of edges; otherwise it is a pulse train.
    """

    kind: Literal["pulses", "edges", "angle", "speed"] = "pulses"
    """Kind of source; it follows from the other keys."""
    column: str = ""
    """Column of the log; for a list of edges the column of times, by default the first."""
    pulses_per_rev: Annotated[int, Field(ge=1, le=100_000)] = 1
    """Pulses per turn, including the missing teeth of a wheel: 60 for 60-2."""
    missing: Annotated[int, Field(ge=0, le=4)] = 0
    """Number of adjacent missing teeth, which mark the turn: 2 for 60-2."""
    quadrature: Name | None = None
    """Column of the second train of a pair in quadrature, a quarter of a pulse apart."""
    shaft: Literal["engine", "propeller"] = "engine"
    """Shaft on which the source is mounted."""
    threshold: float | None = None
    """Level at which pulses are timed, in the channel's unit; by default halfway between low and high level."""
    hysteresis: Positive | None = None
    """Distance between the arming and the firing level, in the channel's unit; by default a fraction of the pulse
    height.
    """
    delay_s: Delay = 0.0
    """Delay of the channel, including filters of telemetry and amplifiers [s]; processing removes it."""
    file: FilePath | None = None
    """File with a list of edges: a column has their times on the log's clock [s]."""
    level: Name | None = None
    """Column of levels in the list of edges; if given, only edges that rise above the middle level count."""
    time_std_s: Positive | None = None
    """Standard deviation of an edge's time in a list [s]; by default from the digits of the times."""
    unit: str = ""
    """Unit of an angle (deg, rad, rev or counts), of a speed (rpm, rad/s, rev/s, Hz over `pole_pairs`), or of the reading
    (%, V, mA) that the calibration converts to rpm.
    """
    counts_per_rev: Annotated[float, Field(ge=1.0, le=1e9)] | None = None
    """Counts of an encoder per turn."""
    calibration: Line | None = None
    """Calibration of an analogue speed or angle: from volts to `unit`, or to rpm if `unit` is that of the reading."""
    std: Positive | None = None
    """Standard deviation of a calibrated sample; by default estimated from the samples."""
    mean_s: Positive | None = None
    """Averaging time of a recorded speed [s]; by default the sample interval."""
    pole_pairs: PolePairs = 1
    """Number of pole pairs of the generator whose frequency the channel records: 2 if 50 Hz are 1500 rpm."""

    @model_validator(mode="before")
    @classmethod
    def _kind_from_keys(cls, content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        unit = told(content["unit"]) if isinstance(content.get("unit"), str) else ""
        wanted = {
            "column": "the name of a channel of the log",
            "shaft": '"engine" or "propeller"',
            "pulses_per_rev": "a whole number, the pulses in a turn",
            "calibration": wanted_line(
                *((unit, "rpm") if unit in CALIBRATED else ("", str(content.get("unit"))))
            ),
        }
        for key, what in wanted.items():
            if content.get(key) == TO_BE_GIVEN:
                raise unexpected(key, repr(TO_BE_GIVEN), f"{what}, for channel {content.get('column')!r}")
        if "pole_pairs" in content:
            _require_use("pole_pairs", content, unit)
        if "kind" in content:
            return content
        if "file" in content:
            kind = "edges"
        elif "counts_per_rev" in content or unit in TO_REV or unit == "counts":
            kind = "angle"
        elif "pulses_per_rev" in content:
            return content
        elif unit in TO_RPM or unit == "%" or (unit in CALIBRATED and "calibration" in content):
            kind = "speed"
        else:
            return content
        return {**content, "kind": kind}

    @model_validator(mode="after")
    def _has_what_its_kind_needs(self) -> Self:
        given = self.model_fields_set
        needs = {
            "pulses": ("column", "pulses_per_rev", "shaft"),
            "edges": ("file", "pulses_per_rev", "shaft"),
            "angle": ("column", "unit", "shaft"),
            "speed": ("column", "unit"),
        }[self.kind]
        lacking = [key for key in needs if key not in given]
        if lacking:
            raise unexpected(lacking[0], "nothing", f"{' and '.join(lacking)} to be given")
        for key in sorted(given - KEYS_OF_ALL - KEYS_OF_KIND[self.kind]):
            raise unexpected(
                key,
                repr(content) if len(repr(content := getattr(self, key))) < 60 else "a table",
                f"nothing: a source of kind {self.kind!r} takes {', '.join(sorted(KEYS_OF_KIND[self.kind]))}",
            )
        if self.kind == "angle" and told(self.unit) not in TO_REV and self.counts_per_rev is None:
            raise unexpected("counts_per_rev", "nothing", f"a number with unit = {self.unit!r}")
        unit = told(self.unit)
        if self.kind == "speed" and unit in CALIBRATED and self.calibration is None:
            raise unexpected("calibration", "nothing", f"channel {self.column!r} {wanted_line(unit, 'rpm')}")
        if self.kind == "speed" and unit not in {*TO_RPM, *CALIBRATED}:
            raise unexpected("unit", repr(self.unit), f"one of {', '.join(TO_RPM)}, or % with a calibration")
        if self.missing and self.pulses_per_rev < 4 * self.missing:
            raise unexpected(
                "missing", self.missing, f"less than a quarter of pulses_per_rev, {self.pulses_per_rev}"
            )
        return self


class Channels(Section):
    """Set point, torque, actuator, load, and any number of sources of speed in tables with other names."""

    # pydantic validates the extra tables as sources of speed.
    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Tacho]

    set_point: SetPoint | None = None
    command: Command | None = None
    """Command of an open-loop drive, instead of a set point."""
    torque: Torque | None = None
    rack: Rack | None = None
    actuator: Rack | None = None
    """Alternative name of `rack`: throttle, fuel, or a motor's current or voltage, as it acts, not its command."""
    load: Load | None = None
    """Measured load of the machine: an input in addition to the set point."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.set_point is not None and self.set_point.rpm is not None and self.load is None:
            raise unexpected(
                "set_point.rpm", self.set_point.rpm, "a table [channels.load] beside it: nothing else moves"
            )
        if self.load is not None and self.load.quantity == "other" and self.torque is None:
            raise unexpected("load.quantity", "'other' without a torque", "a table [channels.torque] as well")
        if self.rack is not None and self.actuator is not None:
            raise unexpected("actuator", "rack as well", "one of the two")
        if not self.tachos:
            raise unexpected(
                "PTM",
                "no pulse train",
                "at least one table like [channels.PTM_4] with pulses_per_rev, or [channels.speed] with unit = 'rpm'",
            )
        return self

    @model_validator(mode="before")
    @classmethod
    def _is_driven(cls, content: Any) -> Any:
        if isinstance(content, dict) and ("set_point" in content) == ("command" in content):
            drivers = ("set_point", "command")
            for key in content.keys() - cls.model_fields.keys():
                if near := nearest(str(key), drivers, 0.7):
                    raise unexpected(key, "an unknown table", f"one of {', '.join(drivers)}{near}")
            raise unexpected(
                "set_point",
                "command as well" if "command" in content else "nothing",
                "a table [channels.set_point] of a governor, or [channels.command] of a drive that has none",
            )
        return content

    @property
    def driver(self) -> SetPoint | Command:
        """Input channel of the model: set point, or command in open loop."""
        driver = self.set_point or self.command
        assert driver is not None
        return driver

    @property
    def asks_for_torque(self) -> bool:
        """Whether the command is a torque and no torque was measured."""
        return self.command is not None and told(self.command.unit) in TO_NM and self.torque is None

    @property
    def driver_signal(self) -> str:
        """Name of the input channel's signal."""
        return "command" if self.set_point is None else "n_set"

    @property
    def levels(self) -> dict[str, Torque | Rack | Load]:
        """Tables of torque, rack and load, by the names of their signals."""
        torque = {} if self.torque is None else {SIGNAL_OF_LOCATION[self.torque.location]: self.torque}
        actuator = self.rack or self.actuator
        load = {} if self.load is None else {"M_load": self.load}
        return torque | ({} if actuator is None else {"X_f": actuator}) | load

    @property
    def recorded_speeds(self) -> list[Tacho]:
        """Pulse trains, angles and speeds that are channels of the log, not times in a file."""
        return [one for one in self.tachos.values() if one.kind != "edges"]

    @property
    def tachos(self) -> dict[str, Tacho]:
        """Sources of speed by name; a pair of trains in quadrature counts as two."""
        found: dict[str, Tacho] = {}
        for name, tacho in self.__pydantic_extra__.items():
            found[name] = tacho
            if tacho.quadrature is not None:
                found[f"{name}, second"] = tacho.model_copy(
                    update={"column": tacho.quadrature, "quadrature": None}
                )
        return found
