"""Pulse detector against the speed of reading memory (np.max), a numba state machine and a vectorised NumPy version.

Build with `maturin develop --release`, then `python -m benches.bench_pulse`. All figures come from one run on the same
array: 3.2 hours of a pulse train at 2 kHz, far larger than the caches.
"""

import argparse

import numpy as np
from numba import njit

from benches.timing import median_time, print_table
from shipfp_rs import tacho
from shipfp_rs._core import pulse_levels

LOW, MIDDLE, HIGH = 1.0, 2.0, 3.0
RATE = 2000.0


def pulse_train(samples: int, pulses_per_s: float) -> np.ndarray:
    """Noisy train of 0.2 and 5 V, 35 % of the time high, from a shaft whose speed wanders."""
    rng = np.random.default_rng(1)
    speed = 1.0 + 0.02 * np.sin(np.arange(samples) * (2 * np.pi * 0.1 / RATE))
    phase = np.cumsum(speed * (pulses_per_s / RATE))
    noise = 0.05 * rng.standard_normal(samples, dtype=np.float32)
    return np.where(phase % 1.0 < 0.35, 5.0, 0.2).astype(np.float32) + noise


def ours(train: np.ndarray) -> np.ndarray:
    return RATE * tacho.pulse_times(train, RATE, threshold=MIDDLE, hysteresis=HIGH - LOW).times_s


def speed(train: np.ndarray) -> tacho.IntervalSpeed:
    return tacho.speed_from_pulses(tacho.pulse_times(train, RATE), 1)


@njit(cache=False)
def state_machine(train: np.ndarray, low: float, high: float, middle: float) -> np.ndarray:
    times = np.empty(train.size // 2 + 1)
    count = 0
    armed = False
    previous = np.nan
    crossing = np.nan
    for k in range(train.size):
        x = np.float64(train[k])
        if np.isnan(x):
            armed = False
        if previous < middle <= x:
            crossing = k - (x - middle) / (x - previous)
        if x <= low:
            armed = True
        elif armed and x >= high:
            times[count] = crossing
            count += 1
            armed = False
        previous = x
    return times[:count].copy()


def vectorised(train: np.ndarray) -> np.ndarray:
    """Hysteresis by filling the last state forward; the last rise through the middle before each fire."""
    state = np.zeros(train.size, dtype=np.int8)
    state[train >= HIGH] = 1
    state[train <= LOW] = -1
    known = np.flatnonzero(state)
    fires = known[1:][np.diff(state[known]) == 2]
    rises = np.flatnonzero((train[:-1] < MIDDLE) & (train[1:] >= MIDDLE))
    before = rises[np.searchsorted(rises, fires) - 1]
    below, above = train[before].astype(np.float64), train[before + 1].astype(np.float64)
    return before + 1 - (above - MIDDLE) / (above - below)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=23_000_000, help="length of the train")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--quick", action="store_true", help="a short train, just to see that it runs")
    options = parser.parse_args()
    if options.quick:
        options.samples, options.repeats = 1_000_000, 3
    rows = []
    for pulses_per_s in (20.65, 60.0, 160.0):
        train = pulse_train(options.samples, pulses_per_s)
        expected = state_machine(train, LOW, HIGH, MIDDLE)
        assert np.allclose(ours(train), expected, atol=1e-3, rtol=0.0)
        assert np.array_equal(vectorised(train), expected)
        reading = median_time(lambda train=train: train.max(), options.repeats)
        calls = {
            "np.max": train.max,
            "ours": lambda train=train: ours(train),
            "numba": lambda train=train: state_machine(train, LOW, HIGH, MIDDLE),
            "NumPy": lambda train=train: vectorised(train),
            "pulse_levels": lambda train=train: pulse_levels(train),
            "levels and crossings": lambda train=train: tacho.pulse_times(train, RATE),
            "levels, crossings and speed": lambda train=train: speed(train),
        }
        times = {name: median_time(call, options.repeats) for name, call in calls.items()}
        for name, time in times.items():
            rows.append(
                [
                    f"{name}, {pulses_per_s:g} pulses/s",
                    f"{time * 1e3:.2f}",
                    f"{train.nbytes / time / 1e9:.1f}",
                    f"{reading / time:.2f}",
                    f"{time / times['ours']:.1f}",
                ]
            )
    print_table(["case", "ms", "GB/s", "speed of np.max", "times ours"], rows)


if __name__ == "__main__":
    main()
