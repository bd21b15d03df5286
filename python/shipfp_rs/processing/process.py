"""Conversion of a raw log to experiments: calibrated, cleaned, on one time base, with a record of each fault.

The same zero-phase low-pass is applied to all channels, including speeds from pulses, which preserves gain and phase of
the responses between channels.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import DRIVES, Experiment, Hold
from shipfp_rs.logs.channel import blocks_by_name
from shipfp_rs.logs.faults.chirp import constant_frequency
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.log import STRETCH_BYTES, Log, Rows
from shipfp_rs.logs.time_axis import finer
from shipfp_rs.processing.cleaning import (
    Cleaned,
    Cleaner,
    require_columns,
    require_load,
    require_sense,
    require_size,
    require_unit,
)
from shipfp_rs.processing.conditioning import (
    SAME_RATE,
    Grid,
    Ripple,
    conditioned,
    driven_point,
    nearest_rate,
    without_ripple,
)
from shipfp_rs.processing.engine_speed import EngineSpeed
from shipfp_rs.processing.speed_sources import PulseTrain, require_one_direction, source_of
from shipfp_rs.processing.trial import Trial, Window
from shipfp_rs.processing.trial_channels import Level, Load, Rack, SetPoint, Tacho, Torque
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array, clipped_to, joined, marks
from shipfp_rs.support.derivatives import ATTENUATION_DB, PASSBAND, STOPBAND
from shipfp_rs.support.progress import counted
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.spikes import bridge
from shipfp_rs.support.threads import side_by_side
from shipfp_rs.vessel.vessel import Vessel

Cut = tuple[dict[str, Array], dict[str, Any]]
STEADY_STRETCH = "operating_point.steady_s"
STEADY = 0.02
"""Relative standard deviation above which a set point is not steady."""


@checked
def process(
    log: str | Path | Log | Trial,
    trial: Trial | None = None,
    vessel: Vessel | None = None,
    *,
    chunk: int | None = None,
) -> list[Experiment]:
    """Convert the windows of a log to experiments.

    The set point is calibrated, and short jumps caused by the signal generator's relay are bridged. The torque is
    calibrated, and short spikes caused by radio interference are masked. Pulse trains become speed; the angles of the
    reflectors are estimated from the log, and double or lost pulses are repaired. Of several trains, the one with the
    most good intervals is used (only one per turn counts if the reflectors' angles are unknown), and the others must
    agree with it. With `processing.speed = "fused"`, all trains are fused. All channels then pass the same low-pass
    and are sampled at `processing.rate_hz`.

    Parameters
    ----------
    log
        Log to convert. A trial, or the path of its TRIAL.toml, stands for all logs of the trial.
    trial
        Trial with channels, windows, operating point and settings; windows of other logs are ignored.
    vessel
        Vessel; by default the one named in the trial.
    chunk
        Number of samples of a channel read at once; results are bitwise independent of it.

    Returns
    -------
    list of Experiment
        One for each window, with n_set and n_e [rpm], the torque [Nm] by its location and the rack X_f in its
        calibration's unit, NaN where masked.
        `provenance["faults"]` lists every fault: kind (`shipfp_rs.logs.faults.KINDS`), channel, method, count, spans
        on the channel's own index, and whether they are excluded, that is, NaN in the signals of the channel or, for
        set point and load, in all outputs.
        `provenance["ripple"]` lists the torque ripple, periodic in the angle of shaft and engine, that was removed.
        `provenance["gauge_accuracy"]` has the accuracy of the signals for which the trial gives it.

    Raises
    ------
    InputError
        If a channel or window is missing, a unit or calibration is implausible, or no usable samples remain.

    Notes
    -----
    A pulse train resolves the speed up to half its pulse rate, 10 Hz with four reflectors at 5.16 rev/s (section 6.4).
    Provenance includes that bandwidth, the speed error due to the resolution of pulses [rpm], and for a fused speed the
    standard deviation [rpm], as a root mean square over the window before the low-pass.

    Examples
    --------
    >>> experiments = process("TRIAL.toml")  # doctest: +SKIP
    """
    if isinstance(log, str | Path):
        log = Trial.load(log)
    if isinstance(log, Trial):
        if trial is not None:
            raise InputError(
                "process: both arguments are trials, expected a Log and a Trial, or one Trial alone"
            )
        return [one for own in log.logs() for one in process(own, log, vessel, chunk=chunk)]
    if trial is None:
        raise InputError(
            "process: found no trial beside the log, expected one: it tells the channels and windows"
        )
    if not (windows := trial.windows_of(log.name)):
        raise InputError(
            f"{log.name}: no window of the trial names this log, expected one with log = {log.name!r}"
        )
    recording = _Recording(log, trial, vessel or Vessel.load(trial.trial.vessel), chunk)
    with recording.naming_the_rate():
        point = recording.operating_point()
        cut = [recording.signals(_label(window)) for window in windows]
    shaft = recording.vessel.torque_ratio if "M_b" in point else 1.0
    if trial.channels.load is not None and trial.channels.load.quantity == "other":
        shaft = 0.0  # a load other than torque or power can't be calculated from the torque
    else:
        require_load([signals for signals, _ in cut], recording.vessel)
    point = driven_point(point, [signals for signals, _ in cut], trial.operating_point.M_Nm, shaft)
    if trial.channels.asks_for_torque:
        point.setdefault("M_b", point["command"])  # reference of tau_n in SI units
    return [recording.experiment(*each, point) for each in zip(windows, cut, strict=True)]


def _no_slower(log: Log, trial: Trial) -> Log:
    """Log with set point and load, if they were polled slowly, resampled at the rate of torque and speed."""
    channels, least_hz = trial.channels, (1.0 - SAME_RATE) * trial.processing.rate_hz
    answers = [one for one in (channels.torque, *channels.recorded_speeds) if one is not None]
    rate_hz = max((log.channel(one.column).rate_hz for one in answers), default=trial.processing.rate_hz)
    raised = {
        one.column: finer(log.channel(one.column), log.raw_blocks, rate_hz, held=getattr(one, "held", False))
        for one in (channels.driver, channels.load)
        if one is not None and log.channel(one.column).rate_hz < least_hz < rate_hz
    }
    own = [raised[name][0] if name in raised else one for name, one in log.channels.items()]
    finer_by = {name: channel.rate_hz / log.channel(name).rate_hz for name, (channel, _) in raised.items()}
    faults = tuple(
        dataclasses.replace(fault, spans=np.round(fault.spans * finer_by.get(fault.of or fault.channel, 1.0)))
        for fault in log.faults
    )

    blocks = blocks_by_name({name: own_blocks for name, (_, own_blocks) in raised.items()}, log.raw_blocks)
    return Log(log.name, own, blocks, log.start_utc, faults, log.notes) if raised else log


class _Recording:
    """Log with its trial's settings; channels are read once and in parallel, only a stretch of the torque twice."""

    def __init__(self, log: Log, trial: Trial, vessel: Vessel, chunk: int | None) -> None:
        log = trial.completed(log)
        require_columns(log, trial.channels)
        self.log = log = _no_slower(log, trial)
        self.trial = trial
        self.vessel = vessel
        self._chunk = chunk
        self._stopped = threading.Event()
        channels = trial.channels
        for key in ("set_point", "command", "torque", "rack", "actuator", "load"):
            if (sensor := getattr(channels, key)) is not None:
                require_unit(log, key, sensor)
        stretches = {_label(window): (window.start_s, window.stop_s) for window in trial.windows_of(log.name)}
        if trial.operating_point.steady_s is not None:
            stretches[STEADY_STRETCH] = trial.operating_point.steady_s
        # Sort the stretches by time, the order in which the channels are read.
        self.stretches = dict(sorted(stretches.items(), key=lambda item: item[1]))
        self.rate_hz = nearest_rate(log.channel(channels.driver.column), trial.processing.rate_hz)
        self.hold: Hold = "zero" if self._shows_stairs() else "first"
        self._base = self._rows(channels.driver)
        sensors = (channels.driver, *channels.levels.values(), *channels.recorded_speeds)
        self._channels = {sensor.column: self._rows(sensor).channel for sensor in sensors}
        with self.naming_the_rate():
            self.grids = {label: self._grid(label) for label in self.stretches}
        self._read()

    def _shows_stairs(self) -> bool:
        """Whether a speed or torque recorded at the rate of a held set point shows the set point's stairs."""
        driver, channels = self.trial.channels.driver, self.trial.channels
        answers = channels.recorded_speeds if channels.torque is None else [channels.torque]
        rates = [self.log.channel(one.column).rate_hz for one in answers]
        held = isinstance(driver, SetPoint) and driver.held
        return held and np.allclose(
            [self.log.channel(driver.column).rate_hz, *rates], self.rate_hz, rtol=SAME_RATE
        )

    def _rows(self, sensor: Level | Tacho, kept_bytes: int = 0) -> Rows:
        # A held set point acts half a sample late on average; if its stairs are visible, the model includes this delay.
        late = getattr(sensor, "late", 0.0) if self.hold == "first" else 0.0
        return Rows(
            self.log,
            sensor.column,
            delay_s=sensor.delay_s - late / self.log.channel(sensor.column).rate_hz,
            size=self._chunk,
            kept_bytes=kept_bytes,
            stopped=self._stopped,
        )

    def _grid(self, label: str) -> Grid:
        """Sample times of all signals, starting at a sample of the set point."""
        base = self._base.channel
        first, last = self._within(self._base, label)
        self._require_one_stretch(label, first, last)
        count = int((last - first) * self.rate_hz / base.rate_hz + 1e-9)
        if count < 2:
            start_s, stop_s = self.stretches[label]
            raise InputError(
                f"{label}: {start_s:g} to {stop_s:g} s hold {count} samples at {self.rate_hz:g} Hz"
            )
        return Grid(label, base.start_s + first / base.rate_hz, self.rate_hz, count)

    def _require_one_stretch(self, label: str, first: int, last: int) -> None:
        """Reject a window that includes a jump of the clock, since the length of the jump is unknown."""
        start_s, stop_s = self._base.channel.start_s + np.array([first, last]) / self._base.channel.rate_hz
        for fault in (one for one in self.log.faults if one.kind == "time_jump"):
            channel = self.log.counted(fault) or self._base.channel
            jumps_s = channel.start_s + fault.spans / channel.rate_hz
            over = jumps_s[(jumps_s[:, 0] > start_s) & (jumps_s[:, 1] < stop_s)]
            if len(over):
                begin, end = over[0]
                raise InputError(
                    f"{label}: the clock was reset within it; expected a window that ends before {begin:.6g} s or "
                    f"begins after {end:.6g} s"
                )

    def _within(self, rows: Rows, label: str) -> tuple[int, int]:
        try:
            return rows.within(*self.stretches[label])
        except InputError as error:
            raise InputError(f"{label}: {error}") from error

    @contextmanager
    def naming_the_rate(self) -> Iterator[None]:
        """Add the trial's sample rate to errors raised in the block: a wrong rate would change all times and speeds."""
        try:
            yield
        except InputError as error:
            rate_hz = self.trial.trial.rate_hz
            told = "" if rate_hz is None else f"; is trial.rate_hz, {rate_hz:g}, the logger's?"
            raise InputError(f"{error}{told}") from error

    def _read(self) -> None:
        """Read, clean and resample every channel, then calculate the speed in every stretch."""
        channels = self.trial.channels
        levels = [partial(self._cleaned, s) for s in (channels.driver, *channels.levels.values())]
        steps = len(self.grids) * (len(levels) + 1) + len(channels.tachos)
        self._step = counted("reading and cleaning the channels", steps)
        trains = [partial(self._train, name, tacho) for name, tacho in channels.tachos.items()]
        found: list[Any] = side_by_side([*levels, *trains], self._stopped)
        self.set_point: dict[str, Cleaned] = found[0]
        self.levels: dict[str, dict[str, Cleaned]]
        self.levels = dict(zip(channels.levels, found[1 : len(levels)], strict=True))
        self.trains: list[PulseTrain] = found[len(levels) :]
        by_name = {train.name: train for train in self.trains}
        for name, tacho in channels.tachos.items():
            if tacho.quadrature is not None:
                require_one_direction(by_name[name], by_name[f"{name}, second"])
        speeds = side_by_side(
            [partial(self._engine_speed, grid) for grid in self.grids.values()], self._stopped
        )
        self.speeds = dict(zip(self.grids, speeds, strict=True))

    def _cleaned(self, sensor: Level) -> dict[str, Cleaned]:
        """Calibrate, repair and resample a channel in every stretch."""
        rows = self._rows(sensor, STRETCH_BYTES)
        found = {}
        for label, grid in self.grids.items():
            within, may_rest = self._within(rows, label), self.trial.channels.load is not None
            cleaner = Cleaner(rows, sensor, self.trial.processing, *within, may_rest=may_rest)
            samples = grid.low_passed(rows.channel, cleaner)
            self._step()
            found[label] = Cleaned(samples, cleaner.faults(), cleaner.calibration)
        return found

    def _train(self, name: str, tacho: Tacho) -> PulseTrain:
        rows = None if tacho.kind == "edges" else self._rows(tacho)
        found = source_of(
            rows, name, tacho, self.vessel.gearbox.ratio, self.stretches, self.trial.processing.torque_spikes
        )
        self._step()
        return found

    def operating_point(self) -> dict[str, float]:
        """Operating point as given in the trial, else means over the steady stretch."""
        given = self.trial.operating_point
        point: dict[str, float] = {}
        if given.steady_s is not None:
            signals, _ = self.signals(STEADY_STRETCH)
            point = {name: float(np.nanmean(values)) for name, values in signals.items()}
            driver = self.trial.channels.driver_signal
            spread = float(np.std(signals[driver])) / abs(point[driver])
            if spread > STEADY:
                raise InputError(
                    f"{STEADY_STRETCH}: the {DRIVES[driver]} varies by {spread:.1%} there, expected a constant one"
                )
        if given.n_e_rpm is not None:
            if abs(given.n_e_rpm / point.get("n_e", given.n_e_rpm) - 1.0) > STEADY:
                known = f"{point['n_e']:.5g} rpm of steady_s; leave one of the two out"
                raise InputError(f"operating_point.n_e_rpm: found {given.n_e_rpm:g}, expected the {known}")
            point |= dict.fromkeys({"n_e", self.trial.channels.driver_signal} - {"command"}, given.n_e_rpm)
        for signal, sensor in self.trial.channels.levels.items():
            if isinstance(sensor, Load):
                continue  # without a steady stretch, the load is calculated from the torque
            value = given.X_mm if isinstance(sensor, Rack) else given.M_Nm
            point |= {} if value is None else {signal: value}
        return point

    def experiment(self, window: Window, cut: Cut, point: Mapping[str, float]) -> Experiment:
        """Make the experiment of a window, with signals and provenance."""
        (signals, account), settings = cut, self.trial.processing
        if (
            window.kind == "chirp"
            and (only := constant_frequency(signals[self.trial.channels.driver_signal], self.rate_hz))
            is not None
        ):
            account["faults"].append(self._no_chirp(_label(window), only).to_dict())
        experiment = Experiment(
            name=window.name,
            rate_hz=self.rate_hz,
            signals=signals,
            operating_point=point,
            hold=self.hold,
            kind=window.kind,
            provenance={
                "log": self.log.name,
                "window_s": [window.start_s, window.stop_s],
                "normalise": settings.normalise,
                "gauge_accuracy": {
                    signal: sensor.gauge_accuracy
                    for signal, sensor in self.trial.channels.levels.items()
                    if not isinstance(sensor, Load) and sensor.gauge_accuracy is not None
                },
                **account,
            },
        )
        return conditioned(experiment, settings.detrend, settings.normalise)

    def signals(self, label: str) -> Cut:
        """Return the signals of a stretch with their provenance, and free their memory."""
        set_point, speed = self.set_point.pop(label), self.speeds.pop(label)
        signals = {self.trial.channels.driver_signal: set_point.samples, "n_e": speed.rpm}
        faults = set_point.faults + speed.faults
        told_by = {speed.account["channel"]: ["n_e"]}
        calibration = {"set_point": dataclasses.asdict(set_point.calibration)}
        ripple: list[Ripple] = []
        load: dict[str, Any] = {}
        for name, sensor in self.trial.channels.levels.items():
            cleaned, is_torque = self.levels[name].pop(label), isinstance(sensor, Torque)
            signals[name] = cleaned.samples
            if isinstance(sensor, Load):
                load["load"] = {"quantity": sensor.quantity, "torque_ratio": self.vessel.torque_ratio}
            if is_torque:
                ratio = self.vessel.gearbox.ratio
                signals[name], ripple = without_ripple(cleaned.samples, speed.rpm, self.rate_hz, ratio)
            if isinstance(sensor, Load) and sensor.quantity == "power":
                shaft = bridge(speed.rpm, np.isnan(speed.rpm)) / 60.0 / self.vessel.gearbox.ratio
                signals[name] = cleaned.samples / (2.0 * np.pi * shaft)
            faults = faults + cleaned.faults
            told_by[sensor.column] = [name]
            kind = "torque" if is_torque else "load" if isinstance(sensor, Load) else "rack"
            calibration[kind] = dataclasses.asdict(cleaned.calibration)
            if is_torque and np.nansum(cleaned.samples) < 0.0:
                rows = np.array([self._within(self._rows(sensor), label)])
                kept = Sentence(
                    "kept: negative on average, which makes no difference once it is normalised by its mean"
                )
                faults = [*faults, Fault("sign", sensor.column, kept, rows, excluded=False)]
            if isinstance(sensor, Torque | Load) and getattr(sensor, "quantity", "") != "other":
                require_size(label, kind, sensor, cleaned.samples, cleaned.calibration)
        tacho = self.trial.channels.tachos.get(speed.account["train"])
        source = None if tacho is None else (speed.account["train"], tacho)
        if source is not None:
            require_size(label, *source, speed.rpm)
        require_sense(label, signals, self.vessel, source)
        answers = [name for name in signals if name not in DRIVES]
        drives = (self.trial.channels.driver, self.trial.channels.load)
        # Where an input of the model was repaired, all outputs are masked.
        told_by |= dict.fromkeys([one.column for one in drives if one is not None], answers)
        self._exclude(signals, label, faults, told_by)
        return signals, {
            "filter": f"zero-phase FIR low-pass on every channel, {PASSBAND * self.rate_hz:g} Hz passed, "
            f"{ATTENUATION_DB:g} dB from {STOPBAND * self.rate_hz:g} Hz on",
            "calibration": calibration,
            **load,
            "speed": speed.account,
            "ripple": [line._asdict() for line in ripple],
            "faults": [fault.to_dict() for fault in faults + self._faults_of_the_file(label)],
            "recorded": self._recorded(label, speed.account["train"]),
        }

    def _recorded(self, label: str, train: str) -> dict[str, Any]:
        """Signal, clock, length and rows of each channel, to which the spans of faults refer."""
        channels = self.trial.channels
        sensors: list[tuple[Level | Tacho, str]] = [(channels.driver, channels.driver_signal)]
        sensors += [(sensor, signal) for signal, sensor in channels.levels.items()]
        tachos = {name: tacho for name, tacho in channels.tachos.items() if tacho.kind != "edges"}
        sensors += [(tacho, "n_e" if name == train else "") for name, tacho in tachos.items()]
        told = {}
        for sensor, signal in sensors:
            rows = self._rows(sensor)
            told[sensor.column] = {
                "signal": signal,
                "rate_hz": rows.channel.rate_hz,
                "start_s": rows.channel.start_s,
                "samples": rows.channel.samples,
                "rows": list(self._within(rows, label)),
            }
        return told

    def _exclude(
        self, signals: dict[str, Array], label: str, faults: list[Fault], told_by: Mapping[str, list[str]]
    ) -> None:
        """Mask the signals of a channel where it was repaired."""
        grid = self.grids[label]
        for channel, names in told_by.items():
            if channel not in self._channels:
                continue  # a list of edges has no samples
            about = self._channels[channel]
            spans = joined([fault.spans for fault in faults if fault.excluded and fault.channel == channel])
            at = (about.start_s - grid.start_s + spans / about.rate_hz) * grid.rate_hz
            # A grid sample covers half an interval on either side; rounding removes rounding errors of the times.
            at = np.round(at, 6)
            touched = np.column_stack([np.floor(at[:, 0] + 0.5), np.ceil(at[:, 1] + 0.5)]).astype(np.int64)
            for name in names:
                signals[name] = np.where(marks(touched, 0, grid.count), np.nan, signals[name])

    def _faults_of_the_file(self, label: str) -> list[Fault]:
        """Faults of the file itself, such as of its clock, within a stretch."""
        found = []
        for fault in self.log.faults:
            channel = self.log.counted(fault) or self._base.channel
            rows = np.round((np.array(self.stretches[label]) - channel.start_s) * channel.rate_hz).astype(
                np.int64
            )
            if len(spans := clipped_to(fault.spans, *rows)):
                found.append(dataclasses.replace(fault, spans=spans))
        return found

    def _no_chirp(self, label: str, frequency_hz: float) -> Fault:
        rows = np.array([self._within(self._base, label)])
        kept = Sentence(
            "kept: no chirp, its frequency stays at {frequency} Hz", frequency=f"{frequency_hz:.3g}"
        )
        return Fault("D3", self._base.channel.name, kept, rows, excluded=False)

    def _engine_speed(self, grid: Grid) -> _EngineSpeed:
        """Engine speed in a stretch, sampled first at the set point's rate, so that the same filter applies."""
        base = self._base.channel
        speed = EngineSpeed(self.trains, grid.label, (grid.start_s, grid.stop_s), base, self.rate_hz)
        source, account = speed.fused() if self.trial.processing.speed == "fused" else speed.best()
        found = _EngineSpeed(grid.low_passed(base, source), account, speed.faults())
        for train in self.trains:  # the pulses of several days take hundreds of MiB
            train.pulses.pop(grid.label, None)
        self._step()
        return found


@dataclass(frozen=True)
class _EngineSpeed:
    """Engine speed [rpm] on the grid of a stretch, the record of its origin, and the faults of all trains."""

    rpm: Array
    account: dict[str, Any]
    faults: list[Fault]


def _label(window: Window) -> str:
    return f"window {window.name!r}"
