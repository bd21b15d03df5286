"""Calibration of recorded samples and treatment of their faults, with a record of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel_reader import Rows
from shipfp_rs.logs.faults.hum import hum_in
from shipfp_rs.logs.faults.levels import LevelLimits
from shipfp_rs.logs.faults.record import KINDS, Fault
from shipfp_rs.logs.faults.scan import scan
from shipfp_rs.logs.faults.spikes import spikes_between
from shipfp_rs.processing.low_pass import MARGIN_S
from shipfp_rs.processing.trial_channels import Command, Level, Load, Rack, SetPoint, Torque
from shipfp_rs.processing.trial_tables import Processing, Spikes
from shipfp_rs.support.arrays import Array, Mask
from shipfp_rs.support.calibration import Calibration
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.spans import Spans, clipped_to, joined, marks
from shipfp_rs.support.spikes import bridge

OF_A_LEVEL = {"stuck": "stuck_s", "dropout": "dropout_s", "clipped": "clipped_samples"}
"""Faults that a load's normal level may resemble, and their keys in [processing.faults]."""


def spike_rule(sensor: Level | None, processing: Processing) -> tuple[str, Spikes]:
    """Fault kind and spike limits of a channel; `sensor` is None for a channel without a role."""
    if isinstance(sensor, SetPoint | Command):
        return "D1", processing.set_point_jumps
    return "C" if isinstance(sensor, Torque) else "spike", processing.torque_spikes


@dataclass(frozen=True)
class Cleaned:
    """Calibrated channel on the grid of a stretch, its faults and its calibration."""

    samples: Array
    faults: list[Fault]
    calibration: Calibration


class Cleaner:
    """Calibrated samples of a channel in a stretch: inputs of the model are bridged, torque and rack masked where faulty."""

    def __init__(
        self,
        rows: Rows,
        sensor: Level,
        processing: Processing,
        first: int,
        last: int,
        *,
        may_rest: bool = False,
    ) -> None:
        settings = processing.faults
        is_set_point = isinstance(sensor, SetPoint | Command)
        self.drives = isinstance(sensor, SetPoint | Command | Load)
        self.what = (
            "load" if isinstance(sensor, Load) else "command" if isinstance(sensor, Command) else "set point"
        )
        self.rows = rows
        self.channel = rows.channel
        unit = (
            ""
            if isinstance(sensor, Command)
            else "rpm"
            if is_set_point
            else "mm"
            if isinstance(sensor, Rack)
            else "Nm"
        )
        if isinstance(sensor, Load) and sensor.quantity == "power":
            unit = "W"
        self.calibration = sensor.calibration.calibration(unit)
        self._spike, self.spikes = spike_rule(sensor, processing)
        self.first, self.last = first, last
        self.mains_hz = settings.mains_hz
        # The low-pass uses samples on either side of the stretch.
        reach = round(MARGIN_S * self.channel.rate_hz)
        begin, end = max(first - reach, 0), min(last + reach, self.channel.samples)
        found = scan(
            rows,
            begin,
            end,
            LevelLimits(
                stuck_s=settings.stuck_s,
                dropout_s=settings.dropout_s,
                clipped_samples=settings.clipped_samples,
                spike_s=self.spikes.longest_s,
            ),
            mains_hz=self.mains_hz if is_set_point else None,
            least_hum=settings.least_hum,
            repeats=is_set_point,
        )
        if isinstance(sensor, Load):
            # A load that is switched off stays at zero, and at its rating it stays at a limit: neither is a fault.
            found = {kind: spans for kind, spans in found.items() if kind not in OF_A_LEVEL}
        if is_set_point and self.channel.resolution:
            # A quantised set point has no noise, so it may be constant, and flat at its crest.
            found = {kind: spans for kind, spans in found.items() if kind not in ("stuck", "clipped")}
        # A channel that never changes may be correct. It is reported and kept, since nothing could repair it.
        whole = np.array([[begin, end]])
        self.still = np.array_equal(found.get("stuck", whole[:0]), whole)
        self._may_rest = may_rest
        self._hum = found.pop("D2", whole[:0])
        self._found = {kind: spans for kind, spans in found.items() if not (kind == "stuck" and self.still)}
        self._lost = joined(self._found.values())
        self._spikes: list[Spans] = []
        if self.drives:
            self._require_short(settings.longest_bridge_s)

    def __call__(self, first: int, stop: int) -> Array:
        """Samples [first, stop); missing ones are bridged or NaN."""
        samples = self.calibration(self.rows.read(first, stop))
        missing = ~np.isfinite(samples) | marks(self._lost, first, stop)
        if marks(self._hum, first, stop).any():
            samples = self._without_hum(samples, missing, first)
        spiky, found = self._spiky(samples, missing)
        self._spikes.append(first + found[self._judged(found, first, len(samples))])
        lost = missing | spiky
        return bridge(samples, lost) if self.drives else np.where(lost, np.nan, samples)

    def faults(self) -> list[Fault]:
        """Faults, complete after all samples of the stretch were read."""
        method = Sentence("bridged by straight lines") if self.drives else Sentence("masked")
        name = self.channel.name
        found = [Fault(self._spike, name, method, self._within(joined(self._spikes)))]
        found += [Fault(lost, name, method, self._within(spans)) for lost, spans in self._found.items()]
        found.append(
            Fault(
                "D2",
                name,
                Sentence("{frequency} Hz taken out", frequency=f"{self.mains_hz:g}"),
                self._within(self._hum),
                excluded=False,
            )
        )
        if self.still and not self._may_rest:
            whole = np.array([[self.first, self.last]])
            found.append(Fault("stuck", name, Sentence("kept: constant throughout"), whole, excluded=False))
        return [fault for fault in found if len(fault.spans)]

    def _within(self, spans: Spans) -> Spans:
        return clipped_to(spans, self.first, self.last)

    def _require_short(self, longest_s: float) -> None:
        """Raise `InputError` for an input of the model that is missing for too long to be bridged."""
        for kind, found in self._found.items():
            spans = self._within(found)
            long = spans[spans[:, 1] - spans[:, 0] > longest_s * self.channel.rate_hz]
            if len(long):
                start, stop = long[0].tolist()
                at, until = (self.channel.start_s + k / self.channel.rate_hz for k in (start, stop))
                sound = (
                    f"; if it is sound, raise processing.faults.{OF_A_LEVEL[kind]}"
                    if kind in OF_A_LEVEL
                    else ""
                )
                raise InputError(
                    f"{self.rows.log.name}: {self.what} {self.channel.name!r} has a fault, {KINDS[kind]}, from {at:g} "
                    f"to {until:g} s (samples {start} to {stop - 1}); it drives the model and no more than "
                    f"{longest_s:g} s are bridged (processing.faults.longest_bridge_s), cut the window there{sound}"
                )

    def _without_hum(self, samples: Array, missing: Mask, first: int) -> Array:
        """Remove hum from a piece; spikes are bridged first, since each would affect a whole filter length."""
        filled = bridge(samples, missing | self._spiky(samples, missing)[0])
        return samples - hum_in(filled, first, self._hum, self.channel.rate_hz, self.mains_hz)

    def _spiky(self, samples: Array, missing: Mask) -> tuple[Mask, Spans]:
        """Mask of the spikes in a piece, shape (N,), and their spans."""
        spiky = np.zeros(len(samples), dtype=np.bool_)
        found = spikes_between(samples, missing, self.channel.rate_hz, self.spikes, steps=self._spike == "D1")
        for begin, end in found:
            # One sample more on either side: the receiver's filter widens the foot of a spike.
            spiky[max(begin - 1, 0) : end + 1] = True
        return spiky, found

    def _judged(self, spans: Spans, first: int, size: int) -> Mask:
        """Whether spans are far enough inside a piece for both sides to be visible; pieces overlap by more."""
        border = round(0.5 * MARGIN_S * self.channel.rate_hz)
        low = 0 if first == 0 else border
        high = size if first + size == self.channel.samples else size - border
        return (spans[:, 0] >= low) & (spans[:, 1] <= high)
