"""Calibration of recorded samples, treatment of their faults, and rejection of implausible units and signals."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.faults.levels import LevelLimits, hum_in
from shipfp_rs.logs.faults.record import KINDS, Fault
from shipfp_rs.logs.faults.scan import scan
from shipfp_rs.logs.faults.spikes import spikes_between
from shipfp_rs.logs.log import Log, Rows
from shipfp_rs.processing.conditioning import MARGIN_S
from shipfp_rs.processing.roles import named
from shipfp_rs.processing.trial import Processing, Spikes
from shipfp_rs.processing.trial_channels import Channels, Command, Level, Load, Rack, SetPoint, Tacho, Torque
from shipfp_rs.support import hints
from shipfp_rs.support.arrays import Array, Mask, Spans, clipped_to, joined, marks
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.spikes import bridge
from shipfp_rs.support.units import FREQUENCIES, QUANTITIES, Calibration, told
from shipfp_rs.vessel.vessel import Vessel

CALIBRATED_WITHIN = 0.1
"""With a correct calibration, the means of set point and speed differ by at most this fraction."""
CHECK = "; check unit and calibration"
LEAST_TORQUE, MOST_TORQUE = 0.002, 2.0
"""Range of a plausible mean torque, relative to the rated torque."""


def require_size(
    label: str,
    key: str,
    sensor: Torque | Load | Tacho,
    samples: Array,
    calibration: Calibration | None = None,
) -> None:
    """Reject an implausible mean of a channel with the table `key` in TRIAL.toml, or warn of an unusual one."""
    known = QUANTITIES["speed" if isinstance(sensor, Tacho) else getattr(sensor, "quantity", "torque")]
    size = abs(float(np.nanmean(samples))) if np.isfinite(samples).any() else 0.0
    found = f"channels.{key}: {size:.4g} {known.unit} on average in {label}"
    least, most = known.usual
    if size == 0.0 or least <= size <= most:
        return
    factor = known.factors.get(told(sensor.unit), 0.0)
    # The calibration is rejected if only the factor of the unit gives a usual mean.
    alone = 0.0 if calibration is None else factor * abs(float(np.nanmean(calibration.inverse(samples))))
    if least <= alone <= most:
        raise InputError(
            f"{found}, where its unit {sensor.unit!r} alone makes {alone:.4g} {known.unit}; leave "
            f"channels.{key}.calibration out, or let it lead from {sensor.unit} to {known.unit}"
        )
    if isinstance(sensor, Load) and size < least:
        return  # the load may be switched off
    least, most = known.possible
    if not least <= size <= most:
        raise InputError(
            f"{found}, where no drive train has more than {most:g} or less than {least:g}{CHECK}"
        )
    # The text does not name the stretch: equal warnings for all windows of a trial are shown once.
    warnings.warn(
        f"channels.{key}: a mean of {size:.2g} {known.unit} is unusual for a drive train{CHECK}",
        LogWarning,
        stacklevel=2,
    )


def require_columns(log: Log, channels: Channels) -> None:
    """Reject a table whose column is not in the log; the error names the table's key."""
    tables = {key: getattr(channels, key) for key in type(channels).model_fields}
    columns = {f"{key}.column": table.column for key, table in tables.items() if table is not None}
    for name, tacho in (channels.__pydantic_extra__ or {}).items():
        if tacho.kind != "edges":
            columns[f"{name}.column"] = tacho.column
        if tacho.quadrature is not None:
            columns[f"{name}.quadrature"] = tacho.quadrature
    for key, column in columns.items():
        try:
            log.channel(column)
        except InputError as error:
            raise InputError(f"channels.{key}: {error}") from error


def require_unit(log: Log, key: str, sensor: Level) -> None:
    """Reject a unit, and so a calibration, that differs from the log's."""
    channel, given = log.channel(sensor.column), told(sensor.unit)
    by_name = named(channel).unit
    # The unit at the end of a channel's name counts only if the trial's unit is of the same quantity.
    same = any({by_name, given} <= known.factors.keys() for known in QUANTITIES.values())
    recorded = channel.unit or (by_name if same else "")
    if recorded and recorded != given:
        raise InputError(
            f"{log.name}: channel {sensor.column!r} is in {recorded!r}, channels.{key}.unit says {sensor.unit!r}; "
            "give the log's unit and a calibration for it"
        )


def require_sense(
    label: str,
    signals: Mapping[str, Array],
    vessel: Vessel,
    source: tuple[str, Tacho] | None = None,
) -> None:
    """Reject fully masked signals and wrong calibrations; `source` is the name and table of the source of speed."""
    mean = {}
    for name, values in signals.items():
        if np.isnan(values).all():
            raise InputError(f"{label}: all samples of {name!r} are masked; choose another stretch")
        mean[name] = float(np.nanmean(values))
    if "n_set" in mean and abs(mean["n_set"] / mean["n_e"] - 1.0) > CALIBRATED_WITHIN:
        raise InputError(
            f"channels.set_point: {mean['n_set']:.4g} rpm on average in {label}, where the engine turns "
            f"{mean['n_e']:.4g} rpm{_slip_of_speed(mean['n_set'] / mean['n_e'], vessel.gearbox.ratio, source)}"
        )
    for name in mean.keys() & {"M_b", "M_s", "M_g"}:
        _require_rating("torque", f"on average in {label}", mean[name], vessel, by_engine=name == "M_b")


def require_load(windows: Sequence[Mapping[str, Array]], vessel: Vessel) -> None:
    """Reject a load that is far from the rating in all windows; in some windows it may be switched off."""
    loads = [np.abs(one["M_load"]) for one in windows if "M_load" in one]
    if largest := max((float(np.nanmax(load)) for load in loads if np.isfinite(load).any()), default=0.0):
        _require_rating("load", "at most", largest, vessel)


def _require_rating(
    key: str, where: str, torque_Nm: float, vessel: Vessel, *, by_engine: bool = False
) -> None:
    """Reject a torque far from the rating of the engine, or of the shaft behind a gearbox."""
    if not vessel.given("engine.rated_power_kW", "engine.rated_speed_rpm"):
        return
    rated = vessel.engine.rated_power_kW * 1e3 / (2.0 * math.pi * vessel.engine.rated_speed_rpm / 60.0)
    limit = rated if by_engine else rated * vessel.gearbox.ratio
    least, most = LEAST_TORQUE * limit, MOST_TORQUE * limit
    if not least < abs(torque_Nm) < most:
        hint = hints.likely(abs(torque_Nm), least, most, hints.TORQUE)
        raise InputError(
            f"channels.{key}: {torque_Nm:.4g} Nm {where}, but the rated torque is {limit:.4g} Nm{hint}{CHECK}"
        )


def _slip_of_speed(ratio: float, gear_ratio: float, source: tuple[str, Tacho] | None) -> str:
    """Text with the likely cause if the set point is `ratio` times the engine speed; 1 is correct."""
    name, kind = ("", "pulses") if source is None else (source[0], source[1].kind)
    count = (
        f"channels.{name}.pole_pairs" if source is not None and told(source[1].unit) in FREQUENCIES else ""
    )
    if count and ratio < 1.0 and abs(ratio * (times := round(1.0 / ratio)) - 1.0) < CALIBRATED_WITHIN:
        return f"; a machine of {times} times as many pairs of poles? check {count}"
    if hint := hints.likely_ratio(ratio, hints.SPEED_RPM):
        return f"{hint} check channels.set_point.calibration"
    # A wrong number of pulses gives a whole factor; a gear ratio may be near 1.
    wrong = {"the propeller's shaft for the engine's, or the other way round? check shaft": gear_ratio}
    if kind in ("pulses", "edges"):
        wrong |= {f"a number of pulses wrong by {k}? check pulses_per_rev": float(k) for k in range(2, 9)}
    off = {what: abs(max(ratio, 1.0 / ratio) / factor - 1.0) for what, factor in wrong.items()}
    nearest = min(off, key=off.__getitem__)
    if off[nearest] < CALIBRATED_WITHIN:
        return f"; {nearest} of the {'pulse trains' if kind in ('pulses', 'edges') else 'source of speed'}"
    return (
        CHECK
        if source is None
        else f"; check unit and calibration of both, channels.set_point and channels.{name}"
    )


OF_A_LEVEL = {"stuck": "stuck_s", "dropout": "dropout_s", "clipped": "clipped_samples"}
"""Faults that may be normal states of a load, with their keys in [processing.faults]."""


def spike_rule(sensor: Level | None, processing: Processing) -> tuple[str, Spikes]:
    """Kind of fault and limits of a channel's spikes; `sensor` is None for a channel without a role."""
    if isinstance(sensor, SetPoint | Command):
        return "D1", processing.set_point_jumps
    return "C" if isinstance(sensor, Torque) else "spike", processing.torque_spikes


@dataclass(frozen=True)
class Cleaned:
    """Calibrated channel on the grid of a stretch, with its faults and calibration."""

    samples: Array
    faults: list[Fault]
    calibration: Calibration


class Cleaner:
    """Reader of a channel's calibrated samples in a stretch; faults are bridged in the model's inputs, else masked."""

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
        unit = {SetPoint: "rpm", Command: "", Rack: "mm"}.get(type(sensor), "Nm")
        if isinstance(sensor, Load):
            unit = {"torque": "Nm", "power": "W", "other": ""}[sensor.quantity]
        self.calibration = sensor.calibration.calibration(unit)
        self._spike, self.spikes = spike_rule(sensor, processing)
        self.first, self.last = first, last
        self.mains_hz = settings.mains_hz
        # Faults are also searched in samples beside the stretch, which the low-pass uses.
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
            # A load is constantly zero when switched off and constant at its rating; neither is a fault.
            found = {kind: spans for kind, spans in found.items() if kind not in OF_A_LEVEL}
        if is_set_point and self.channel.resolution:
            # A quantised set point has no noise: constant stretches and flat crests are not faults.
            found = {kind: spans for kind, spans in found.items() if kind not in ("stuck", "clipped")}
        # A channel that never changes may be correct, so it is reported but not masked.
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
        """Calibrated samples [first, stop); missing samples are bridged (inputs of the model) or NaN."""
        samples = self.calibration(self.rows.read(first, stop))
        missing = ~np.isfinite(samples) | marks(self._lost, first, stop)
        if marks(self._hum, first, stop).any():
            # Spikes are bridged first, since each one would affect all samples within the filter's length.
            filled = bridge(samples, missing | self._spiky(samples, missing)[0])
            samples = samples - hum_in(filled, first, self._hum, self.channel.rate_hz, self.mains_hz)
        spiky, found = self._spiky(samples, missing)
        self._spikes.append(first + found[self._judged(found, first, len(samples))])
        lost = missing | spiky
        return bridge(samples, lost) if self.drives else np.where(lost, np.nan, samples)

    def faults(self) -> list[Fault]:
        """Faults of the stretch; complete only after all its samples were read."""
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
        """Raise `InputError` if an input of the model is missing for too long to be bridged."""
        for kind, found in self._found.items():
            spans = self._within(found)
            long = spans[spans[:, 1] - spans[:, 0] > longest_s * self.channel.rate_hz]
            if len(long):
                start, stop = long[0].tolist()
                at, until = (self.channel.start_s + k / self.channel.rate_hz for k in (start, stop))
                sound = (
                    f"; if the signal is correct, raise processing.faults.{OF_A_LEVEL[kind]}"
                    if kind in OF_A_LEVEL
                    else ""
                )
                raise InputError(
                    f"{self.rows.log.name}: {self.what} {self.channel.name!r} has a fault, {KINDS[kind]}, from {at:g} "
                    f"to {until:g} s (samples {start} to {stop - 1}); it is an input of the model, and at most "
                    f"{longest_s:g} s are bridged (processing.faults.longest_bridge_s); end the window before it{sound}"
                )

    def _spiky(self, samples: Array, missing: Mask) -> tuple[Mask, Spans]:
        """Mask of the spikes in a piece, shape (N,), and their spans."""
        spiky = np.zeros(len(samples), dtype=np.bool_)
        found = spikes_between(samples, missing, self.channel.rate_hz, self.spikes, steps=self._spike == "D1")
        for begin, end in found:
            # The mask has an additional sample on either side, since the receiver's filter widens a spike.
            spiky[max(begin - 1, 0) : end + 1] = True
        return spiky, found

    def _judged(self, spans: Spans, first: int, size: int) -> Mask:
        """Whether spans are far enough from a piece's ends to count; others are found again in the overlapping piece."""
        border = round(0.5 * MARGIN_S * self.channel.rate_hz)
        low = 0 if first == 0 else border
        high = size if first + size == self.channel.samples else size - border
        return (spans[:, 0] >= low) & (spans[:, 1] <= high)
