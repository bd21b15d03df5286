"""From a raw log to experiments: calibrated, cleaned, on one time base, each repair on record.

Every channel goes through one and the same zero-phase low-pass, the pulse speeds included, so that responses from
one channel to another keep their gain and phase.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.cleaning import Cleaner, Repair
from shipfp_rs.errors import InputError
from shipfp_rs.experiment import Experiment
from shipfp_rs.log import Channel, Log
from shipfp_rs.low_pass import ATTENUATION_DB, PASSBAND, STOPBAND, LowPass, Source, nearest_rate
from shipfp_rs.pulse_train import PulseTrain
from shipfp_rs.tacho import resample
from shipfp_rs.trial import SIGNAL_OF_LOCATION, SetPoint, Torque, Trial, Window
from shipfp_rs.vessel import Vessel

Array = npt.NDArray[np.float64]

STEADY_STRETCH = "operating_point.steady_s"
TRAINS_AGREE = 0.02
"""Relative difference in speed that no two pulse trains of one shaft line have."""
STEADY = 0.02
"""Relative standard deviation of the set point above which a stretch is not steady."""
CALIBRATED_WITHIN = 0.1
"""Relative difference between the means of set point and speed above which a calibration is wrong."""
LEAST_TORQUE, MOST_TORQUE = 0.002, 2.0
"""Shares of the rated torque between which a mean torque makes sense."""


def process(log: Log, trial: Trial, vessel: Vessel | None = None) -> list[Experiment]:
    """Cut a log into experiments.

    The set point is calibrated and short jumps of the signal generator's relay are bridged; the torque is
    calibrated and short spikes of radio interference are masked; pulse trains become speed, with the angles of the
    reflectors estimated from the log and double or lost pulses repaired. Of several trains the one with the most
    good intervals a second is taken, reflectors of unknown angles counting as one a turn, and the others must
    agree with it. All channels then pass the same low-pass and are sampled at `processing.rate_hz`.

    Parameters
    ----------
    log
        The recording.
    trial
        Channels, windows, operating point and settings; windows of other logs are left out.
    vessel
        The ship; None: the one that the trial names.

    Returns
    -------
    list of Experiment
        One for each window, with n_set and n_e [rpm] and the torque [Nm] by its location, NaN where masked.
        `provenance["repairs"]` lists every repair: kind of fault (Table 6.10), channel, method, count, and the
        samples concerned on the channel's own index.

    Raises
    ------
    InputError
        Where a channel or window is missing, a unit or calibration can't be right, or nothing usable is left.

    Notes
    -----
    A pulse train shows speed up to half its pulses per second, 10 Hz with four reflectors at 5.16 rev/s (section
    6.4); provenance holds that bandwidth.
    """
    windows = trial.windows_of(log.name)
    if not windows:
        raise InputError(f"{log.name}: no window of the trial is cut from this log")
    recording = _Recording(log, trial, vessel or Vessel.load(trial.trial.vessel))
    point = recording.operating_point()
    return [recording.experiment(window, point) for window in windows]


@dataclass(frozen=True)
class _Grid:
    """Times at which the signals of a stretch are sampled."""

    label: str
    start_s: float
    rate_hz: float
    count: int

    @property
    def stop_s(self) -> float:
        return self.start_s + self.count / self.rate_hz

    def low_passed(self, channel: Channel, source: Source) -> Array:
        """Return samples of `source`, on the channel's own index, low-passed and sampled on the grid."""
        first = max(round((self.start_s - channel.start_s) * channel.rate_hz), 0)
        return LowPass(channel, self.rate_hz)(source, first, self.count)


class _Recording:
    """A log together with what the trial says about it."""

    def __init__(self, log: Log, trial: Trial, vessel: Vessel) -> None:
        self.log = log
        self.trial = trial
        self.vessel = vessel
        channels = trial.channels
        for key, sensor in (("set_point", channels.set_point), ("torque", channels.torque)):
            if sensor is not None:
                _require_unit(log, key, sensor)
        stretches = {_label(window): (window.start_s, window.stop_s) for window in trial.windows_of(log.name)}
        if trial.operating_point.steady_s is not None:
            stretches[STEADY_STRETCH] = trial.operating_point.steady_s
        for label, stretch in stretches.items():
            self._rows(label, channels.set_point.column, *stretch)
        longest = max(stretches.values(), key=lambda stretch: stretch[1] - stretch[0])
        self.trains = [
            PulseTrain(log, name, tacho, vessel.gearbox.ratio, longest)
            for name, tacho in channels.tachos.items()
        ]

    def operating_point(self) -> dict[str, float]:
        """Values given, or means over the steady stretch."""
        given, torque = self.trial.operating_point, self.trial.channels.torque
        point: dict[str, float] = {}
        if given.steady_s is not None:
            signals, _ = self._signals(STEADY_STRETCH, *given.steady_s)
            point = {name: float(np.nanmean(values)) for name, values in signals.items()}
            spread = float(np.std(signals["n_set"])) / point["n_set"]
            if spread > STEADY:
                raise InputError(
                    f"{STEADY_STRETCH}: the set point varies by {spread:.1%} there, expected a constant one"
                )
        if given.n_e_rpm is not None:
            point |= {"n_set": given.n_e_rpm, "n_e": given.n_e_rpm}
        if given.M_Nm is not None and torque is not None:
            point[SIGNAL_OF_LOCATION[torque.location]] = given.M_Nm
        return point

    def experiment(self, window: Window, point: Mapping[str, float]) -> Experiment:
        """Cut one window."""
        signals, account = self._signals(_label(window), window.start_s, window.stop_s)
        return Experiment(
            name=window.name,
            rate_hz=nearest_rate(
                self.log.channel(self.trial.channels.set_point.column), self.trial.processing.rate_hz
            ),
            signals=signals,
            operating_point=point,
            hold="first",
            kind=window.kind,
            provenance={"log": self.log.name, "window_s": [window.start_s, window.stop_s], **account},
        )

    def _signals(self, label: str, start_s: float, stop_s: float) -> tuple[dict[str, Array], dict[str, Any]]:
        """Return the signals of a stretch at the common rate, and an account of how they were made."""
        channels = self.trial.channels
        set_point = self.log.channel(channels.set_point.column)
        rate = nearest_rate(set_point, self.trial.processing.rate_hz)
        first, last = self._rows(label, set_point.name, start_s, stop_s)
        # The grid starts at a sample of the set point; whatever else is evaluated at its times.
        count = int((last - first) * rate / set_point.rate_hz + 1e-9)
        if count < 2:
            raise InputError(f"{label}: {start_s:g} to {stop_s:g} s hold {count} samples at {rate:g} Hz")
        grid = _Grid(label, set_point.start_s + first / set_point.rate_hz, rate, count)

        cleaner = Cleaner(
            self.log, channels.set_point, "rpm", self.trial.processing.set_point_jumps, first, last
        )
        signals = {"n_set": grid.low_passed(set_point, cleaner.bridged)}
        repairs = cleaner.repairs("D1", "bridged by straight lines")
        calibration = {"set_point": dataclasses.asdict(cleaner.calibration)}

        signals["n_e"], speed_account, speed_repairs = self._engine_speed(grid, set_point)
        repairs += speed_repairs

        if channels.torque is not None:
            rows = self._rows(label, channels.torque.column, start_s, stop_s)
            cleaner = Cleaner(self.log, channels.torque, "Nm", self.trial.processing.torque_spikes, *rows)
            name = SIGNAL_OF_LOCATION[channels.torque.location]
            signals[name] = grid.low_passed(cleaner.channel, cleaner.masked)
            repairs += cleaner.repairs("C", "masked")
            calibration["torque"] = dataclasses.asdict(cleaner.calibration)

        _require_sense(label, signals, self.vessel)
        return signals, {
            "filter": f"zero-phase FIR low-pass on every channel, {PASSBAND * rate:g} Hz passed, "
            f"{ATTENUATION_DB:g} dB from {STOPBAND * rate:g} Hz on",
            "calibration": calibration,
            "speed": speed_account,
            "repairs": [repair.to_dict() for repair in repairs if len(repair.spans)],
        }

    def _rows(self, label: str, channel: str, start_s: float, stop_s: float) -> tuple[int, int]:
        try:
            return self.log.rows(channel, start_s, stop_s)
        except InputError as error:
            raise InputError(f"{label}: {error}") from error

    def _engine_speed(self, grid: _Grid, base: Channel) -> tuple[Array, dict[str, Any], list[Repair]]:
        """Return the engine speed [rpm] from the best train, an account of the choice, and its repairs.

        It is sampled at the rate of `base` first, so that it passes the very filter that the others do.
        """
        pulses = {train.name: train.pulses(grid.start_s, grid.stop_s) for train in self.trains}
        speeds = {train.name: train.speed(pulses[train.name]) for train in self.trains}
        train = max(self.trains, key=lambda train: train.score(speeds[train.name]))
        speed = speeds[train.name]
        if not len(speed.time_s):
            raise InputError(f"{grid.label}: no pulses in {', '.join(speeds)}")
        median_rpm = {
            other.name: float(np.median(speeds[other.name].speed_rps)) * other.rpm_per_rps
            for other in self.trains
            if len(speeds[other.name].time_s)
        }
        for name, rpm in median_rpm.items():
            if abs(rpm / median_rpm[train.name] - 1.0) > TRAINS_AGREE:
                raise InputError(
                    f"{grid.label}: {name!r} tells {rpm:.1f} rpm of the engine and {train.name!r} "
                    f"{median_rpm[train.name]:.1f}; check pulses_per_rev, shaft and the gear ratio"
                )

        def sampled(first: int, stop: int) -> Array:
            start_s = base.start_s + first / base.rate_hz
            rps, _ = resample(speed, base.rate_hz, start_s, start_s + (stop - first) / base.rate_hz)
            return rps * train.rpm_per_rps

        account = {
            "train": train.name,
            "pulses_per_rev": train.tacho.pulses_per_rev,
            "bandwidth_hz": speed.bandwidth_hz,
            "reflectors": {
                "fractions": train.angles.fractions.tolist(),
                "std": train.angles.std.tolist() if train.angles.ok else None,
                "reason": train.angles.reason,
            },
            "median_rpm": median_rpm,
        }
        repairs = train.repairs(pulses[train.name], speed, grid.start_s, grid.stop_s)
        return grid.low_passed(base, sampled), account, repairs


def _label(window: Window) -> str:
    return f"window {window.name!r}"


def _require_unit(log: Log, key: str, sensor: SetPoint | Torque) -> None:
    recorded = log.channel(sensor.column).unit
    if recorded and recorded != sensor.unit:
        raise InputError(
            f"{log.name}: channel {sensor.column!r} is in {recorded!r}, channels.{key}.unit says {sensor.unit!r}; "
            "give the log's unit and a calibration for it"
        )


def _require_sense(label: str, signals: Mapping[str, Array], vessel: Vessel) -> None:
    """Catch signals without samples, and calibrations wrong by a factor such as the thousand between V and mV."""
    rated = vessel.engine.rated_power_kW * 1e3 / (2.0 * math.pi * vessel.engine.rated_speed_rpm / 60.0)
    rated_torque = {"M_b": rated, "M_s": rated * vessel.gearbox.ratio, "M_g": rated * vessel.gearbox.ratio}
    mean = {}
    for name, values in signals.items():
        if np.isnan(values).all():
            raise InputError(f"{label}: nothing usable is left of {name!r}; choose another stretch")
        mean[name] = float(np.nanmean(values))
    if abs(mean["n_set"] / mean["n_e"] - 1.0) > CALIBRATED_WITHIN:
        raise InputError(
            f"channels.set_point: {mean['n_set']:.4g} rpm on average in {label}, where the engine turns "
            f"{mean['n_e']:.4g} rpm; check unit and calibration"
        )
    for name, limit in rated_torque.items():
        if name in mean and not LEAST_TORQUE * limit < abs(mean[name]) < MOST_TORQUE * limit:
            raise InputError(
                f"channels.torque: {mean[name]:.4g} Nm on average in {label}, where the engine's rating makes "
                f"{limit:.4g} Nm; check unit and calibration"
            )
