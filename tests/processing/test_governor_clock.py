"""The clock of a governor that samples is found in the torque's stairs, and nothing that turns is taken for one."""

import numpy as np
import pytest

from shipfp_rs.processing.governor_clock import QUARTZ, governor_clock, liveliest

RATE_HZ, FACTOR, SECONDS = 800.0, 16, 200.0
TURNS_HZ = np.array([4.21, 10.3])


def drive_train(period_s, seed, *, ripple=0.02, late_s=0.0):
    """Torque at 800 Hz and speed at 50 Hz of a shaft that a held command drives, with firing and noise."""
    random = np.random.default_rng(seed)
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    command = lambda at: 0.2 * np.sin(2.0 * np.pi * (0.05 * at + 1.2 / SECONDS * at**2))  # noqa: E731
    at = time if period_s is None else 0.004 + period_s * np.floor((time - 0.004) / period_s)
    torque = command(at)
    speed = 1.0 + np.cumsum(command(time - late_s)) / RATE_HZ / 1.2
    angle = np.cumsum(speed) / RATE_HZ
    for order in (1.0, 2.0, 6.0):
        torque = torque + ripple * np.sin(2.0 * np.pi * order * TURNS_HZ[1] * angle + order)
    torque += 0.01 * random.standard_normal(len(time))
    return torque, speed[::FACTOR] + 1e-4 * random.standard_normal(len(speed) // FACTOR)


@pytest.mark.parametrize("period_s", [0.0061, 0.02, 0.0317, 0.05])
def test_the_period_is_found_to_its_deviation(period_s):
    found = governor_clock(*drive_train(period_s, 1), FACTOR, RATE_HZ, TURNS_HZ)
    assert found is not None
    assert abs(found.period_s - period_s) < 4.0 * found.std_s
    assert QUARTZ <= found.std_s / period_s < 3.0 * QUARTZ


@pytest.mark.parametrize("late_s", [0.1, 0.15, 0.2])
def test_a_speed_that_answers_late_hides_no_clock_whose_harmonics_are_all_there(late_s):
    found = governor_clock(*drive_train(0.04, 1, late_s=late_s), FACTOR, RATE_HZ, TURNS_HZ)
    assert found is not None
    assert abs(found.period_s - 0.04) < 4.0 * found.std_s


@pytest.mark.parametrize("seed", range(3))
def test_without_a_clock_none_is_found_however_much_the_torque_pulsates(seed):
    assert governor_clock(*drive_train(None, seed, ripple=0.1), FACTOR, RATE_HZ, TURNS_HZ) is None


def test_masked_samples_are_bridged():
    torque, speed = drive_train(0.02, 2)
    torque[5000:5200], speed[700:720] = np.nan, np.nan
    found = governor_clock(torque, speed, FACTOR, RATE_HZ, TURNS_HZ)
    assert found is not None
    assert found.period_s == pytest.approx(0.02, rel=1e-4)


def test_a_speed_that_stands_still_tells_nothing():
    torque, speed = drive_train(0.02, 3)
    assert governor_clock(torque, np.ones(len(speed)), FACTOR, RATE_HZ, TURNS_HZ) is None


def test_of_a_long_record_the_part_that_moves_most_is_taken():
    speed = np.ones(1000)
    speed[600:700] += np.sin(np.arange(100.0))
    part = liveliest(speed, 200)
    assert part.stop - part.start == 200
    assert part.start <= 600
    assert part.stop >= 700


@pytest.mark.parametrize("seed", range(20))
def test_whatever_was_recorded_an_answer_or_none_comes(seed):
    random = np.random.default_rng(seed)
    factor, count = int(random.integers(2, 17)), int(random.integers(2, 3000))
    speed = 1.0 + 0.01 * np.cumsum(random.standard_normal(count)) * random.integers(0, 2)
    torque = random.choice([0.0, 1.0]) * random.standard_normal(factor * count)
    line = random.uniform(0.5, 0.5 * 50.0 * factor)
    torque += random.choice([0.0, 1e3]) * np.sin(
        2.0 * np.pi * line * np.arange(factor * count) / (50.0 * factor)
    )
    torque[random.random(len(torque)) < random.choice([0.0, 0.3, 1.0])] = np.nan
    found = governor_clock(torque, speed, factor, 50.0 * factor, TURNS_HZ)
    assert found is None or found.std_s > 0.0
