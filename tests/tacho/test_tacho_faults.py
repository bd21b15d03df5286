"""Speed of a simulated trial's raw pulse trains, with misplaced reflectors and one fault a second, against the truth.

`pytest -m study -k pulse_faults -s` prints the figures of eight trials of 300 s.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, sosfiltfilt

from shipfp_rs import signals
from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log
from shipfp_rs.tacho import (
    IntervalSpeed,
    PulseFlag,
    Train,
    fuse,
    pulse_times,
    reflector_angles,
    resample,
    speed_from_pulses,
)
from shipfp_rs.vessel.vessel import Vessel

TUG = Vessel.load("stan-tug-1205")
RATE = 2000.0
MISPLACED = (0.0, 0.02, -0.02, 0.01)
FAULTS_PER_S = 1.0
BAND_HZ = 2.0
EDGE_S = 10.0


@dataclass(frozen=True)
class Trial:
    """Figures of one trial, relative to the mean speed, in units of the sampling limit where they are called so."""

    limit: float
    interval_rms: float
    uncorrected_rms: float
    largest_good: float
    largest_repaired: float
    band_rms: float
    fused_band_rms: float
    fused_score: float
    doubled: int
    lost: int
    put_in: int


def trial(seed: int, duration_s: float) -> Trial:
    """Simulate, read and compare; edges lie between two samples, the worst case for their timing."""
    sensors = Sensors(
        rate_hz=RATE,
        edge_s=0.0,
        reflector_errors=MISPLACED,
        faults_per_minute={"A": 60.0 * FAULTS_PER_S, "B": 60.0 * FAULTS_PER_S},
    )
    chirp = signals.chirp(0.02, 0.5, duration_s, 40.0, rate_hz=100.0)
    log, truth = simulate_raw_log(
        TUG, chirp, sensors=sensors, faults=("A", "B"), steady_s=60.0, pause_s=0.0, seed=seed
    )
    n_s = truth.clean.signals["n_s"]
    time = np.arange(len(n_s)) / RATE
    turned = cumulative_trapezoid(n_s, time, initial=0.0)

    def read(channel: str, pulses_per_rev: int, *, correct: bool = True) -> IntervalSpeed:
        pulses = pulse_times(log.chunks(channel), RATE)
        angles = reflector_angles(pulses.times_s, pulses_per_rev)
        assert angles.ok, angles.reason
        return speed_from_pulses(
            pulses.times_s, pulses_per_rev, angles=angles if correct else None, time_std_s=pulses.time_std_s
        )

    def error(speed: IntervalSpeed) -> np.ndarray:
        half = 0.5 * speed.duration_s
        ends = [np.interp(speed.time_s + side, time, turned) for side in (-half, half)]
        inside = (speed.time_s > EDGE_S) & (speed.time_s < time[-1] - EDGE_S)
        return ((speed.speed_rps * speed.duration_s / (ends[1] - ends[0])) - 1.0)[inside], inside

    four = read("PTM_4", 4)
    found, inside = error(four)
    good = four.flags[inside] != PulseFlag.MISSED
    # Timing of both ends against the period, sqrt(2) sigma_t / T with sigma_t = Ts / sqrt(12).
    limit = np.sqrt(2.0) / np.sqrt(12.0) / RATE / np.median(four.duration_s)

    def in_band(speed: np.ndarray, rate: float, start: float) -> float:
        at = start + np.arange(len(speed)) / rate
        low_pass = butter(6, BAND_HZ, fs=rate, output="sos")
        wrong = sosfiltfilt(low_pass, speed - np.interp(at, time, n_s))[round(2 * rate) : -round(2 * rate)]
        return float(np.sqrt(np.mean(wrong**2)) / n_s.mean())

    rate, span = 50.0, (EDGE_S, time[-1] - EDGE_S)
    alone, masked = resample(four, rate, *span)
    assert not masked.any()
    trains = [
        Train("PTM_1", read("PTM_1", 1)),
        Train("PTM_4", four),
        Train("PTM_e", read("PTM_e", 1), TUG.gearbox.ratio),
    ]
    fused = fuse(trains, rate, *span, bandwidth_hz=BAND_HZ)
    assert np.isfinite(fused.speed_rps).all()
    assert all(report.agrees for report in fused.trains.values())
    return Trial(
        limit=float(limit),
        interval_rms=float(np.sqrt(np.mean(found[good] ** 2)) / limit),
        uncorrected_rms=float(np.sqrt(np.mean(error(read("PTM_4", 4, correct=False))[0] ** 2)) / limit),
        largest_good=float(np.abs(found[good]).max() / limit),
        largest_repaired=float(np.abs(found[~good]).max() / limit),
        band_rms=in_band(alone, rate, EDGE_S),
        fused_band_rms=in_band(fused.speed_rps, rate, EDGE_S),
        fused_score=float(
            np.sqrt(np.mean(((fused.speed_rps - np.interp(fused.time_s, time, n_s)) / fused.std_rps) ** 2))
        ),
        doubled=len(truth.faults["A"]["PTM_4"]),
        lost=len(truth.faults["B"]["PTM_4"]),
        put_in=int(np.count_nonzero(four.flags & PulseFlag.MISSED) / 2),
    )


def show(trials: list[Trial]) -> None:
    print(
        f"\n{len(trials)} trials, four reflectors misplaced by up to {max(MISPLACED):.0%}, {RATE:g} Hz, "
        f"{FAULTS_PER_S:g} double and {FAULTS_PER_S:g} lost pulses a second"
    )
    for one in fields(Trial):
        values = [getattr(found, one.name) for found in trials]
        print(f"{one.name:20} mean {np.mean(values):9.5f}  worst {np.max(values):9.5f}")


def check(trials: list[Trial]) -> None:
    show(trials)
    for found in trials:
        assert found.put_in >= 0.9 * found.lost > 30
        assert found.uncorrected_rms > 1.5
        assert found.interval_rms < 1.15
        assert found.largest_good < 3.0
        assert found.largest_repaired < 3.0
        assert found.band_rms < 5e-4
        assert found.fused_band_rms < found.band_rms
        assert 0.8 < found.fused_score < 1.2


def test_speed_is_as_good_as_sampling_allows_at_one_fault_a_second():
    check([trial(0, 60.0)])


@pytest.mark.study
def test_pulse_faults_leave_no_trace_in_eight_trials():
    check([trial(seed, 300.0) for seed in range(8)])
