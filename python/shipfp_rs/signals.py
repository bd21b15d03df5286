"""Excitations: what is put on the set point of the engine speed, as deviations from the operating point."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import signal

from shipfp_rs import published
from shipfp_rs.errors import InputError
from shipfp_rs.experiment import Hold
from shipfp_rs.files import write_text_atomically

Array = npt.NDArray[np.float64]
Law = Literal["linear", "logarithmic"]

_LARGEST_SAMPLES = 200_000_000


@dataclass(frozen=True)
class Segment:
    """A stretch of an excitation: what it holds, from when to when [s], its frequency [Hz] if it has one."""

    label: str
    start_s: float
    stop_s: float
    frequency_hz: float | None = None


@dataclass(frozen=True, eq=False)
class Excitation:
    """Deviations of the set point, uniformly sampled.

    Parameters
    ----------
    name, kind
        Label, and kind of signal for tables ("chirp", "steps", ...).
    rate_hz
        Sample rate [Hz].
    samples
        Deviation of the set point from the operating point [rpm of the engine], shape (N,).
    hold
        How the set point runs between samples: "first" (straight lines) or "zero" (stairs).
    segments
        Stretches that are analysed one by one; empty where the excitation is one piece.
    """

    name: str
    kind: str
    rate_hz: float
    samples: Array
    hold: Hold = "first"
    segments: tuple[Segment, ...] = ()

    def __post_init__(self) -> None:
        _positive("rate_hz", self.rate_hz)
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

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def time(self) -> Array:
        """Time from the first sample [s], shape (N,)."""
        return np.arange(len(self)) / self.rate_hz

    @property
    def duration(self) -> float:
        """Length [s]."""
        return len(self) / self.rate_hz

    @property
    def amplitude_rpm(self) -> float:
        """Largest deviation [rpm]."""
        return float(np.abs(self.samples).max())

    @property
    def crest_factor(self) -> float:
        """Largest deviation over root mean square [-]: 1.41 for a sine; low: much power, little motion."""
        rms = float(np.sqrt(np.mean(self.samples**2)))
        return self.amplitude_rpm / rms if rms > 0.0 else math.nan

    def to_csv(self, path: str | Path) -> Path:
        """Write time [s] and deviation [rpm] for a signal generator; the file appears whole or not at all."""
        text = io.StringIO()
        text.write("time_s,set_point_deviation_rpm\n")
        np.savetxt(text, np.column_stack([self.time, self.samples]), fmt="%.17g", delimiter=",")
        return write_text_atomically(Path(path), text.getvalue())


def sine_sequence(
    frequencies_hz: npt.ArrayLike,
    periods: float,
    amplitude_rpm: float,
    *,
    rate_hz: float = 100.0,
    name: str = "sine sequence",
) -> Excitation:
    """Return sines one after the other, each for a whole number of periods (section 5.1.1).

    Parameters
    ----------
    frequencies_hz
        Frequencies in order [Hz], each below half the sample rate.
    periods
        Periods of each, a whole number, so that the set point has no jumps.
    amplitude_rpm
        Amplitude [rpm].
    rate_hz
        Sample rate [Hz].
    name
        Label.

    Returns
    -------
    Excitation
        With one segment for each frequency.

    Raises
    ------
    InputError
        Where an argument is out of its range.

    Examples
    --------
    >>> sine_sequence([0.1, 1.0], 4, 13.0).duration
    44.0
    """
    frequencies = _numbers("frequencies_hz", frequencies_hz)
    _positive("periods", periods)
    if periods != round(periods):
        raise InputError(
            f"periods is {periods:g}, expected a whole number; a part of one would end in a jump"
        )
    _positive("amplitude_rpm", amplitude_rpm)
    for index, frequency in enumerate(frequencies):
        _below_nyquist(f"frequencies_hz[{index}]", frequency, rate_hz)
    stops = np.cumsum([periods / frequency for frequency in frequencies])
    starts = np.concatenate([[0.0], stops[:-1]])
    time = _time(float(stops[-1]), rate_hz)
    at = np.minimum(np.searchsorted(stops, time, side="right"), len(stops) - 1)
    phase = 2.0 * math.pi * np.array(frequencies)[at] * (time - starts[at])
    segments = tuple(
        Segment(f"{frequency:.4g} Hz", float(start), float(stop), frequency)
        for frequency, start, stop in zip(frequencies, starts, stops, strict=True)
    )
    return Excitation(name, "sines", rate_hz, amplitude_rpm * np.sin(phase), segments=segments)


def published_sine_sequence(amplitude_rpm: float = 13.0, *, rate_hz: float = 100.0) -> Excitation:
    """Return the sixteen sines of the virtual trial, four periods each (Table 5.1).

    The frequencies are those of the printed times, of which a period holds whole hundredths of a second; the
    printed frequencies are rounded.
    """
    rows = published.virtual_schedule()
    frequencies = [4.0 / (row.end_s - row.begin_s) for row in rows]
    return sine_sequence(frequencies, 4, amplitude_rpm, rate_hz=rate_hz, name="virtual multisine")


def multisine(
    frequencies_hz: npt.ArrayLike,
    period_s: float,
    amplitude_rpm: float,
    *,
    periods: int = 1,
    rate_hz: float = 100.0,
    iterations: int = 300,
    name: str = "multisine",
) -> Excitation:
    """Return all frequencies at once, of equal amplitude, with phases that keep the crest factor low.

    Parameters
    ----------
    frequencies_hz
        Wanted frequencies [Hz]; each moves to the nearest multiple of 1/period_s.
    period_s
        Period [s], a whole number of samples.
    amplitude_rpm
        Largest deviation [rpm].
    periods
        Number of periods; the first one lets the ship settle.
    rate_hz
        Sample rate [Hz].
    iterations
        Rounds of clipping; each cuts the peaks, keeps the new phases and restores the amplitudes. Evenly
        spaced lines reach a crest factor near 1.5, lines spread over decades near 2.5.
    name
        Label.

    Returns
    -------
    Excitation
        With one segment for each period.

    Raises
    ------
    InputError
        Where an argument is out of its range, or two frequencies fall on one multiple.

    Notes
    -----
    Start: M. Schroeder, doi:10.1109/TIT.1970.1054411. Clipping: E. van der Ouderaa, J. Schoukens,
    J. Renneboog, IEEE Transactions on Instrumentation and Measurement 37 (1988) 145.

    Examples
    --------
    >>> multisine([0.1, 0.2, 0.3, 0.4], 10.0, 13.0).crest_factor < 2.0
    True
    """
    _positive("period_s", period_s)
    _positive("amplitude_rpm", amplitude_rpm)
    if periods < 1:
        raise InputError(f"periods is {periods}, expected 1 or more")
    frequencies = _numbers("frequencies_hz", frequencies_hz)
    samples = len(_time(period_s, rate_hz))
    if not math.isclose(samples, period_s * rate_hz, rel_tol=1e-9):
        raise InputError(
            f"period_s is {period_s:g}, {period_s * rate_hz:g} samples, expected a whole number of samples"
        )
    lines = [round(frequency * period_s) for frequency in frequencies]
    for index, (line, frequency) in enumerate(zip(lines, frequencies, strict=True)):
        _below_nyquist(f"frequencies_hz[{index}]", frequency, rate_hz)
        if line < 1 or line in lines[:index] or 2 * line >= samples:
            raise InputError(
                f"frequencies_hz[{index}] is {frequency:g}, nearest multiple {line / period_s:g} of "
                "1/period_s, expected one of its own between zero and half of rate_hz; take a longer period"
            )
    lines.sort()
    one_period = _flattened(np.array(lines), samples, iterations)
    tones = np.tile(amplitude_rpm / np.abs(one_period).max() * one_period, periods)
    segments = tuple(Segment(f"period {k + 1}", k * period_s, (k + 1) * period_s) for k in range(periods))
    return Excitation(name, "multisine", rate_hz, tones, segments=segments)


def _flattened(lines: npt.NDArray[np.int64], samples: int, iterations: int) -> Array:
    """One period of equal cosines on the given lines, with the lowest crest factor that clipping found."""
    order = np.arange(len(lines))
    spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
    spectrum[lines] = np.exp(-1j * math.pi * order * (order + 1) / len(lines))
    best = trial = np.fft.irfft(spectrum, samples)
    for round_ in range(iterations):
        # Cutting more at first leaves the start's local minimum, cutting less at last refines.
        ceiling = (0.4 + 0.55 * round_ / iterations) * np.abs(trial).max()
        clipped = np.fft.rfft(np.clip(trial, -ceiling, ceiling))[lines]
        spectrum[lines] = np.exp(1j * np.angle(clipped))
        trial = np.fft.irfft(spectrum, samples)
        # All trials have the same power, so the lowest peak is the lowest crest factor.
        if np.abs(trial).max() < np.abs(best).max():
            best = trial
    return best


def chirp(
    start_hz: float,
    stop_hz: float,
    duration_s: float,
    amplitude_rpm: float,
    law: Law = "logarithmic",
    *,
    rate_hz: float = 100.0,
    name: str = "chirp",
) -> Excitation:
    """Return a sine whose frequency runs from `start_hz` to `stop_hz` (section 5.1.2).

    Parameters
    ----------
    start_hz, stop_hz
        Frequencies at the ends [Hz], below half the sample rate.
    duration_s
        Length [s].
    amplitude_rpm
        Amplitude [rpm].
    law
        "linear": equal time for each Hz; "logarithmic": equal time for each decade.
    rate_hz
        Sample rate [Hz].
    name
        Label.

    Raises
    ------
    InputError
        Where an argument is out of its range.
    """
    _below_nyquist("start_hz", start_hz, rate_hz)
    _below_nyquist("stop_hz", stop_hz, rate_hz)
    _positive("amplitude_rpm", amplitude_rpm)
    if law not in ("linear", "logarithmic"):
        raise InputError(f"law is {law!r}, expected 'linear' or 'logarithmic'")
    time = _time(duration_s, rate_hz)
    wave = signal.chirp(time, start_hz, duration_s, stop_hz, method=law, phi=-90.0)
    return Excitation(name, "chirp", rate_hz, amplitude_rpm * wave)


def steps(
    sizes_rpm: npt.ArrayLike,
    hold_s: float,
    *,
    lead_s: float = 0.0,
    rate_hz: float = 100.0,
    name: str = "steps",
) -> Excitation:
    """Return steps one upon the other, each held (section 5.1.3).

    Parameters
    ----------
    sizes_rpm
        Size of each step [rpm], up or down from the level before.
    hold_s
        Time at each level [s].
    lead_s
        Time at the operating point before the first step [s].
    rate_hz
        Sample rate [Hz].
    name
        Label.

    Raises
    ------
    InputError
        Where an argument is out of its range.

    Examples
    --------
    >>> steps([65.0, -65.0], 1.0, rate_hz=2.0).samples.tolist()
    [65.0, 65.0, 0.0, 0.0]
    """
    sizes = _numbers("sizes_rpm", sizes_rpm)
    if not (math.isfinite(lead_s) and lead_s >= 0.0):
        raise InputError(f"lead_s is {lead_s}, expected zero or more")
    hold, lead = len(_time(hold_s, rate_hz)), round(lead_s * rate_hz)
    levels = np.repeat(np.cumsum(sizes), hold)
    return Excitation(name, "steps", rate_hz, np.concatenate([np.zeros(lead), levels]), hold="zero")


def prbs(
    order: int,
    bit_s: float,
    amplitude_rpm: float,
    *,
    periods: int = 1,
    seed: int = 0,
    rate_hz: float = 100.0,
    name: str = "PRBS",
) -> Excitation:
    """Return a pseudo-random binary sequence of greatest length, 2^order - 1 bits a period.

    Parameters
    ----------
    order
        Length of the shift register, 2 to 20.
    bit_s
        Length of a bit [s], a whole number of samples.
    amplitude_rpm
        Deviation, up or down [rpm].
    periods
        Number of periods.
    seed
        Chooses where in the sequence the signal starts.
    rate_hz
        Sample rate [Hz].
    name
        Label.

    Returns
    -------
    Excitation
        With one segment for each period.

    Raises
    ------
    InputError
        Where an argument is out of its range.
    """
    if not 2 <= order <= 20:
        raise InputError(f"order is {order}, expected 2 to 20")
    if periods < 1:
        raise InputError(f"periods is {periods}, expected 1 or more")
    _positive("amplitude_rpm", amplitude_rpm)
    _positive("bit_s", bit_s)
    bit = round(bit_s * rate_hz)
    if bit < 1 or not math.isclose(bit, bit_s * rate_hz, rel_tol=1e-9):
        raise InputError(
            f"bit_s is {bit_s:g}, {bit_s * rate_hz:g} samples, expected a whole number of samples"
        )
    sequence, _ = signal.max_len_seq(order)
    start = int(np.random.default_rng(seed).integers(len(sequence)))
    one_period = np.repeat(amplitude_rpm * (2.0 * np.roll(sequence, -start) - 1.0), bit)
    length = len(one_period) / rate_hz
    segments = tuple(Segment(f"period {k + 1}", k * length, (k + 1) * length) for k in range(periods))
    return Excitation(name, "prbs", rate_hz, np.tile(one_period, periods), hold="zero", segments=segments)


def band_limited_noise(
    low_hz: float,
    high_hz: float,
    duration_s: float,
    rms_rpm: float,
    *,
    seed: int,
    rate_hz: float = 100.0,
    name: str = "noise",
) -> Excitation:
    """Return Gaussian noise whose spectrum is flat between two frequencies and empty outside.

    Parameters
    ----------
    low_hz, high_hz
        Band [Hz]; at least one multiple of 1/duration_s lies in it.
    duration_s
        Length [s], also the period.
    rms_rpm
        Root mean square [rpm].
    seed
        Seed of the draw.
    rate_hz
        Sample rate [Hz].
    name
        Label.

    Raises
    ------
    InputError
        Where an argument is out of its range.
    """
    _below_nyquist("low_hz", low_hz, rate_hz)
    _below_nyquist("high_hz", high_hz, rate_hz)
    _positive("rms_rpm", rms_rpm)
    samples = len(_time(duration_s, rate_hz))
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(samples))
    frequency = np.fft.rfftfreq(samples, 1.0 / rate_hz)
    spectrum[(frequency < low_hz) | (frequency > high_hz)] = 0.0
    if not spectrum.any():
        raise InputError(
            f"the band {low_hz:g} to {high_hz:g} Hz holds no multiple of 1/duration_s, "
            f"{1.0 / duration_s:g} Hz; give low_hz below high_hz and a longer duration"
        )
    noise = np.fft.irfft(spectrum, samples)
    return Excitation(name, "noise", rate_hz, rms_rpm / np.sqrt(np.mean(noise**2)) * noise)


def join(excitations: Sequence[Excitation], *, pause_s: float = 0.0, name: str = "joined") -> Excitation:
    """Return excitations one after the other, with pauses at the operating point between them.

    Parameters
    ----------
    excitations
        What to join, all of one rate and hold.
    pause_s
        Length of each pause [s].
    name
        Label.

    Returns
    -------
    Excitation
        With a segment for each part, or its parts' own segments where they have some.

    Raises
    ------
    InputError
        Where the parts do not go together.
    """
    if not excitations:
        raise InputError("excitations is empty, expected at least one")
    if not (math.isfinite(pause_s) and pause_s >= 0.0):
        raise InputError(f"pause_s is {pause_s}, expected zero or more")
    first = excitations[0]
    for part in excitations[1:]:
        if (part.rate_hz, part.hold) != (first.rate_hz, first.hold):
            raise InputError(
                f"excitation {part.name!r} has {part.rate_hz:g} Hz and hold {part.hold!r}, expected "
                f"{first.rate_hz:g} Hz and {first.hold!r} as {first.name!r} has"
            )
    pause = np.zeros(round(pause_s * first.rate_hz))
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


def _time(duration_s: float, rate_hz: float) -> Array:
    """Sample times of a stretch, at least one."""
    _positive("duration", duration_s)
    _positive("rate_hz", rate_hz)
    samples = duration_s * rate_hz
    if not 1.0 <= samples + 0.5 <= _LARGEST_SAMPLES:
        raise InputError(
            f"{duration_s:g} s at {rate_hz:g} Hz are {samples:.3g} samples, expected 1 to {_LARGEST_SAMPLES}"
        )
    return np.arange(round(samples)) / rate_hz


def _numbers(name: str, values: npt.ArrayLike) -> list[float]:
    numbers = np.array(values, dtype=np.float64)
    if numbers.ndim != 1 or not numbers.size or not np.isfinite(numbers).all():
        raise InputError(f"{name} is {values!r}, expected a list of at least one finite number")
    return [float(number) for number in numbers]


def _positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} is {value}, expected a positive number")


def _below_nyquist(name: str, frequency: float, rate_hz: float) -> None:
    _positive(name, frequency)
    _positive("rate_hz", rate_hz)
    if frequency >= 0.5 * rate_hz:
        raise InputError(
            f"{name} is {frequency:g} Hz, expected less than half of rate_hz {rate_hz:g}; sample faster"
        )
