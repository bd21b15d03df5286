"""Engine speed in a stretch, from the best pulse train or fused from all trains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.processing.conditioning import Source
from shipfp_rs.processing.speed_sources import PulseTrain, SpeedLevel
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.derivatives import PASSBAND, STOPBAND
from shipfp_rs.tacho import IntervalSpeed, Train, resample
from shipfp_rs.tacho.fusion import fused_angle

TRAINS_AGREE = 0.02
"""Largest relative difference in speed between pulse trains of one shaft line."""
LEAST_INTERVALS = 8
"""Least number of intervals for a train to be compared with the others."""


@dataclass(frozen=True)
class _Level:
    """Comparison of a recorded speed with a speed counted from pulses: scale, standard deviation and scatter."""

    train: SpeedLevel
    speed: IntervalSpeed
    ratio: float
    std_rpm: float
    scatter: float

    @classmethod
    def beside(
        cls, train: SpeedLevel, speed: IntervalSpeed, grid: Array, rpm: Array, std_rpm: float, rate_hz: float
    ) -> _Level | None:
        """Compare a recorded speed with a counted one [rpm] on a grid of `rate_hz`; None if they have no common times."""
        if len(speed.time_s) < LEAST_INTERVALS:
            return None
        own, _ = resample(speed, rate_hz, float(grid[0]), float(grid[-1]) + 1.0 / rate_hz)
        own = own[: len(grid)] * train.rpm_per_rps
        known = np.isfinite(own) & np.isfinite(rpm)
        if known.sum() < LEAST_INTERVALS:
            return None
        # The counted speed determines the scale, since a converter's gain is known only to about one per cent.
        ratio = float(np.median(own[known] / rpm[known]))
        white = float(np.median(speed.std_rps)) * train.rpm_per_rps
        apart = float(np.std(own[known] / ratio - rpm[known]))
        # Excess scatter increases the recorded speed's standard deviation, so a slow converter has little weight.
        scatter = apart / float(np.hypot(white, std_rpm))
        return cls(train, speed, ratio, max(white, white * scatter), scatter)


def _told(ratio: float, ratio_std: float, scatter: float, *, agrees: bool) -> dict[str, Any]:
    return {"ratio": [ratio, ratio_std], "scatter": scatter, "agrees": agrees}


def _beside(counted: Source, levels: Sequence[_Level], std_rpm: float, base: Channel) -> Source:
    """Mean of a counted speed and recorded speeds, weighted by inverse variance."""

    def sampled(first: int, stop: int) -> Array:
        told, weight = counted(first, stop), 1.0 / std_rpm**2
        total = np.full(len(told), weight)
        told = told * weight
        start = base.start_s + first / base.rate_hz
        end = start + (stop - first) / base.rate_hz
        for level in levels:
            part = level.train.around(level.speed, start, end)
            other, masked = resample(part, base.rate_hz, start, end)
            share = np.where(masked, 0.0, 1.0 / level.std_rpm**2)
            told += share * np.where(masked, 0.0, other * level.train.rpm_per_rps / level.ratio)
            total += share
        return np.asarray(told / total)

    return sampled


class EngineSpeed:
    """Speeds of all trains in a stretch, and the engine speed found from them; `InputError` if the trains differ."""

    def __init__(
        self,
        trains: Sequence[PulseTrain],
        label: str,
        stretch_s: tuple[float, float],
        base: Channel,
        rate_hz: float,
    ) -> None:
        self.trains, self.label, self.stretch_s, self.base, self.rate_hz = (
            trains,
            label,
            stretch_s,
            base,
            rate_hz,
        )
        self.speeds = {train.name: train.speed(label) for train in trains}
        self.train = max(trains, key=lambda train: train.score(self.speeds[train.name]))
        if not len(self.speeds[self.train.name].time_s):
            raise InputError(f"{label}: no pulses in {', '.join(self.speeds)}")
        self.median_rpm = {
            train.name: self._typical_rpm(train) for train in trains if len(self.speeds[train.name].time_s)
        }
        for name, rpm in self.median_rpm.items():
            if abs(rpm / self.median_rpm[self.train.name] - 1.0) > TRAINS_AGREE:
                levels = any(isinstance(train, SpeedLevel) for train in trains if train.name == name)
                check = (
                    "its unit, calibration and shaft"
                    if levels
                    else "pulses_per_rev, shaft and the gear ratio"
                )
                raise InputError(
                    f"{label}: {name!r} gives an engine speed of {rpm:.1f} rpm, and {self.train.name!r} "
                    f"{self.median_rpm[self.train.name]:.1f}; check {check}"
                )

    def _typical_rpm(self, train: PulseTrain) -> float:
        """Median engine speed by a train [rpm]: that of the best train times the ratio of both speeds at common times."""
        own, best = self.speeds[train.name], self.speeds[self.train.name]
        typical = best.typical_rps() * self.train.rpm_per_rps
        ratio = (
            1.0
            if train is self.train
            else own.times_as_fast_as(best) * train.rpm_per_rps / self.train.rpm_per_rps
        )
        return typical * ratio if np.isfinite(ratio) else own.typical_rps() * train.rpm_per_rps

    def best(self) -> tuple[Source, dict[str, Any]]:
        """Engine speed [rpm] from the train with the most good intervals, and a record of its origin."""
        train, speed, base = self.train, self.speeds[self.train.name], self.base

        def sampled(first: int, stop: int) -> Array:
            start_s = base.start_s + first / base.rate_hz
            stop_s = start_s + (stop - first) / base.rate_hz
            rps, _ = resample(train.around(speed, start_s, stop_s), base.rate_hz, start_s, stop_s)
            return rps * train.rpm_per_rps

        return sampled, self._account(speed.bandwidth_hz)

    def fused(self) -> tuple[Source, dict[str, Any]]:
        """Engine speed [rpm] fused from all trains, and a record of its origin with the standard deviation."""
        own, base = self.train, self.base
        useful = [
            train
            for train in self.trains
            if len(self.speeds[train.name].time_s) >= LEAST_INTERVALS and not isinstance(train, SpeedLevel)
        ]
        if not useful:
            source, account = self.best()
            level_std = float(np.median(self.speeds[own.name].std_rps))
            return source, {**account, "std_rpm": level_std * own.rpm_per_rps}
        # The fused speed is that of the best train's shaft. The gear ratio is estimated, since it is known to a few digits.
        try:
            fit, bandwidth_hz = fused_angle(
                [
                    Train(
                        train.name,
                        self.speeds[train.name],
                        1.0 if train.tacho.shaft == own.tacho.shaft else None,
                    )
                    for train in useful
                ]
            )
        except InputError as error:
            raise InputError(f"{self.label}: {error}") from error
        every = max(round(base.rate_hz / self.rate_hz), 1)

        def sampled(first: int, stop: int) -> Array:
            time = base.start_s + np.arange(first, stop) / base.rate_hz
            rps = fit.fit.speed(time)
            # The standard deviation is large where the spline only bridges a gap; it takes longer to compute than the speed.
            lost = np.isnan(fit.at(time[::every])[0])
            rps[np.repeat(lost, every)[: len(time)]] = np.nan
            return rps * own.rpm_per_rps

        start_s, stop_s = self.stretch_s
        grid = np.arange(start_s, stop_s, 1.0 / self.rate_hz)
        speed_rps, deviation_rps = fit.at(grid)
        reports = {train.name: fit.report(train.name) for train in useful}
        std_rpm = float(np.sqrt(np.nanmean(deviation_rps**2))) * own.rpm_per_rps
        found = (
            _Level.beside(
                train, self.speeds[train.name], grid, speed_rps * own.rpm_per_rps, std_rpm, self.rate_hz
            )
            for train in self.trains
            if isinstance(train, SpeedLevel)
        )
        levels = [level for level in found if level is not None]
        both = 1.0 / np.sqrt(1.0 / std_rpm**2 + sum(1.0 / level.std_rpm**2 for level in levels))
        return _beside(sampled, levels, std_rpm, base) if levels else sampled, {
            **self._account(bandwidth_hz),
            "std_rpm": float(both),
            "fused": {
                name: _told(report.ratio, report.ratio_std, report.scatter, agrees=report.agrees)
                for name, report in reports.items()
            }
            | {
                level.train.name: _told(level.ratio, 0.0, level.scatter, agrees=level.scatter < 3.0)
                for level in levels
            },
        }

    def faults(self) -> list[Fault]:
        """Faults of the trains."""
        return [
            fault
            for train in self.trains
            for fault in train.faults(self.label, self.speeds[train.name], *self.stretch_s)
        ]

    def _account(self, bandwidth_hz: float) -> dict[str, Any]:
        train = self.train
        return {
            "train": train.name,
            "channel": train.channel.name,
            "shaft": train.tacho.shaft,
            "pulses_per_rev": train.tacho.pulses_per_rev,
            "bandwidth_hz": bandwidth_hz,
            "reflectors": {
                "fractions": train.angles.fractions.tolist(),
                "std": train.angles.std.tolist() if train.angles.ok else None,
                "reason": train.angles.reason,
            },
            "median_rpm": self.median_rpm,
            "resolution_rpm": self._resolution_rpm(bandwidth_hz),
        }

    def _resolution_rpm(self, bandwidth_hz: float) -> float | None:
        """Error of the speed [rpm] below the low-pass due to the sampling of edges; None if there are no sampled pulses."""
        if self.train.tacho.kind != "pulses" or not bandwidth_hz > 0.0:
            return None
        # Errors of the angle at the edges are white, so the power of their derivative grows with the frequency squared.
        # It ends at the passband, or at half the number of intervals per second.
        shown = min(1.0, 0.5 * (PASSBAND + STOPBAND) * self.rate_hz / bandwidth_hz) / 2.0
        interval_rpm = float(np.median(self.speeds[self.train.name].std_rps)) * self.train.rpm_per_rps
        return float(2.0 * np.pi / np.sqrt(3.0) * shown**1.5 * interval_rpm)
