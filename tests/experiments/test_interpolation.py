"""A set point between its samples: what straight lines take from a band-limited signal, and its return."""

import numpy as np
import pytest

from shipfp_rs import Experiment
from shipfp_rs.experiments.interpolation import band_limited

RATE_HZ, FINER = 50.0, 20


def experiment(values):
    return Experiment(
        "made",
        RATE_HZ,
        {"n_set": 1000.0 * values, "n_e": 1000.0 * np.ones(len(values))},
        operating_point={"n_set": 1000.0, "n_e": 1000.0},
    )


def drawn(values):
    """The straight lines through samples, on a finer grid."""
    t = np.arange(len(values) * FINER) / FINER
    return np.interp(t, np.arange(len(values)), values)


def amplitude(values, frequency_hz, rate_hz):
    inner = slice(len(values) // 4, 3 * len(values) // 4)
    t = np.arange(len(values))[inner] / rate_hz
    columns = np.column_stack([np.sin(2 * np.pi * frequency_hz * t), np.cos(2 * np.pi * frequency_hz * t)])
    return float(np.hypot(*np.linalg.lstsq(columns, values[inner], rcond=None)[0]))


@pytest.mark.parametrize("frequency_hz", [0.5, 2.0, 4.0, 8.0, 14.0])
def test_straight_lines_then_have_the_sines_amplitude(frequency_hz):
    t = np.arange(2000) / RATE_HZ
    asked = 0.05 * np.sin(2 * np.pi * frequency_hz * t)
    before = amplitude(drawn(asked), frequency_hz, RATE_HZ * FINER)
    # The squared sinc, which a closed form gives.
    assert before == pytest.approx(0.05 * np.sinc(frequency_hz / RATE_HZ) ** 2, rel=2e-3)
    filtered = band_limited(experiment(1.0 + asked)).dn_set
    assert amplitude(drawn(filtered), frequency_hz, RATE_HZ * FINER) == pytest.approx(0.05, rel=3e-3)


def test_what_stands_still_stays_and_nothing_else_changes():
    made = experiment(np.full(200, 1.03))
    filtered = band_limited(made)
    np.testing.assert_allclose(filtered.signals["n_set"], 1030.0, rtol=1e-12)
    np.testing.assert_array_equal(filtered.signals["n_e"], made.signals["n_e"])
    assert filtered.operating_point == made.operating_point


def test_a_slow_change_is_hardly_touched():
    values = 1.0 + 0.05 * np.linspace(-1.0, 1.0, 500)
    change = band_limited(experiment(values)).dn_set - experiment(values).dn_set
    assert np.abs(change[25:-25]).max() < 1e-9
