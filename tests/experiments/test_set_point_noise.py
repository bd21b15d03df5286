"""A set point without the logger's noise: what goes, and what stays."""

import numpy as np
import pytest
from scipy.signal import chirp as scipy_chirp

from shipfp_rs import Experiment
from shipfp_rs.experiments.set_point_noise import without_noise

RATE_HZ, NOISE = 50.0, 5e-5
T = np.arange(15_000) / RATE_HZ


def experiment(values):
    return Experiment(
        "made",
        RATE_HZ,
        {"n_set": 1000.0 * values, "n_e": 1000.0 * np.ones(len(values))},
        operating_point={"n_set": 1000.0, "n_e": 1000.0},
    )


def chirp():
    return 0.06 * scipy_chirp(T, 0.02, T[-1], 4.0, method="logarithmic", phi=-90.0)


SENT = {
    "chirp": chirp,
    "steps": lambda: 0.05 * np.sign(np.sin(2.0 * np.pi * T / 41.0)),
    "sines": lambda: sum(0.01 * np.sin(2.0 * np.pi * f * T + f) for f in (0.07, 0.23, 0.61, 1.3, 3.7)),
}


@pytest.mark.parametrize("kind", SENT)
def test_most_of_the_noise_goes_and_the_signal_stays(kind):
    sent = 1.0 + np.resize(SENT[kind](), len(T))
    logged = sent + NOISE * np.random.default_rng(3).standard_normal(len(T))
    quiet = 1.0 + without_noise(experiment(logged)).dn_set
    before, after = np.std(logged - sent), np.std(quiet - sent)
    assert after < 0.62 * before
    # Above the excitation hardly any is left.
    spectrum = np.abs(np.fft.rfft((quiet - sent) * np.hanning(len(T))))
    told = np.abs(np.fft.rfft((logged - sent) * np.hanning(len(T))))
    high = np.fft.rfftfreq(len(T), 1.0 / RATE_HZ) > 12.0
    if kind != "steps":
        assert np.sum(spectrum[high] ** 2) < 0.02 * np.sum(told[high] ** 2)


def test_a_set_point_without_noise_stays_what_it_is():
    sent = 1.0 + np.resize(chirp(), len(T))
    quiet = 1.0 + without_noise(experiment(sent)).dn_set
    assert np.abs(quiet - sent).max() < 1e-4 * np.ptp(sent)


def test_a_record_too_short_to_tell_noise_is_left_alone():
    short = experiment(1.0 + 0.01 * np.sin(T[:700]))
    assert without_noise(short) is short


def test_only_the_set_point_changes():
    made = experiment(1.0 + NOISE * np.random.default_rng(1).standard_normal(len(T)))
    quiet = without_noise(made)
    np.testing.assert_array_equal(quiet.signals["n_e"], made.signals["n_e"])
    assert quiet.operating_point == made.operating_point
