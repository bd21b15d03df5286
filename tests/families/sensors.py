"""From motion to what a logger records: filters, coloured noise, telemetry, pulse trains and their faults."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import bessel, firwin, freqz, lfilter, sosfilt, sosfilt_zi, upfirdn

COMMON_HZ = 50.0
"""Rate of experiments without a pulse chain [Hz]."""
MIDDLE_HZ = 200.0
"""Rate at which their noise comes in, before the last filter [Hz]."""
PASS_HZ = 18.0
"""Band of the last filter; its stop band begins at 25 Hz [Hz]."""
LAST_FILTER = firwin(141, 0.5 * (PASS_HZ + 25.0), window=("kaiser", 7.0), fs=MIDDLE_HZ)


def decimated(samples, taps, factor):
    """Filter with symmetric taps, without delay, and keep every `factor`-th sample; ends are held."""
    half = len(taps) // 2
    padded = np.concatenate([np.full(half, samples[0]), samples, np.full(half, samples[-1])])
    if half * 2 % factor:
        raise ValueError(f"{len(taps)} taps, expected one more than a multiple of {factor}")
    first = 2 * half // factor
    return upfirdn(taps, padded, 1, factor)[first : first - (-len(samples) // factor)]


def to_middle(samples, step_s):
    """Bring a signal from small steps to `MIDDLE_HZ`."""
    factor = round(1.0 / (step_s * MIDDLE_HZ))
    taps = firwin(20 * factor + 1, 70.0, window=("kaiser", 7.0), fs=1.0 / step_s)
    return decimated(samples, taps, factor)


def to_common(samples):
    """Bring a signal from `MIDDLE_HZ` to `COMMON_HZ`, through one and the same filter for all of them."""
    return decimated(samples, LAST_FILTER, round(MIDDLE_HZ / COMMON_HZ))


def experiment(name, excitation, signals):
    """Return an experiment of signals at `MIDDLE_HZ`, its operating point from the steady stretch."""
    signals = {key: to_common(one) for key, one in signals.items()}
    steady = slice(int(2.0 * COMMON_HZ), int((excitation.start_s - 1.0) * COMMON_HZ))
    return {
        "name": name,
        "rate_hz": COMMON_HZ,
        "kind": excitation.kind,
        "signals": signals,
        "operating_point": {key: float(one[steady].mean()) for key, one in signals.items()},
    }


@dataclass(frozen=True)
class Noise:
    """Coloured noise at `MIDDLE_HZ`: independent autoregressive parts, each (standard deviation, coefficients a_1..a_n)."""

    parts: tuple[tuple[float, tuple[float, ...]], ...]

    def samples(self, random, count):
        """Draw it, shape (count,)."""
        total = np.zeros(count)
        for deviation, coefficients in self.parts:
            drive = random.standard_normal(count + 2000)
            total += deviation / _gain(coefficients) * lfilter([1.0], np.r_[1.0, coefficients], drive)[2000:]
        return total

    def spectrum(self, frequency_hz):
        """Variance a sample that it has at `COMMON_HZ` behind the last filter, at frequencies up to 25 Hz.

        White noise of unit variance at `COMMON_HZ` would have 1 throughout; aliases are left out, the stop band is deep.
        """
        w = 2.0 * np.pi * np.asarray(frequency_hz) / MIDDLE_HZ
        total = np.zeros(len(w))
        for deviation, coefficients in self.parts:
            answer = freqz([1.0], np.r_[1.0, coefficients], worN=w)[1]
            total += (deviation / _gain(coefficients) * np.abs(answer)) ** 2
        return total * np.abs(freqz(LAST_FILTER, worN=w)[1]) ** 2 * COMMON_HZ / MIDDLE_HZ


def _gain(coefficients):
    """Standard deviation behind an autoregression driven by unit white noise."""
    pulse = np.zeros(20000)
    pulse[0] = 1.0
    return np.sqrt((lfilter([1.0], np.r_[1.0, coefficients], pulse) ** 2).sum())


def speed_noise(random) -> Noise:
    """What pulses leave on a speed: a slow part, and a floor."""
    size = 10.0 ** random.uniform(-3.6, -2.8)
    corner = random.uniform(0.3, 5.0)
    return Noise(((size, (-np.exp(-2 * np.pi * corner / MIDDLE_HZ),)), (size, ())))


def torque_noise(random) -> Noise:
    """What telemetry and ripple leave on a torque: a slow part, a line at a rotation's rate, a floor."""
    size = 10.0 ** random.uniform(-2.7, -2.0)
    corner, line = random.uniform(0.3, 5.0), random.uniform(4.0, 16.0)
    radius = np.exp(-2 * np.pi * 0.3 / MIDDLE_HZ)
    peak = (-2.0 * radius * np.cos(2.0 * np.pi * line / MIDDLE_HZ), radius**2)
    return Noise(((size, (-np.exp(-2 * np.pi * corner / MIDDLE_HZ),)), (size, peak), (size, ())))


def delayed(samples, step_s, delay_s):
    """Shift a signal back by a time, straight lines between samples; before its begin the first one."""
    at = np.arange(len(samples)) - delay_s / step_s
    return np.interp(at, np.arange(len(samples)), samples)


@dataclass(frozen=True)
class Telemetry:
    """A torque meter: two Bessel filters of the second order, then sampled and held."""

    first_hz: float
    second_hz: float
    hold_hz: float = 500.0

    @property
    def delay_s(self) -> float:
        """How late it is at low frequencies [s]: the filters' delays and half a hold."""
        # A Bessel filter of the second order with its phase asymptote at w has the delay sqrt(3) / w.
        filters = sum(np.sqrt(3.0) / (2.0 * np.pi * hz) for hz in (self.first_hz, self.second_hz))
        return float(filters + 0.5 / self.hold_hz)

    def __call__(self, samples, step_s):
        for corner in (self.first_hz, self.second_hz):
            sections = bessel(2, corner, norm="phase", fs=1.0 / step_s, output="sos")
            samples = sosfilt(sections, samples, zi=sosfilt_zi(sections) * samples[0])[0]
        # The receiver's clock is its own: what it holds is the last sample before.
        at = np.floor(np.arange(len(samples)) * step_s * self.hold_hz + 1e-9) / (self.hold_hz * step_s)
        return samples[np.minimum(np.round(at).astype(int), len(samples) - 1)]


@dataclass(frozen=True)
class Pulses:
    """A pulse train of a shaft.

    Parameters
    ----------
    positions
        Rising edges within a turn, ascending in [0, 1), one a reflector or tooth.
    width
        Length of a pulse over the mean pitch.
    rise_s
        Time of an edge from low to high [s].
    low, high, noise
        Levels and noise [V].
    double, broken
        Share of pulses with a second crossing on their edge, and of pulses that are missing.
    """

    positions: np.ndarray
    width: float = 0.4
    rise_s: float = 2e-4
    low: float = 0.1
    high: float = 4.8
    noise: float = 0.03
    double: float = 0.0
    broken: float = 0.0

    def edges(self, turns, step_s):
        """Return times of the rising edges [s] from the angle in turns at every step."""
        count = int(np.ceil(turns[-1])) + 1
        angles = (np.arange(count)[:, None] + self.positions).ravel()
        angles = angles[(angles > turns[0]) & (angles < turns[-1])]
        return np.interp(angles, turns, np.arange(len(turns)) * step_s)

    def __call__(self, turns, step_s, times, random):
        """Return what a logger records at `times` [V]."""
        count = int(np.ceil(turns[-1])) + 1
        up = (np.arange(count)[:, None] + self.positions).ravel()
        down = up + self.width / len(self.positions)
        keep = (up > turns[0]) & (down < turns[-1]) & (random.random(len(up)) >= self.broken)
        clock = np.arange(len(turns)) * step_s
        rises, falls = (np.interp(one[keep], turns, clock) for one in (up, down))
        sign = np.tile([1.0, -1.0], len(rises))
        events = np.column_stack([rises, falls]).ravel()
        twice = np.flatnonzero(random.random(len(rises)) < self.double)
        if len(twice):
            # A saw-tooth edge: down again for a moment shortly behind the rise.
            late = rises[twice] + np.minimum(1.5e-3, 0.2 * (falls - rises)[twice])
            gone = late + np.minimum(1.0e-3, 0.15 * (falls - rises)[twice])
            events = np.concatenate([events, late, gone])
            sign = np.concatenate([sign, -np.ones(len(late)), np.ones(len(gone))])
            order = np.argsort(events)
            events, sign = events[order], sign[order]
        # Sum of ramps: each edge has passed by a share that grows over its rise.
        done = np.searchsorted(events, times - self.rise_s, side="right")
        level = np.concatenate([[0.0], np.cumsum(sign)])[done]
        begun = np.searchsorted(events, times, side="right")
        for more in range(int((begun - done).max(initial=0))):
            under_way = np.flatnonzero(begun > done + more)
            edge = done[under_way] + more
            level[under_way] += sign[edge] * np.clip(
                (times[under_way] - events[edge]) / self.rise_s, 0.0, 1.0
            )
        volts = self.low + (self.high - self.low) * level + self.noise * random.standard_normal(len(times))
        return volts.astype(np.float32)


def reflectors(random, count, error=0.02):
    """Positions of reflectors within a turn, each off by up to `error` of the pitch."""
    pitch = (np.arange(count) + random.uniform(-error, error, count) + random.uniform(0.05, 0.9)) / count
    return np.sort(pitch % 1.0)


def pick_up(random, teeth, error, rise_s, width=0.4) -> Pulses:
    """Pulses of an engine's teeth, each off by up to `error` of the pitch, with edges of a drawn length [s]."""
    positions = reflectors(random, teeth, error)
    return Pulses(positions, width, random.uniform(*rise_s))


@dataclass(frozen=True)
class Faults:
    """What goes wrong in a recording, counts a record."""

    spikes: int = 0
    """Radio interference that saturates the torque receiver."""
    jumps: int = 0
    """Of the set point's relay."""
    hum_V: float = 0.0
    """50 Hz on the set point."""


def set_point_volts(rpm, scale, offset, rate_hz, random, faults: Faults, noise_V=1.5e-3):
    """Return the set point's channel: noise, hum, relay jumps, 16 bits over 20 V."""
    volts = (rpm - offset) / scale
    t = np.arange(len(volts)) / rate_hz
    volts = volts + faults.hum_V * np.sin(2.0 * np.pi * 50.0 * t + random.uniform(0.0, 6.28))
    volts += noise_V * random.standard_normal(len(volts))
    for at in random.integers(int(rate_hz), len(volts) - int(rate_hz), faults.jumps):
        long = int(rate_hz * random.uniform(0.004, 0.03))
        volts[at : at + long] += random.choice([-1.0, 1.0]) * random.uniform(0.3, 1.0)
    return _recorded(volts)


def torque_volts(torque, per_volt, rate_hz, random, faults: Faults, full_V=10.0, noise_V=2e-3):
    """Return the torque's channel: noise, radio spikes at full scale, 16 bits."""
    volts = torque / per_volt + noise_V * random.standard_normal(len(torque))
    for at in random.integers(int(rate_hz), len(volts) - int(rate_hz), faults.spikes):
        volts[at : at + int(rate_hz * random.uniform(0.004, 0.03))] = random.choice([-0.98, 0.98]) * full_V
    return _recorded(volts, full_V)


def _recorded(volts, full_V=10.0):
    step = full_V / 32768.0
    return (np.round(np.clip(volts, -full_V, full_V) / step) * step).astype(np.float32)


@dataclass(frozen=True)
class RawLog:
    """A recording: channels of one rate and what a trial file has to say of them."""

    rate_hz: float
    columns: dict[str, np.ndarray]
    units: dict[str, str]
    tables: str
    """[channels...] of TRIAL.toml."""
    gear_ratio: float
    facts: dict = field(default_factory=dict)
    """Of the sensors, for the truth."""
