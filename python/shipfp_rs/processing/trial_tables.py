"""Tables of a TRIAL.toml: header, channels, operating point, processing, windows, identification."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from shipfp_rs.support.calibration import Calibration
from shipfp_rs.support.toml import Section, unexpected
from shipfp_rs.support.units import TO_REV, TO_RPM, told

Positive = Annotated[float, Field(gt=0.0)]
Pair = Annotated[tuple[float, float], Field(strict=False)]
Relation = Annotated[
    tuple[str, float, float],
    Field(strict=False),
    BeforeValidator(lambda value: [*value, 0.0] if isinstance(value, list) and len(value) == 2 else value),
]
"""Name of a parameter, factor and offset; without one 0."""
Auto = Annotated[Positive | None, BeforeValidator(lambda value: None if value == "auto" else value)]
"""A positive number, or "auto" (None)."""

ELEMENTS = ("actuator_lag", "derivative", "sampling", "misreading", "twist", "curvature")
SIGNAL_OF_LOCATION = {"gauge": "M_g", "brake": "M_b", "shaft": "M_s"}


class Header(Section):
    """The trial: its name, the ship, the recordings."""

    name: str
    vessel: str
    """A built-in ship's name or the path of a vessel file."""
    log: Annotated[
        tuple[str, ...],
        Field(strict=False, min_length=1),
        BeforeValidator(lambda value: [value] if isinstance(value, str) else value),
    ]
    """One path or several; relative ones count from the folder of TRIAL.toml."""
    rate_hz: Positive | None = None
    """Sample rate of logs that tell none [Hz]."""
    time_column: str | None = None
    """Column of time of a table, where it is not found by itself: "COLUMN", "COLUMN [ms]", "DATE [d.m.y] + CLOCK"."""
    names: str | None = None
    """File that names the channels: a DBC for a CAN log, a channel list for ISO 19848."""


class Align(Section):
    """Several loggers that recorded one trial, each with a clock of its own: brought to one of them."""

    reference: str
    """File name of the log whose clock counts; all windows are on it."""
    common: str | None = None
    """Channel that every log holds, such as the set point's voltage or a pulse train; without one the logs share a
    clock, and their time stamps count."""
    pulses: bool = False
    """Whether the common channel is a pulse train."""


class Line(Section):
    """A calibration: scale and offset, or a table of readings and values to fit them to."""

    scale: float | None = None
    offset: float = 0.0
    table: Annotated[tuple[Pair, ...], Field(strict=False, min_length=2)] | None = None

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


class SetPoint(Section):
    """The channel of the engine-speed set point, calibrated to rpm of the engine."""

    column: str
    unit: str
    calibration: Line
    delay_s: float = 0.0
    """How late the channel tells what happened, filters of telemetry and amplifiers [s]; taken off."""


class Torque(Section):
    """The torque channel, calibrated to Nm."""

    column: str
    unit: str
    calibration: Line
    location: Literal["gauge", "brake", "shaft"]
    """"gauge": strain gauge between the inertias (M_g); "brake": engine brake torque (M_b); "shaft": M_s."""
    delay_s: float = 0.0
    """How late the channel tells what happened, filters of telemetry and amplifiers [s]; taken off."""


class Rack(Section):
    """The fuel rack, or what an engine's CAN bus tells of its fuel: nothing without fuel, and in proportion to it.

    Only its ratio to the operating point counts, so a per cent or mg a stroke do as well as mm.
    """

    column: str
    unit: str
    calibration: Line
    delay_s: float = 0.0
    """How late the channel tells what happened, half the period at which a bus repeats it included [s]; taken off."""


LOADS = {"torque": "M_load", "power": "P_load"}
"""Signals that a measured load becomes."""


class Load(Section):
    """The load of a dynamometer, a generator or a hydraulic brake, calibrated to Nm or W."""

    column: str
    unit: str
    calibration: Line
    quantity: Literal["torque", "power"]
    """Torque [Nm] of the load, or its power [W]."""
    delay_s: float = 0.0
    """How late the channel tells what happened [s]; taken off."""


class Tacho(Section):
    """A source of speed: a pulse train, a list of its edges, an encoder's angle, or a speed recorded as such.

    The kind follows from the keys: `counts_per_rev`, or a unit of angle, make an encoder; a unit of speed makes a speed;
    `file` makes a list of edges; anything else is a pulse train.
    """

    kind: Literal["pulses", "edges", "angle", "speed"] = "pulses"
    column: str = ""
    """Of the log; in a list of edges that of the times, the first one by default."""
    pulses_per_rev: Annotated[int, Field(ge=1)] = 1
    """Of a wheel with missing teeth as many as it would have: 60 for 60-2."""
    missing: Annotated[int, Field(ge=0, le=4)] = 0
    """Teeth that a wheel lacks side by side, for its mark: 2 for 60-2."""
    quadrature: str | None = None
    """Column of the second train of a pair that is a quarter of a pulse apart."""
    shaft: Literal["engine", "propeller"] = "engine"
    threshold: float | None = None
    """Level of a crossing, in the channel's unit; halfway between the two levels where it isn't given."""
    hysteresis: Positive | None = None
    """Width between arming and firing, in the channel's unit; a share of the height where it isn't given."""
    delay_s: float = 0.0
    """How late the channel tells what happened, filters of telemetry and amplifiers [s]; taken off."""
    file: str | None = None
    """A list of edges: a file with a column of times on the log's clock [s]."""
    level: str | None = None
    """Its column of levels: of such a list only edges up to a level above the middle count."""
    time_std_s: Positive | None = None
    """Standard deviation of an edge of a list [s]; from the digits of its times where it isn't given."""
    unit: str = ""
    """Of an angle deg, rad, rev or counts; of a speed rpm, rad/s, rev/s or Hz: turns a second."""
    counts_per_rev: Positive | None = None
    calibration: Line | None = None
    """Of an analogue speed or angle: what its volts make in `unit`."""
    std: Positive | None = None
    """Standard deviation of a sample, in `unit`; from the samples themselves where it isn't given."""

    @model_validator(mode="before")
    @classmethod
    def _kind_from_keys(cls, content: Any) -> Any:
        if not isinstance(content, dict) or "kind" in content:
            return content
        unit = told(content["unit"]) if isinstance(content.get("unit"), str) else ""
        if "file" in content:
            kind = "edges"
        elif "counts_per_rev" in content or unit in TO_REV or unit == "counts":
            kind = "angle"
        elif unit in TO_RPM and "pulses_per_rev" not in content:
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
        if self.kind == "angle" and told(self.unit) not in TO_REV and self.counts_per_rev is None:
            raise unexpected("counts_per_rev", "nothing", f"it beside unit = {self.unit!r}")
        if self.kind == "speed" and told(self.unit) not in TO_RPM:
            raise unexpected("unit", repr(self.unit), f"one of {', '.join(TO_RPM)}")
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

    set_point: SetPoint
    torque: Torque | None = None
    rack: Rack | None = None
    actuator: Rack | None = None
    """Another name of `rack`: throttle, fuel, or a motor's current or torque command."""
    load: Load | None = None
    """What the machine drives, measured: an input beside the set point."""

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
        """Measured outputs that are recorded as levels, by the signals that they become."""
        torque = {} if self.torque is None else {SIGNAL_OF_LOCATION[self.torque.location]: self.torque}
        actuator = self.rack or self.actuator
        load = {} if self.load is None else {LOADS[self.load.quantity]: self.load}
        return torque | ({} if actuator is None else {"X_f": actuator}) | load

    @property
    def tachos(self) -> dict[str, Tacho]:
        """The sources of speed by name; a pair of trains in quadrature is two."""
        found: dict[str, Tacho] = {}
        for name, tacho in self.__pydantic_extra__.items():
            found[name] = tacho
            if tacho.quadrature is not None:
                found[f"{name}, second"] = tacho.model_copy(
                    update={"column": tacho.quadrature, "quadrature": None}
                )
        return found


class OperatingPoint(Section):
    """The steady state that signals are normalised with: given, or "auto" from a steady stretch."""

    n_e_rpm: Auto = None
    M_Nm: Auto = None
    """At the place of the torque channel."""
    X_mm: Auto = None
    """Of the rack's channel, in the unit of its calibration."""
    steady_s: Pair | None = None
    """Start and stop of a stretch with a constant set point, on the log's clock [s]."""

    @model_validator(mode="after")
    def _can_be_had(self) -> Self:
        if self.steady_s is not None and not self.steady_s[0] < self.steady_s[1]:
            raise unexpected("steady_s", list(self.steady_s), "[start, stop] with start before stop")
        return self


class Spikes(Section):
    """Short excursions from the running median that are taken for faults."""

    longest_s: Positive = 0.05
    """Longest one [s]; excursions of the plant are longer."""
    threshold: Positive = 6.0
    """Height in robust standard deviations about the running median."""
    least: Positive = 0.05
    """Height below which nothing is a fault, as a share of the median magnitude."""


class Faults(Section):
    """What counts as a fault of a recorded channel, apart from spikes."""

    stuck_s: Positive = 0.25
    """Shortest stretch of one and the same value in an otherwise noisy channel [s]."""
    dropout_s: Positive = 0.01
    """Shortest stretch at zero of a channel that stays away from it [s]."""
    longest_bridge_s: Positive = 0.25
    """Longest stretch over which a lost set point is guessed, by a straight line [s]; the answers are masked there."""
    mains_hz: Positive = 50.0
    """Frequency of the mains, whose hum is taken out of the set point [Hz]."""
    least_hum: Positive = 1e-3
    """Amplitude that counts as hum, as a share of the set point."""


class Processing(Section):
    """How raw channels become signals."""

    rate_hz: Positive = 50.0
    """Common rate of the signals [Hz]. Above what the tachometer tells there is only interpolation, which a fit that
    whitens its residuals would take for signal; four reflectors on a shaft at 5 rev/s tell 10 Hz."""
    normalise: Literal["global", "local"] = "global"
    """About the trial's operating point, or each window about its own means."""
    detrend: Annotated[int, Field(ge=0, le=3)] = 0
    """Degree of a polynomial drift that is taken off the outputs; 0: none. A window whose set point is such a trend
    itself, a stair of steps, keeps its outputs as they are."""
    speed: Literal["best", "fused"] = "best"
    """From the train with the most good intervals, or from the pulses of all trains together, each weighed by its
    timing and reflectors; takes some ten seconds more for an hour of log, and tells the speed's standard deviation."""
    torque_spikes: Spikes = Spikes()
    """Of the rack's channel, too."""
    set_point_jumps: Spikes = Spikes()
    faults: Faults = Faults()


class Window(Section):
    """One stretch of a log, one experiment."""

    name: str
    kind: str = ""
    start_s: float
    stop_s: float
    log: str | None = None
    """File name of the log it is cut from; the first one where none is named."""

    @model_validator(mode="after")
    def _is_not_empty(self) -> Self:
        if not self.start_s < self.stop_s:
            raise unexpected("stop_s", f"{self.stop_s:g}", f"more than start_s, {self.start_s:g}")
        return self


class GreyBox(Section):
    """The plant of the vessel itself in place of [identify]'s linear structure; names are checked by the structure."""

    kind: Literal["grey_box"]
    free: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    """What is searched for; all else is the vessel's."""
    torque: Literal["gauge", "brake"] | None = None
    """None: what the torque channel's location says."""
    outputs: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = ("dn", "dM")
    pass_hz: Annotated[float, Field(gt=0.0)] | None = None
    """Compare below this frequency only: above it an engine's firing has a phase that no fit can know."""


HOW = ("weighting", "noise", "covariance", "offsets", "initial_state")
"""Keys of [identify] that are options of `identify` under the same name."""
OF_ANY_STRUCTURE = frozenset(("fixed", "priors", "tied", *HOW, "starts", "seed"))
"""Keys of [identify] that do not describe the linear structure."""


class Identify(Section):
    """The structure to fit and how; parameter names are checked by the structure itself."""

    torque: Literal["gauge", "brake"] | None = None
    """None: what the torque channel's location says."""
    products: bool = False
    """Fit vK_p and vK_i in place of v, K_p and K_i, which speed and torque never tell apart."""
    three_parameters: bool = False
    """Leave v and g out: effective tau_n, vK_p and vK_i remain, enough to simulate the speed with."""
    free_exponent: bool = False
    dead_time_loop: bool = False
    dead_time_set_point: bool = False
    actuator_lag: bool = False
    derivative: bool = False
    sampling: Literal[True, False, "exact"] = False
    misreading: bool = False
    twist: bool = False
    curvature: bool = False
    """These six as in `Structure.linear`; not with three_parameters."""
    outputs: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = ("dn", "dM")
    fixed: dict[str, float] = Field(default_factory=dict)
    priors: dict[str, Pair] = Field(default_factory=dict)
    """Name to [mean, standard deviation]."""
    tied: dict[str, Relation] = Field(default_factory=dict)
    """Name to [name of another one, factor] or [name, factor, offset]."""
    weighting: Literal["determinant", "variance", "none"] = "determinant"
    noise: Literal["ar", "white", "innovations"] | None = None
    covariance: Literal["model", "sandwich"] = "model"
    offsets: Literal[True, False, "relative"] = True
    initial_state: Literal["estimated", "zero"] = "estimated"
    """These five as in `identify`."""
    lead_back: bool = False
    """Simulate the vessel and take off the estimates what the structure lacks beside it (`indirect_inference`)."""
    starts: Annotated[int, Field(ge=1)] = 8
    """Of a grey box, which starts at the vessel's own values, what `identify` takes where none are given."""
    seed: Annotated[int, Field(ge=0)] = 0

    @property
    def options(self) -> dict[str, Any]:
        """Those of `identify`, but for starts and seed."""
        return {name: getattr(self, name) for name in HOW}

    @property
    def elements(self) -> dict[str, Any]:
        """What of the drive train beyond eq. 3.14-3.54 is asked for, by the options of `Structure.linear`."""
        return {name: value for name in ELEMENTS if (value := getattr(self, name))}

    @model_validator(mode="after")
    def _three_parameters_are_all(self) -> Self:
        if self.three_parameters and self.elements:
            raise unexpected(next(iter(self.elements)), "with three_parameters = true", "one of the two")
        return self
