"""Channel tables of a TRIAL.toml: calibrations, set point, torque, rack, load and pulse trains."""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from shipfp_rs.support.calibration import Calibration
from shipfp_rs.support.hints import nearest
from shipfp_rs.support.toml import TO_BE_GIVEN, FilePath, Name, Section, unexpected
from shipfp_rs.support.units import ELECTRIC, FREQUENCIES, QUANTITIES, TO_NM, TO_REV, TO_RPM, TO_W, told

Positive = Annotated[float, Field(gt=0.0)]
Rate = Annotated[float, Field(gt=0.0, le=1e8)]
"""Samples per second; the range covers every logger."""
Delay = Annotated[float, Field(ge=-60.0, le=60.0)]
"""Delay of a channel [s]; more than a minute is no delay but another clock."""
Accuracy = Annotated[float, Field(ge=0.0, le=0.2)]
"""Smooth relative error of a calibrated channel, one standard deviation."""
Pair = Annotated[tuple[float, float], Field(strict=False)]
KEYS_OF_KIND: Mapping[str, Set[str]] = {
    "pulses": {"pulses_per_rev", "missing", "quadrature", "threshold", "hysteresis", "unit"},
    "edges": {"file", "level", "time_std_s", "pulses_per_rev", "missing"},
    "angle": {"unit", "counts_per_rev", "calibration", "std"},
    "speed": {"unit", "calibration", "std", "mean_s", "pole_pairs"},
}
"""Keys that a source of speed takes beside those of every kind."""
CALIBRATED = {"%", *ELECTRIC} - {"", "counts"}
"""Units of a reading that a source of speed may have, from which its calibration leads to rpm."""
KEYS_OF_ALL = {"kind", "column", "shaft", "delay_s"}
SIGNAL_OF_LOCATION = {"gauge": "M_g", "brake": "M_b", "shaft": "M_s"}


class Line(Section):
    """A calibration: scale and offset, or a table of readings and values to fit them to."""

    scale: float | None = None
    """What one unit of the reading is in the calibrated unit."""
    offset: float = 0.0
    """Calibrated value where the reading is 0."""
    table: Annotated[tuple[Pair, ...], Field(strict=False, min_length=2)] | None = None
    """Pairs of reading and value, through which a line is fitted; in place of `scale`."""

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
        """Return the line, with `unit` for its values."""
        if self.table is not None:
            readings, values = zip(*self.table, strict=True)
            return Calibration.from_table(readings, values, unit)
        assert self.scale is not None
        return Calibration(self.scale, self.offset, unit)


def wanted_line(unit: str, to: str) -> str:
    """Return what a calibration from one unit to another is to be, in words."""
    reading = unit or "reading"
    return (
        f"from {reading} to {to}: {{ scale = {to} per {reading}, offset = {to} at 0 }}, or "
        f"{{ table = [[{reading}, {to}], [{reading}, {to}]] }}"
    )


PolePairs = Annotated[int, Field(ge=1, le=200)]
"""Pairs of poles of the machine whose electric frequency is recorded; the frequency is divided by this number."""
SCALING: Mapping[str, tuple[Set[str], str]] = {
    "pole_pairs": ({*FREQUENCIES}, "a whole number, the pairs of poles: 2 where 50 Hz are 1500 rpm"),
    "rated_torque_Nm": ({"%"}, "the torque at 100 % [Nm]"),
    "efficiency": ({*TO_W}, "the share of the shaft's power that the channel shows, such as 0.95"),
}
"""Keys that convert a unit to the shaft's quantity, the units for which they are valid, and what they mean."""
RESTING = "set point at rest"
"""Channel of a set point that no logger recorded."""
MOST_RPM = 1e6


class Level(Section):
    """A channel of samples, calibrated by a line; a unit of the channel's own quantity needs no line."""

    a: ClassVar[str] = ""
    """Name of its quantity in the table of quantities; units of this quantity need no line."""

    column: Name
    """Name of the channel in the log."""
    unit: str
    """Unit of its readings."""
    calibration: Line
    """Calibration line of the readings; default: the factor of their unit."""
    delay_s: Delay = 0.0
    """Delay of the channel, filters of telemetry and amplifiers included [s]; it is removed."""

    @model_validator(mode="before")
    @classmethod
    def _unit_calibrates(cls, content: Any) -> Any:
        """Fill in the factor of a known unit; say what to write for any other."""
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
        """Return the factor of a unit, None for one that is not what the channel is, and the unit it leads to.

        `content` is the rest of the channel's table.
        """
        known = QUANTITIES[content["quantity"] if content.get("quantity") in QUANTITIES else cls.a]
        scaled = {key: content[key] for key in SCALING if isinstance(content.get(key), int | float)}
        if unit == "%" and known.unit == "Nm" and "rated_torque_Nm" in scaled:
            return 0.01 * scaled["rated_torque_Nm"], known.unit
        factor = known.factors.get(unit)
        if factor is not None:
            # What is out of range is refused once the keys are looked at.
            factor /= abs(scaled.get("pole_pairs", 1.0) * scaled.get("efficiency", 1.0)) or 1.0
        return factor, known.unit


def _require_use(key: str, content: Mapping[str, Any], unit: str) -> None:
    """Refuse a key that is still to be given, or that does nothing with a channel's unit."""
    units, what = SCALING[key]
    if content[key] == TO_BE_GIVEN:
        raise unexpected(key, repr(TO_BE_GIVEN), f"{what}, of channel {content.get('column')!r}")
    if unit not in units:
        raise unexpected(key, f"it beside unit = {unit!r}", f"it beside {' or '.join(sorted(units))} only")


class SetPoint(Level):
    """The channel of the engine-speed set point, calibrated to rpm; where none was logged, its constant value."""

    a = "speed"

    pole_pairs: PolePairs = 1
    """Pairs of poles of the generator whose frequency it is: 2 where 50 Hz are 1500 rpm."""
    rpm: Annotated[float, Field(gt=0.0, lt=MOST_RPM)] | None = None
    """Constant set point [rpm] in place of a channel, where a load drives the ship."""

    held: bool = False
    """The engine holds each sample until the next one comes, as with a set point from a bus. The set point that it follows
    is then late by half a sample's period, which is not part of `delay_s`. A torque recorded at this rate shows the stairs.
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
        """Delay of the held set point, as a share of a sample's period."""
        return 0.5 if self.held else 0.0


class Command(Level):
    """The command of a drive in open loop: torque, current, voltage or fuel, in any unit, 0 for no torque.

    Only its ratio to the operating point counts; a unit of torque becomes Nm.
    """

    @classmethod
    def factor(cls, unit: str, content: Mapping[str, Any]) -> tuple[float | None, str]:
        """Return 1 for any unit but one of torque."""
        return TO_NM.get(unit, 1.0), ""


class Torque(Level):
    """The torque channel, calibrated to Nm."""

    a = "torque"

    rated_torque_Nm: Annotated[float, Field(gt=0.0, lt=1e9)] | None = None
    """Rated torque [Nm], for a channel in per cent of it."""
    location: Literal["gauge", "brake", "shaft"]
    """"gauge": strain gauge between the inertias (M_g); "brake": engine brake torque (M_b); "shaft": M_s."""
    gauge_accuracy: Accuracy | None = None
    """Accuracy of the sensor; default: that of the likelihood, 0.003."""

    @property
    def place(self) -> Literal["gauge", "brake"]:
        """Side of the inertias on which the torque acts in the equations."""
        return "gauge" if self.location == "gauge" else "brake"


class Rack(Level):
    """The fuel rack, or a CAN bus's fuel signal: zero without fuel, and proportional to it.

    Only its ratio to the operating point counts, so a per cent or mg a stroke do as well as mm, without a calibration. For
    a bus half of its repetition period is part of `delay_s`.
    """

    gauge_accuracy: Accuracy | None = None
    """Accuracy of the sensor, as for the torque."""

    @classmethod
    def factor(cls, unit: str, content: Mapping[str, Any]) -> tuple[float | None, str]:
        """Return 1 for any unit but an electric one."""
        return None if unit in ELECTRIC else 1.0, "mm"


class Load(Level):
    """The load of a dynamometer, a generator or a hydraulic brake: torque of the shaft behind a gearbox, or power."""

    quantity: Literal["torque", "power"]
    """Torque [Nm], or power [W], which is divided by the shaft's speed."""
    a = "torque"
    rated_torque_Nm: Annotated[float, Field(gt=0.0, lt=1e9)] | None = None
    """Rated torque [Nm], for a torque in per cent of it."""
    efficiency: Annotated[float, Field(ge=0.2, le=1.0)] = 1.0
    """Efficiency of a generator: electric power over shaft power."""


class Tacho(Section):
    """A source of speed: a pulse train, a list of its edges, an encoder's angle, or a speed recorded as such.

    The kind follows from the keys: `counts_per_rev`, or a unit of angle, make an encoder; a unit of speed makes a speed, and
    so does per cent, or another reading with a calibration; `file` makes a list of edges; anything else is a pulse train.
    """

    kind: Literal["pulses", "edges", "angle", "speed"] = "pulses"
    """Kind of source; it follows from the other keys."""
    column: str = ""
    """Column of the log; in a list of edges the column of the times, by default the first."""
    pulses_per_rev: Annotated[int, Field(ge=1, le=100_000)] = 1
    """Pulses in a turn; for a wheel with missing teeth counted as if none were missing: 60 for 60-2."""
    missing: Annotated[int, Field(ge=0, le=4)] = 0
    """Missing teeth, side by side, that mark the turn: 2 for 60-2."""
    quadrature: Name | None = None
    """Column of the second train of a pair that is a quarter of a pulse apart."""
    shaft: Literal["engine", "propeller"] = "engine"
    """Shaft on which it is mounted."""
    threshold: float | None = None
    """Level of a crossing, in the channel's unit; halfway between the two levels where it isn't given."""
    hysteresis: Positive | None = None
    """Width between arming and firing, in the channel's unit; a share of the height where it isn't given."""
    delay_s: Delay = 0.0
    """Delay of the channel, filters of telemetry and amplifiers included [s]; it is removed."""
    file: FilePath | None = None
    """A list of edges: a file with a column of times on the log's clock [s]."""
    level: Name | None = None
    """The list's column of levels; with one, only edges that rise to a level above the middle count."""
    time_std_s: Positive | None = None
    """Standard deviation of an edge of a list [s]; from the digits of its times where it isn't given."""
    unit: str = ""
    """Unit of an angle (deg, rad, rev or counts), of a speed (rpm, rad/s, rev/s, Hz over `pole_pairs`), or of the reading
    (%, V, mA) from which the calibration leads to rpm."""
    counts_per_rev: Annotated[float, Field(ge=1.0, le=1e9)] | None = None
    """Counts of an encoder in a turn."""
    calibration: Line | None = None
    """Calibration of an analogue speed or angle, from volts to `unit`; from a `unit` of the reading to rpm."""
    std: Positive | None = None
    """Standard deviation of a sample, calibrated; from the samples themselves where it isn't given."""
    mean_s: Positive | None = None
    """Time over which a recorded speed is a mean [s]; from one sample to the next where it isn't given."""
    pole_pairs: PolePairs = 1
    """Pairs of poles of the generator whose frequency it is: 2 where 50 Hz are 1500 rpm."""

    @model_validator(mode="before")
    @classmethod
    def _kind_from_keys(cls, content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        unit = told(content["unit"]) if isinstance(content.get("unit"), str) else ""
        wanted = {
            "column": "the name of a channel of the log",
            "pulses_per_rev": "a whole number, the pulses in a turn",
            "calibration": wanted_line(
                *((unit, "rpm") if unit in CALIBRATED else ("", str(content.get("unit"))))
            ),
        }
        wanted |= {"shaft": '"engine" or "propeller"'}
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
            raise unexpected("counts_per_rev", "nothing", f"it beside unit = {self.unit!r}")
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
    """Set point, torque, actuator, load, and any number of sources of speed under names of their own."""

    # pydantic checks the extra tables as sources of speed.
    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Tacho]

    set_point: SetPoint | None = None
    command: Command | None = None
    """Command of a drive in open loop, in place of a set point."""
    torque: Torque | None = None
    rack: Rack | None = None
    actuator: Rack | None = None
    """Another name of `rack`: throttle, fuel, or a motor's current or torque command."""
    load: Load | None = None
    """Measured load that the machine drives: an input beside the set point."""

    @model_validator(mode="after")
    def _rests_under_a_load(self) -> Self:
        if self.set_point is not None and self.set_point.rpm is not None and self.load is None:
            raise unexpected(
                "set_point.rpm", self.set_point.rpm, "a table [channels.load] beside it: nothing else moves"
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
        """The channel that drives the model: set point, or command in open loop."""
        driver = self.set_point or self.command
        assert driver is not None
        return driver

    @property
    def asks_for_torque(self) -> bool:
        """Whether the command is a torque, and none was measured beside it."""
        return self.command is not None and told(self.command.unit) in TO_NM and self.torque is None

    @property
    def driver_signal(self) -> str:
        """Name of the signal that the driving channel becomes."""
        return "command" if self.set_point is None else "n_set"

    @model_validator(mode="after")
    def _has_one_actuator(self) -> Self:
        if self.rack is not None and self.actuator is not None:
            raise unexpected("actuator", "rack as well", "one of the two")
        return self

    @model_validator(mode="after")
    def _has_a_pulse_train(self) -> Self:
        if not self.tachos:
            raise unexpected(
                "PTM",
                "no pulse train",
                "at least one table like [channels.PTM_4] with pulses_per_rev, or [channels.speed] with unit = 'rpm'",
            )
        return self

    @property
    def levels(self) -> dict[str, Torque | Rack | Load]:
        """Channels of torque, rack and load, by the names of the signals that they become."""
        torque = {} if self.torque is None else {SIGNAL_OF_LOCATION[self.torque.location]: self.torque}
        actuator = self.rack or self.actuator
        load = {} if self.load is None else {"M_load": self.load}
        return torque | ({} if actuator is None else {"X_f": actuator}) | load

    @property
    def tachos(self) -> dict[str, Tacho]:
        """The sources of speed by name; a pair of trains in quadrature counts as two."""
        found: dict[str, Tacho] = {}
        for name, tacho in self.__pydantic_extra__.items():
            found[name] = tacho
            if tacho.quadrature is not None:
                found[f"{name}, second"] = tacho.model_copy(
                    update={"column": tacho.quadrature, "quadrature": None}
                )
        return found
