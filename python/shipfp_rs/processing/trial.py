"""TRIAL.toml: which ship, which log, which channels, which windows, and how to identify."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from shipfp_rs.logs.log import Log
from shipfp_rs.support.calibration import Calibration
from shipfp_rs.support.toml import Section, read_toml, unexpected

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
    common: str
    """Channel that every log holds, such as the set point's voltage or a pulse train."""
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


class Tacho(Section):
    """A pulse train."""

    column: str
    pulses_per_rev: Annotated[int, Field(ge=1)]
    shaft: Literal["engine", "propeller"]
    threshold: float | None = None
    """Level of a crossing, in the channel's unit; halfway between the two levels where it isn't given."""
    hysteresis: Positive | None = None
    """Width between arming and firing, in the channel's unit; a share of the height where it isn't given."""
    delay_s: float = 0.0
    """How late the channel tells what happened, filters of telemetry and amplifiers [s]; taken off."""


class Channels(Section):
    """Set point, torque, fuel rack, and any number of pulse trains under names of their own."""

    # pydantic checks the extra tables as pulse trains.
    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Tacho]

    set_point: SetPoint
    torque: Torque | None = None
    rack: Rack | None = None

    @model_validator(mode="after")
    def _has_a_pulse_train(self) -> Self:
        if not self.tachos:
            raise unexpected(
                "PTM", "no pulse train", "at least one table like [channels.PTM_4] with pulses_per_rev"
            )
        return self

    @property
    def levels(self) -> dict[str, Torque | Rack]:
        """Measured outputs that are recorded as levels, by the signals that they become."""
        torque = {} if self.torque is None else {SIGNAL_OF_LOCATION[self.torque.location]: self.torque}
        return torque | ({} if self.rack is None else {"X_f": self.rack})

    @property
    def tachos(self) -> dict[str, Tacho]:
        """The pulse trains by name."""
        return self.__pydantic_extra__


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


class Trial(Section):
    """A whole TRIAL.toml.

    Examples
    --------
    >>> trial = Trial.load("TRIAL.toml")  # doctest: +SKIP
    >>> [window.name for window in trial.windows]  # doctest: +SKIP
    ['S2', 'C11']
    """

    trial: Header
    align: Align | None = None
    channels: Channels
    operating_point: OperatingPoint = OperatingPoint()
    processing: Processing = Processing()
    windows: Annotated[tuple[Window, ...], Field(strict=False, min_length=1)]
    structure: GreyBox | None = None
    """None: the linear structure that [identify] describes."""
    identify: Identify = Identify()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        names = [window.name for window in self.windows]
        if len(set(names)) < len(names):
            raise unexpected("windows", f"names {names}", "each name once")
        linear = sorted(self.identify.model_fields_set - OF_ANY_STRUCTURE)
        if self.structure is not None and linear:
            raise unexpected(
                f"identify.{linear[0]}", "a key of the linear structure", "none beside the table [structure]"
            )
        point = self.operating_point
        given = {
            "n_e": point.n_e_rpm,
            **dict.fromkeys(SIGNAL_OF_LOCATION.values(), point.M_Nm),
            "X_f": point.X_mm,
        }
        missing = any(given[signal] is None for signal in ("n_e", *self.channels.levels))
        if missing and point.steady_s is None:
            raise unexpected(
                "operating_point",
                "neither n_e_rpm, M_Nm and X_mm of what is recorded nor steady_s",
                "these values, or steady_s = [start, stop]",
            )
        if missing and len(self.trial.log) > 1 and self.align is None:
            raise unexpected(
                "operating_point", '"auto" with several logs', "n_e_rpm, M_Nm and X_mm given as numbers"
            )
        files = [Path(log).name for log in self.trial.log]
        if self.align is not None:
            if Path(self.align.reference).name not in files or len(files) < 2:
                raise unexpected(
                    "align.reference", f"{self.align.reference!r}", f"one of several logs, {', '.join(files)}"
                )
            files = [Path(self.align.reference).name]
        for window in self.windows:
            if window.log is not None and Path(window.log).name not in files:
                raise unexpected(
                    "windows", f"log {window.log!r} in {window.name!r}", f"one of {', '.join(files)}"
                )
        return self

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a TRIAL.toml; relative paths of logs and of a vessel file are taken from its folder.

        Raises
        ------
        InputError
            Where the file can't be read or a key or value is wrong; one line names it.
        """
        path = Path(path)
        read = read_toml(path, cls)
        header = read.trial
        changes: dict[str, Any] = {"log": tuple(str(path.parent / log) for log in header.log)}
        if (path.parent / header.vessel).is_file():
            changes["vessel"] = str(path.parent / header.vessel)
        if header.names is not None:
            changes["names"] = str(path.parent / header.names)
        return read.model_copy(update={"trial": header.model_copy(update=changes)})

    def logs(self) -> list[Log]:
        """Open the recordings, in order; one log where loggers are aligned."""
        header = self.trial
        logs = [
            Log.open(path, rate_hz=header.rate_hz, time=header.time_column, names=header.names)
            for path in header.log
        ]
        if self.align is None:
            return logs
        from shipfp_rs.processing.alignment import merged  # SciPy takes long to load

        name = Path(self.align.reference).name
        (reference,) = [log for log in logs if Path(log.name).name == name]
        others = [log for log in logs if log is not reference]
        return [merged(reference, others, self.align.common, pulses=self.align.pulses)]

    def windows_of(self, log: str) -> tuple[Window, ...]:
        """Return the windows that are cut from the log of this file name."""
        first = Path(self.trial.log[0]).name
        if len(self.trial.log) == 1 or self.align is not None:
            return self.windows
        return tuple(window for window in self.windows if Path(window.log or first).name == Path(log).name)


TRIAL_TEMPLATE = """\
# A trial: one ship, its raw log, and what to find in it. Run it with `shipfp run TRIAL.toml`.

[trial]
name = "Bollard pull trial"
vessel = "stan-tug-1205"        # built-in ship, or the path of a vessel file
log = "run.parquet"             # Parquet, Feather, CSV, ...; a list where there are several
# rate_hz = 2000.0              # only where the log tells neither rate nor time
# time_column = "Zeit [s]"      # only where it is not found; also "Time [ms]", or "Date [d.m.y] + Clock"
# names = "engine.dbc"          # DBC of a CAN log, or channel list of ISO 19848

# [align]                       # where several loggers recorded the same trial, each with its own clock
# reference = "run.parquet"     # whose clock counts
# common = "U_setpoint"         # channel in every log that their clocks are compared by
# pulses = false                # true: it is a pulse train

# Value = scale * recorded + offset, or: calibration = { table = [[-3.03, 676.7], [-5.03, 1184.4]] }
[channels.set_point]            # engine-speed set point, to rpm of the engine
column = "U_setpoint"
unit = "V"                      # unit in the log, that of the calibration
calibration = { scale = -251.38, offset = -85.29 }

[channels.torque]               # to Nm; leave the table out where no torque was measured
column = "U_torque"
unit = "V"
calibration = { scale = 1059.0, offset = 0.0 }
location = "gauge"              # "gauge" between the inertias, "brake" of the engine, "shaft" of the gearbox
# delay_s = 0.004               # how late the channel is (filters of the telemetry); any channel may have one

# [channels.rack]               # the fuel rack, or the fuel that a CAN bus tells, in any unit that is 0 without fuel
# column = "fuel"
# unit = "%"
# calibration = { scale = 1.0, offset = 0.0 }
# delay_s = 0.05                # half the period at which a bus repeats it, for one

[channels.PTM_4]                # a pulse train; add one table for each, under any name
column = "PTM_4"
pulses_per_rev = 4
shaft = "propeller"             # or "engine"
# threshold = 2.0               # level of a crossing; found from the train's two levels where it isn't given

[channels.PTM_e]
column = "PTM_e"
pulses_per_rev = 1
shaft = "engine"

[operating_point]               # what signals are normalised with; "auto": mean over the steady stretch
n_e_rpm = "auto"
M_Nm = "auto"
steady_s = [10.0, 70.0]         # stretch with a constant set point, on the log's clock

[processing]
rate_hz = 50.0                  # common rate of the signals; 50 holds all that 20 pulses a second tell
normalise = "global"            # about the operating point above; "local": each window about its own means
detrend = 0                     # degree of a drift to be taken off the outputs, 1 to 3
speed = "best"                  # of several pulse trains the best one; "fused": all together, with a standard deviation

[processing.torque_spikes]      # radio interference: masked
longest_s = 0.05
threshold = 6.0                 # robust standard deviations from the running median
least = 0.05                    # share of the mean below which nothing is a fault

[processing.set_point_jumps]    # relay jumps of the signal generator: bridged
longest_s = 0.05
threshold = 6.0
least = 0.05

[processing.faults]             # what else is looked for in set point and torque
stuck_s = 0.25                  # one and the same value in a noisy channel
dropout_s = 0.01                # at zero in a channel that stays away from it
longest_bridge_s = 0.25         # a set point lost for longer is refused
mains_hz = 50.0                 # hum of this frequency is taken out of the set point
least_hum = 0.001               # share of the set point

[[windows]]                     # one table for each experiment
name = "C11"
kind = "chirp"
start_s = 100.0
stop_s = 600.0
# log = "run.parquet"           # where there are several

[identify]
torque = "gauge"
products = true                 # fit vK_p and vK_i, which speed and torque tell, in place of v, K_p and K_i
# three_parameters = true       # leave g out, too: effective tau_n, vK_p and vK_i, to simulate the speed with
free_exponent = true            # propeller torque goes with n^p, p free
dead_time_loop = true           # in the fuel path
dead_time_set_point = true      # in the set-point path
# sampling = "exact"            # a governor that computes every T_s, given below; true: its hold alone. Others of this
#                               # kind: actuator_lag, derivative, misreading, twist, curvature
weighting = "determinant"       # or "variance", "none"
noise = "ar"                    # or "white", "innovations"
covariance = "model"            # "sandwich": for water, which reaches speed and torque at once; with noise = "white"
offsets = true                  # "relative": as errors of the operating point, where the steady stretch is short
initial_state = "estimated"     # "zero": for windows that begin at rest
lead_back = false               # true: simulate the vessel's file, too, and take off what the linear structure lacks
starts = 8
seed = 0
# [identify.fixed]              # known values close what the data can't tell
# tau_n = 1.17
# [identify.priors]             # name = [mean, standard deviation]
# v = [1.2, 0.1]
# [identify.tied]               # name = [another name, factor], or with an offset: a ratio that the governor's manual gives
# vK_i = ["vK_p", 2.4]

# [structure]                   # the vessel's own plant with its limits, in place of the lines above from torque to
# kind = "grey_box"             # dead_time_set_point: starts at the vessel file's values, in their units
# free = ["propeller_inertia", "Kp_abs", "Ki_abs", "torque_exponent"]
# pass_hz = 5.0                 # compare below this frequency; for a vessel whose file has firing or ripple
"""
"""Text that `shipfp init` writes; valid as it stands."""
