"""Excitations with jumps or random samples: binary sequences, band-limited noise, steps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import signal

from shipfp_rs.errors import InputError
from shipfp_rs.signals.excitation import (
    Bands,
    Excitation,
    bands,
    below_nyquist,
    numbers,
    repeated,
    sample_times,
    whole_samples,
    zero_or_more,
)
from shipfp_rs.support.arguments import Whole, at_most, checked, positive


@checked
def prbs(
    order: int,
    bit_s: float,
    amplitude_rpm: float,
    *,
    periods: int = 1,
    seed: Whole = 0,
    rate_hz: float = 100.0,
    name: str = "PRBS",
) -> Excitation:
    """Return a maximum-length pseudo-random binary sequence, with 2^order - 1 bits per period.

    No signal of the same amplitude has more power, but much of it lies at frequencies that a ship does not follow.

    Parameters
    ----------
    order
        Length of the shift register, 2 to 20.
    bit_s
        Duration of a bit [s], a whole number of samples.
    amplitude_rpm
        Deviation in either direction [rpm].
    periods
        Number of periods.
    seed
        Seed that selects the start within the sequence.
    rate_hz, name
        Sample rate [Hz] and label.

    Returns
    -------
    Excitation
        With one segment for each period.
    """
    if not 2 <= order <= 20:
        raise InputError(f"order is {order}, expected 2 to 20")
    positive("amplitude_rpm", amplitude_rpm)
    bit = whole_samples("bit_s", bit_s, rate_hz)
    at_most("bit_s", bit * 2**order)
    sequence, _ = signal.max_len_seq(order)
    start = int(np.random.default_rng(seed).integers(len(sequence)))
    one_period = np.repeat(amplitude_rpm * (2.0 * np.roll(sequence, -start) - 1.0), bit)
    return repeated(name, "prbs", rate_hz, one_period, periods, hold="zero")


@checked
def band_limited_noise(
    low_hz: float,
    high_hz: float,
    duration_s: float,
    rms_rpm: float,
    *,
    seed: Whole,
    avoid_hz: Bands = (),
    rate_hz: float = 100.0,
    name: str = "noise",
) -> Excitation:
    """Return Gaussian noise whose spectrum is flat between two frequencies and zero elsewhere.

    The same seed gives the same samples.

    Parameters
    ----------
    low_hz, high_hz
        Band [Hz]; at least one multiple of 1/duration_s lies in it.
    duration_s
        Length [s], also the period.
    rms_rpm
        Root mean square [rpm].
    seed
        Seed of the random samples.
    avoid_hz
        Bands (low, high) around resonances [Hz] without noise.
    rate_hz, name
        Sample rate [Hz] and label.
    """
    below_nyquist("low_hz", low_hz, rate_hz)
    below_nyquist("high_hz", high_hz, rate_hz)
    positive("rms_rpm", rms_rpm)
    samples = len(sample_times(duration_s, rate_hz))
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(samples))
    frequency = np.fft.rfftfreq(samples, 1.0 / rate_hz)
    spectrum[(frequency < low_hz) | (frequency > high_hz)] = 0.0
    for low, high in bands(avoid_hz):
        spectrum[(frequency >= low) & (frequency <= high)] = 0.0
    if not spectrum.any():
        raise InputError(
            f"the band {low_hz:g} to {high_hz:g} Hz holds no multiple of 1/duration_s, "
            f"{1.0 / duration_s:g} Hz; give low_hz below high_hz and a longer duration"
        )
    noise = np.fft.irfft(spectrum, samples)
    return Excitation(name, "noise", rate_hz, rms_rpm / np.sqrt(np.mean(noise**2)) * noise)


@checked
def steps(
    sizes_rpm: npt.ArrayLike,
    hold_s: float | None = None,
    *,
    duration_s: float | None = None,
    lead_s: float = 0.0,
    rate_hz: float = 100.0,
    name: str = "steps",
) -> Excitation:
    """Return successive steps, each held (section 5.1.3).

    Parameters
    ----------
    sizes_rpm
        Size of each step [rpm], shape (S,), relative to the previous level.
    hold_s
        Time at each level [s].
    duration_s
        Instead of `hold_s`: duration of the whole signal including `lead_s` [s]; all levels are held equally long.
    lead_s
        Time at the operating point before the first step [s].
    rate_hz, name
        Sample rate [Hz] and label.

    Raises
    ------
    InputError
        Unless exactly one of `hold_s` and `duration_s` is given, or if a time is too short or too long.

    Examples
    --------
    >>> steps([65.0, -65.0], 1.0, rate_hz=2.0).samples.tolist()
    [65.0, 65.0, 0.0, 0.0]
    >>> steps([65.0, -65.0], duration_s=3.0, lead_s=1.0, rate_hz=2.0).samples.tolist()
    [0.0, 0.0, 65.0, 65.0, 0.0, 0.0]
    """
    sizes = numbers("sizes_rpm", sizes_rpm)
    zero_or_more("lead_s", lead_s)
    if (hold_s is None) == (duration_s is None):
        found = "neither" if hold_s is None else "both"
        raise InputError(f"steps: found {found} of hold_s and duration_s, expected one of them")
    if hold_s is None:
        assert duration_s is not None
        if not duration_s > lead_s:
            raise InputError(f"duration_s is {duration_s:g} with lead_s = {lead_s:g}, expected longer")
        hold_s = (duration_s - lead_s) / max(len(sizes), 1)
    hold, lead = len(sample_times(hold_s, rate_hz)), at_most("lead_s", lead_s * rate_hz)
    levels = np.repeat(np.cumsum(sizes), hold)
    return Excitation(name, "steps", rate_hz, np.concatenate([np.zeros(lead), levels]), hold="zero")
