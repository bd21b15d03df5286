"""Random-looking signals: binary sequences and band-limited noise."""

from __future__ import annotations

import numpy as np
from scipy import signal

from shipfp_rs.errors import InputError
from shipfp_rs.signals.checks import Bands, bands, below_nyquist, sample_times, whole_samples
from shipfp_rs.signals.excitation import Excitation, repeated
from shipfp_rs.support.arguments import Whole, checked
from shipfp_rs.support.checks import at_most, positive


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
        Determines the start within the sequence.
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
        Seed of the draw.
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
