"""Removal of torque ripple that is periodic in the angle of shaft and engine: unbalance, blades, firing.

Blades in the wake and firing cylinders make the torque oscillate at multiples of the rotation frequency. Such a line is of
no use to a fit, and below half the sample rate it may be twenty times the other noise. Its frequency varies with the
speed, so no filter removes it, but its angle is known from the tachometers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.ndimage import convolve1d
from scipy.signal import resample_poly

from shipfp_rs.support.arrays import Array, ComplexArray, Mask
from shipfp_rs.support.derivatives import taps
from shipfp_rs.support.spikes import bridge

FINER = 8
"""Steps of the angle per sample."""
SLOWEST_HZ = 1.0
"""Lowest mean frequency of a removed line; slower motion may be due to the set point."""
BESIDE_HZ = 1.0
"""Bandwidth on either side of a line in which its noise is estimated, in the line's rotating frame."""
NEAR = 3
"""Frequency bins on either side of a line that do not count as noise, since its amplitude may vary slowly."""
LINE = 30.0
"""Least ratio of a line's power to the noise beside it; noise alone reaches it once in 1e13."""
SLOW_S = 0.2
"""Length of the running mean of the torque [s]; the amplitude of a line may vary with this mean."""
LEVEL_S = 1.0
"""Length of the running mean [s] that is subtracted before the search for lines."""
ROUNDED = 2e-4
"""Largest relative error of an order: gear ratios are given with four digits."""
FINER_LINES = 4
"""Search frequencies per bin of the record's spectrum."""
SHORTEST_S = 20.0
"""Shortest record in which lines can be separated from the response to the set point."""
TURNS = 24
"""Highest multiple of the rotation of engine and shaft that is searched: two blade harmonics of any propeller."""
MOST = 12
"""Most lines that are removed."""


class Ripple(NamedTuple):
    """Line: multiple of the engine's turns, mean frequency [Hz], amplitude in the torque's unit, ratio of power to noise."""

    order: float
    frequency_hz: float
    amplitude: float
    power: float


def without_ripple(torque: Array, speed: Array, rate_hz: float, ratio: float) -> tuple[Array, list[Ripple]]:
    """Remove ripple lines from the torque; also return the lines, strongest first.

    Cosine and sine amplitude of a line each have a constant part and a part proportional to the mean torque: four
    coefficients per line, fitted by least squares. There is no part proportional to the speed: in a step test, speed and
    torque differ only while the shaft accelerates, so such a part would absorb the motion of the torque.

    Parameters
    ----------
    torque
        Low-passed torque, shape (N,), any unit, NaN where masked.
    speed
        Engine speed [rpm], shape (N,), NaN where masked.
    rate_hz
        Sample rate.
    ratio
        Turns of the engine per turn of the propeller's shaft.

    Returns
    -------
    tuple
        The torque, the same array if it has no ripple, and a list of `Ripple`.
    """
    valid = np.isfinite(torque)
    if valid.sum() < SHORTEST_S * rate_hz or not np.isfinite(speed).any():
        return torque, []
    turns_hz = bridge(speed, np.isnan(speed)) / 60.0
    filled = bridge(torque, ~valid)
    beyond = _beyond(filled, rate_hz)
    slow = _running_mean(filled, SLOW_S * rate_hz)
    shapes = [np.ones(len(torque)), (slow - slow.mean()) / max(float(np.std(slow)), 1e-300)]
    angle = _angle(turns_hz, rate_hz)
    turning = {order: _turning(order, angle) for order in _orders(float(turns_hz.mean()), rate_hz, ratio)}
    found: list[Ripple] = []
    columns, seen = np.empty((0, len(torque))), np.empty((0, len(torque)))
    ripple, rest = np.zeros(len(torque)), np.where(valid, beyond, 0.0)
    while turning and len(found) < MOST:
        lines = {
            order: _line(rest, turned, valid, order, turns_hz, rate_hz) for order, turned in turning.items()
        }
        nominal = max(lines, key=lambda order: lines[order].power)
        line = lines[nominal]
        if line.power < LINE:
            break
        del turning[nominal]
        found.append(line)
        # Gear ratio or speeds may be rounded, so the order is estimated from the line itself.
        turned = _turning(line.order, angle)
        own = np.array([part * shape for shape in shapes for part in (turned.real, turned.imag)])
        columns = np.vstack([columns, own])
        seen = np.vstack([seen, [_beyond(column, rate_hz) for column in own]])
        factors, *_ = np.linalg.lstsq(seen[:, valid].T, beyond[valid], rcond=1e-9)
        ripple = np.asarray(factors @ columns)
        rest = np.where(valid, beyond - factors @ seen, 0.0)
    return (torque - ripple, found) if found else (torque, [])


def _orders(mean_hz: float, rate_hz: float, ratio: float) -> list[float]:
    """Multiples of the engine's rotation within the record's band: half orders of the engine, whole ones of the shaft."""
    if mean_hz < SLOWEST_HZ:
        return []
    engine, shaft = 0.5 * np.arange(1, 2 * TURNS + 1), np.arange(1, TURNS + 1) / ratio
    shaft = shaft[np.abs(shaft * 2.0 - np.round(shaft * 2.0)) > 1e-6]
    return [
        float(order) for order in np.append(engine, shaft) if SLOWEST_HZ < order * mean_hz < 0.5 * rate_hz
    ]


def _angle(turns_hz: Array, rate_hz: float) -> Array:
    """Angle of the engine at every fine step [rad], shape (FINER N,)."""
    level = turns_hz[0]
    fine = level + resample_poly(turns_hz - level, FINER, 1, padtype="line")
    turns = np.append(0.0, np.cumsum(0.5 * (fine[1:] + fine[:-1]))) / (FINER * rate_hz)
    return np.asarray(2.0 * np.pi * turns)


def _turning(order: float, angle: Array) -> ComplexArray:
    """Low-passed exp(i order angle), shape (N,)."""
    turned, kernel = order * angle, taps(1.0 / FINER, 0.0)
    real, imaginary = (
        resample_poly(part, 1, FINER, window=kernel) for part in (np.cos(turned), np.sin(turned))
    )
    return np.asarray(real + 1j * imaginary)


def _line(
    rest: Array, turned: ComplexArray, valid: Mask, order: float, turns_hz: Array, rate_hz: float
) -> Ripple:
    """Strongest line near an order in the remaining torque, with its ratio of power to noise."""
    mean = float(turns_hz.mean())
    weight = float(np.sum(np.abs(turned[valid]) ** 2))
    if weight < NEAR * rate_hz:
        return Ripple(order, order * mean, 0.0, 0.0)
    length = fft.next_fast_len(FINER_LINES * len(rest))
    spectrum = np.abs(fft.fft(rest * turned.conj(), length)) ** 2
    step = rate_hz / length
    width, near = max(int(BESIDE_HZ / step), 10 * NEAR), NEAR * FINER_LINES
    reach = int(ROUNDED * order * mean / step)
    beside = np.append(spectrum[reach + near : width], spectrum[-width : -reach - near])
    noise = float(np.median(beside) / np.log(2.0))
    offsets = np.arange(-reach, reach + 1)
    best = int(offsets[np.argmax(spectrum[offsets])])
    power = float(spectrum[best])
    # Maximum of the parabola through the line and its neighbours.
    before, after = float(spectrum[best - 1]), float(spectrum[best + 1])
    lean = 0.5 * (after - before) / max(2.0 * power - before - after, 1e-300)
    placed = order + (best + float(np.clip(lean, -0.5, 0.5))) * step / mean
    amplitude = 2.0 * float(np.sqrt(power)) / weight
    return Ripple(placed, placed * mean, amplitude, power / max(noise, 1e-300))


def _beyond(signal: Array, rate_hz: float) -> Array:
    return np.asarray(signal - _running_mean(signal, LEVEL_S * rate_hz))


def _running_mean(signal: Array, samples: float) -> Array:
    width = 2 * int(0.5 * samples) + 1
    return np.asarray(convolve1d(signal, np.full(width, 1.0 / width), mode="nearest"))
