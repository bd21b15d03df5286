"""Moving water, worked out from a record's speed and torque where a limit of torque or rate acts.

In a linear ship the responses to set point and water add up, and the likelihood takes the water's for noise. Where a limit
acts they do not: the water decides, too, when the limit holds. There the model is driven by the water's torque: the
measured torque less that of the inertia and that of the load's law. Parameters that are not right yet would leave a part
of the response to the set point in it, so what goes with that response is taken off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from shipfp_rs.identification.record import Record
from shipfp_rs.support.arrays import Array, ComplexArray

PAD_S = 10.0
"""By which signals are turned back about their ends before their spectrum is taken [s]."""
TOP = 0.8
"""From this part of the band on its end shows the noise."""
WIDTH, LEAST_REACH = 0.1, 10
"""Frequencies on either side over which a power is averaged, as a part of the own one, and at least."""


def beyond_the_law(
    record: Record,
    seen: Sequence[int],
    values: Mapping[str, float],
    inertia: tuple[float, float],
    scale: float,
) -> Array:
    """Return the torque of the load beyond its law and what is measured of it, over the operating point's, shape (K,).

    Parameters
    ----------
    record, seen
        The record, and the places of speed and torque among its outputs.
    values
        The ship's parameters.
    inertia, scale
        Time constants of what turns between the torque meter and a shaft that twists, and of all that turns behind [s],
        and by which factor the meter's torque is read.
    """
    rate = record.data_hz / record.down
    speed, torque = record.decimated[list(seen)]
    ahead, behind = inertia
    through = (1.0 + torque) / scale - ahead * _slope(speed, rate)
    speed = speed - _twisting(through, rate, values)
    found = through - behind * _slope(speed, rate)
    found -= np.maximum(1.0 + speed, 1e-3) ** values["p"] + values["c_2"] * speed**2
    found -= values.get("damping", 0.0) * speed
    if record.load.size:
        at = np.arange(len(speed)) / rate
        found -= values.get("k_L", 1.0) * np.interp(
            at, np.arange(len(record.load)) / record.rate_hz, record.load
        )
    return np.asarray(found)


def moving_water(record: Record, beyond: Array, response: Array) -> Array:
    """Return what moves the load beyond its law (K,), less what goes with the response and what is no more than noise.

    `beyond` is of `beyond_the_law`, `response` decimated speed and torque of the ship without water, shape (2, K).
    """
    rate = record.data_hz / record.down
    n, m = response
    shown = np.array([np.ones_like(n), n, n**2, _slope(n, rate), m, _slope(m, rate)])
    found = beyond[: len(n)] - np.linalg.lstsq(shown.T, beyond[: len(n)], rcond=None)[0] @ shown
    return _by_frequency(found, rate, partial(_without_noise, band_hz=record.seen_hz))


def _without_noise(frequency: Array, spectrum: ComplexArray, band_hz: float) -> ComplexArray:
    """Wiener's filter; the noise, of torque and of the speed's slope, is no more than what stands at the band's end."""
    power = np.abs(spectrum) ** 2
    place = np.arange(len(power))
    reach = np.maximum((WIDTH * place).astype(int), LEAST_REACH)
    sums = np.concatenate([[0.0], np.cumsum(power)])
    first, last = np.maximum(place - reach, 0), np.minimum(place + reach + 1, len(power))
    smooth = (sums[last] - sums[first]) / (last - first)
    noise = np.mean(power[(frequency > TOP * band_hz) & (frequency <= band_hz)])
    kept = np.maximum(1.0 - noise / np.maximum(smooth, 1e-300), 0.0)
    return np.asarray(spectrum * kept * (frequency <= band_hz))


def _twisting(through: Array, rate: float, values: Mapping[str, float]) -> Array:
    """Speed by which a shaft twists under a torque."""
    twist = values.get("tau_twist", 0.0)
    damped = twist * values.get("zeta_twist", 0.0)

    def change(frequency: Array, spectrum: ComplexArray) -> ComplexArray:
        s = 2j * np.pi * frequency
        return np.asarray(spectrum * twist * s / (1.0 + damped * s))

    return _by_frequency(through, rate, change) if twist > 0.0 else np.zeros_like(through)


def _slope(signal: Array, rate: float) -> Array:
    """Derivative of a band-limited signal."""
    return _by_frequency(signal, rate, lambda frequency, spectrum: 2j * np.pi * frequency * spectrum)


def _by_frequency(signal: Array, rate: float, change: Callable[[Array, ComplexArray], ComplexArray]) -> Array:
    """A signal whose spectrum is changed; its ends are turned back about their last values."""
    pad = min(int(PAD_S * rate), len(signal) - 1)
    wide = np.pad(signal, pad, mode="reflect", reflect_type="odd")
    # Twice as long and even it has no jump where it begins again.
    both = np.concatenate([wide, wide[-2:0:-1]])
    frequency = np.asarray(np.fft.rfftfreq(len(both), 1.0 / rate), dtype=float)
    changed = np.fft.irfft(change(frequency, np.fft.rfft(both)), len(both))
    return np.asarray(changed[pad : pad + len(signal)])
