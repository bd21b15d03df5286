"""One-step prediction with a Kalman gain: derivatives, a known gain found again, what it can and can't do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.errors import InputError
from shipfp_rs.identification.identify import identify
from shipfp_rs.structures.innovations import with_innovations
from shipfp_rs.structures.structure import Structure
from tests.launch import LAUNCH, TRUTH, noisy_record, outputs_of, record

STRUCTURE = Structure.linear(products=True)
CHIRP = signals.chirp(0.02, 5.0, 100.0, 13.0, rate_hz=25.0)
GAIN = np.array([[0.4, 0.02], [-0.05, 0.03]])


def innovations_record(seed, level=1e-4):
    """x[k+1] = Phi x + Gamma u + K e, y = C x + D u + e, by superposition on the clean outputs."""
    dt = 1.0 / CHIRP.rate_hz
    rate = -(LAUNCH.p - LAUNCH.g + LAUNCH.v * LAUNCH.K_p) / LAUNCH.tau_n
    system = np.array([[rate, LAUNCH.v * LAUNCH.K_i / LAUNCH.tau_n], [-1.0, 0.0]])
    strength, modes = np.linalg.eig(system)
    transition = (modes * np.exp(strength * dt) @ np.linalg.inv(modes)).real
    observed = np.array([[1.0, 0.0], [LAUNCH.g - LAUNCH.v * LAUNCH.K_p, LAUNCH.v * LAUNCH.K_i]])
    shocks = level * np.random.default_rng(seed).normal(size=(len(CHIRP.samples), 2)) * [1.0, 5.0]
    disturbed, state = np.empty_like(shocks), np.zeros(2)
    for index, shock in enumerate(shocks):
        disturbed[index] = observed @ state + shock
        state = transition @ state + GAIN @ shock
    return record(CHIRP, outputs_of(CHIRP) + disturbed.T)


def test_the_derivatives_are_those_of_differences():
    structure = with_innovations(Structure.linear(products=True, dead_time_set_point=True), offsets=True)
    equations = structure.equations
    names = ("tau_n", "g", "vK_p", "vK_i", "T_set", *equations.states)
    values = {**TRUTH, "p": 2.0, "T_set": 0.07, **dict.fromkeys(equations.states, 0.01)}
    experiment = noisy_record(CHIRP, 0.05, 0.9, 1).window(0.0, 20.0)
    _, slopes = equations.sensitivities(values, experiment, names)
    for name, slope in zip(names, slopes, strict=True):
        step = 1e-6 * max(abs(values[name]), 1e-2)
        up, down = (
            equations.simulate({**values, name: values[name] + way * step}, experiment) for way in (1.0, -1.0)
        )
        size = np.abs(slope).max()
        np.testing.assert_allclose(slope, (up - down) / (2.0 * step), atol=2e-6 * size)


def test_a_known_gain_and_the_parameters_are_found_again_within_their_intervals():
    fingerprint = identify(innovations_record(1), STRUCTURE, noise="innovations")
    for name, truth in TRUTH.items():
        estimate = fingerprint[name]
        assert abs(estimate.value - truth) < 4.0 * estimate.std
    found = np.reshape(list(fingerprint.settings["kalman_gain"].values()), (2, 2))
    # 2,500 samples tell an entry within about 1/sqrt(2500) of its output's scale.
    np.testing.assert_allclose(found, GAIN, atol=0.08)
    assert fingerprint.fit["dn"]["whiteness_p"] > 0.001
    assert not [line for line in fingerprint.verdict if "contradict" in line]


def test_intervals_hold_the_truth_where_the_disturbance_acts_on_the_drive_train():
    inside = []
    for seed in range(8):
        fingerprint = identify(innovations_record([2, seed]), STRUCTURE, noise="innovations")
        intervals = [fingerprint[name].ci95 for name in TRUTH]
        inside += [low <= truth <= high for (low, high), truth in zip(intervals, TRUTH.values(), strict=True)]
    assert np.mean(inside) > 0.85


def test_without_noise_of_that_kind_the_gain_vanishes_and_the_fit_is_the_simulation_s():
    experiment = noisy_record(CHIRP, 0.05, 0.0, 3)
    white = identify(experiment, STRUCTURE, noise="white")
    predicted = identify(experiment, STRUCTURE, noise="innovations")
    for name in TRUTH:
        assert abs(predicted[name].value - white[name].value) < white[name].std
    assert predicted.fit["dn"]["nrmse_pct"] == pytest.approx(white.fit["dn"]["nrmse_pct"], abs=0.1)


@pytest.mark.parametrize(
    ("structure", "options", "message"),
    [
        (Structure.linear(dead_time_loop=True), {}, "expected a linear one without dead time in the loop"),
        (STRUCTURE, {"initial_state": "zero"}, "estimates the initial state"),
    ],
)
def test_what_it_can_not_do_is_said(structure, options, message):
    with pytest.raises(InputError, match=message):
        identify(noisy_record(CHIRP, 0.05, 0.0, 3), structure, noise="innovations", **options)


def test_masked_samples_are_refused():
    experiment = noisy_record(CHIRP, 0.05, 0.0, 3)
    speed = np.where(np.arange(len(experiment)) == 9, np.nan, experiment.signals["n_e"])
    masked = replace(experiment, signals={**experiment.signals, "n_e": speed})
    with pytest.raises(InputError, match="1 masked samples, noise 'innovations' needs them all"):
        identify(masked, STRUCTURE, noise="innovations")
