"""A laboratory's motor under PI control: eleven seconds of steps at 100 Hz tell the gains, with the voltage as rack."""

import numpy as np
import pytest

import shipfp_rs as fp

TAU_S, SLOPE, GAIN, K_P, K_I = 0.1, 1.0, 0.8, 1.5, 12.0
LEVELS = np.array([0.0, 0.1, -0.1, 0.15, 0.0, -0.12, 0.08, -0.05, 0.12, 0.0, 0.1])
FINE_HZ, EVERY = 10_000, 100


def trial(seed):
    """Return a record of the motor tau N' = -N + v X, simulated by its own few lines."""
    random = np.random.default_rng(seed)
    asked = np.repeat(LEVELS, FINE_HZ)
    speed, integral, rows = 0.0, 0.0, np.empty((2, len(asked)))
    for k, u in enumerate(asked):
        error = u - speed
        voltage = K_P * error + K_I * integral
        rows[:, k] = speed, voltage
        integral += error / FINE_HZ
        speed += (GAIN * voltage - SLOPE * speed) / TAU_S / FINE_HZ
    u, (n, x) = asked[::EVERY], rows[:, ::EVERY]
    signals = {
        "n_set": 1500.0 * (1.0 + u),
        "n_e": 1500.0 * (1.0 + n + 1e-3 * random.standard_normal(len(u))),
        "X_f": 6.0 * (1.0 + x + 2e-3 * random.standard_normal(len(u))),
    }
    point = {"n_set": 1500.0, "n_e": 1500.0, "X_f": 6.0}
    return fp.Experiment("motor", FINE_HZ / EVERY, signals, operating_point=point, hold="zero", kind="steps")


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_eleven_seconds_of_steps_tell_the_gains_of_a_quick_motor_a7(seed):
    found = fp.identify(trial(seed))
    assert found.usability != "not usable"
    for name, truth in {"K_p": K_P, "K_i": K_I, "v": GAIN / TAU_S}.items():
        low, high = found[name].ci95
        assert low < truth < high, name
        assert high - low < 0.1 * truth, name
