"""Ripple that goes with the angle of the shaft, beside what the set point does."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from shipfp_rs.processing.conditioning import without_ripple
from shipfp_rs.support.derivatives import taps

RATE_HZ, FINER, RATIO = 50.0, 40, 2.59
COUNT = 15_000
FINE = np.arange(COUNT * FINER) / (RATE_HZ * FINER)


def recorded(signal: np.ndarray) -> np.ndarray:
    """Low-passed and sampled."""
    kernel = taps(1.0 / FINER, 0.0)
    return np.convolve(np.pad(signal, len(kernel) // 2, mode="edge"), kernel, mode="valid")[::FINER]


def motion(kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Engine speed [Hz], torque that follows it and angle of the shaft [turns], at every fine step."""
    if kind == "chirp":
        swing = np.sin(2.0 * np.pi * (0.02 * FINE + 0.005 * FINE**2))
    elif kind == "steps":
        levels = np.random.default_rng(6).choice([-1.0, 0.0, 1.0], size=int(FINE[-1] / 9.7) + 1)
        wanted = levels[(FINE / 9.7).astype(int)]
        decay = np.exp(-1.0 / (0.3 * RATE_HZ * FINER))
        swing = lfilter([1.0 - decay], [1.0, -decay], wanted)
        # The torque that makes the shaft run up comes a little after the step.
        torque = lfilter([1.0 - decay**4], [1.0, -(decay**4)], wanted + 2.0 * (wanted - swing))
        speed = 26.7 * (1.0 + 0.03 * swing)
        return speed, 100.0 + 8.0 * torque, np.cumsum(speed) / (RATE_HZ * FINER) / RATIO
    else:
        swing = np.sin(2.0 * np.pi * 0.31 * FINE) * (FINE > 40.0)
    speed = 26.7 * (1.0 + 0.03 * swing)
    return speed, 100.0 + 8.0 * swing, np.cumsum(speed) / (RATE_HZ * FINER) / RATIO


@pytest.mark.parametrize(("kind", "written"), [("chirp", RATIO), ("sines", 2.5903), ("steps", 2.5903)])
def test_ripple_of_the_shaft_goes_and_the_answer_to_the_set_point_stays(kind: str, written: float) -> None:
    speed, torque, turns = motion(kind)
    ripple = torque * (0.012 * np.sin(2.0 * np.pi * turns + 0.7) + 0.004 * np.sin(4.0 * np.pi * turns))
    noise = 0.03 * np.random.default_rng(3).standard_normal(COUNT)
    clean, rippled = (recorded(one) + noise for one in (torque, torque + ripple))
    rippled[5000:5040] = np.nan
    found, lines = without_ripple(rippled, 60.0 * recorded(speed), RATE_HZ, written)
    settled = slice(100, COUNT - 100)
    assert np.array_equal(np.isnan(found), np.isnan(rippled))
    left = np.nanstd((found - clean)[settled])
    assert left < 0.04 * np.nanstd((rippled - clean)[settled])
    assert [line.order for line in lines] == pytest.approx([1.0 / RATIO, 2.0 / RATIO], rel=5e-5)
    assert lines[0].amplitude == pytest.approx(1.2, rel=0.06)


@pytest.mark.parametrize("kind", ["chirp", "sines"])
def test_a_torque_without_ripple_is_the_same_array(kind: str) -> None:
    speed, torque, _ = motion(kind)
    told = recorded(torque) + 0.03 * np.random.default_rng(4).standard_normal(COUNT)
    found, lines = without_ripple(told, 60.0 * recorded(speed), RATE_HZ, RATIO)
    assert found is told
    assert lines == []


def test_a_line_that_does_not_go_with_the_speed_stays() -> None:
    speed, torque, _ = motion("sines")
    told = recorded(torque + np.sin(2.0 * np.pi * 1.02 * 26.7 / RATIO * FINE))
    found, lines = without_ripple(told, 60.0 * recorded(speed), RATE_HZ, RATIO)
    assert found is told
    assert lines == []


@pytest.mark.parametrize("samples", [0, 3, 400])
def test_short_and_empty_records_are_returned_as_they_are(samples: int) -> None:
    torque, speed = np.full(samples, 5.0), np.full(samples, np.nan)
    found, lines = without_ripple(torque, speed, RATE_HZ, RATIO)
    assert found is torque
    assert lines == []
