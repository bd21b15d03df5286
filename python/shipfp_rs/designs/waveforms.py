"""Waveforms of a design (sines in sequence or simultaneous, a chirp, steps), and their limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from shipfp_rs import signals
from shipfp_rs.designs.spectrum import Criterion, Lines, best_sweep, optimal_shares, support
from shipfp_rs.errors import InputError
from shipfp_rs.signals import Excitation
from shipfp_rs.signals.excitation import bands
from shipfp_rs.support.arguments import positive
from shipfp_rs.support.arrays import Array, Mask
from shipfp_rs.support.units import Calibration

RATES_HZ = (100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0)
"""Sample rates to try, highest first; ships respond up to a few hertz."""
SAMPLES_A_PERIOD = 10.0
"""Least number of samples per period: linear interpolation is then within 5 % of a sine."""
TOP_HZ = 5.0
"""Highest useful frequency, limited by pulse trains and governors."""


@dataclass(frozen=True)
class Generator:
    """Arbitrary-waveform generator on the set-point line.

    Parameters
    ----------
    calibration
        Conversion of the generator's volts to the set point [rpm], as in eq. 6.7.
    lowest_V, highest_V
        Range of the output [V].
    """

    calibration: Calibration
    lowest_V: float = -10.0
    highest_V: float = 10.0

    def __post_init__(self) -> None:
        if not self.lowest_V < self.highest_V:
            raise InputError(
                f"generator: range {self.lowest_V:g} to {self.highest_V:g} V, expected low before high"
            )

    def volts(self, set_point_rpm: Array) -> Array:
        """Volts for a set point (N,); `InputError` if they are outside the output's range."""
        volts = self.calibration.inverse(set_point_rpm)
        if volts.min() < self.lowest_V or volts.max() > self.highest_V:
            raise InputError(
                f"the set point {set_point_rpm.min():.6g} to {set_point_rpm.max():.6g} rpm needs {volts.min():.4g} to "
                f"{volts.max():.4g} V, expected {self.lowest_V:g} to {self.highest_V:g} V; lower the amplitude or check "
                "the calibration"
            )
        return volts


@dataclass(frozen=True)
class Limits:
    """Limits of a trial.

    Parameters
    ----------
    amplitude_rpm
        Largest deviation of the set point [rpm of the engine].
    rate_rpm_s
        Largest rate of change of the set point [rpm/s]; None: unlimited.
    avoid_hz
        Bands (low, high) around resonances [Hz].
    lowest_hz, highest_hz
        Lowest and highest frequency of the set point [Hz]; None: two periods in the available time, and 5 Hz.
    longest_samples
        Longest waveform that fits the generator; None: unlimited.
    """

    amplitude_rpm: float
    rate_rpm_s: float | None = None
    avoid_hz: tuple[tuple[float, float], ...] = ()
    lowest_hz: float | None = None
    highest_hz: float | None = None
    longest_samples: int | None = None

    def __post_init__(self) -> None:
        positive("amplitude_rpm", self.amplitude_rpm)
        for name in ("rate_rpm_s", "lowest_hz", "highest_hz", "longest_samples"):
            if getattr(self, name) is not None:
                positive(name, getattr(self, name))
        object.__setattr__(self, "avoid_hz", tuple(bands(self.avoid_hz)))

    def sample_rate(self, duration_s: float) -> float:
        """Highest sample rate [Hz] whose waveform fits the generator; `InputError` if none does or it is too low."""
        for rate in RATES_HZ:
            if self.longest_samples is None or duration_s * rate <= self.longest_samples:
                break
        else:
            raise InputError(
                f"longest_samples is {self.longest_samples}, {duration_s:g} s at {RATES_HZ[-1]:g} Hz are "
                f"{duration_s * RATES_HZ[-1]:.0f}; shorten the trial or split it"
            )
        if self.highest_hz is not None and self.highest_hz * SAMPLES_A_PERIOD > rate:
            raise InputError(
                f"highest_hz is {self.highest_hz:g}, expected at most {rate / SAMPLES_A_PERIOD:g}: ten samples a "
                f"period, and {duration_s:g} s within the generator's "
                + (f"{self.longest_samples} samples" if self.longest_samples else f"{rate:g} Hz")
            )
        return rate

    def span(self, duration_s: float, rate_hz: float) -> tuple[float, float]:
        """Lowest and highest frequency [Hz]."""
        low = self.lowest_hz or 2.0 / duration_s
        high = self.highest_hz or min(TOP_HZ, rate_hz / SAMPLES_A_PERIOD)
        if low >= high:
            raise InputError(
                f"frequencies from {low:.4g} to {high:.4g} Hz, expected the lower one first; lengthen the trial or "
                "allow a longer waveform"
            )
        return low, high

    def amplitude_at(self, frequency_hz: Array) -> Array:
        """Largest amplitude of a sine within the rate limit [rpm], shape (F,)."""
        steepest = math.inf if self.rate_rpm_s is None else self.rate_rpm_s
        return np.minimum(self.amplitude_rpm, steepest / (2.0 * math.pi * frequency_hz))

    def outside(self, frequency_hz: Array) -> Mask:
        """Whether each frequency (F,) is outside all excluded bands."""
        inside = [(low <= frequency_hz) & (frequency_hz <= high) for low, high in self.avoid_hz]
        return ~np.any(inside, axis=0) if inside else np.ones(len(frequency_hz), dtype=bool)

    def within(self, excitation: Excitation) -> float:
        """Factor, at most 1, by which an excitation must be scaled to respect amplitude and rate of change."""
        factor = self.amplitude_rpm / excitation.amplitude_rpm
        if self.rate_rpm_s is not None:
            factor = min(factor, self.rate_rpm_s / steepest_rpm_s(excitation))
        # Exceeding a limit by rounding is permitted.
        return 1.0 if factor > 1.0 - 1e-9 else factor


def steepest_rpm_s(excitation: Excitation) -> float:
    """Largest rate of change of an excitation [rpm/s]."""
    return float(np.abs(np.diff(excitation.samples)).max() * excitation.rate_hz)


Kind = Literal["sines", "squares", "multisine", "chirp", "mix"]
Part = Literal["sines", "squares", "multisine", "chirp", "steps"]

PARTS: Mapping[Kind, Mapping[Part, float]] = {
    "sines": {"sines": 1.0},
    "squares": {"squares": 1.0},
    "multisine": {"multisine": 1.0},
    "chirp": {"chirp": 1.0},
    "mix": {"sines": 0.6, "chirp": 0.25, "steps": 0.15},
}
"""Parts of each kind and their shares of the time.

In a mix, the sines are the most informative part, the chirp reveals unexpected behaviour, and the steps are for
validation and not fitted. Section 6.5.2 recommends the three in one signal.
"""
LEVELS = (1.0, -1.0, -1.0, 1.0)
"""Sizes of the steps for validation, relative to the amplitude: up, back, down, back."""


@dataclass(frozen=True)
class Setting:
    """Requirements for a waveform: candidate lines, optimal shares, limits, sample rate [Hz]."""

    lines: Lines
    shares: Array
    limits: Limits
    criterion: Criterion
    rate_hz: float

    @classmethod
    def of(cls, lines: Lines, limits: Limits, criterion: Criterion, rate_hz: float) -> tuple[Setting, float]:
        """Optimise each line's share of time or power; return a setting with these shares, and their efficiency."""
        shares, efficiency = optimal_shares(lines, criterion)
        return cls(lines, shares, limits, criterion, rate_hz), efficiency


def settling(kind: Kind, settle_s: float) -> float:
    """Total settling time of a plan [s], before, between and after its parts."""
    return settle_s * (len(PARTS[kind]) + 1)


def waveform(kind: Kind, setting: Setting, duration_s: float, settle_s: float) -> Excitation:
    """Time series of a plan, with settling before, between and after its parts; `InputError` if the time is too short."""
    parts = PARTS[kind]
    rest = settling(kind, settle_s)
    if duration_s <= 2.0 * rest:
        raise InputError(
            f"duration_s is {duration_s:g}, of which {rest:g} s are settling time; expected more than twice that time, or a "
            "shorter settle_s"
        )
    built = []
    for part, share in parts.items():
        made = BUILDERS[part](setting, share * (duration_s - rest))
        factor = setting.limits.within(made)
        built.append(replace(made, samples=factor * made.samples, hold="first"))
    whole = signals.join(built, pause_s=settle_s, name=kind).settled(settle_s, settle_s)
    return replace(whole, samples=setting.limits.within(whole) * whole.samples)


def _sines(setting: Setting, duration_s: float) -> Excitation:
    frequencies, shares = support(setting.lines, setting.shares)
    times = np.floor(shares * duration_s * setting.rate_hz) / setting.rate_hz
    periods = np.maximum(np.round(times * frequencies), 1.0)
    # Frequencies are adjusted slightly, so that whole periods fill the time, except where the adjusted frequency is in
    # an excluded band.
    moved = periods / np.maximum(times, 1.0 / setting.rate_hz)
    periods = np.where(setting.limits.outside(moved), periods, np.floor(times * frequencies))
    frequencies = np.where(setting.limits.outside(moved), moved, frequencies)
    if not periods.any():
        raise InputError(
            f"duration_s is {duration_s:.4g}, expected room for a period of a sine of up to {frequencies.max():.4g} Hz; "
            "make the trial longer"
        )
    amplitudes = setting.limits.amplitude_at(frequencies)
    parts = [
        signals.sine_sequence([frequency], count, amplitude, rate_hz=setting.rate_hz)
        for frequency, count, amplitude in zip(frequencies, periods, amplitudes, strict=True)
        if count
    ]
    return signals.join(parts, name="sines")


def _squares(setting: Setting, duration_s: float) -> Excitation:
    made = _sines(setting, duration_s)
    # The samples are rounded, so that a zero crossing has sign 0 in spite of rounding errors.
    level = np.sign(np.round(made.samples / setting.limits.amplitude_rpm, 9))
    return replace(made, name="squares", samples=setting.limits.amplitude_rpm * level)


def _multisine(setting: Setting, duration_s: float) -> Excitation:
    period_s = math.floor(duration_s * setting.rate_hz) / setting.rate_hz
    frequencies, shares = support(setting.lines, setting.shares)
    places = np.maximum(np.round(frequencies * period_s), 1.0)
    # Lines that round to the same multiple are merged.
    lines = np.unique(places)
    weights = np.array([np.sqrt(shares[places == line].sum()) for line in lines])
    amplitudes = setting.limits.amplitude_at(lines / period_s)
    made = signals.multisine(
        lines / period_s,
        period_s,
        setting.limits.amplitude_rpm,
        weights=weights * amplitudes,
        rate_hz=setting.rate_hz,
    )
    # The periodic signal is rotated to start at a zero crossing, so that the set point does not jump.
    start = int(np.argmin(np.abs(made.samples)))
    return replace(made, samples=np.roll(made.samples, -start), segments=())


def _chirp(setting: Setting, duration_s: float) -> Excitation:
    start, stop, law = best_sweep(setting.lines, setting.criterion)
    made = signals.chirp(
        start,
        stop,
        duration_s,
        float(setting.limits.amplitude_at(np.array([stop]))[0]),
        law,
        avoid_hz=setting.limits.avoid_hz,
        rate_hz=setting.rate_hz,
        name=f"{law} chirp, {start:.3g} to {stop:.3g} Hz",
    )
    # The chirp ends at its last zero crossing, so that the set point does not jump back to the operating point.
    crossings = np.flatnonzero(np.diff(np.signbit(made.samples)))
    if not crossings.size:
        raise InputError(
            f"a chirp from {start:.3g} to {stop:.3g} Hz, the range within the limits, has no zero crossing in "
            f"{duration_s:.4g} s; make the trial longer, allow a larger rate of change, or lower the amplitude"
        )
    last = int(crossings[-1])
    return replace(made, samples=np.where(np.arange(len(made)) <= last, made.samples, 0.0))


def _steps(setting: Setting, duration_s: float) -> Excitation:
    limits, rate = setting.limits, setting.rate_hz
    hold = math.floor(duration_s / len(LEVELS) * rate) / rate
    smooth = _smoothing_s(limits)
    if smooth > 0.5 * hold:
        raise InputError(
            f"steps of {hold:.3g} s, each smoothed over {smooth:.3g} s to respect rate of change and excluded bands, "
            "expected smoothing over at most half a step; make the trial longer or choose kind 'sines'"
        )
    made = signals.steps(limits.amplitude_rpm * np.array(LEVELS), hold, rate_hz=rate, name="steps")
    count = round(smooth * rate)
    if count < 2:
        return made
    kernel = np.hanning(count + 2)[1:-1]
    smoothed = np.convolve(made.samples, kernel / kernel.sum())[: len(made)]
    return replace(made, samples=smoothed)


def _smoothing_s(limits: Limits) -> float:
    """Length of the Hann window [s] that smooths steps, so that they respect the rate limit and the excluded bands."""
    # A unit step smoothed over a length L has a slope of at most 2 / L. The window's gain is below 1/200 above 4 / L.
    for_rate = 0.0 if limits.rate_rpm_s is None else 2.0 * limits.amplitude_rpm / limits.rate_rpm_s
    for_bands = 4.0 / max(limits.avoid_hz[0][0], 1e-3) if limits.avoid_hz else 0.0
    return max(for_rate, for_bands)


BUILDERS: Mapping[Part, Callable[[Setting, float], Excitation]] = {
    "sines": _sines,
    "squares": _squares,
    "multisine": _multisine,
    "chirp": _chirp,
    "steps": _steps,
}
