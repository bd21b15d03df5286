"""A pulse train of a log: its reflectors, its speeds, what had to be repaired."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from shipfp_rs.cleaning import Repair
from shipfp_rs.despike import runs
from shipfp_rs.errors import InputError
from shipfp_rs.log import Log
from shipfp_rs.tacho import (
    IntervalSpeed,
    PulseFlag,
    PulseTimes,
    pulse_times,
    reflector_angles,
    speed_from_pulses,
)
from shipfp_rs.trial import Tacho

Array = npt.NDArray[np.float64]

MARGIN_S = 2.0
"""Read before and after a stretch, so that it begins and ends within an interval."""


class PulseTrain:
    """One train; its reflectors are measured on the longest stretch that the trial uses."""

    def __init__(
        self, log: Log, name: str, tacho: Tacho, gear_ratio: float, longest: tuple[float, float]
    ) -> None:
        self.log = log
        self.name = name
        self.channel = log.channel(tacho.column)
        self.tacho = tacho
        self.rpm_per_rps = 60.0 * (gear_ratio if tacho.shaft == "propeller" else 1.0)
        """Engine rpm per rev/s of the train's own shaft."""
        pulses = self.pulses(*longest)
        self.angles = reflector_angles(pulses.times_s, tacho.pulses_per_rev, gaps=pulses.gaps_s)

    def pulses(self, start_s: float, stop_s: float) -> PulseTimes:
        """Pulses of a stretch and a margin on either side, on the log's clock."""
        channel = self.channel
        start_s, stop_s = max(start_s - MARGIN_S, channel.start_s), min(stop_s + MARGIN_S, channel.stop_s)
        try:
            first, _ = self.log.rows(channel.name, start_s, stop_s)
            pulses = pulse_times(
                self.log.chunks(channel.name, start_s=start_s, stop_s=stop_s),
                channel.rate_hz,
                threshold=self.tacho.threshold,
                hysteresis=self.tacho.hysteresis,
            )
        except InputError as error:
            raise InputError(f"channels.{self.name}, {start_s:g} to {stop_s:g} s: {error}") from error
        offset = channel.start_s + first / channel.rate_hz
        return replace(pulses, times_s=pulses.times_s + offset, gaps_s=pulses.gaps_s + offset)

    def speed(self, pulses: PulseTimes) -> IntervalSpeed:
        """Interval speeds [rev/s] of the train's shaft."""
        return speed_from_pulses(
            pulses.times_s,
            self.tacho.pulses_per_rev,
            gaps=pulses.gaps_s,
            angles=self.angles if self.angles.ok else None,
            time_std_s=pulses.time_std_s,
        )

    def score(self, speed: IntervalSpeed) -> float:
        """Good intervals; where the reflectors' angles are unknown only one a turn says anything about speed."""
        good = float(np.count_nonzero(speed.flags == PulseFlag.GOOD))
        return good if self.angles.ok else good / self.tacho.pulses_per_rev

    def repairs(
        self, pulses: PulseTimes, speed: IntervalSpeed, start_s: float, stop_s: float
    ) -> list[Repair]:
        """What was repaired in a stretch."""
        begins, ends = speed.time_s - 0.5 * speed.duration_s, speed.time_s + 0.5 * speed.duration_s

        def repair(kind: str, method: str, begins: Array, ends: Array) -> Repair:
            inside = (ends > start_s) & (begins < stop_s)
            times = np.column_stack([begins, ends])[inside] - self.channel.start_s
            return Repair(
                kind, self.channel.name, method, np.rint(times * self.channel.rate_hz).astype(np.int64)
            )

        extra = runs((speed.flags & PulseFlag.EXTRA) > 0)
        missed = runs((speed.flags & PulseFlag.MISSED) > 0)
        return [
            repair("A", "second crossings removed", begins[extra[:, 0]], ends[extra[:, 1] - 1]),
            repair("B", "lost pulses put in at equal shares", begins[missed[:, 0]], ends[missed[:, 1] - 1]),
            repair("gap", "masked", *pulses.gaps_s.T),
        ]
