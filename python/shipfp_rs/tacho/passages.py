"""Passages of a pulse train: times of its true pulses, and the shaft angle at each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arrays import Array
from shipfp_rs.tacho.speed import IntervalSpeed, unbroken
from shipfp_rs.tacho.tracks import PulseFlag, require_positive


@dataclass(frozen=True)
class Train:
    """Pulse train of one shaft.

    Parameters
    ----------
    name
        Label.
    speed
        Interval speeds of the train's shaft, with standard deviations (`speed_from_pulses(..., time_std_s=...)`).
    ratio
        Turns of the train's shaft per turn of the shaft whose speed is wanted: 1 on that shaft, the gear ratio on the
        engine's; None: estimated.
    """

    name: str
    speed: IntervalSpeed
    ratio: float | None = 1.0


@dataclass(frozen=True)
class Passages:
    """True pulses of a train: times, turns of its own shaft, their standard deviations, stretch of each."""

    time_s: Array
    turned: Array
    std: Array
    stretch: npt.NDArray[np.intp]
    pitch: float
    """Angle between pulses [rev]."""
    slips_s: Array

    def cut(self, places: npt.NDArray[np.intp]) -> Passages:
        """Passages with a new stretch at each of the given indices, where the count slipped."""
        later = np.zeros(len(self.time_s), dtype=np.intp)
        later[places] = 1
        return replace(
            self,
            stretch=self.stretch + np.cumsum(later),
            slips_s=np.sort(np.append(self.slips_s, self.time_s[places])),
        )


def passages_of(train: Train) -> Passages:
    """Recorded pulses of a train, without those inserted for missed ones."""
    speed = train.speed
    if not (speed.std_rps > 0.0).all():
        raise InputError(
            f"train {train.name!r}: its speeds have no standard deviation; give speed_from_pulses time_std_s"
        )
    if train.ratio is not None:
        require_positive(f"train {train.name!r}, ratio", train.ratio)
    ends_std_rps = speed.std_rps if speed.ends_std_rps is None else speed.ends_std_rps
    columns: list[tuple[Array, Array, Array, npt.NDArray[np.intp]]] = []
    for k, (stretch, edges, turned) in enumerate(unbroken(speed)):
        put_in = (speed.flags[stretch] & PulseFlag.MISSED) > 0
        true = ~np.concatenate([[False], put_in[1:] & put_in[:-1], [False]])
        # The variance of an interval is the sum of those of its two ends.
        variance = 0.5 * (ends_std_rps * speed.duration_s)[stretch] ** 2
        std = np.sqrt(0.5 * (np.append(variance, variance[-1]) + np.append(variance[0], variance)))
        columns.append((edges[true], turned[true], std[true], np.full(np.count_nonzero(true), k)))
    if not columns or sum(len(column[0]) for column in columns) < 8:
        raise InputError(f"train {train.name!r}: too few pulses, expected 8 or more")
    time, angle, deviation, stretches = (np.concatenate(column) for column in zip(*columns, strict=True))
    return Passages(time, angle, deviation, stretches, 1.0 / speed.pulses_per_rev, np.empty(0))
