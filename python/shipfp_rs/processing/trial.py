"""TRIAL.toml: header, logs, channels, operating point, processing, windows, and options of the identification."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from shipfp_rs.logs.channel import Samples, blocks_by_name
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.trial_channels import SIGNAL_OF_LOCATION, Channels, Pair, Positive, Rate
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.hints import nearest
from shipfp_rs.support.sentences import LANGUAGES
from shipfp_rs.support.toml import FilePath, Name, Section, Seed, Starts, read_toml, unexpected
from shipfp_rs.vessel.torsion import Line

Relation = Annotated[
    tuple[str, float, float],
    Field(strict=False),
    BeforeValidator(lambda value: [*value, 0.0] if isinstance(value, list) and len(value) == 2 else value),
]
"""Name of another parameter, factor and offset; the default offset is 0."""
Share = Annotated[float, Field(ge=1e-9, le=1e3)]
Sigmas = Annotated[float, Field(ge=0.1, le=1e6)]
Stretch = Annotated[float, Field(ge=1e-6, le=3600.0)]
"""Length of a fault [s]."""
Auto = Annotated[Positive | None, BeforeValidator(lambda value: None if value == "auto" else value)]
"""A positive number, or "auto" (None)."""
KINDS = ("steady", "sine", "sines", "chirp", "steps", "multisine", "squares", "prbs", "noise", "other")
"""Usual kinds of windows."""


class Header(Section):
    """The trial: name, ship and recordings."""

    name: Name
    """Name of the trial in the report."""
    vessel: FilePath = "direct-drive"
    """Name of a built-in ship or path of a vessel file; by default there is no gear between engine and shaft."""
    log: Annotated[
        tuple[FilePath, ...],
        Field(strict=False, min_length=1, max_length=1000),
        BeforeValidator(lambda value: [value] if isinstance(value, str) else value),
    ]
    """Path of the log, or list of paths, relative to the folder of TRIAL.toml."""
    rate_hz: Rate | None = None
    """Sample rate of logs that do not state one [Hz]."""
    time_column: str | None = None
    """Time column of a table, needed only if it is not detected: "COLUMN", "COLUMN [ms]", "DATE [d.m.y] + CLOCK"."""
    names: FilePath | None = None
    """File with the names of the channels: a DBC for a CAN log, a channel list for ISO 19848."""


class Align(Section):
    """Alignment of several loggers with separate clocks to the clock of one of them."""

    reference: FilePath
    """File name of the log with the reference clock, on which all windows are given."""
    common: Name | None = None
    """Channel that every log has, such as the set point's voltage or a pulse train. Without this key, the logs must
    share a clock and are merged by their time stamps.
    """
    pulses: bool = False
    """Whether the common channel is a pulse train."""


class OperatingPoint(Section):
    """Steady state by which signals are normalised: given values, or "auto" for means over a steady stretch."""

    n_e_rpm: Auto = None
    """Engine speed [rpm]."""
    M_Nm: Auto = None
    """Torque at the location of the torque channel [Nm]; without a steady stretch, the load's operating point is
    calculated from it.
    """
    X_mm: Auto = None
    """Position of the fuel rack, in the unit of the rack channel's calibration."""
    steady_s: Pair | None = None
    """Start and stop of a stretch with a constant set point, on the log's clock [s]."""

    @model_validator(mode="after")
    def _can_be_had(self) -> Self:
        if self.steady_s is not None and not self.steady_s[0] < self.steady_s[1]:
            raise unexpected("steady_s", list(self.steady_s), "[start, stop] with start before stop")
        return self


class Spikes(Section):
    """Short excursions from the running median that count as faults."""

    longest_s: Stretch = 0.05
    """Longest spike [s], shorter than any motion of the plant. In a channel that holds each value for a longer time, a
    spike is a single value.
    """
    threshold: Sigmas = 6.0
    """Least deviation of a spike from the running median, in robust standard deviations."""
    least: Share = 0.05
    """Least height of a spike, relative to the channel's median magnitude."""


class Faults(Section):
    """Limits by which faults of a recorded channel, except spikes, are detected."""

    stuck_s: Stretch = 0.25
    """Shortest stretch of equal samples in an otherwise noisy channel [s]."""
    dropout_s: Stretch = 0.01
    """Shortest dropout [s]: a stretch at zero in a channel that is otherwise far from zero."""
    clipped_samples: Annotated[int, Field(ge=2, le=1_000_000_000)] = 8
    """Least number of samples at the extreme value of a clipped channel."""
    longest_bridge_s: Stretch = 0.25
    """Longest stretch without a valid set point that is bridged by a straight line [s]; the outputs are masked there."""
    mains_hz: Annotated[float, Field(ge=1.0, le=1000.0)] = 50.0
    """Frequency of the mains, whose hum is removed from the set point [Hz]."""
    least_hum: Share = 1e-3
    """Least amplitude of hum, relative to the set point."""


class Processing(Section):
    """Processing of raw channels to signals."""

    rate_hz: Rate = 50.0
    """Common rate of the signals [Hz]. Above the tachometer's bandwidth, the speed is only interpolated, and a fit
    with whitened residuals would mistake the interpolation for a signal. Four reflectors on a shaft at 5 rev/s have a
    bandwidth of 10 Hz.
    """
    normalise: Literal["global", "local"] = "global"
    """"global" normalises by the trial's operating point, "local" normalises each window by its own means."""
    detrend: Annotated[int, Field(ge=0, le=3)] = 0
    """Degree of the polynomial drift that is removed from the outputs; 0 for none. A window's outputs are not changed
    if its set point itself resembles such a polynomial, as a stair of steps does.
    """
    speed: Literal["best", "fused"] = "best"
    """"best": the speed of the train with the most good intervals. "fused": from the pulses of all trains, each weighted by
    its timing and reflectors; this takes about ten seconds more per hour of log and gives the speed's standard deviation.
    """
    torque_spikes: Spikes = Spikes()
    """Limits for spikes of the torque, of the rack, of the load, and of a recorded speed."""
    set_point_jumps: Spikes = Spikes()
    faults: Faults = Faults()


def _no_slip(word: str) -> str:
    """Reject a misspelt kind; any other word is the user's own."""
    if word not in KINDS and (near := nearest(word, KINDS, 0.75)):
        raise PydanticCustomError(
            "kind", "one of {known}, or a word of your own{near}", {"known": ", ".join(KINDS), "near": near}
        )
    return word


class Window(Section):
    """A stretch of a log, which becomes one experiment."""

    name: Name
    """Name of the experiment, different for each window."""
    kind: Annotated[str, Field(max_length=40), AfterValidator(_no_slip)] = ""
    """Kind of motion of the set point, such as "chirp"; the report shows it, and any word is allowed."""
    start_s: float
    """Start on the log's clock [s]."""
    stop_s: float
    """End on the log's clock [s]."""
    log: FilePath | None = None
    """File name of the window's log; by default the first log."""
    use: Literal["fit", "validation"] = "fit"
    """A window for "validation" is held out: it is not fitted, but predicted by the fit, and the prediction is scored."""

    @model_validator(mode="after")
    def _is_not_empty(self) -> Self:
        if not self.start_s < self.stop_s:
            raise unexpected("stop_s", f"{self.stop_s:g}", f"more than start_s, {self.start_s:g}")
        return self


class Torsion(Section):
    """Torsional calculation of the drive train, whose inertias and stiffness are priors."""

    file: FilePath
    """JSON or TOML file with the lists discs, shafts and gears, or a TORS file of openTorsion; relative to TRIAL.toml."""
    gauge: Name | None = None
    """Shaft with the torque gauge, or the disc ahead of it: its name, or "shaft 3" for the third shaft in the file."""
    std_pct: Annotated[float, Field(gt=0.0, le=100.0)] = 5.0
    """Standard deviation of the inertias and the stiffness, in per cent."""


class Dials(Section):
    """Settings of the governor's dials during the trial; `tune` gives its advice in the same units."""

    gain: Annotated[float, Field(gt=0.0)] | None = None
    """Proportional gain (GAIN of Woodward, Gain of ComAp), in any unit."""
    reset: Annotated[float, Field(gt=0.0)] | None = None
    """Ratio of integral to proportional gain (RESET of Woodward, Int of ComAp), in repeats per second or any other
    unit.
    """
    droop_pct: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    """Droop, in per cent of the governor's own reference quantity."""


HOW = ("noise", "starts")
"""Keys of [identify] that are options of `identify` with the same name."""
NARROWING = frozenset(("elements", "torque", "outputs", "fixed", "priors", "seed", "vessel_std_pct"))
"""Keys of [identify] that restrict the structure selected by the data; any other key declares the structure."""
OF_THE_FULL_SHIP: Mapping[str, tuple[Any, ...]] = {
    "products": (True,),
    "tied": ({},),
    "noise": (None, "coloured"),
    "starts": (None, 1),
}
"""With these values, the other keys declare no structure either, and the full ship is fitted."""


def _a_language(word: str) -> str:
    if word not in LANGUAGES:
        raise PydanticCustomError("language", "one of {known}", {"known": ", ".join(LANGUAGES)})
    return word


class Report(Section):
    """Settings of report.html."""

    language: Annotated[str, AfterValidator(_a_language)] = "en"
    """Language of the report: "en", or one into which the package is translated, such as "de"."""


class Identify(Section):
    """Structure to fit, and options of the fit; the structure checks the names of elements and parameters.

    The data select the elements of the ship unless a key outside `NARROWING` is given; with such a key, only elements
    given as true act. A key with its default value has no effect.
    """

    elements: dict[str, bool] = Field(default_factory=dict)
    """Elements that act (true) or do not (false); if the data select the structure, they decide about the others."""
    torque: Literal["gauge", "brake"] | None = None
    """Location of the torque; by default that of the torque channel."""
    products: bool = True
    """Fit vK_p and vK_i instead of v, K_p and K_i, which speed and torque can't determine separately."""
    outputs: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = ("dn", "dM")
    """Outputs that are fitted: speed dn, torque dM, rack dX; if the data select the structure, by default all measured
    ones.
    """
    fixed: dict[str, float] = Field(default_factory=dict)
    """Fixed parameters, with their known values."""
    priors: dict[str, Pair] = Field(default_factory=dict)
    """Parameters known beforehand, with mean and standard deviation."""
    vessel_std_pct: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    """Standard deviation, in per cent, of the vessel's inertias and stiffness as priors; they are not used without
    this key.
    """
    tied: dict[str, Relation] = Field(default_factory=dict)
    """Tied parameters: [name of another parameter, factor] or [name of another parameter, factor, offset]."""
    noise: Literal["coloured", "white"] | None = None
    """Assumed noise of the residuals, as in `identify`."""
    starts: Starts | None = None
    """Number of starts of the search, as in `identify`."""
    seed: Seed = 0
    """Seed of the random starts."""

    @property
    def options(self) -> dict[str, Any]:
        """Options of `identify`, except the seed."""
        return {name: getattr(self, name) for name in HOW}

    @property
    def chooses(self) -> bool:
        """Whether the data select the structure."""
        return all(getattr(self, name) in values for name, values in OF_THE_FULL_SHIP.items())

    @property
    def acting(self) -> tuple[str, ...]:
        """Elements of the declared structure."""
        return tuple(name for name, acts in self.elements.items() if acts)


MOST_WINDOWS = 500
"""Largest number of windows in a trial; each takes tens of milliseconds."""


class Trial(Section):
    """Contents of a TRIAL.toml.

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
    windows: Annotated[tuple[Window, ...], Field(strict=False, max_length=MOST_WINDOWS)] = ()
    """Stretches of the logs, one experiment each; at least one."""
    torsion: Torsion | None = None
    governor: Dials = Dials()
    identify: Identify = Identify()
    report: Report = Report()

    def __repr__(self) -> str:
        logs = ", ".join(Path(log).name for log in self.trial.log)
        windows = ", ".join(window.name for window in self.windows[:8]) + (
            ", ..." if len(self.windows) > 8 else ""
        )
        return f"Trial({self.trial.name!r}, {self.trial.vessel}: {logs}; windows {windows})"

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if not self.windows:
            raise unexpected(
                "windows", "none", "one table [[windows]] or more, each with name, start_s and stop_s"
            )
        if all(window.use == "validation" for window in self.windows):
            raise unexpected("windows", 'use = "validation" in each', "one window or more to fit")
        names = [window.name for window in self.windows]
        if len(set(names)) < len(names):
            raise unexpected("windows", f"names {names}", "each name once")
        self._require_one_place_of_torque()
        self._require_own_columns()
        if self.channels.command is not None and not self.identify.chooses:
            raise unexpected(
                "identify",
                "a declared ship beside channels.command",
                f"only {', '.join(sorted(NARROWING))} in open loop",
            )
        point = self.operating_point
        given = {
            "n_e": point.n_e_rpm,
            **dict.fromkeys(SIGNAL_OF_LOCATION.values(), point.M_Nm),
            "X_f": point.X_mm,
            "M_load": point.M_Nm if self.channels.torque is not None else None,
        }
        missing = any(given[signal] is None for signal in ("n_e", *self.channels.levels))
        if missing and point.steady_s is None and self.channels.command is None:
            raise unexpected(
                "operating_point",
                "neither n_e_rpm, M_Nm and X_mm of what is recorded nor steady_s",
                "these values, or steady_s = [start, stop]",
            )
        if missing and len(self.trial.log) > 1 and self.align is None:
            raise unexpected(
                "operating_point",
                '"auto" with several logs',
                "n_e_rpm, M_Nm and X_mm given as numbers; or [align], where the logs are loggers of one trial",
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

    def _require_own_columns(self) -> None:
        """Reject a column with two roles, and a speed of the propeller's shaft without a vessel for the gear ratio."""
        channels = self.channels
        found: dict[str, str] = {}
        for key in ("set_point", "command", "torque", "rack", "actuator", "load"):
            if (sensor := getattr(channels, key)) is not None:
                found[key] = sensor.column
        found |= {name: tacho.column for name, tacho in channels.tachos.items() if tacho.kind != "edges"}
        first: dict[str, str] = {}
        for key, column in found.items():
            if (other := first.setdefault(column, key)) != key:
                raise unexpected(
                    f"channels.{key}.column", f"{column!r}, which is channels.{other}, too", "another one"
                )
        for name, tacho in channels.tachos.items():
            if tacho.shaft == "propeller" and "vessel" not in self.trial.model_fields_set:
                raise unexpected(
                    "trial.vessel",
                    f'nothing beside channels.{name}.shaft = "propeller"',
                    "a built-in ship or a vessel file, whose gear lies between propeller and set point",
                )

    def _require_one_place_of_torque(self) -> None:
        """Reject an [identify] that contradicts the torque channel's location, or that needs a missing torque channel."""
        measured = self.channels.torque
        options, asked = self.identify, self.identify.torque
        if measured is None and (
            asked is not None or ("dM" in options.outputs and "outputs" in options.model_fields_set)
        ):
            key, found = ("torque", f"{asked!r}") if asked is not None else ("outputs", "'dM'")
            raise unexpected(
                f"identify.{key}",
                f"{found} without a torque channel",
                "a table [channels.torque], or this key left out",
            )
        if measured is not None and asked is not None and asked != measured.place:
            raise unexpected(
                "identify.torque",
                f"{asked!r} beside channels.torque.location = {measured.location!r}",
                f"{measured.place!r}, or no identify.torque, which follows from the location",
            )

    @classmethod
    @checked
    def load(cls, path: str | Path) -> Self:
        """Read a TRIAL.toml; paths of logs and of a vessel file are relative to its folder.

        Raises
        ------
        InputError
            If the file can't be read, or a key or value is wrong; the message names it.
        """
        path = Path(path)
        read = read_toml(path, cls)
        header = read.trial
        changes: dict[str, Any] = {"log": tuple(str(path.parent / log) for log in header.log)}
        if (path.parent / header.vessel).is_file():
            changes["vessel"] = str(path.parent / header.vessel)
        if header.names is not None:
            changes["names"] = str(path.parent / header.names)
        extra = {
            name: tacho.model_copy(update={"file": str(path.parent / tacho.file)}) if tacho.file else tacho
            for name, tacho in (read.channels.__pydantic_extra__ or {}).items()
        }
        channels = read.channels.model_copy()
        channels.__pydantic_extra__.update(extra)
        torsion = read.torsion
        if torsion is not None:
            torsion = torsion.model_copy(update={"file": str(path.parent / torsion.file)})
            Line.read(torsion.file).seen(torsion.gauge)  # raises errors before hours of log are read
        header = header.model_copy(update=changes)
        return read.model_copy(update={"trial": header, "channels": channels, "torsion": torsion})

    def completed(self, log: Log) -> Log:
        """Add the trial's constant set point, if any, to a log, as a channel with the load's length."""
        asked, load = self.channels.set_point, self.channels.load
        if asked is None or asked.rpm is None or load is None or asked.column in log.channels:
            return log
        resting = replace(log.channel(load.column), name=asked.column, unit="rpm", resolution=0.0)

        def rests(_: str, first: int, size: int) -> Iterator[Samples]:
            for start in range(first, resting.samples, size):
                yield np.full(min(size, resting.samples - start), asked.rpm)

        channels = [*log.channels.values(), resting]
        blocks = blocks_by_name({resting.name: rests}, log.raw_blocks)
        return Log(log.name, channels, blocks, log.start_utc, log.faults, log.notes)

    def logs(self) -> list[Log]:
        """Open the recordings, in order; aligned loggers become one log."""
        header = self.trial
        logs = [
            Log.open(path, rate_hz=header.rate_hz, time=header.time_column, names=header.names)
            for path in header.log
        ]
        if self.align is None:
            return [self.completed(log) for log in logs]
        from shipfp_rs.processing.alignment import merged  # SciPy takes long to load

        wanted = Path(self.align.reference)
        named = [log for log in logs if Path(log.name).name == wanted.name]
        # Files with the same name in several folders are distinguished by the ends of their paths.
        ends = (log for log in named if Path(log.name).parts[-len(wanted.parts) :] == wanted.parts)
        reference = next(ends, named[0])
        others = [log for log in logs if log is not reference]
        if self.align.common is None:
            return [self.completed(Log.merge(reference, *others, name=reference.name))]
        return [self.completed(merged(reference, others, self.align.common, pulses=self.align.pulses))]

    def windows_of(self, log: str) -> tuple[Window, ...]:
        """Windows of the log with this file name."""
        first = Path(self.trial.log[0]).name
        if len(self.trial.log) == 1 or self.align is not None:
            return self.windows
        return tuple(window for window in self.windows if Path(window.log or first).name == Path(log).name)
