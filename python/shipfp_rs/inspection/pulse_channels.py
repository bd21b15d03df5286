"""Recognition of pulse trains: of two levels, or sinusoidal as from a variable-reluctance pick-up."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from shipfp_rs._core import pulse_levels
from shipfp_rs.errors import InputError
from shipfp_rs.logs.channel_reader import Rows
from shipfp_rs.support.arrays import Array
from shipfp_rs.tacho import PulseTimes, pulse_times

PROBE_S = 120.0
"""Length of the stretch from which a channel is classified [s]."""
LEAST_PULSES = 10
NEAR_A_LEVEL = 0.15
"""A sample is at one of the two levels if it is closer than this fraction of the train's height."""
AT_LEVELS = 0.75
"""Least fraction of samples at one of the levels in a train with two levels; for a sine it is one half."""
EVEN = 0.3
"""Largest relative difference of an even period from the median of nine. Teeth and reflectors stay below it, steps of a set
point or a torque do not.
"""
EVEN_SHARE = 0.6
SLOWEST_HZ = 0.2
"""Shaft speed below which it counts as at rest."""
SINE_EVEN_SHARE = 0.9
SINE_SLOWEST_HZ = 5.0
"""Lowest rate of a sinusoidal pick-up [Hz]; slower oscillations are set points or waves."""
SINE_SCATTER = 0.15
"""Largest scatter of the heights of neighbouring pulses; a torque's ripple, of several orders, scatters more."""
SINE_OFFSET = 1.0
"""Largest offset of a pick-up's middle from zero, in heights; a torque's ripple is small compared to the torque."""
SINE_DRIFT = 1.5
"""Largest range of its middle during the middle half of the time, in heights."""
MAINS_HZ = (50.0, 60.0)
MAINS_WITHIN, MAINS_STEADY = 5e-3, 1e-3
"""Largest distance from the mains frequency, and largest scatter, of mains hum; no shaft is as steady."""


def pulse_rate(rows: Rows) -> float | None:
    """Pulses per second of a pulse train over its first two minutes; None for other channels."""
    channel = rows.channel
    probe = rows.read(0, min(round(PROBE_S * channel.rate_hz), channel.samples)).astype(np.float64)
    known = np.isfinite(probe)
    if np.count_nonzero(known) < LEAST_PULSES:
        return None
    try:
        pulses = pulse_times(probe, channel.rate_hz)
    except InputError:
        return None
    if len(pulses.times_s) < LEAST_PULSES:
        return None
    seconds = np.count_nonzero(known) / channel.rate_hz
    rate_hz = len(pulses.times_s) / seconds
    even = _even_share(pulses)
    if rate_hz < SLOWEST_HZ or even < EVEN_SHARE:
        return None
    if _has_two_levels(probe[known]) or (even >= SINE_EVEN_SHARE and _is_sinusoidal(probe, pulses)):
        return float(rate_hz)
    return None


def _even_share(pulses: PulseTimes) -> float:
    periods = np.diff(pulses.times_s)
    usual = median_filter(periods, size=9, mode="nearest")
    # A difference of one sample does not make a train uneven.
    return float(np.mean(np.abs(periods - usual) < np.maximum(EVEN * usual, 1.2 / pulses.rate_hz)))


def _has_two_levels(samples: Array) -> bool:
    bottom, top = pulse_levels(samples)
    near = np.minimum(np.abs(samples - bottom), np.abs(samples - top)) < NEAR_A_LEVEL * (top - bottom)
    return bool(near.mean() >= AT_LEVELS)


def _is_sinusoidal(probe: Array, pulses: PulseTimes) -> bool:
    """Whether pulses have similar heights and are centred on zero, at a rate other than that of the mains."""
    times = pulses.times_s
    periods = np.diff(times)
    if np.median(periods) > 1.0 / SINE_SLOWEST_HZ:
        return False
    places = np.ceil(times * pulses.rate_hz).astype(np.int64)
    filled = np.where(np.isfinite(probe), probe, pulses.middle)
    # The last pulse is incomplete.
    top, bottom = (extreme.reduceat(filled, places)[:-1] for extreme in (np.maximum, np.minimum))
    single = periods < 1.5 * median_filter(periods, size=9, mode="nearest")
    height, middle = (top - bottom)[single], 0.5 * (top + bottom)[single]
    if len(height) < LEAST_PULSES:
        return False
    usual = median_filter(height, size=9, mode="nearest")
    level = float(np.median(usual))
    quarter, half, three = np.quantile(middle, [0.25, 0.5, 0.75])
    if not (
        np.median(np.abs(height - usual) / usual) < SINE_SCATTER / 1.4826
        and abs(half) < SINE_OFFSET * level
        and three - quarter < SINE_DRIFT * level
    ):
        return False
    seconds = np.bincount(times.astype(np.int64))[1:-1]
    rate_hz = 1.0 / float(np.mean(periods[single]))
    steady = len(seconds) < 2 or np.std(seconds) < max(1.0, MAINS_STEADY * rate_hz)
    return not (steady and any(abs(rate_hz / mains - 1.0) < MAINS_WITHIN for mains in MAINS_HZ))
