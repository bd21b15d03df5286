"""Waveforms of a design: sines in sequence or simultaneous, a chirp, steps, joined to one time series."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from shipfp_rs import signals
from shipfp_rs.designs.limits import Limits
from shipfp_rs.designs.spectrum import Criterion, Lines, best_sweep, optimal_shares, support
from shipfp_rs.errors import InputError
from shipfp_rs.signals import Excitation
from shipfp_rs.support.arrays import Array

Kind = Literal["sines", "squares", "multisine", "chirp", "mix"]
Part = Literal["sines", "squares", "multisine", "chirp", "steps"]

PARTS: Mapping[Kind, Mapping[Part, float]] = {
    "sines": {"sines": 1.0},
    "squares": {"squares": 1.0},
    "multisine": {"multisine": 1.0},
    "chirp": {"chirp": 1.0},
    "mix": {"sines": 0.6, "chirp": 0.25, "steps": 0.15},
}
"""Parts of each kind and their shares of the time. In a mix the sines are the most informative, the chirp reveals unexpected
behaviour, and the steps, which are not fitted, validate (section 6.5.2 recommends the three in one signal).
"""
LEVELS = (1.0, -1.0, -1.0, 1.0)
"""Steps of the validation in amplitudes: up, back, down, back."""


@dataclass(frozen=True)
class Setting:
    """Requirements of a waveform: candidate lines, optimal shares, limits, sample rate [Hz]."""

    lines: Lines
    shares: Array
    limits: Limits
    criterion: Criterion
    rate_hz: float

    @classmethod
    def of(cls, lines: Lines, limits: Limits, criterion: Criterion, rate_hz: float) -> tuple[Setting, float]:
        """Optimise the share of each line; return the setting and the efficiency of these shares."""
        shares, efficiency = optimal_shares(lines, criterion)
        return cls(lines, shares, limits, criterion, rate_hz), efficiency


def settling(kind: Kind, settle_s: float) -> float:
    """Settling time in a plan, before, between and after its parts [s]."""
    return settle_s * (len(PARTS[kind]) + 1)


def waveform(kind: Kind, setting: Setting, duration_s: float, settle_s: float) -> Excitation:
    """Time series of a plan, with settling before, between and after its parts; `InputError` if the time is too short."""
    parts = PARTS[kind]
    rest = settling(kind, settle_s)
    if duration_s <= 2.0 * rest:
        raise InputError(
            f"duration_s is {duration_s:g}, {rest:g} s of it to settle; expected more than twice that, or a shorter settle_s"
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
    # Frequencies are adjusted slightly to fill the time with whole periods, unless this moves them into a band.
    moved = periods / np.maximum(times, 1.0 / setting.rate_hz)
    periods = np.where(setting.limits.outside(moved), periods, np.floor(times * frequencies))
    frequencies = np.where(setting.limits.outside(moved), moved, frequencies)
    if not periods.any():
        raise InputError(
            f"{duration_s:.4g} s hold no period of the sines wanted, the fastest {frequencies.max():.4g} Hz; "
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
    # Rounding errors at a crossing are not a sign.
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
    # A period may start anywhere; at a zero crossing the set point does not jump.
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
    # It ends at the last zero crossing, without a jump back to the operating point.
    crossings = np.flatnonzero(np.diff(np.signbit(made.samples)))
    if not crossings.size:
        raise InputError(
            f"a chirp from {start:.3g} to {stop:.3g} Hz, what the limits leave, does not turn in {duration_s:.4g} s; make "
            "the trial longer, allow a larger rate of change, or lower the amplitude"
        )
    last = int(crossings[-1])
    return replace(made, samples=np.where(np.arange(len(made)) <= last, made.samples, 0.0))


def _steps(setting: Setting, duration_s: float) -> Excitation:
    limits, rate = setting.limits, setting.rate_hz
    hold = math.floor(duration_s / len(LEVELS) * rate) / rate
    smooth = _smoothing_s(limits)
    if smooth > 0.5 * hold:
        raise InputError(
            f"steps of {hold:.3g} s, each {smooth:.3g} s long to keep to the rate of change and out of the bands; make "
            "the trial longer or choose kind 'sines'"
        )
    made = signals.steps(limits.amplitude_rpm * np.array(LEVELS), hold, rate_hz=rate, name="steps")
    count = round(smooth * rate)
    if count < 2:
        return made
    kernel = np.hanning(count + 2)[1:-1]
    smoothed = np.convolve(made.samples, kernel / kernel.sum())[: len(made)]
    return replace(made, samples=smoothed)


def _smoothing_s(limits: Limits) -> float:
    """Length of the Hann window [s] that smooths steps: long enough for the rate limit, and without power in the bands.

    A step smoothed over L is at most 2 / L steep; from 4 / L up the window passes less than a two-hundredth.
    """
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
