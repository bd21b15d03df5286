"""Pulse train of a log: reflectors, speeds, repairs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel_reader import Rows
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.processing.trial_channels import Tacho
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.spans import runs
from shipfp_rs.tacho import (
    IntervalSpeed,
    PulseFlag,
    PulseTimes,
    ReflectorAngles,
    pulse_times,
    reflector_angles,
    speed_from_pulses,
)

MARGIN_S = 2.0
"""Time read before and after a stretch, so that its ends lie within an interval [s]."""

SPLINE_REACH = 40
"""Number of intervals after which a change has no effect on a cubic spline; it decays by 3.7 per interval."""


class PulseTrain:
    """Pulse train of a log, read once; its reflectors are measured on the longest stretch."""

    def __init__(
        self,
        rows: Rows,
        name: str,
        tacho: Tacho,
        gear_ratio: float,
        stretches: Mapping[str, tuple[float, float]],
    ) -> None:
        self.name = name
        self.channel = rows.channel
        self.tacho = tacho
        self.rpm_per_rps = 60.0 * (gear_ratio if tacho.shaft == "propeller" else 1.0)
        """Engine rpm per rev/s of the train's own shaft."""
        self.pulses = {label: self._pulses(rows, *stretch) for label, stretch in stretches.items()}
        longest = max(stretches, key=lambda label: stretches[label][1] - stretches[label][0])
        self.angles = self._angles(self.pulses[longest])

    def _angles(self, longest: PulseTimes) -> ReflectorAngles:
        """Angles of the reflectors, from the pulses of the longest stretch."""
        return reflector_angles(longest.times_s, self.tacho.pulses_per_rev, gaps=longest.gaps_s)

    def _time_std_s(self, label: str) -> float | None:
        """Standard deviation of a pulse's time in a stretch [s]; None: that of `PulseTimes`."""
        return None

    def _pulses(self, rows: Rows, start_s: float, stop_s: float) -> PulseTimes:
        """Pulses of a stretch, with a margin on either side, on the log's clock."""
        channel = self.channel
        first = max(round((start_s - MARGIN_S - channel.start_s) * channel.rate_hz), 0)
        stop = min(round((stop_s + MARGIN_S - channel.start_s) * channel.rate_hz), channel.samples)
        try:
            rows.within(start_s, stop_s)
            pulses = pulse_times(
                rows.pieces(first, stop),
                channel.rate_hz,
                threshold=self.tacho.threshold,
                hysteresis=self.tacho.hysteresis,
            )
        except InputError as error:
            raise InputError(f"channels.{self.name}, {start_s:g} to {stop_s:g} s: {error}") from error
        offset = channel.start_s + first / channel.rate_hz
        return replace(
            pulses,
            times_s=pulses.times_s + offset,
            gaps_s=pulses.gaps_s + offset,
            faint_s=pulses.faint_s + offset,
        )

    def speed(self, label: str) -> IntervalSpeed:
        """Interval speeds [rev/s] of the train's shaft in a stretch."""
        pulses = self.pulses[label]
        return speed_from_pulses(
            pulses,
            self.tacho.pulses_per_rev,
            angles=self.angles if self.angles.ok else None,
            time_std_s=self._time_std_s(label),
        )

    @staticmethod
    def around(speed: IntervalSpeed, start_s: float, stop_s: float) -> IntervalSpeed:
        """Intervals of a stretch, with as many on either side as affect a spline within it."""
        first, last = np.searchsorted(speed.time_s, [start_s, stop_s])
        return speed.part(slice(max(first - SPLINE_REACH, 0), last + SPLINE_REACH))

    def score(self, speed: IntervalSpeed) -> float:
        """Number of good intervals; one per turn for unknown reflector angles."""
        good = float(np.count_nonzero(speed.flags == PulseFlag.GOOD))
        return good if self.angles.ok else good / self.tacho.pulses_per_rev

    def faults(self, label: str, speed: IntervalSpeed, start_s: float, stop_s: float) -> list[Fault]:
        """Faults of a stretch and their treatment."""
        gaps, faint = self.pulses[label].gaps_s, self.pulses[label].faint_s
        begins, ends = speed.time_s - 0.5 * speed.duration_s, speed.time_s + 0.5 * speed.duration_s

        def fault(kind: str, method: str, begins: Array, ends: Array) -> Fault:
            inside = (ends > start_s) & (begins < stop_s)
            times = np.clip(np.column_stack([begins, ends])[inside], start_s, stop_s) - self.channel.start_s
            spans = np.rint(times * self.channel.rate_hz).astype(np.int64)
            # Less than a sample at the end of a stretch is not a loss.
            return Fault(kind, self.channel.name, method, spans[spans[:, 1] > spans[:, 0]])

        extra = runs((speed.flags & PulseFlag.EXTRA) > 0)
        missed = runs((speed.flags & PulseFlag.MISSED) > 0)
        found = [
            fault("A", Sentence("second crossings removed"), begins[extra[:, 0]], ends[extra[:, 1] - 1]),
            fault(
                "B",
                Sentence("lost pulses inserted at equal spacing"),
                begins[missed[:, 0]],
                ends[missed[:, 1] - 1],
            ),
            fault(
                "B", Sentence("masked: no pulses to count"), *_silent(begins, ends, gaps, start_s, stop_s).T
            ),
            fault(
                "faint",
                Sentence(
                    "masked: lower than {height} and uneven, or none",
                    height=f"{self.pulses[label].limit:.3g}",
                ),
                *faint.T,
            ),
            fault("gap", Sentence("masked"), *self.pulses[label].missing_s.T),
        ]
        return [fault for fault in found if len(fault.spans)]


def _silent(begins: Array, ends: Array, gaps: Array, start_s: float, stop_s: float) -> Array:
    """Stretches [s] without usable intervals outside known gaps, shape (K, 2)."""
    from_s, to_s = np.append(start_s, ends), np.append(begins, stop_s)
    apart = to_s - from_s > 1e-3 * np.median(ends - begins) if len(ends) else np.array([True])
    silent = np.column_stack([from_s, to_s])[apart]
    missing = (gaps[:, 0] < silent[:, 1:]) & (gaps[:, 1] > silent[:, :1])
    return np.asarray(silent[~missing.any(axis=1)])
