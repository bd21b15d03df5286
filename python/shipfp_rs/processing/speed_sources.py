"""Sources of speed: pulse trains of a log, wheels with missing teeth, lists of edges, encoders, recorded speeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.faults.record import Fault
from shipfp_rs.logs.faults.spikes import spikes_along
from shipfp_rs.logs.log import Rows
from shipfp_rs.logs.readers.delimited_layout import is_number
from shipfp_rs.processing.trial import Spikes
from shipfp_rs.processing.trial_channels import Tacho
from shipfp_rs.support.arrays import Array, Spans, apart_from, clipped_to, marks, runs
from shipfp_rs.support.files import local
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.spikes import ROBUST_SIGMA
from shipfp_rs.support.units import TO_REV, TO_RPM, told
from shipfp_rs.tacho import (
    IntervalSpeed,
    PulseFlag,
    PulseTimes,
    ReflectorAngles,
    pulse_times,
    reflector_angles,
    speed_from_pulses,
)

if TYPE_CHECKING:
    import pyarrow as pa


MARGIN_S = 2.0
"""Margin read before and after a stretch [s], so that both ends of the stretch lie between two pulses."""
SPLINE_REACH = 40
"""Number of intervals after which a change no longer affects a cubic spline; its effect decays by a factor of 3.7 per
interval.
"""


def _with_margin(channel: Channel, start_s: float, stop_s: float) -> tuple[int, int]:
    """Rows of a stretch and its margins."""
    edges = (
        round((edge - channel.start_s) * channel.rate_hz) for edge in (start_s - MARGIN_S, stop_s + MARGIN_S)
    )
    first, stop = edges
    return max(first, 0), min(stop, channel.samples)


class PulseTrain:
    """Pulse train of a log, read once; its longest stretch determines the angles of the reflectors."""

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
        """Ratio of the engine speed [rpm] to the speed of the train's shaft [rev/s]."""
        self.pulses = {label: self._pulses(rows, label, *stretch) for label, stretch in stretches.items()}
        longest = max(stretches, key=lambda label: stretches[label][1] - stretches[label][0])
        self.angles = self._angles(self.pulses[longest])

    def _angles(self, longest: PulseTimes) -> ReflectorAngles:
        """Angles of the reflectors, from the pulses of the longest stretch."""
        return reflector_angles(longest.times_s, self.tacho.pulses_per_rev, gaps=longest.gaps_s)

    def _time_std_s(self, label: str) -> float | None:
        """Standard deviation of a pulse's time in a stretch [s]; None if that of `PulseTimes` applies."""
        return None

    def _pulses(self, rows: Rows, label: str, start_s: float, stop_s: float) -> PulseTimes:
        """Pulses of a stretch and its margins, on the log's clock."""
        channel = self.channel
        first, stop = _with_margin(channel, start_s, stop_s)
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
        """Intervals of a stretch, and those on either side that affect a spline within it."""
        first, last = np.searchsorted(speed.time_s, [start_s, stop_s])
        return speed.part(slice(max(first - SPLINE_REACH, 0), last + SPLINE_REACH))

    def score(self, speed: IntervalSpeed) -> float:
        """Number of good intervals, or of good turns if the reflectors' angles are unknown."""
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
            # Faults shorter than a sample, at the end of a stretch, are dropped.
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
                    "no clear pulses, masked: lower than {height} at uneven intervals, shorter than a sample, or absent",
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


LEAST_SAMPLES = 4.0
"""Least number of an encoder's samples between two virtual pulses, so that their errors are independent."""
MOST_VIRTUAL = 64
SPEED_RATE_HZ = 200.0
"""Rate to which a recorded speed is averaged [Hz], far above the frequencies of a shaft line."""

Stretches = Mapping[str, tuple[float, float]]


class MarkedWheel(PulseTrain):
    """Toothed wheel with a gap of missing teeth, such as 60-2; the times of the missing teeth are interpolated."""

    def __init__(self, rows: Rows, name: str, tacho: Tacho, gear_ratio: float, stretches: Stretches) -> None:
        self._found_s: dict[str, Array] = {}
        """Times of the gaps in each stretch [s], each that of the first missing tooth."""
        super().__init__(rows, name, tacho, gear_ratio, stretches)

    def _pulses(self, rows: Rows, label: str, start_s: float, stop_s: float) -> PulseTimes:
        pulses = super()._pulses(rows, label, start_s, stop_s)
        every = with_missing(pulses.times_s, self.tacho.pulses_per_rev, self.tacho.missing)
        self._found_s[label] = np.setdiff1d(every, pulses.times_s)[:: self.tacho.missing]
        return pulses.at(every)

    def faults(self, label: str, speed: IntervalSpeed, start_s: float, stop_s: float) -> list[Fault]:
        """Faults of a stretch, including gaps that are not whole turns apart."""
        channel, spans = self.channel, self._not_whole(label, speed)
        spans = spans[(spans[:, 1] > start_s) & (spans[:, 0] < stop_s)].clip(start_s, stop_s)
        lost = np.rint((spans - channel.start_s) * channel.rate_hz).astype(np.int64)
        method = Sentence("kept: the teeth from gap to gap are not those of whole turns")
        found = super().faults(label, speed, start_s, stop_s)
        return [*found, Fault("B", channel.name, method, lost)] if len(lost) else found

    def _not_whole(self, label: str, speed: IntervalSpeed) -> Array:
        """Stretches [s] between successive gaps that are not a whole number of turns, shape (K, 2)."""
        gaps = self._found_s[label]
        if len(gaps) < 2 or not len(speed.time_s):
            return np.empty((0, 2))
        ends = speed.time_s + 0.5 * speed.duration_s
        turned, lasted = (
            np.diff(np.interp(gaps, ends, np.cumsum(column)))
            for column in (speed.turned_rev, speed.duration_s)
        )
        # Masked stretches are reported by `PulseTrain.faults`.
        counted = np.abs(lasted / np.diff(gaps) - 1.0) < 1e-3
        wrong = np.abs(turned - np.rint(turned)) * self.tacho.pulses_per_rev > 0.5
        return np.column_stack([gaps[:-1], gaps[1:]])[counted & wrong]


def with_missing(times_s: Array, teeth: int, missing: int) -> Array:
    """Insert the times of a wheel's `missing` adjacent teeth, by cubics through two teeth on either side of each gap.

    Examples
    --------
    >>> turn = np.arange(6.0)[:5]  # a wheel 6-1
    >>> with_missing(np.concatenate([turn, turn + 6.0, turn + 12.0]), 6, 1)[4:8]
    array([4., 5., 6., 7.])
    """
    periods = np.diff(times_s)
    if len(periods) < 4:
        return times_s
    # A gap is `missing` + 1 pitches long; a gap beside another lost tooth is repaired later.
    after, before = np.append(periods[1:], periods[-1]), np.insert(periods[:-1], 0, periods[0])
    # The usual period is the mean of both sides if the speed changes, and the lesser one beside a lost tooth.
    usual = np.array([0.5 * (before + after), np.minimum(before, after)])
    wide = (np.abs(periods / usual - (missing + 1)) < 0.5).any(axis=0)
    gaps = np.flatnonzero(wide[1:-1]) + 1
    at = np.array([-1.0, 0.0, missing + 1.0, missing + 2.0])
    wanted = np.arange(1.0, missing + 1.0)
    weights = np.array(
        [
            [np.prod([(x - at[j]) / (at[k] - at[j]) for j in range(4) if j != k]) for k in range(4)]
            for x in wanted
        ]
    )
    around = times_s[gaps[:, None] + np.array([-1, 0, 1, 2])]
    return np.sort(np.concatenate([times_s, (around @ weights.T).ravel()]))


class EdgeList(PulseTrain):
    """List of edges in a separate file, on the log's clock."""

    def __init__(self, name: str, tacho: Tacho, gear_ratio: float, stretches: Stretches) -> None:
        path = Path(tacho.file or "")
        self.times_s = read_edges(path, tacho) - tacho.delay_s
        apart = float(np.median(np.diff(self.times_s)))
        steps = np.abs(self.times_s * 1e6 - np.rint(self.times_s * 1e6)).max() < 1e-3
        resolution = 1e-6 if steps else min(apart * 1e-3, 1e-6)
        _require_less(f"channels.{name}.time_std_s", tacho.time_std_s, apart, "s, the time between edges")
        self.time_std_s = tacho.time_std_s or resolution / np.sqrt(12.0)
        rate_hz = 1.0 / (self.time_std_s * np.sqrt(12.0))
        self._clock = Channel(path.name, "", rate_hz, 1, float(self.times_s[0]))
        super().__init__(SimpleNamespace(channel=self._clock), name, tacho, gear_ratio, stretches)  # type: ignore[arg-type]

    def _pulses(self, rows: Rows, label: str, start_s: float, stop_s: float) -> PulseTimes:
        inside = (self.times_s >= start_s - MARGIN_S) & (self.times_s <= stop_s + MARGIN_S)
        times = self.times_s[inside]
        if self.tacho.missing:
            times = with_missing(times, self.tacho.pulses_per_rev, self.tacho.missing)
        return PulseTimes(times, np.empty((0, 2)), 0.0, 0.5, 1.0, self._clock.rate_hz)

    def _time_std_s(self, label: str) -> float:
        return float(self.time_std_s)


def read_edges(path: Path, tacho: Tacho) -> Array:
    """Read the times of edges [s]; with a column of levels, only rising edges; `InputError` if they do not increase."""
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    if not path.is_file():
        raise InputError(f"{path}: no such file, expected a list of edges")
    try:
        table = (
            pa.parquet.ParquetFile(local(path)).read()
            if path.suffix.lower() in (".parquet", ".pq")
            else _table_of_text(path)
        )
        columns = {name: table.column(name).cast(pa.float64()).to_numpy() for name in table.column_names}
    except (OSError, ValueError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())[:300]
        raise InputError(
            f"{path}: can't be read as a list of edges: {reason}; expected columns of numbers"
        ) from error
    for key in (tacho.column, tacho.level):
        if key and key not in columns:
            raise InputError(f"{path}: no column {key!r}, found {', '.join(columns)}")
    times = columns[tacho.column or next(iter(columns))]
    if tacho.level:
        levels = columns[tacho.level]
        up = levels > 0.5 * (np.nanmin(levels) + np.nanmax(levels))
        times = times[up & ~np.insert(up[:-1], 0, False)]
    bad = np.flatnonzero(~(np.diff(times) > 0.0))
    if len(times) < 2 or bad.size:
        where = (
            f"row {int(bad[0]) + 2}: {times[bad[0] + 1]:g} after {times[bad[0]]:g} s"
            if bad.size
            else f"{len(times)} edges"
        )
        raise InputError(f"{path}: {where}, expected two or more times that increase")
    return np.asarray(times)


def _table_of_text(path: Path) -> pa.Table:
    import pyarrow as pa
    import pyarrow.csv

    first = path.read_text(encoding="utf-8-sig", errors="replace").split("\n", 1)[0]
    bare = all(is_number(cell.strip(), ".") for cell in first.replace(";", ",").split(","))
    return pa.csv.read_csv(
        local(path),
        read_options=pa.csv.ReadOptions(autogenerate_column_names=bare),
        parse_options=pa.csv.ParseOptions(delimiter=";" if ";" in first else "\t" if "\t" in first else ","),
    )


class Encoder(PulseTrain):
    """Angle of an encoder, wrapped or counting; its virtual pulses are the times at which it passes evenly spaced angles."""

    def __init__(self, rows: Rows, name: str, tacho: Tacho, gear_ratio: float, stretches: Stretches) -> None:
        self._std_s: dict[str, float] = {}
        """Standard deviation of a pulse's time in each stretch [s]."""
        per_rev = tacho.counts_per_rev
        self._rev = 1.0 / per_rev if per_rev else TO_REV[told(tacho.unit)]
        calibration = tacho.calibration
        self._line = None if calibration is None else calibration.calibration(tacho.unit)
        _require_less(f"channels.{name}.std", tacho.std, 0.5 / self._rev, "or half a turn")
        self._per_rev = self._virtual(rows, tacho, stretches)
        super().__init__(
            rows, name, tacho.model_copy(update={"pulses_per_rev": self._per_rev}), gear_ratio, stretches
        )

    def _angle(self, rows: Rows, start_s: float, stop_s: float) -> tuple[Array, Array, Array]:
        """Times [s], increasing angles [rev] and gaps [s] of a stretch and its margins."""
        channel = rows.channel
        first, stop = _with_margin(channel, start_s, stop_s)
        recorded = rows.read(first, stop).astype(np.float64)
        known = np.isfinite(recorded)
        if known.sum() < 8:
            raise InputError(
                f"channel {channel.name!r}, {start_s:g} to {stop_s:g} s: fewer than 8 samples of an angle"
            )
        time = channel.start_s + (first + np.arange(len(recorded))) / channel.rate_hz
        gaps = time[0] + (runs(~known) - np.array([1, 0])) / channel.rate_hz
        values = (recorded if self._line is None else self._line(recorded))[known] * self._rev
        wrap = self._wrap(values)
        if wrap:
            steps = np.diff(values)
            values = values[0] + np.concatenate([[0.0], np.cumsum(steps - wrap * np.rint(steps / wrap))])
        if values[-1] < values[0]:
            values = -values
        return time[known], values, gaps

    def _wrap(self, values: Array) -> float:
        """Angle at which the encoder's output wraps [rev]; 0 if it does not wrap."""
        span = float(np.ptp(values))
        largest = float(np.abs(np.diff(values)).max())
        if span <= 1.2 and largest > 0.5 * span:
            return 1.0
        for bits in (8, 12, 16, 24, 32):  # overflow of a counter
            if abs(largest / (2.0**bits * self._rev) - 1.0) < 0.1:
                return float(2.0**bits * self._rev)
        return 0.0

    def _virtual(self, rows: Rows, tacho: Tacho, stretches: Stretches) -> int:
        longest = max(stretches.values(), key=lambda each: each[1] - each[0])
        time, angle, _ = self._angle(rows, *longest)
        speed = float((angle[-1] - angle[0]) / (time[-1] - time[0]))
        if not speed > 0.0:
            raise InputError(
                f"channels: encoder {tacho.column!r} does not turn from {longest[0]:g} to {longest[1]:g} s"
            )
        return int(np.clip(rows.channel.rate_hz / (LEAST_SAMPLES * speed), 1, MOST_VIRTUAL))

    def _pulses(self, rows: Rows, label: str, start_s: float, stop_s: float) -> PulseTimes:
        rows.within(start_s, stop_s)
        time, angle, gaps = self._angle(rows, start_s, stop_s)
        noise = ROBUST_SIGMA * float(np.median(np.abs(np.diff(angle, 2)))) / np.sqrt(6.0)
        step = self._rev if self.tacho.counts_per_rev else _step(np.abs(np.diff(angle)))
        step = max(step, rows.channel.resolution * self._rev)
        # The error of an angle is its resolution or its noise, whichever is larger.
        std = self.tacho.std * self._rev if self.tacho.std else max(noise, step / np.sqrt(12.0), 1e-9)
        forward = np.maximum.accumulate(angle)
        keep = np.append(True, np.diff(forward) > 0.0)
        passed = np.arange(np.ceil(forward[0] * self._per_rev), np.floor(forward[-1] * self._per_rev) + 1.0)
        times = np.interp(passed / self._per_rev, forward[keep], time[keep])
        inside = np.zeros(len(times), dtype=np.bool_)
        for begin, end in gaps:
            inside |= (times > begin) & (times < end)
        speed = float((angle[-1] - angle[0]) / (time[-1] - time[0]))
        self._std_s[label] = std / speed
        return PulseTimes(times[~inside], gaps, 0.0, 0.5, 1.0, rows.channel.rate_hz)

    def _angles(self, longest: PulseTimes) -> ReflectorAngles:
        even = np.full(self._per_rev, 1.0 / self._per_rev)
        return ReflectorAngles(even, np.zeros(self._per_rev), ok=True)

    def _time_std_s(self, label: str) -> float:
        return self._std_s[label]


def _step(steps: Array) -> float:
    """Resolution of an angle: the step of which all differences are multiples; 0 if there is no such step."""
    levels = np.unique(np.round(steps, 12))
    apart = np.diff(levels)
    apart = apart[apart > 1e-10]
    if not apart.size:
        return 0.0
    step = float(apart.min())
    ratio = steps[:10_000] / step
    return step if np.abs(ratio - np.rint(ratio)).max() < 1e-2 else 0.0


class SpeedLevel(PulseTrain):
    """Speed recorded by a drive, a bus or an analogue converter, as means over the sample intervals, without spikes."""

    def __init__(
        self, rows: Rows, name: str, tacho: Tacho, gear_ratio: float, stretches: Stretches, spikes: Spikes
    ) -> None:
        self._held: dict[str, IntervalSpeed] = {}
        self._spikes, self._spiky = spikes, dict[str, Spans]()
        super().__init__(rows, name, tacho, gear_ratio, stretches)

    def _pulses(self, rows: Rows, label: str, start_s: float, stop_s: float) -> PulseTimes:
        rows.within(start_s, stop_s)
        channel, tacho = rows.channel, self.tacho
        factor = TO_RPM.get(told(tacho.unit), 1.0) / 60.0 / tacho.pole_pairs  # a calibration leads to rpm
        first, stop = _with_margin(channel, start_s, stop_s)
        recorded = rows.read(first, stop).astype(np.float64)
        calibration = tacho.calibration
        line = None if calibration is None else calibration.calibration(tacho.unit)
        rps = (recorded if line is None else line(recorded)) * factor
        if np.nanmedian(rps) < 0.0:
            rps = -rps
        spiky = spikes_along(rps, channel.rate_hz, self._spikes)
        rps[marks(spiky, 0, len(rps))] = np.nan
        self._spiky[label] = first + spiky
        middle = float(np.nanmedian(rps)) / factor
        _require_less(
            f"channels.{self.name}.std",
            tacho.std,
            middle,
            f"{tacho.unit if tacho.unit in TO_RPM else 'rpm'}, the speed itself",
        )
        block = max(int(channel.rate_hz / SPEED_RATE_HZ), 1)
        count = len(rps) // block
        means = rps[: count * block].reshape(count, block).mean(axis=1)
        scale = factor * (1.0 if line is None else abs(line.scale))
        noise = ROBUST_SIGMA * float(np.nanmedian(np.abs(np.diff(rps, 2)))) / np.sqrt(6.0) / np.sqrt(block)
        # Averaging does not reduce the rounding error while the speed stays within a step.
        rounding = channel.resolution * scale / np.sqrt(12.0)
        std = tacho.std * factor if tacho.std else max(float(np.hypot(noise, rounding)), 1e-9)
        duration = block / channel.rate_hz
        if tacho.mean_s is not None:
            # The mean over T deviates from the speed by T^2 / 24 times its second derivative.
            bend = np.diff(means, 2, prepend=means[:1], append=means[-1:]) / duration**2
            means = means - (tacho.mean_s**2 - duration**2) / 24.0 * bend
        # Each sample counts as the mean over the interval around its time.
        time = channel.start_s + (first - 0.5) / channel.rate_hz + (np.arange(count) + 0.5) * duration
        known = np.isfinite(means) & (means > 0.0)
        std_rps, lasts, good = np.broadcast_arrays(std, duration, np.zeros(known.sum(), dtype=np.uint8))[:3]
        self._held[label] = IntervalSpeed(time[known], means[known], std_rps, lasts, good, 1)
        gaps = time[0] + (runs(~np.isfinite(means)) - 0.5) * duration
        return PulseTimes(time[known], gaps, 0.0, 0.5, 1.0, channel.rate_hz)

    def _angles(self, longest: PulseTimes) -> ReflectorAngles:
        return ReflectorAngles(np.ones(1), np.zeros(1), ok=True)

    def speed(self, label: str) -> IntervalSpeed:
        """Speeds in a stretch [rev/s], each a mean over its interval."""
        return self._held[label]

    def faults(self, label: str, speed: IntervalSpeed, start_s: float, stop_s: float) -> list[Fault]:
        """Faults of a stretch, spikes included, and their treatment."""
        channel = self.channel
        spans = clipped_to(
            self._spiky[label],
            *(round((time_s - channel.start_s) * channel.rate_hz) for time_s in (start_s, stop_s)),
        )
        others = super().faults(label, speed, start_s, stop_s)
        found = [replace(one, spans=apart_from(one.spans, spans)) for one in others]
        found.append(Fault("spike", channel.name, Sentence("masked"), spans))
        return [one for one in found if len(one.spans)]

    def score(self, speed: IntervalSpeed) -> float:
        """Score below that of any source that counts pulses, since the filter of a speed converter is unknown."""
        return -1.0 / (1.0 + len(speed.time_s))


def _require_less(key: str, std: float | None, limit: float, what: str) -> None:
    """Reject a standard deviation as large as the quantity itself; its unit is probably wrong."""
    if std is not None and not std < limit:
        raise InputError(f"{key}: found {std:g}, expected less than {limit:.4g} {what}")


def source_of(
    rows: Rows | None, name: str, tacho: Tacho, gear_ratio: float, stretches: Stretches, spikes: Spikes
) -> PulseTrain:
    """Make the source of speed for a table of a trial; `spikes` are the limits for a recorded speed."""
    if tacho.kind == "edges" or rows is None:
        return EdgeList(name, tacho, gear_ratio, stretches)
    if tacho.kind == "speed":
        return SpeedLevel(rows, name, tacho, gear_ratio, stretches, spikes)
    kind = Encoder if tacho.kind == "angle" else MarkedWheel if tacho.missing else PulseTrain
    return kind(rows, name, tacho, gear_ratio, stretches)


def require_one_direction(first: PulseTrain, second: PulseTrain) -> None:
    """Reject a shaft that reverses, as a change of the order of two trains in quadrature shows."""
    for label, pulses in first.pulses.items():
        one, two = pulses.times_s, second.pulses[label].times_s
        if len(one) < 3 or len(two) < 3:
            continue
        after = two[np.minimum(np.searchsorted(two, one[:-1]), len(two) - 1)]
        phase = (after - one[:-1]) / np.diff(one)
        leads = phase < 0.5
        if 0.05 < leads.mean() < 0.95:
            turned = one[int(np.flatnonzero(leads != leads[0])[0])]
            raise InputError(
                f"{label}: channels.{first.name} and its quadrature change order at {turned:.3f} s: the shaft reverses "
                "there; choose stretches of one direction"
            )
