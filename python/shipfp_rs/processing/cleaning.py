"""Recorded samples calibrated and freed of faults, with an account of every one."""

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
"""Faults that a load's own level looks like, and the keys of [processing.faults] that say what counts as one."""


def spike_rule(sensor: Level | None, processing: Processing) -> tuple[str, Spikes]:
    """Return the kind of fault that a spike of a channel is, and what counts as one; None: a channel without a role."""
    if isinstance(sensor, SetPoint | Command):
        return "D1", processing.set_point_jumps
    return "C" if isinstance(sensor, Torque) else "spike", processing.torque_spikes


@dataclass(frozen=True)
class Cleaned:
    """A calibrated channel on the grid of a stretch, what was wrong with it, and its calibration."""

    samples: Array
    faults: list[Fault]
    calibration: Calibration


class Cleaner:
    """Calibrated samples of a channel with its faults bridged or masked; remembers those of one stretch.

    Parameters
    ----------
    rows
        The channel.
    sensor
        Its calibration. Set point and load drive the model and are bridged; torque and rack are masked.
    processing
        What counts as a fault.
    first, last
        First sample of the stretch and first one after.
    may_rest
        Whether the channel may stand still throughout, as a set point does while the load moves.

    Raises
    ------
    InputError
        Where the set point, or the load, is missing for longer than may be bridged.
    """

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
        # The low-pass reaches beyond the stretch on either side.
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
            # What is asked for in whole bits has no noise: it may stand, and turn at its crest.
            found = {kind: spans for kind, spans in found.items() if kind not in ("stuck", "clipped")}
        # A channel that never changes may be right. It is reported and left as it is: nothing is there to repair it from.
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
        """Return samples [first, stop); lost ones are bridged or NaN."""
        samples = self.calibration(self.rows.read(first, stop))
        missing = ~np.isfinite(samples) | marks(self._lost, first, stop)
        if marks(self._hum, first, stop).any():
            samples = self._without_hum(samples, missing, first)
        spiky, found = self._spiky(samples, missing)
        self._spikes.append(first + found[self._judged(found, first, len(samples))])
        lost = missing | spiky
        return bridge(samples, lost) if self.drives else np.where(lost, np.nan, samples)

    def faults(self) -> list[Fault]:
        """Return what was found, after all samples of the stretch were asked for."""
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
        """Refuse a channel that drives the model but is missing for too long to be bridged."""
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
        """Remove the hum from a piece; spikes are bridged before, since each would disturb it over the filter's length."""
        filled = bridge(samples, missing | self._spiky(samples, missing)[0])
        return samples - hum_in(filled, first, self._hum, self.channel.rate_hz, self.mains_hz)

    def _spiky(self, samples: Array, missing: Mask) -> tuple[Mask, Spans]:
        """Mark the spikes of a piece, shape (N,), and tell where they begin and end in it."""
        spiky = np.zeros(len(samples), dtype=np.bool_)
        found = spikes_between(samples, missing, self.channel.rate_hz, self.spikes, steps=self._spike == "D1")
        for begin, end in found:
            # One sample more on either side: the receiver's filter widens a spike's foot.
            spiky[max(begin - 1, 0) : end + 1] = True
        return spiky, found

    def _judged(self, spans: Spans, first: int, size: int) -> Mask:
        """Whether spans lie so far inside a piece that both sides of them are seen; pieces overlap by more."""
        border = round(0.5 * MARGIN_S * self.channel.rate_hz)
        low = 0 if first == 0 else border
        high = size if first + size == self.channel.samples else size - border
        return (spans[:, 0] >= low) & (spans[:, 1] <= high)
