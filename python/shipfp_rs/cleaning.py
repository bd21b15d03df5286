"""Recorded samples calibrated and freed of faults, with an account of every repair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.despike import Spans, bridge, find_spikes, runs
from shipfp_rs.errors import InputError
from shipfp_rs.low_pass import MARGIN_S
from shipfp_rs.rows import Rows
from shipfp_rs.trial import SetPoint, Spikes, Torque

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Repair:
    """What was wrong with a channel, where, and what was done.

    Parameters
    ----------
    kind
        Fault of Table 6.10: "A" double crossings (those that hysteresis let through), "B" lost pulses, "C" torque
        spikes, "D1" set-point jumps; or "gap" for missing samples.
    channel
        Name in the log.
    method
        What was done.
    spans
        First sample and first sample after on the channel's own index, shape (K, 2).
    """

    kind: str
    channel: str
    method: str
    spans: Spans

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "kind": self.kind,
            "channel": self.channel,
            "method": self.method,
            "count": len(self.spans),
            "spans": self.spans.tolist(),
        }


class Cleaner:
    """Calibrated samples of a channel with its spikes bridged or masked; remembers those of one stretch."""

    def __init__(
        self, rows: Rows, sensor: SetPoint | Torque, unit: str, spikes: Spikes, first: int, last: int
    ) -> None:
        self.rows = rows
        self.channel = rows.channel
        self.calibration = sensor.calibration.calibration(unit)
        self.spikes = spikes
        self.first, self.last = first, last
        self._spikes: list[Spans] = []
        self._gaps: list[Spans] = []

    def bridged(self, first: int, stop: int) -> Array:
        """Samples with spikes bridged; missing ones are an error, for they drive the model."""
        samples, missing = self._read(first, stop)
        inside = missing[max(self.first - first, 0) : max(self.last - first, 0)]
        if inside.any():
            at = (
                self.channel.start_s
                + (max(self.first, first) + int(np.argmax(inside))) / self.channel.rate_hz
            )
            raise InputError(
                f"{self.rows.log.name}: set point {self.channel.name!r} is NaN at {at:g} s; it drives the model, cut "
                "the window there"
            )
        return bridge(samples, missing | self._spiky(samples, missing, first))

    def masked(self, first: int, stop: int) -> Array:
        """Samples with spikes and missing ones NaN."""
        samples, missing = self._read(first, stop)
        return np.where(missing | self._spiky(samples, missing, first), np.nan, samples)

    def repairs(self, kind: str, method: str) -> list[Repair]:
        """What was found so far."""
        return [
            Repair(kind, self.channel.name, method, self._merged(self._spikes)),
            Repair("gap", self.channel.name, method, self._merged(self._gaps)),
        ]

    def _read(self, first: int, stop: int) -> tuple[Array, npt.NDArray[np.bool_]]:
        samples = self.calibration(self.rows.read(first, stop))
        missing = ~np.isfinite(samples)
        self._gaps.append(runs(missing) + first)
        return samples, missing

    def _spiky(self, samples: Array, missing: npt.NDArray[np.bool_], first: int) -> npt.NDArray[np.bool_]:
        """Mark the spikes of a piece that begins at sample `first` of the channel."""
        settings, rate = self.spikes, self.channel.rate_hz
        spiky = np.zeros(len(samples), dtype=np.bool_)
        filled = bridge(samples, missing)
        # A long bridge has no noise in it and would make its neighbours' noise look like spikes.
        absent = np.zeros(len(samples), dtype=np.bool_)
        gaps = runs(missing)
        for start, stop in gaps[gaps[:, 1] - gaps[:, 0] > settings.longest_s * rate]:
            absent[start:stop] = True
        for start, stop in runs(~absent):
            spans = start + find_spikes(
                filled[start:stop],
                rate,
                longest_s=settings.longest_s,
                threshold=settings.threshold,
                least=settings.least,
            )
            self._spikes.append(first + spans[self._judged(spans, first, len(samples))])
            for begin, end in spans:
                # One more on either side: the receiver's filter rounds a spike's feet.
                spiky[max(begin - 1, 0) : end + 1] = True
        return spiky

    def _judged(self, spans: Spans, first: int, size: int) -> npt.NDArray[np.bool_]:
        """Whether spans stand far enough inside a piece to be judged from both sides; pieces overlap by more."""
        border = round(0.5 * MARGIN_S * self.channel.rate_hz)
        low = 0 if first == 0 else border
        high = size if first + size == self.channel.samples else size - border
        return (spans[:, 0] >= low) & (spans[:, 1] <= high)

    def _merged(self, found: list[Spans]) -> Spans:
        """Spans within the stretch, each once though pieces overlap."""
        marked = np.zeros(self.last - self.first, dtype=np.bool_)
        for start, stop in np.clip(
            np.concatenate([np.empty((0, 2), dtype=np.int64), *found]), self.first, self.last
        ):
            marked[start - self.first : stop - self.first] = True
        return runs(marked) + self.first
