"""TRIAL.toml: vessel, logs, channels, windows, and how to identify."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from shipfp_rs.logs.channel import Samples
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.trial_channels import SIGNAL_OF_LOCATION, Channels
from shipfp_rs.processing.trial_tables import (
    NARROWING,
    Align,
    Header,
    Identify,
    OperatingPoint,
    Processing,
    Report,
    Window,
)
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.toml import Section, read_toml, unexpected

MOST_WINDOWS = 500
"""Most windows of a trial; each takes tens of milliseconds."""


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
        """Reject a column with two roles, and a speed behind a gear without a vessel."""
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
        """Reject an [identify] that contradicts the torque channel: its location, or whether there is one."""
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
                f"{measured.place!r}, or this key left out: the location says it",
            )

    @property
    def chooses(self) -> bool:
        """Whether the data select the structure, within the limits set by [identify]."""
        return self.identify.chooses

    @classmethod
    @checked
    def load(cls, path: str | Path) -> Self:
        """Read a TRIAL.toml; paths of logs and of a vessel file are relative to its folder.

        Raises
        ------
        InputError
            If the file can't be read, or a key or value is wrong, which the message names.
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
        return read.model_copy(update={"trial": header.model_copy(update=changes), "channels": channels})

    def completed(self, log: Log) -> Log:
        """Add a constant set point to a log, if the trial has one, with the length of the load."""
        asked, load = self.channels.set_point, self.channels.load
        if asked is None or asked.rpm is None or load is None or asked.column in log.channels:
            return log
        resting = replace(log.channel(load.column), name=asked.column, unit="rpm", resolution=0.0)

        def blocks(name: str, first: int, size: int) -> Iterator[Samples]:
            if name != resting.name:
                yield from log.raw_blocks(name, first, size)
                return
            for start in range(first, resting.samples, size):
                yield np.full(min(size, resting.samples - start), asked.rpm)

        channels = [*log.channels.values(), resting]
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
        # Files with the same name in several folders are distinguished by part of their paths.
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
