"""Sinusoidal excitations: chirps, sequences of sines, and multisines."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt

from shipfp_rs import published
from shipfp_rs.errors import InputError
from shipfp_rs.signals.excitation import (
    Bands,
    Excitation,
    Segment,
    bands,
    below_nyquist,
    numbers,
    outside,
    repeated,
    sample_times,
    whole_samples,
)
from shipfp_rs.support.arguments import between, checked, positive
from shipfp_rs.support.arrays import Array

Law = Literal["linear", "logarithmic"]


@checked
def chirp(
    start_hz: float,
    stop_hz: float,
    duration_s: float,
    amplitude_rpm: float,
    law: Literal["linear", "logarithmic"] = "logarithmic",
    *,
    avoid_hz: Bands = (),
    rate_hz: float = 100.0,
    name: str = "chirp",
) -> Excitation:
    """Return a sine whose frequency changes from `start_hz` to `stop_hz` (section 5.1.2).

    It excites the whole range in one run, with the crest factor of a sine.

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
    avoid_hz
        Bands (low, high) around resonances [Hz], which the frequency skips. The phase is continuous at a skipped band,
        and the whole duration is spent outside the bands.
    rate_hz, name
        Sample rate [Hz] and label.
    """
    below_nyquist("start_hz", start_hz, rate_hz)
    below_nyquist("stop_hz", stop_hz, rate_hz)
    positive("amplitude_rpm", amplitude_rpm)
    time = sample_times(duration_s, rate_hz)
    pieces = _kept(start_hz, stop_hz, avoid_hz)
    measure = np.log if law == "logarithmic" else np.asarray
    shares = np.array([abs(measure(stop) - measure(start)) for start, stop in pieces])
    ends = duration_s * np.cumsum(shares) / shares.sum() if shares.sum() > 0.0 else np.array([duration_s])
    phase, turned, begun = np.empty_like(time), 0.0, 0.0
    for (start, stop), end in zip(pieces, ends, strict=True):
        # The last piece includes the last sample, in spite of rounding.
        inside = (time >= begun) & ((time < end) | (end == ends[-1]))
        phase[inside] = turned + _turns(time[inside] - begun, start, stop, end - begun, law)
        turned += float(_turns(np.array([end - begun]), start, stop, end - begun, law)[0])
        begun = end
    return Excitation(name, "chirp", rate_hz, amplitude_rpm * np.sin(2.0 * math.pi * phase))


def _kept(start_hz: float, stop_hz: float, avoid_hz: Bands) -> list[tuple[float, float]]:
    """Ranges from start to stop outside the bands, in the order of the sweep."""
    low, high = min(start_hz, stop_hz), max(start_hz, stop_hz)
    pieces, at = [], low
    for lower, upper in bands(avoid_hz):
        if upper <= low or lower > high:
            continue
        if at < lower:
            pieces.append((at, lower))
        at = max(at, upper)
    if at < high or low == high:
        pieces.append((at, high))
    if not pieces:
        raise InputError(
            f"the bands of avoid_hz {list(avoid_hz)} cover all of {low:g} to {high:g} Hz; narrow the bands"
        )
    return pieces if start_hz <= stop_hz else [(upper, lower) for lower, upper in reversed(pieces)]


def _turns(time: Array, start: float, stop: float, duration: float, law: Law) -> Array:
    """Phase [turns] since the start of a sweep: the integral of its frequency."""
    if law == "linear":
        return start * time + 0.5 * (stop - start) / duration * time**2
    rate = math.log(stop / start) / duration
    return start * np.expm1(rate * time) / rate if rate != 0.0 else start * time


MOST_ITERATIONS = 100_000
"""Largest number of rounds of clipping; the crest factor converges in far fewer."""


@checked
def sine_sequence(
    frequencies_hz: npt.ArrayLike,
    periods: float,
    amplitude_rpm: float,
    *,
    avoid_hz: Bands = (),
    rate_hz: float = 100.0,
    name: str = "sine sequence",
) -> Excitation:
    """Return sines in sequence, each for a whole number of periods (section 5.1.1).

    Parameters
    ----------
    frequencies_hz
        Frequencies in order [Hz], shape (F,), each below half the sample rate.
    periods
        Periods of each frequency, a whole number, so that the set point has no jumps.
    amplitude_rpm
        Amplitude [rpm].
    avoid_hz
        Bands (low, high) around resonances [Hz]; frequencies in them are omitted.
    rate_hz, name
        Sample rate [Hz] and label.

    Returns
    -------
    Excitation
        With one segment for each frequency.

    Examples
    --------
    >>> sine_sequence([0.1, 1.0], 4, 13.0).duration
    44.0
    """
    frequencies = outside(numbers("frequencies_hz", frequencies_hz), avoid_hz)
    positive("periods", periods)
    if periods != round(periods):
        raise InputError(f"periods is {periods:g}, expected a whole number; a fraction would end in a jump")
    positive("amplitude_rpm", amplitude_rpm)
    for index, frequency in enumerate(frequencies):
        below_nyquist(f"frequencies_hz[{index}]", frequency, rate_hz)
    stops = np.cumsum([periods / frequency for frequency in frequencies])
    starts = np.concatenate([[0.0], stops[:-1]])
    time = sample_times(float(stops[-1]), rate_hz)
    at = np.minimum(np.searchsorted(stops, time, side="right"), len(stops) - 1)
    phase = 2.0 * math.pi * np.array(frequencies)[at] * (time - starts[at])
    segments = tuple(
        Segment(f"{frequency:.4g} Hz", float(start), float(stop), frequency)
        for frequency, start, stop in zip(frequencies, starts, stops, strict=True)
    )
    return Excitation(name, "sines", rate_hz, amplitude_rpm * np.sin(phase), segments=segments)


@checked
def published_sine_sequence(amplitude_rpm: float = 13.0, *, rate_hz: float = 100.0) -> Excitation:
    """Return the sixteen sines of the virtual trial, four periods each (Table 5.1).

    The frequencies are computed from the printed times, which make each period a multiple of 0.01 s; the printed
    frequencies are rounded.
    """
    rows = published.virtual_schedule()
    frequencies = [4.0 / (row.end_s - row.begin_s) for row in rows]
    return sine_sequence(frequencies, 4, amplitude_rpm, rate_hz=rate_hz, name="virtual multisine")


@checked
def multisine(
    frequencies_hz: npt.ArrayLike,
    period_s: float,
    amplitude_rpm: float,
    *,
    weights: npt.ArrayLike | None = None,
    periods: int = 1,
    avoid_hz: Bands = (),
    rate_hz: float = 100.0,
    iterations: int = 300,
    name: str = "multisine",
) -> Excitation:
    """Return a sum of sines with phases that keep the crest factor low.

    One period excites all frequencies, and need not be longer than a period of the lowest frequency.

    Parameters
    ----------
    frequencies_hz
        Wanted frequencies [Hz], shape (F,), rounded to the nearest multiples of 1/period_s.
    period_s
        Period [s], a whole number of samples.
    amplitude_rpm
        Largest deviation [rpm].
    weights
        Relative amplitude of each frequency, shape (F,); None: all equal.
    periods
        Number of periods; the ship settles during the first.
    avoid_hz
        Bands (low, high) around resonances [Hz]; frequencies in them are omitted.
    rate_hz
        Sample rate [Hz].
    iterations
        Rounds of clipping; each cuts the peaks, keeps the new phases and restores the amplitudes. The crest factor
        reaches about 1.5 for evenly spaced lines and 2.5 for lines spread over decades.
    name
        Label.

    Returns
    -------
    Excitation
        With one segment for each period.

    Raises
    ------
    InputError
        If an argument is out of range, or two frequencies round to the same multiple.

    Notes
    -----
    Start: M. Schroeder, doi:10.1109/TIT.1970.1054411. Clipping: E. van der Ouderaa, J. Schoukens,
    J. Renneboog, IEEE Transactions on Instrumentation and Measurement 37 (1988) 145.

    Examples
    --------
    >>> multisine([0.1, 0.2, 0.3, 0.4], 10.0, 13.0).crest_factor < 2.0
    True
    """
    positive("amplitude_rpm", amplitude_rpm)
    wanted = numbers("frequencies_hz", frequencies_hz)
    sizes = np.ones(len(wanted)) if weights is None else np.array(numbers("weights", weights))
    if len(sizes) != len(wanted) or sizes.min() <= 0.0:
        raise InputError(
            f"weights are {weights!r}, expected {len(wanted)} positive numbers, one per frequency"
        )
    frequencies = outside(wanted, avoid_hz)
    sizes = np.array(
        [size for size, frequency in zip(sizes, wanted, strict=True) if frequency in frequencies]
    )
    samples = whole_samples("period_s", period_s, rate_hz)
    lines = [round(frequency * period_s) for frequency in frequencies]
    for index, (line, frequency) in enumerate(zip(lines, frequencies, strict=True)):
        below_nyquist(f"frequencies_hz[{index}]", frequency, rate_hz)
        if line < 1 or line in lines[:index] or 2 * line >= samples:
            raise InputError(
                f"frequencies_hz[{index}] is {frequency:g}, nearest multiple {line / period_s:g} of "
                "1/period_s, expected one per frequency, above zero and below half of rate_hz; lengthen period_s"
            )
    order = np.argsort(lines)
    between("iterations", iterations, 0, MOST_ITERATIONS)
    one_period = _flattened(np.array(lines)[order], sizes[order], samples, iterations)
    one_period *= amplitude_rpm / np.abs(one_period).max()
    return repeated(name, "multisine", rate_hz, one_period, periods)


def _flattened(lines: npt.NDArray[np.int64], sizes: Array, samples: int, iterations: int) -> Array:
    """One period of a sum of cosines at multiples of 1 / period, with the lowest crest factor that clipping finds."""
    # Schroeder's phases: each depends on the power of all lower lines. For F equal lines this is
    # pi k (k + 1) / F, apart from a shift in time.
    power = np.cumsum(sizes**2) / np.sum(sizes**2)
    phase = 2.0 * math.pi * (np.cumsum(power) - power[0])
    spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
    spectrum[lines] = sizes * np.exp(-1j * phase)
    best = trial = np.fft.irfft(spectrum, samples)
    for round_ in range(iterations):
        # Strong clipping in the first rounds leaves the initial local minimum; weak clipping in the last refines it.
        ceiling = (0.4 + 0.55 * round_ / iterations) * np.abs(trial).max()
        clipped = np.fft.rfft(np.clip(trial, -ceiling, ceiling))[lines]
        spectrum[lines] = sizes * np.exp(1j * np.angle(clipped))
        trial = np.fft.irfft(spectrum, samples)
        # All candidates have the same power, so the lowest peak is the lowest crest factor.
        if np.abs(trial).max() < np.abs(best).max():
            best = trial
    return best
