"""Class `Excitation`: deviations of the set point from the operating point, and operations on them."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Hold
from shipfp_rs.support.arguments import MOST_SAMPLES, at_most, check_fields, checked, positive, told
from shipfp_rs.support.arrays import Array, Brief, EvenlySampled, same
from shipfp_rs.support.files import ending_in, write_text_atomically

Bands = Sequence[tuple[float, float]]


def sample_times(duration_s: float, rate_hz: float) -> Array:
    """Sample times of a stretch [s]; at least one sample."""
    return np.arange(_sample_count("duration", duration_s, rate_hz)) / rate_hz


def _sample_count(name: str, duration_s: float, rate_hz: float) -> int:
    positive(name, duration_s)
    positive("rate_hz", rate_hz)
    samples = duration_s * rate_hz
    if not 1.0 <= samples + 0.5 <= MOST_SAMPLES:
        raise InputError(
            f"{duration_s:g} s at {rate_hz:g} Hz are {samples:.3g} samples, expected 1 to {MOST_SAMPLES}"
        )
    return round(samples)


def whole_samples(name: str, duration_s: float, rate_hz: float) -> int:
    """Number of samples in a duration [s]; `InputError` if it is not a whole number."""
    count, samples = _sample_count(name, duration_s, rate_hz), duration_s * rate_hz
    if not math.isclose(count, samples, rel_tol=1e-9):
        raise InputError(f"{name} is {duration_s:g}, {samples:g} samples, expected a whole number of samples")
    return count


def zero_or_more(name: str, value: float) -> None:
    """Raise `InputError` unless a value is finite and not negative."""
    if not (math.isfinite(value) and value >= 0.0):
        raise InputError(f"{name} is {value}, expected zero or more")


def numbers(name: str, values: npt.ArrayLike) -> list[float]:
    """Convert values to a list of finite numbers, at least one."""
    numbers = np.array(values, dtype=np.float64)
    if numbers.ndim != 1 or not numbers.size or not np.isfinite(numbers).all():
        raise InputError(f"{name} is {values!r}, expected a list of at least one finite number")
    return [float(number) for number in numbers]


def below_nyquist(name: str, frequency: float, rate_hz: float) -> None:
    """Raise `InputError` for a frequency above half the sample rate."""
    positive(name, frequency)
    positive("rate_hz", rate_hz)
    if frequency >= 0.5 * rate_hz:
        raise InputError(
            f"{name} is {frequency:g} Hz, expected less than half of rate_hz {rate_hz:g}; sample faster"
        )


def bands(avoid_hz: Bands) -> list[tuple[float, float]]:
    """Sorted bands to avoid [Hz], each a pair (low, high)."""
    for index, band in enumerate(avoid_hz):
        if len(band) != 2 or not 0.0 <= band[0] < band[1] or not math.isfinite(band[1]):
            raise InputError(f"avoid_hz[{index}] is {tuple(band)}, expected (low, high) with 0 <= low < high")
    return sorted((float(low), float(high)) for low, high in avoid_hz)


def outside(frequencies: Sequence[float], avoid_hz: Bands) -> list[float]:
    """Frequencies [Hz] outside all bands; `InputError` if there are none."""
    left = [f for f in frequencies if not any(low <= f <= high for low, high in bands(avoid_hz))]
    if not left:
        raise InputError(f"every frequency lies in a band of avoid_hz {list(avoid_hz)}; narrow the bands")
    return left


@dataclass(frozen=True)
class Segment:
    """Stretch of an excitation: label of its content, start and end [s], and frequency [Hz] if it has one."""

    label: str
    start_s: float
    stop_s: float
    frequency_hz: float | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Excitation(Brief, EvenlySampled):
    """Deviations of the set point at a constant sample rate.

    Parameters
    ----------
    name, kind
        Label, and kind of signal for tables ("chirp", "steps", ...).
    rate_hz
        Sample rate [Hz].
    samples
        Deviation of the set point from the operating point [rpm of the engine], shape (N,).
    hold
        Interpolation between samples: "first" (straight lines) or "zero" (stairs).
    segments
        Stretches that are analysed separately; empty if the excitation is a single stretch.
    """

    name: str
    kind: str
    rate_hz: float
    samples: Array
    hold: Literal["zero", "first"] = "first"
    segments: tuple[Segment, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self, f"excitation {told(self.name)}")
        positive("rate_hz", self.rate_hz)
        samples = np.array(self.samples, dtype=np.float64)
        if samples.ndim != 1 or samples.size < 2:
            raise InputError(
                f"excitation {self.name!r}: samples have shape {samples.shape}, expected (N,), N >= 2"
            )
        bad = np.flatnonzero(~np.isfinite(samples))
        if bad.size:
            raise InputError(
                f"excitation {self.name!r}: sample {bad[0]} is {samples[bad[0]]}, expected finite ones"
            )
        samples.flags.writeable = False
        object.__setattr__(self, "samples", samples)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Excitation):
            return NotImplemented
        return all(same(getattr(self, field.name), getattr(other, field.name)) for field in fields(self))

    def __hash__(self) -> int:
        return hash((self.name, self.kind, self.rate_hz, len(self), self.hold, self.segments))

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def amplitude_rpm(self) -> float:
        """Largest deviation [rpm]."""
        return float(np.abs(self.samples).max())

    @property
    def crest_factor(self) -> float:
        """Largest deviation over root mean square [-], 1.41 for a sine; low values mean much power for little motion."""
        return self.amplitude_rpm / self.rms_rpm if self.rms_rpm > 0.0 else math.nan

    @property
    def rms_rpm(self) -> float:
        """Root mean square of the deviation [rpm]."""
        return float(np.sqrt(np.mean(self.samples**2)))

    def plot(self, axes: Sequence[Any] | None = None) -> Sequence[Any]:
        """Draw the deviation against time; see `plot.signals`."""
        # Imported by name, since this module does not depend on plots.
        drawn: Sequence[Any] = import_module("shipfp_rs.plot").signals(self, axes)
        return drawn

    def spectrum(self) -> tuple[Array, Array]:
        """Return frequencies [Hz] and amplitudes [rpm] of the discrete Fourier lines, each shape (N // 2 + 1,).

        The line of a sine with a whole number of periods has the sine's amplitude.
        """
        lines = 2.0 * np.abs(np.fft.rfft(self.samples)) / len(self)
        lines[0] /= 2.0
        if len(self) % 2 == 0:
            lines[-1] /= 2.0
        return np.asarray(np.fft.rfftfreq(len(self), 1.0 / self.rate_hz), dtype=np.float64), lines

    @checked
    def power_in(self, low_hz: float, high_hz: float) -> float:
        """Return the fraction [-] of the variance that lies in a frequency band.

        Parameters
        ----------
        low_hz, high_hz
            Ends of the band [Hz], inclusive.
        """
        frequency, amplitude = self.spectrum()
        power = amplitude**2
        power[0] = 0.0
        return float(power[(frequency >= low_hz) & (frequency <= high_hz)].sum() / power.sum())

    @checked
    def ramped(self, ramp_s: float) -> Excitation:
        """Return a copy with half-cosine ramps from zero at its start and to zero at its end.

        Ramps avoid a jump where a signal starts or ends away from zero, but reduce the excitation.

        Parameters
        ----------
        ramp_s
            Length of each ramp [s].

        Raises
        ------
        InputError
            If two ramps are longer than the excitation, or one is shorter than half a sample.
        """
        positive("ramp_s", ramp_s)
        count = round(ramp_s * self.rate_hz)
        if not count:
            raise InputError(f"ramp_s is {ramp_s:g}, expected a sample or more, {1.0 / self.rate_hz:g} s")
        if 2 * count > len(self):
            raise InputError(
                f"ramp_s is {ramp_s:g}, two ramps expected within the {self.duration:g} s of the excitation"
            )
        rise = 0.5 - 0.5 * np.cos(math.pi * np.arange(count) / count)
        window = np.ones(len(self))
        window[:count] *= rise
        window[len(self) - count :] *= rise[::-1]
        return replace(self, samples=self.samples * window)

    @checked
    def settled(self, before_s: float, after_s: float = 0.0) -> Excitation:
        """Return a copy with the operating point held before and after it, for the ship to settle.

        Parameters
        ----------
        before_s, after_s
            Duration of each hold [s].

        Raises
        ------
        InputError
            For a negative time.
        """
        for name, value in (("before_s", before_s), ("after_s", after_s)):
            zero_or_more(name, value)
        lead, tail = (
            at_most(name, value * self.rate_hz)
            for name, value in (("before_s", before_s), ("after_s", after_s))
        )
        shift = lead / self.rate_hz
        moved = tuple(replace(s, start_s=s.start_s + shift, stop_s=s.stop_s + shift) for s in self.segments)
        return replace(self, samples=np.pad(self.samples, (lead, tail)), segments=moved)

    @checked
    def to_csv(self, path: str | Path) -> Path:
        """Write time [s] and deviation [rpm] for a signal generator; the file is written atomically."""
        text = io.StringIO()
        text.write("time_s,set_point_deviation_rpm\n")
        np.savetxt(text, np.column_stack([self.time, self.samples]), fmt="%.17g", delimiter=",")
        return write_text_atomically(ending_in(path, ".csv", ".txt"), text.getvalue())


MOST_PERIODS = 100_000


def repeated(
    name: str, kind: str, rate_hz: float, one_period: Array, periods: int, hold: Hold = "first"
) -> Excitation:
    """Repeat one period of samples [rpm]; each repetition is a segment."""
    if not 1 <= periods <= MOST_PERIODS:
        raise InputError(f"periods is {periods}, expected 1 to {MOST_PERIODS}")
    at_most("periods", periods * len(one_period))
    length = len(one_period) / rate_hz
    segments = tuple(Segment(f"period {k + 1}", k * length, (k + 1) * length) for k in range(periods))
    return Excitation(name, kind, rate_hz, np.tile(one_period, periods), hold, segments)


@checked
def join(excitations: Sequence[Excitation], *, pause_s: float = 0.0, name: str = "joined") -> Excitation:
    """Return excitations in sequence, with pauses at the operating point between them.

    Parameters
    ----------
    excitations
        Excitations to join, all with the same rate and hold.
    pause_s
        Length of each pause [s].
    name
        Label.

    Returns
    -------
    Excitation
        With the segments of all given excitations; an excitation without segments becomes one segment.

    Raises
    ------
    InputError
        If the parts differ in rate or hold.
    """
    if len(excitations) == 0:  # truth value of an empty array is ambiguous
        raise InputError("excitations is empty, expected at least one")
    zero_or_more("pause_s", pause_s)
    first = excitations[0]
    for part in excitations[1:]:
        if (part.rate_hz, part.hold) != (first.rate_hz, first.hold):
            raise InputError(
                f"excitation {part.name!r} has {part.rate_hz:g} Hz and hold {part.hold!r}, expected "
                f"{first.rate_hz:g} Hz and {first.hold!r} as {first.name!r} has"
            )
    pause = np.zeros(at_most("pause_s", pause_s * first.rate_hz))
    pieces: list[Array] = []
    segments: list[Segment] = []
    length = 0
    for part in excitations:
        start = length / first.rate_hz
        own = part.segments or (Segment(part.name, 0.0, part.duration),)
        segments += [
            replace(piece, start_s=start + piece.start_s, stop_s=start + piece.stop_s) for piece in own
        ]
        pieces += [part.samples, pause]
        length += len(part) + len(pause)
    return Excitation(name, "joined", first.rate_hz, np.concatenate(pieces[:-1]), first.hold, tuple(segments))
