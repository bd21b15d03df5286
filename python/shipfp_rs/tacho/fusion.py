"""Fusion of several pulse trains of one shaft line into one speed and its variance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.tacho.fused_angle import FusedAngle, TrainReport
from shipfp_rs.tacho.passages import Train, passages_of
from shipfp_rs.tacho.tracks import require_positive

_PULSES_PER_HZ, _LEAST_PULSES_PER_HZ = 6.0, 4.5
"""Pulses per second needed per Hz of bandwidth, usually and at least: 2 and 1.5 per spline coefficient."""


@dataclass(frozen=True)
class FusedSpeed:
    """Speed fused from several trains.

    Parameters
    ----------
    time_s
        Uniform grid [s], shape (N,).
    speed_rps, std_rps
        Speed and its standard deviation [rev/s], shape (N,); NaN where no train determines it.
    bandwidth_hz
        Frequency up to which the speed follows the shaft, with a gain of 1 within 0.2 % and no delay [Hz].
    trains
        Report on each train, by name.
    """

    time_s: Array
    speed_rps: Array
    std_rps: Array
    bandwidth_hz: float
    trains: dict[str, TrainReport]


@checked
def fuse(
    trains: Sequence[Train],
    rate_hz: float,
    start_s: float,
    stop_s: float,
    *,
    bandwidth_hz: float | None = None,
) -> FusedSpeed:
    """Fuse several pulse trains into one speed on a uniform grid from `start_s` up to, not including, `stop_s`.

    Every pulse is a measurement of the angle of its shaft. A spline is fitted to the angles of all trains; its slope is the
    speed. Each angle is weighted by its inverse variance, and each unbroken stretch has its own offset. Unlike speeds
    between pulses, angles are not averaged over an interval: there is no boxcar gain or delay to correct, and the errors of
    successive pulses are independent.

    Parameters
    ----------
    trains
        One train or more, at least one with a known ratio.
    rate_hz
        Rate of the grid [Hz].
    start_s, stop_s
        Ends of the grid [s].
    bandwidth_hz
        Highest frequency to follow [Hz]; noise grows with its power 3/2. None: a sixth of all pulses per second.

    Raises
    ------
    InputError
        If the trains have too few pulses for the bandwidth, or the standard deviation of their timing is unknown.

    Examples
    --------
    >>> from shipfp_rs.tacho import speed_from_pulses
    >>> four = speed_from_pulses(np.arange(400) / 20.0, 4, time_std_s=1e-4)
    >>> engine = speed_from_pulses(np.arange(300) / 15.0, 1, time_std_s=1e-4)
    >>> fused = fuse([Train("PTM_4", four), Train("PTM_e", engine, ratio=3.0)], 10.0, 2.0, 18.0)
    >>> round(float(fused.speed_rps[0]), 6), fused.trains["PTM_e"].agrees
    (5.0, True)
    """
    require_positive("rate_hz", rate_hz)
    count = round((stop_s - start_s) * rate_hz)
    if not count > 0:
        raise InputError(f"stop_s: found {stop_s} with start_s = {start_s}, expected later")
    fit, band = fused_angle(trains, bandwidth_hz)
    grid = start_s + np.arange(count) / rate_hz
    speed, std = fit.at(grid)
    return FusedSpeed(grid, speed, std, band, {name: fit.report(name) for name in fit.passages})


def fused_angle(trains: Sequence[Train], bandwidth_hz: float | None = None) -> tuple[FusedAngle, float]:
    """Angle fitted to the pulses of several trains, and its bandwidth [Hz]; see `fuse`."""
    if len(trains) == 0 or len({train.name for train in trains}) < len(trains):
        raise InputError(
            f"trains: found {[train.name for train in trains]}, expected one or more of different names"
        )
    if all(train.ratio is None for train in trains):
        raise InputError("trains: no ratio is known, expected that of one train at least")
    passages = {train.name: passages_of(train) for train in trains}
    pulses_per_s = sum(1.0 / np.median(np.diff(p.time_s)) for p in passages.values())
    band = pulses_per_s / _PULSES_PER_HZ if bandwidth_hz is None else bandwidth_hz
    require_positive("bandwidth_hz", band)
    if band > pulses_per_s / _LEAST_PULSES_PER_HZ:
        raise InputError(
            f"bandwidth_hz: found {band:g} with {pulses_per_s:.3g} pulses a second in all trains, expected at most "
            f"{pulses_per_s / _LEAST_PULSES_PER_HZ:.3g}"
        )
    ratios = {train.name: (train.ratio, 0.0) for train in trains if train.ratio is not None}
    known = {name: (ratio, std) for name, (ratio, std) in ratios.items() if ratio is not None}
    if len(known) < len(trains):
        fit = FusedAngle(passages, known, band)
        known |= {t.name: fit.ratio(passages[t.name]) for t in trains if t.ratio is None}
    fit = FusedAngle(passages, known, band)
    slips = {name: fit.slips(name) for name in passages}
    if any(len(places) for places in slips.values()):
        passages = {name: own.cut(slips[name]) for name, own in passages.items()}
        fit = FusedAngle(passages, known, band)
    return fit, float(band)
