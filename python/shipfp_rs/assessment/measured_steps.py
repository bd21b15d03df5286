"""Measured load steps: speed deviation and recovery time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.support.arrays import Array

LEAST_STEP = 0.05
"""Least change of the load within `AROUND_S` that counts as a step, relative to the operating torque."""
AROUND_S, BEFORE_S, APART_S = 0.5, 1.0, 3.0
"""Half the longest duration of a step, length of the stretches before and after it whose means are its levels, and least
time between two steps [s].
"""
STILL = 2e-3
"""Largest motion of a set point that counts as constant, relative to the operating speed."""
STEADY = 0.15
"""Largest standard deviation of the load before and after a step, relative to the step; above it is an oscillation."""
BAND_PCT = 2.0
"""Band about the speed before the step within which it has recovered, of classes G2 and G3 of ISO 8528-5 [%]."""


@dataclass(frozen=True)
class MeasuredStep:
    """Load step: time [s], size relative to the operating torque [%], largest speed deviation [%], recovery time [s].

    The speed falls if the load rises, and rises if it falls; `recovery_s` is None if the speed does not recover before the
    next step or the end of the record.
    """

    at_s: float
    step_pct: float
    deviation_pct: float
    recovery_s: float | None


def measured_steps(experiment: Experiment) -> list[MeasuredStep]:
    """Load steps of an experiment with a measured load, during which the set point is constant.

    Examples
    --------
    >>> measured_steps(experiment)[0].deviation_pct  # doctest: +SKIP
    4.2
    """
    if not {"M_load", "n_e"} <= set(experiment.signals):
        return []
    rate_hz = experiment.rate_hz
    load, speed = (_bridged(experiment.normalised(name)) for name in ("M_load", "n_e"))
    asked = experiment.dn_set if "n_set" in experiment.signals else np.zeros(len(load))
    around, before = round(AROUND_S * rate_hz), round(BEFORE_S * rate_hz)
    places = _places(load, around, round(APART_S * rate_hz))
    found = []
    ends = [*places[1:], len(load) + around][: len(places)]
    for place, following in zip(places, ends, strict=True):
        level = slice(place - around - before, place - around)
        after = slice(place + around, min(place + around + before, following - around))
        if level.start < 0 or after.stop - after.start < before // 2:
            continue
        moved = np.abs(asked[level.start : following - around] - asked[level].mean()) > STILL
        end = level.start + int(np.argmax(moved)) if moved.any() else following - around
        if end < after.stop:
            continue
        step = float(load[after].mean() - load[level].mean())
        if max(load[level].std(), load[after].std()) > STEADY * abs(step):
            continue
        off = 100.0 * (speed[place - around : end] - speed[level].mean())
        outside = np.flatnonzero(np.abs(off) > BAND_PCT)
        # From the start of the step, which is near the middle of the searched stretch.
        last = (outside[-1] + 1 - around) / rate_hz if len(outside) else 0.0
        back = not len(outside) or outside[-1] + 1 < len(off)
        deviation = float((-np.sign(step) * off).max())
        found.append(
            MeasuredStep(place / rate_hz, 100.0 * step, deviation, float(max(last, 0.0)) if back else None)
        )
    return found


def _bridged(row: Array) -> Array:
    """Signal with masked samples interpolated linearly."""
    kept = np.flatnonzero(np.isfinite(row))
    return np.interp(np.arange(len(row)), kept, row[kept]) if len(kept) else np.zeros(len(row))


def _places(load: Array, around: int, apart: int) -> list[int]:
    """Indices at which a load changes most, one per step."""
    change = np.zeros(len(load))
    change[around : len(load) - around] = np.abs(load[2 * around :] - load[: -2 * around])
    places: list[int] = []
    while (largest := float(change.max(initial=0.0))) > LEAST_STEP:
        # The middle of the range of largest change is the step.
        first = int(np.argmax(change))
        begin = max(first - 2 * around, 0)
        near = np.flatnonzero(change[begin : first + 2 * around + 1] > 0.5 * largest)
        place = begin + int(near.mean())
        places.append(place)
        change[max(place - apart, 0) : place + apart] = 0.0
    return sorted(places)
