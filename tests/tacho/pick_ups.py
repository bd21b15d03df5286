"""Pick-ups whose amplitude goes with speed or fades, whose offset drifts or whose wheel lacks a tooth, and what is true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shipfp_rs import tacho

Array = npt.NDArray[np.float64]

TEETH = 6
RATED_RPS = 20.0
NOISE = 0.01
"""Standard deviation, of an amplitude of 1 at rated speed."""
KINDS = ("run-up", "from rest", "fading", "drift", "missing tooth", "run-up, missing tooth")


@dataclass(frozen=True)
class Record:
    """Samples of a pick-up with their times [s], and of each true pulse its time, height, and slope [1/s]."""

    rate_hz: float
    samples: Array
    pulse_s: Array
    height: Array
    slope: Array
    pulses: npt.NDArray[np.int64]


def record(kind: str, rate_hz: float, seed: int, duration_s: float = 60.0, noise: float = NOISE) -> Record:
    """Simulate a sinusoidal pick-up of six teeth; a missing tooth leaves the middle level for a whole pulse."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration_s * rate_hz)) / rate_hz
    way = time / duration_s
    if kind.startswith("run-up"):
        share = np.interp(way, [0.15, 0.8], [0.25, 1.0])
    elif kind == "from rest":
        share = np.interp(way, [0.0, 0.2, 0.8], [0.0, 0.02, 1.0])
    else:
        share = np.full(len(time), 0.7)
    amplitude = np.ones(len(time))
    if kind.startswith("run-up") or kind == "from rest":
        amplitude = share
    elif kind == "fading":
        amplitude = np.interp(way, [0.2, 0.5, 0.6, 0.9], [1.0, 0.0, 0.0, 1.0])
    swing = 1.0 + 0.003 * np.sin(2 * np.pi * 0.7 * time + rng.uniform(0.0, 6.3))
    speed = RATED_RPS * share * swing
    turned = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]))) / rate_hz + rng.uniform()
    phase = TEETH * turned
    wave = np.sin(2.0 * np.pi * phase)
    missing = 12 if "missing" in kind else 0
    pulses = np.arange(np.ceil(phase[0]), np.floor(phase[-1]) + 1.0)
    if missing:
        wave = np.where(np.round(phase) % missing == 0, 0.0, wave)
        pulses = pulses[pulses % missing != 0]
    offset = 1.5 * np.sin(2 * np.pi * way) + 0.5 * np.sin(2 * np.pi * time / 7.0) if kind == "drift" else 0.0
    at = np.interp(pulses, phase, time)
    return Record(
        rate_hz,
        (amplitude * wave + offset + noise * rng.standard_normal(len(time))).astype(np.float32),
        at,
        2.0 * np.interp(at, time, amplitude),
        2.0 * np.pi * TEETH * np.interp(at, time, speed * amplitude),
        pulses.astype(np.int64),
    )


@dataclass(frozen=True)
class Outcome:
    """What became of the pulses of a record, and the errors of speed over the sampling limit and over those stated."""

    lost: int
    """Above the detection limit and not counted."""
    invented: int
    """Crossings that are no pulse, and second ones of a pulse."""
    untold: int
    """Neither counted nor in a gap."""
    gap_s: float
    over_limit: float
    over_stated: float
    counted: int


def _nearest(places: Array, values: Array) -> npt.NDArray[np.intp]:
    found = np.clip(np.searchsorted(places, values), 1, len(places) - 1)
    return found - (np.abs(places[found] - values) > np.abs(places[found - 1] - values))


def outcome(truth: Record, noise: float = NOISE) -> Outcome:
    """Find the pulses of a record and compare."""
    found = tacho.pulse_times(truth.samples, truth.rate_hz)
    true = truth.pulse_s
    period = np.gradient(true)
    place = _nearest(true, found.times_s)
    error = found.times_s - true[place]
    strange = np.abs(error) > 0.3 * period[place]
    counted = np.zeros(len(true), dtype=np.bool_)
    counted[place[~strange]] = True
    in_gap = np.zeros(len(true), dtype=np.bool_)
    for start, stop in found.gaps_s:
        in_gap |= (true >= start - 1e-9) & (true <= stop + 1e-9)
    # Half a pulse at either end of the record may not be armed, or not get high.
    whole = (np.arange(len(true)) > 0) & (np.arange(len(true)) < len(true) - 1)
    speed = tacho.speed_from_pulses(found, 1)
    single = speed.flags == tacho.PulseFlag.GOOD
    begins, ends = speed.time_s - 0.5 * speed.duration_s, speed.time_s + 0.5 * speed.duration_s
    first, last = (_nearest(true, edge[single]) for edge in (begins, ends))
    truly = (truth.pulses[last] - truth.pulses[first]) / (true[last] - true[first])
    wrong = speed.speed_rps[single] - truly
    # A straight line between two samples has two thirds of their variance on average.
    timing = np.sqrt(2.0 / 3.0) * noise * np.hypot(1.0 / truth.slope[first], 1.0 / truth.slope[last])
    return Outcome(
        int(np.count_nonzero(~counted & (truth.height > found.limit) & whole)),
        int(np.count_nonzero(strange) + len(place) - len(np.unique(place))),
        int(np.count_nonzero(~counted & ~in_gap & whole)),
        float(np.sum(np.diff(found.gaps_s))),
        float(np.sqrt(np.mean((wrong / (timing * truly**2)) ** 2))),
        float(np.sqrt(np.mean((wrong / speed.std_rps[single]) ** 2))),
        int(np.count_nonzero(counted)),
    )
