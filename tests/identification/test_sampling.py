"""A record: the band that its inputs reach, its noise, and what is known of its channels."""

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.identification.likelihood import ACCURACY
from shipfp_rs.identification.noise import noise_root
from shipfp_rs.identification.question import question_of
from shipfp_rs.identification.sampling import BAND_HZ, LEAST_HZ
from shipfp_rs.support.derivatives import interpolated

RATE_HZ = 50.0


def recorded(deviation, **provenance):
    signals = {"n_set": 1200.0 * (1.0 + deviation), "n_e": 1200.0 * (1.0 + deviation)}
    return fp.Experiment(
        "R1",
        RATE_HZ,
        {**signals, "M_b": 100.0 * (1.0 + 2.0 * deviation)},
        {"n_set": 1200.0, "n_e": 1200.0, "M_b": 100.0},
        provenance=provenance,
    )


def band_of(deviation):
    (record,) = question_of([recorded(deviation)]).likelihood("band-limited").records
    return record.band_hz


@pytest.mark.parametrize("last_hz", [0.8, 1.6, 3.0])
def test_the_band_ends_where_a_chirp_does(last_hz):
    t = np.arange(0.0, 200.0, 1.0 / RATE_HZ)
    chirp = 0.05 * np.sin(np.pi * last_hz * t**2 / t[-1])
    assert band_of(chirp) == pytest.approx(last_hz, rel=0.05)


def test_steps_reach_far_and_a_slow_sine_no_further_than_the_least_band():
    t = np.arange(0.0, 200.0, 1.0 / RATE_HZ)
    assert band_of(0.05 * np.sign(np.sin(2.0 * np.pi * t / 40.0))) > 0.9 * BAND_HZ
    assert band_of(0.05 * np.sin(2.0 * np.pi * 0.02 * t)) == LEAST_HZ


def test_noise_that_falls_with_the_frequency_is_told_down_to_the_lowest():
    # Over 60 records: the power that the roots put to one, where a mean over neighbours alone would tell too little.
    random, place = np.random.default_rng(5), np.arange(400)
    deviation = np.maximum(place, 1.0) ** -1.5 + 1e-3
    powers = []
    for _ in range(60):
        white = random.standard_normal((2, 1, len(place)))
        residual = deviation * (white[0] + 1j * white[1])
        powers.append(np.abs(noise_root(residual)[:, 0, 0] * residual[0]) ** 2)
    told = np.mean(powers, axis=0)
    assert 1.0 < np.mean(told[2:8]) < 4.0
    assert np.mean(told[50:]) == pytest.approx(2.0, rel=0.1)


def test_the_accuracy_of_a_gauge_comes_with_the_experiment():
    said = recorded(0.01 * np.sin(np.arange(2000.0)), gauge_accuracy={"M_b": 0.01})
    usual, worse = question_of([said]).likelihood("band-limited").accuracy
    assert (usual, worse) == (ACCURACY, 0.01)


@pytest.mark.parametrize("part", [0.02, 0.1, 0.3, 0.42])
def test_an_interpolation_keeps_every_sine_of_the_band(part):
    at = np.arange(1000)
    fine = interpolated(np.sin(2.0 * np.pi * part * at), 4)
    inside = slice(4 * 100, -4 * 100)
    wanted = np.sin(2.0 * np.pi * part * np.arange(len(fine)) / 4.0)
    assert np.abs(fine - wanted)[inside].max() < 3e-5


def test_a_chirp_with_hardly_any_noise_tells_the_exponent_of_the_ship_that_made_it():
    launch = fp.Vessel.load("stan-launch-804")
    chirp = fp.signals.chirp(0.1, 1.4, 60.0, 39.0, rate_hz=RATE_HZ * 10)
    record = fp.simulate(launch, chirp, noise={"n_e": 1e-4, "M_b": 1e-4}, seed=1)
    thinned = {name: record.signals[name][5::10] for name in ("n_set", "n_e", "M_b")}
    found = fp.identify(fp.Experiment("C1", RATE_HZ, thinned, record.operating_point, "first", "chirp"))
    low, high = found["p"].ci95
    assert low < 2.0 < high
    assert found["p"].value == pytest.approx(2.0, abs=5e-3)
