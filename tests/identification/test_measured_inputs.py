"""What sensors do to a fit: white noise of a measured input, which the ship never received, and a torque that is held."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.identification.sampling import excitation
from tests.families import recording
from tests.families.draw import draw
from tests.identification.test_sampled_governor import recorded

RATE_HZ = 50.0
TIME = np.arange(round(400.0 * RATE_HZ)) / RATE_HZ
NOISE = 5e-5 * np.random.default_rng(1).standard_normal(len(TIME))


@pytest.mark.parametrize("swing", [0.1, 0.01, 0.001])
def test_noise_of_the_set_point_widens_no_band(swing):
    chirp = swing * np.sin(2.0 * np.pi * (0.01 + 0.25e-3 * TIME) * TIME)  # 0.01 to 0.21 Hz
    # The chirp ends at 0.21 Hz.
    assert 0.15 < excitation(chirp + NOISE, RATE_HZ, 20.0)[1] < 1.2 * excitation(chirp, RATE_HZ, 20.0)[1]


@pytest.mark.parametrize("seed", range(20))
def test_noise_of_a_set_point_at_rest_is_taken_out(seed):
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(9000)
    assert np.std(excitation(1.0 + noise, RATE_HZ, 4.0)[0]) < 0.1 * np.std(noise)


def test_an_input_keeps_what_stands_above_its_noise():
    sines = 1e-3 * np.sin(2.0 * np.pi * 0.2 * TIME) + 2e-4 * np.sin(2.0 * np.pi * 1.1 * TIME)
    assert np.std(excitation(sines + NOISE, RATE_HZ, 4.0)[0] - sines) < 0.15 * np.std(NOISE)


def test_a_random_excitation_is_no_noise():
    random = 0.02 * np.random.default_rng(2).standard_normal(9000)
    kept, band_hz = excitation(random, RATE_HZ, 4.0)
    np.testing.assert_array_equal(kept, random)
    assert band_hz > 3.9


def test_a_boat_whose_set_point_rests_is_right_behind_a_loggers_noise():
    """Half a revolution a minute of noise was taken for an excitation: vK_p 1.33 (0.77 to 1.91) for 2.35."""
    boat = draw("strangers", 95030)
    with tempfile.TemporaryDirectory() as folder:
        trial, _ = recording.write(boat, Path(folder))
        found = fp.identify(fp.process(trial))
    for name in ("tau_n", "vK_p", "vK_i", "T_d"):
        low, high = found[name].ci95
        assert low <= boat.truth()["parameters"][name] <= high, name


def test_a_torque_that_is_held_is_no_twisting_shaft():
    truth, experiment = recorded({"tau_act": 0.05}, "chirp")
    held = np.repeat(experiment.signals["M_b"][::3], 3)[: len(experiment)]
    found = fp.identify(replace(experiment, signals={**experiment.signals, "M_b": held}))
    assert found["tau_twist"].ci95[0] == 0.0
    low, high = found["tau_n"].ci95
    assert low <= truth["tau_n"] <= high


def test_straight_lines_between_samples_make_no_stiff_shaft_twist():
    """Images of the set point in a resonance above the band took a twist for real: tau_n 0.24 to 0.41 for 1.51."""
    launch = fp.Vessel.load("stan-launch-804")
    chirp = fp.signals.chirp(0.02, 3.0, 120.0, 13.0, rate_hz=25.0)
    truth, twisting = fp.linearise(launch), 0
    for seed in range(1, 7):
        trial = fp.simulate(launch, chirp, noise={"n_e": 0.02, "M_g": 0.02}, seed=seed)
        found = fp.identify(trial, outputs=["n_e", "M_g"])
        twisting += found["tau_twist"].ci95[0] > 0.0
        for name in ("tau_n", "p", "tau_prop"):
            low, high = found[name].ci95
            assert low <= getattr(truth, name) <= high, name
    assert twisting <= 1
