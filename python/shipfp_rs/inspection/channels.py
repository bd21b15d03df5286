"""Contents of a log's channels (gaps, levels, noise, pulses); each channel is read once, in parallel."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from shipfp_rs._core import pulse_levels
from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.faults.record import KINDS
from shipfp_rs.logs.log import Log, Rows
from shipfp_rs.processing.roles import named
from shipfp_rs.processing.trial import Trial
from shipfp_rs.support.arrays import Array, Spans, joined, runs
from shipfp_rs.support.spikes import ROBUST_SIGMA
from shipfp_rs.support.threads import side_by_side
from shipfp_rs.tacho import PulseTimes, pulse_times

OF_ANY = ("gap", "dropout", "stuck", "clipped", "repeated", "spike")
"""Faults of level and spikes, which are searched in all channels except pulse trains."""
OF_A_TRAIN = ("gap",)
SPIKES: Mapping[str, str] = {"set_point": "D1", "torque": "C"}
"""Fault kind of a spike, by the role of its channel."""
OF_ROLES: Mapping[str, tuple[str, ...]] = {
    "set_point": ("D2", "D3"),
    "torque": ("sign",),
    "train": ("A", "B", "faint"),
}
"""Faults that only channels of certain roles can have; a trial assigns the roles."""


def looked_for(reports: Sequence[ChannelReport], trial: Trial | None) -> dict[str, Any]:
    """JSON form: the fault kinds searched in each channel ("channels"), and those searched in no channel ("left_out")."""
    found = {
        report.channel.name: [*(OF_ANY if report.pulses_hz is None else OF_A_TRAIN)]
        for report in reports
        if report.channel.samples
    }
    if trial is not None:
        roles = {trial.channels.driver.column: "set_point"}
        if trial.channels.torque is not None:
            roles[trial.channels.torque.column] = "torque"
        roles |= {tacho.column: "train" for tacho in trial.channels.tachos.values() if tacho.kind == "pulses"}
        for name, role in roles.items():
            if name in found:
                kinds = [SPIKES.get(role, kind) if kind == "spike" else kind for kind in found[name]]
                found[name] = [*kinds, *OF_ROLES[role]]
    told = {kind for kinds in found.values() for kind in kinds}
    left_out = [kind for kinds in OF_ROLES.values() for kind in kinds if kind not in told]
    return {"channels": found, "left_out": left_out}


def sentences(told: Mapping[str, Any], *, trial: bool) -> list[str]:
    """Sentences that list the searched faults; channels with the same faults share a sentence."""
    together: dict[tuple[str, ...], list[str]] = {}
    for name, kinds in told["channels"].items():
        together.setdefault(tuple(kinds), []).append(name)
    lines = [
        f"Looked for {', '.join(KINDS[kind] for kind in kinds)} in {', '.join(names)}."
        for kinds, names in together.items()
    ]
    if told["left_out"] and not trial:
        kinds = ", ".join(KINDS[kind] for kind in told["left_out"])
        lines.append(
            f"Not looked for: {kinds}; "
            "a log does not tell which channel is what, its trial does (shipfp inspect LOG TRIAL.toml)"
        )
    return lines


PROBE_S = 120.0
"""Length of the stretch from which a channel is classified [s]."""
LEAST_PULSES = 10
NEAR_A_LEVEL = 0.15
"""A sample is at one of the two levels if it is closer to it than this fraction of the train's height."""
AT_LEVELS = 0.75
"""Least fraction of samples near one of the levels in a train with two levels; for a sine it is one half."""
EVEN = 0.3
"""Largest relative difference of an even period from the median of nine. Periods of teeth and reflectors differ by
less, those of steps of a set point or a torque by more.
"""
EVEN_SHARE = 0.6
SLOWEST_HZ = 0.2
"""Pulse rate [Hz] below which a channel does not count as a pulse train."""
SINE_EVEN_SHARE = 0.9
SWINGING_SLOWEST_HZ = 5.0
"""Lowest pulse rate of a pick-up whose signal swings about zero [Hz], such as a variable-reluctance one, which needs
motion. Slower oscillations are set points, test signals or waves. The train of a switch has a level near zero and may
have any rate.
"""
SINE_SCATTER = 0.15
"""Largest scatter of the heights of neighbouring pulses; the ripple of a torque has several orders and scatters more."""
OFFSET = 1.0
"""Largest offset of a train's mid-level from zero, relative to the pulse height. The ripple of a torque, and steps of
a speed or voltage about its level, have a larger offset.
"""
SINE_DRIFT = 1.5
"""Largest interquartile range of a pick-up's mid-level, relative to the pulse height."""
MAINS_HZ = (50.0, 60.0)
MAINS_WITHIN, MAINS_STEADY = 5e-3, 1e-3
"""Largest relative deviation of mains hum from the mains frequency, and its largest relative scatter; no shaft is as
steady.
"""


def pulse_rate(rows: Rows) -> float | None:
    """Pulses per second of a pulse train over its first two minutes; None for other channels."""
    channel = rows.channel
    probe = rows.read(0, min(round(PROBE_S * channel.rate_hz), channel.samples)).astype(np.float64)
    known = np.isfinite(probe)
    if np.count_nonzero(known) < LEAST_PULSES:
        return None
    try:
        pulses = pulse_times(probe, channel.rate_hz)
    except InputError:
        return None
    if len(pulses.times_s) < LEAST_PULSES:
        return None
    seconds = np.count_nonzero(known) / channel.rate_hz
    rate_hz = len(pulses.times_s) / seconds
    even = _even_share(pulses)
    if rate_hz < SLOWEST_HZ or even < EVEN_SHARE:
        return None
    if _has_two_levels(probe[known], pulses) or (even >= SINE_EVEN_SHARE and _is_sinusoidal(probe, pulses)):
        return float(rate_hz)
    return None


def _even_share(pulses: PulseTimes) -> float:
    periods = np.diff(pulses.times_s)
    usual = median_filter(periods, size=9, mode="nearest")
    # Differences of up to about one sample are allowed.
    return float(np.mean(np.abs(periods - usual) < np.maximum(EVEN * usual, 1.2 / pulses.rate_hz)))


def _is_fast(pulses: PulseTimes) -> bool:
    return bool(np.median(np.diff(pulses.times_s)) * SWINGING_SLOWEST_HZ <= 1.0)


def _has_two_levels(samples: Array, pulses: PulseTimes) -> bool:
    bottom, top = pulse_levels(samples)
    if min(top, -bottom) > NEAR_A_LEVEL * (top - bottom) and not _is_fast(pulses):
        return False
    near = np.minimum(np.abs(samples - bottom), np.abs(samples - top)) < NEAR_A_LEVEL * (top - bottom)
    return bool(near.mean() >= AT_LEVELS and abs(top + bottom) < 2.0 * OFFSET * (top - bottom))


def _is_sinusoidal(probe: Array, pulses: PulseTimes) -> bool:
    """Whether pulses have similar heights and are centred on zero, at a rate other than that of the mains."""
    times = pulses.times_s
    periods = np.diff(times)
    if not _is_fast(pulses):
        return False
    places = np.ceil(times * pulses.rate_hz).astype(np.int64)
    filled = np.where(np.isfinite(probe), probe, pulses.middle)
    # The last pulse is incomplete.
    top, bottom = (extreme.reduceat(filled, places)[:-1] for extreme in (np.maximum, np.minimum))
    single = periods < 1.5 * median_filter(periods, size=9, mode="nearest")
    height, middle = (top - bottom)[single], 0.5 * (top + bottom)[single]
    if len(height) < LEAST_PULSES:
        return False
    usual = median_filter(height, size=9, mode="nearest")
    level = float(np.median(usual))
    quarter, half, three = np.quantile(middle, [0.25, 0.5, 0.75])
    if not (
        np.median(np.abs(height - usual) / usual) < SINE_SCATTER / 1.4826
        and abs(half) < OFFSET * level
        and three - quarter < SINE_DRIFT * level
    ):
        return False
    seconds = np.bincount(times.astype(np.int64))[1:-1]
    rate_hz = 1.0 / float(np.mean(periods[single]))
    steady = len(seconds) < 2 or np.std(seconds) < max(1.0, MAINS_STEADY * rate_hz)
    return not (steady and any(abs(rate_hz / mains - 1.0) < MAINS_WITHIN for mains in MAINS_HZ))


@dataclass(frozen=True)
class ChannelReport:
    """Contents of one channel; gaps are spans (K, 2), a train's noise is NaN, `pulses_hz` is None for other channels."""

    channel: Channel
    gaps: Spans
    low: float
    high: float
    noise: float
    pulses_hz: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form; gaps are in seconds on the log's clock."""
        channel = self.channel
        times = channel.start_s + self.gaps / channel.rate_hz
        return {
            "name": channel.name,
            "unit": channel.unit,
            "rate_hz": channel.rate_hz,
            "samples": channel.samples,
            "start": channel.start_s,
            "gaps": times.tolist(),
            "low": _or_none(self.low),
            "high": _or_none(self.high),
            "noise": _or_none(self.noise),
            "pulses_hz": self.pulses_hz,
        }


def describe(log: Log) -> list[ChannelReport]:
    """Read every channel once and report its contents."""
    stopped = threading.Event()
    return side_by_side([partial(_described, log, name, stopped) for name in log.channels], stopped)


def _described(log: Log, name: str, stopped: threading.Event) -> ChannelReport:
    rows = Rows(log, name, stopped=stopped)
    channel = rows.channel
    gaps, noises = [], []
    low, high, at = np.inf, -np.inf, 0
    for chunk in rows.pieces(0, channel.samples):
        known = np.isfinite(chunk)
        gaps.append(runs(~known) + at)
        at += len(chunk)
        present = chunk if known.all() else chunk[known]
        if len(present):
            low, high = min(low, float(present.min())), max(high, float(present.max()))
            noises.append(_noise(present[: 1 << 17].astype(np.float64)))
    given = named(channel)
    # The ripple of a torque, with spikes of equal height, looks like a train; a unit of speed or power excludes a train.
    other = "torque" in given.tells and "pulses" not in given.tells
    other |= not given.is_open and given.quantity not in (None, "other")
    pulses = None if other else pulse_rate(rows)
    return ChannelReport(
        channel,
        joined(gaps),
        low if np.isfinite(low) else math.nan,
        high if np.isfinite(high) else math.nan,
        float(np.median(noises)) if noises and pulses is None else math.nan,
        pulses,
    )


def _noise(samples: Array) -> float:
    if len(samples) < 3:
        return math.nan
    return float(ROBUST_SIGMA * np.median(np.abs(np.diff(samples, 2))) / math.sqrt(6.0))


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None
