"""Covariance of estimates whose residuals are correlated in time and from one output to the other."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import firwin, freqz, lfilter, oaconvolve

from shipfp_rs import Structure, Vessel, identify, signals, simulate
from shipfp_rs.errors import InputError
from shipfp_rs.identification.sandwich import score_covariance, vector_autoregression
from shipfp_rs.simulation.inflow import Inflow, disturbed
from shipfp_rs.vessel.linear_model import linearise

TUG = Vessel.load("stan-tug-1205")


def correlated(samples: int, random: np.random.Generator) -> np.ndarray:
    """Two outputs of one source, the second late."""
    source = random.normal(size=samples + 3)
    slow = np.convolve(source, [1.0, 0.8, 0.5], "valid")[:samples]
    return np.array([slow, 0.7 * np.roll(slow, 2) + 0.3 * random.normal(size=samples)])


def test_scores_scatter_as_the_spectral_matrix_says():
    random = np.random.default_rng(5)
    samples, draws = 400, 3000
    time = np.arange(samples)
    columns = np.array(
        [
            [np.sin(0.3 * time), np.cos(0.2 * time)],
            [np.ones(samples), np.sin(0.05 * time)],
            [np.cos(1.5 * time), -np.sin(0.3 * time)],
        ]
    )
    scores = np.array([np.einsum("pon,on->p", columns, correlated(samples, random)) for _ in range(draws)])
    long = correlated(40000, random)
    predicted = score_covariance([columns], [(long, np.ones(40000, dtype=bool))])
    deviations = np.sqrt(np.diag(predicted))
    assert np.allclose(scores.std(axis=0), deviations, rtol=0.08)
    found = np.corrcoef(scores.T)
    assert np.allclose(found, predicted / np.outer(deviations, deviations), atol=0.08)


@pytest.mark.parametrize("frequency_hz", [0.05, 0.2, 0.4, 0.6, 0.8, 1.0])
def test_scores_below_the_edge_of_a_low_pass_scatter_as_its_response_says(frequency_hz):
    # As in processed logs: slow noise, low-passed and brought to 6.25 Hz. The fold-back lies in the stop band.
    rate_hz, fine, samples, draws = 6.25, 8, 2500, 30
    taps = firwin(40 * fine + 1, 0.4 * rate_hz, fs=fine * rate_hz, window=("kaiser", 10.0))
    slow = [1.0, -np.exp(-1.0 / (fine * rate_hz))]
    wave = np.sin(2.0 * np.pi * frequency_hz / rate_hz * np.arange(samples))[None, None]
    told = []
    for seed in range(draws):
        source = np.random.default_rng(seed).normal(size=(samples + 50) * fine)
        passed = oaconvolve(lfilter([1.0], slow, source), taps, "valid")[::fine][:samples]
        told.append(score_covariance([wave], [(passed[None], np.ones(samples, dtype=bool))])[0, 0])
    at = [frequency_hz / rate_hz / fine * 2.0 * np.pi]
    power = np.abs(freqz(taps, worN=at)[1] * freqz([1.0], slow, worN=at)[1])[0] ** 2
    assert np.mean(told) == pytest.approx(0.5 * samples * power / fine, rel=0.1)


def test_samples_next_to_a_gap_are_left_out():
    values = correlated(5000, np.random.default_rng(2))
    valid = np.ones(5000, dtype=bool)
    whole = vector_autoregression([(values, valid)])
    values[:, 1000:1010], valid[1000:1010] = 100.0, False
    assert np.allclose(vector_autoregression([(values, valid)]), whole, atol=0.05)


def test_disturbed_water_is_what_the_propeller_meets():
    tug = linearise(TUG)
    still = simulate(TUG, signals.steps([0.0], 300.0, rate_hz=20.0))
    moving = disturbed(still, tug, Inflow(share=0.02, memory_s=0.5), seed=4)
    n, M = moving.normalised("n_e"), moving.normalised("M_g")
    slope = np.gradient(n, 1.0 / 20.0)
    water = M - tug.p * n - tug.tau_prop * slope
    assert water.std() == pytest.approx(0.02, rel=0.1)
    assert np.corrcoef(water[10:], water[:-10])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.1)
    # Engine's side: what the shaft's inertia takes beside the gauge is what governor and engine give.
    integral = np.cumsum(-n) / 20.0
    brake = tug.g * n + tug.v * (tug.K_i * integral - tug.K_p * n)
    rest = (tug.tau_n - tug.tau_prop) * slope + M - brake
    assert np.std(rest - rest.mean()) < 0.2 * M.std()


def test_intervals_by_the_sandwich_hold_the_truth_in_moving_water():
    # The water's torque reaches gauge and speed, each in its own way; the chirp is small, so that nothing bends.
    excitation = signals.chirp(0.02, 1.0, 100.0, 20.0, rate_hz=10.0)
    truth = dataclasses.asdict(linearise(TUG))
    clean = simulate(TUG, excitation)
    structure = Structure.linear(torque="gauge", products=True, free_exponent=True)
    structure = structure.with_fixed(tau_n=truth["tau_n"], g=truth["g"])
    inside = []
    for seed in range(12):
        experiment = disturbed(clean, linearise(TUG), Inflow(), seed)
        found = identify(experiment, structure, noise="white", covariance="sandwich")
        assert not any("intervals may be too narrow" in line for line in found.verdict)
        inside += [
            low <= truth[name] <= high for name in ("p", "tau_prop") for low, high in [found[name].ci95]
        ]
    assert np.mean(inside) >= 0.8


def test_a_word_that_is_no_covariance_is_refused():
    excitation = signals.steps([30.0], 20.0, rate_hz=10.0)
    with pytest.raises(InputError, match="'bread', expected 'model' or 'sandwich'"):
        identify(simulate(TUG, excitation), Structure.linear(), covariance="bread")
