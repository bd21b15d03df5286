"""Frequency responses of the linear launch, whose closed form is the known answer, from every kind of excitation."""

from __future__ import annotations

import dataclasses
import tomllib
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from shipfp_rs import signals
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import (
    FrequencyResponse,
    local_response,
    multisine_response,
    spectral_response,
    stepped_sine_response,
)
from shipfp_rs.identification.identify import identify
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log, trial_toml
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.linear_model import LinearModel
from shipfp_rs.vessel.vessel import Vessel
from tests.launch import LAUNCH, POINT, TRUTH, noise, noisy_record, outputs_of, record

RATE = 100.0
PERIOD = 50.0
OUTPUTS = {"n_e": "dn", "M_b": "dM_b"}


@cache
def sines():
    return signals.sine_sequence([0.05, 0.1, 0.2, 0.5, 1.0, 2.0], 12, 13.0, rate_hz=RATE)


@cache
def multisine():
    return signals.multisine(np.geomspace(0.04, 2.0, 14), PERIOD, 26.0, periods=5, rate_hz=RATE)


@cache
def chirp():
    return signals.chirp(0.01, 4.0, 400.0, 13.0, rate_hz=RATE).settled(5.0, 60.0)


@cache
def random_noise():
    return signals.band_limited_noise(0.02, 4.0, 800.0, 13.0, seed=4, rate_hz=RATE).ramped(5.0)


def by_sines(experiment):
    return stepped_sine_response(experiment, sines().segments, settle_periods=4)


def by_lines(experiment):
    return multisine_response(experiment, PERIOD)


def by_polynomials(experiment):
    return local_response(experiment, (0.03, 3.0))


def by_periodograms(experiment):
    return spectral_response(experiment, 80.0, band_hz=(0.03, 3.0))


# The share of a response by which each method may be off without noise. Between samples the set point runs straight:
# (pi f / rate)^2 / 3, 1.3e-3 at 2 Hz and 3e-3 at 3 Hz. Windows cut off the tail of the ship's answer, whose slowest
# pole lies at 0.11 rad/s: 1 / (0.11 * 40 s) of the line's width near the corner.
METHODS = {
    "sines": (sines, by_sines, 2e-3),
    "multisine": (multisine, by_lines, 2e-3),
    "chirp": (chirp, by_polynomials, 4e-3),
    "noise": (random_noise, by_polynomials, 4e-3),
    "chirp, periodograms": (chirp, by_periodograms, 2e-2),
    "noise, periodograms": (random_noise, by_periodograms, 2e-2),
}


def relative_error(found: FrequencyResponse) -> dict[str, np.ndarray]:
    return {
        name: found.response[name] / LAUNCH.response(found.frequency_hz, (output,))[0] - 1.0
        for name, output in OUTPUTS.items()
    }


@pytest.mark.parametrize("method", METHODS)
def test_the_closed_form_is_recovered_from_clean_records(method):
    excitation, estimate, allowed = METHODS[method]
    found = estimate(record(excitation(), outputs_of(excitation())))
    for name, error in relative_error(found).items():
        print(f"{method:20} {name}: {len(found):3} points, worst error {np.abs(error).max():.1e}")
        assert np.abs(error).max() < allowed
    assert found.frequency_hz.min() < 0.06
    assert found.frequency_hz.max() > 1.9


def scores(method: str, correlation: float, draws: int) -> np.ndarray:
    """Errors of both quadratures over the stated deviations, for noise of a tenth of the outputs."""
    excitation, estimate, _ = METHODS[method]
    clean = outputs_of(excitation())
    level = 0.1 * np.sqrt(np.mean(clean**2, axis=1, keepdims=True))
    exact = relative_error(estimate(record(excitation(), clean)))
    found = []
    for draw in range(draws):
        noisy = record(excitation(), clean + level * noise(clean.shape, correlation, [draw, 3]))
        response = estimate(noisy)
        for name, error in relative_error(response).items():
            # Only chance: what the method itself is off by, clean records show.
            chance = error - exact[name]
            found += [chance.real / response.amplitude_std[name], chance.imag / response.phase_std[name]]
    return np.concatenate(found)


COVERED = ("sines", "multisine", "chirp", "noise", "noise, periodograms")


@pytest.mark.parametrize(("method", "correlation"), [*((method, 0.95) for method in COVERED), ("chirp", 0.0)])
def test_errors_are_as_large_as_the_stated_deviations(method, correlation):
    found = scores(method, correlation, 8)
    assert np.sqrt(np.median(found**2)) == pytest.approx(0.6745, rel=0.2)
    assert 0.89 < np.mean(np.abs(found) < 1.96) < 0.985


@pytest.mark.study
def test_coverage_of_the_stated_deviations_in_coloured_noise():
    """Run with `pytest -m study -k coloured_noise -s`."""
    print("\nErrors within 1.96 stated deviations [%], 100 draws; first-order noise of the given correlation")
    print("method                " + "".join(f"{c:>8}" for c in (0.0, 0.9, 0.99)))
    for method in COVERED:
        shares = [np.mean(np.abs(scores(method, c, 100)) < 1.96) for c in (0.0, 0.9, 0.99)]
        print(f"{method:22}" + "".join(f"{100 * share:8.1f}" for share in shares))
        assert all(0.91 < share < 0.97 for share in shares)


@pytest.mark.parametrize("method", ["sines", "multisine", "chirp"])
def test_identification_from_the_responses_finds_the_ship(method):
    excitation, estimate, _ = METHODS[method]
    found = identify(
        estimate(noisy_record(excitation(), 0.02, 0.9, 6)), Structure.linear(products=True), noise="std"
    )
    for name, truth in TRUTH.items():
        assert found[name].value == pytest.approx(truth, abs=5 * found[name].std + 0.01 * abs(truth))


def test_a_common_frequency_keeps_the_phase_though_the_logger_s_clock_is_off():
    excitation = signals.sine_sequence([0.5], 60, 13.0, rate_hz=RATE)
    clean = record(excitation, outputs_of(excitation))
    # The logger calls its samples 0.2 % faster than they are.
    skewed = dataclasses.replace(clean, rate_hz=1.002 * RATE)
    found = stepped_sine_response(skewed, [signals.Segment("sine", 0.0, 119.0, 0.5)], settle_periods=10)
    assert found.frequency_hz[0] == pytest.approx(0.501, rel=1e-6)
    truth = LAUNCH.response([0.5], ("dn",))[0, 0]
    assert np.angle(found.response["n_e"][0] / truth) == pytest.approx(0.0, abs=1e-3)


def test_local_offsets_and_masked_samples_do_not_bend_a_sine_response():
    excitation = signals.sine_sequence([0.5], 20, 13.0, rate_hz=RATE)
    clean = record(excitation, outputs_of(excitation))
    torque = 1.03 * clean.signals["M_b"]
    torque[1500:1700] = np.nan
    drifted = dataclasses.replace(clean, signals={**clean.signals, "M_b": torque})
    options = {"settle_periods": 5, "signals": ["M_b"]}
    np.testing.assert_allclose(
        stepped_sine_response(drifted, **options).response["M_b"],
        stepped_sine_response(clean, **options).response["M_b"],
        rtol=1e-4,
    )


def test_sines_of_several_records_are_put_in_order():
    whole = record(sines(), outputs_of(sines()))
    parts = [whole.window(s.start_s, s.stop_s, name=s.label) for s in sines().segments]
    together = by_sines(whole)
    found = stepped_sine_response(parts[::-1], settle_periods=4)
    np.testing.assert_allclose(found.frequency_hz, together.frequency_hz, rtol=1e-9)
    np.testing.assert_allclose(found.response["M_b"], together.response["M_b"], rtol=1e-6)


def test_harmonics_and_shaft_lines_are_reported_and_removed():
    excitation = signals.sine_sequence([0.5], 20, 13.0, rate_hz=RATE)
    rows = outputs_of(excitation)
    time = excitation.time
    rows[1] += 0.01 * np.sin(2 * np.pi * 1.0 * time) + 0.05 * np.sin(2 * np.pi * 5.15 * time + 1.0)
    truth = LAUNCH.response([0.5], ("dM_b",))[0, 0]
    amplitude = abs(truth) * 13.0 / POINT["n_set"]
    with_lines = stepped_sine_response(record(excitation, rows), disturbances_hz=[5.15], settle_periods=5)
    without = stepped_sine_response(record(excitation, rows), settle_periods=5)
    assert with_lines.response["M_b"][0] == pytest.approx(truth, rel=1e-3)
    assert with_lines.provenance["distortion"]["M_b"][0] == pytest.approx(0.01 / amplitude, rel=1e-2)
    assert abs(without.response["M_b"][0] / truth - 1) > 2 * abs(with_lines.response["M_b"][0] / truth - 1)


def test_h1_is_blind_to_noise_of_the_output_and_h2_to_noise_of_the_set_point():
    rng = np.random.default_rng(1)
    excitation = random_noise()
    rows = outputs_of(excitation)
    heard = rows + 1.5 * rows.std(axis=1, keepdims=True) * rng.standard_normal(rows.shape)
    noisy_output = record(excitation, heard)
    clean = record(excitation, rows)
    # White up to half the sample rate; a fifth of the set point's power in its band.
    shaken = clean.signals["n_set"] + np.sqrt(0.2 * RATE / 8.0) * 13.0 * rng.standard_normal(len(clean))
    noisy_input = dataclasses.replace(clean, signals={**clean.signals, "n_set": shaken})

    def gain(experiment, estimator):
        found = spectral_response(experiment, 20.0, estimator=estimator, band_hz=(0.1, 2.0), signals=["n_e"])
        truth = LAUNCH.response(found.frequency_hz, ("dn",))[0]
        return np.median(np.abs(found.response["n_e"] / truth))

    assert gain(noisy_output, "H1") == pytest.approx(1.0, abs=0.03)
    assert gain(noisy_output, "H2") > 1.03
    assert gain(noisy_input, "H2") == pytest.approx(1.0, abs=0.03)
    assert gain(noisy_input, "H1") == pytest.approx(1 / 1.2, abs=0.04)


def test_averaged_periodograms_are_those_of_scipy():
    experiment = noisy_record(random_noise(), 0.3, 0.5, 1)
    options = {"fs": RATE, "window": "hann", "nperseg": 2000, "noverlap": 1000}
    u, y = experiment.normalised("n_set"), experiment.normalised("M_b")
    frequency, cross = signal.csd(u, y, **options)
    power = {name: signal.welch(x, **options)[1] for name, x in {"u": u, "y": y}.items()}
    coherence = signal.coherence(u, y, **options)[1]
    for estimator, expected in {"H1": cross / power["u"], "H2": power["y"] / cross.conj()}.items():
        found = spectral_response(experiment, 20.0, estimator=estimator, band_hz=(0.1, 3.0))
        bins = np.rint(found.frequency_hz * 20.0).astype(int)
        np.testing.assert_allclose(found.frequency_hz, frequency[bins])
        np.testing.assert_allclose(found.response["M_b"], expected[bins], rtol=1e-9)
        np.testing.assert_allclose(found.coherence["M_b"], coherence[bins], rtol=1e-9)


@settings(max_examples=15)
@given(
    gain=st.floats(0.1, 10.0), delay=st.integers(0, 8), before=st.floats(-1e-2, 1e-2), seed=st.integers(0, 99)
)
def test_a_gain_and_a_delay_are_seen_through_whatever_the_record_cut_off(gain, delay, before, seed):
    # The output goes on from an unknown past, so that the delay is no cyclic one.
    u = 1e-2 * np.random.default_rng(seed).standard_normal(4000)
    y = gain * np.concatenate([np.full(delay, before), u])[:4000]
    found = local_response(record(sampled(u), np.array([y]), ("dn",)), (1.0, 20.0))
    expected = gain * np.exp(-2j * np.pi * found.frequency_hz * delay / RATE)
    # Farthest off of all seeds at the ends of the other ranges: 1.4e-3, where the noise has a dip in its spectrum.
    np.testing.assert_allclose(found.response["n_e"], expected, rtol=2e-3)


def sampled(deviation: np.ndarray) -> signals.Excitation:
    return signals.Excitation("noise", "noise", RATE, POINT["n_set"] * deviation)


def test_a_raw_log_of_sines_gives_the_ship_s_response():
    tug = Vessel.load("stan-tug-1205")
    sequence = signals.sine_sequence([0.1, 0.3, 1.0], 10, 60.0, rate_hz=RATE)
    log, truth = simulate_raw_log(tug, sequence, faults=("A", "B", "C"), seed=3)
    trial_file = tomllib.loads(trial_toml("stan-tug-1205", "log", Sensors(), truth))
    (experiment,) = process(log, Trial.model_validate(trial_file))
    found = stepped_sine_response(
        experiment, sequence.segments, settle_periods=3, disturbances_hz=[5.15, 15.49, 19.68]
    )
    model = LinearModel(**truth.linear)
    for name, output in {"n_e": "dn", "M_g": "dM_g"}.items():
        error = found.response[name] / model.response(found.frequency_hz, (output,))[0] - 1.0
        print(name, np.abs(error), found.amplitude_std[name])
        # The plant is not linear: sixty rpm of 1184 bend the torque by a few per mille.
        assert (np.abs(error) < 0.005 + 4.0 * found.amplitude_std[name]).all()


def test_coherence_is_the_share_of_power_that_the_set_point_explains():
    excitation = random_noise()
    rng = np.random.default_rng(2)
    rows = np.array([excitation.samples / POINT["n_set"]] * 2)
    # In a band of 4 of 50 Hz the noise holds a part of its power.
    ratio = 0.5
    rows[1] += rows[1].std() * np.sqrt(ratio * 50.0 / 4.0) * rng.standard_normal(len(excitation))
    found = spectral_response(record(excitation, rows), 10.0, band_hz=(0.3, 3.0))
    np.testing.assert_allclose(found.coherence["n_e"], 1.0, atol=1e-9)
    assert np.mean(found.coherence["M_b"]) == pytest.approx(1 / (1 + ratio), abs=0.04)
    lines = multisine_response(noisy_record(multisine(), 0.3, 0.0, 2), PERIOD)
    assert (np.diff(np.abs(lines.response["n_e"]))[-3:] < 0).all()
    assert lines.coherence["n_e"][0] > lines.coherence["n_e"][-1]


def test_a_few_masked_samples_are_bridged_and_many_refused():
    clean = record(chirp(), outputs_of(chirp()))
    torque = clean.signals["M_b"].copy()
    torque[20_000:20_020] = np.nan
    spiked = dataclasses.replace(clean, signals={**clean.signals, "M_b": torque})
    found = local_response(spiked, (0.05, 1.0))
    assert found.provenance["bridged"]["M_b"] > 0
    np.testing.assert_allclose(
        found.response["M_b"], local_response(clean, (0.05, 1.0)).response["M_b"], rtol=0.02
    )
    torque[20_000:30_000] = np.nan
    holed = dataclasses.replace(clean, signals={**clean.signals, "M_b": torque})
    for estimate in (by_polynomials, by_periodograms):
        with pytest.raises(InputError, match=r"22% of 'M_b' is masked, at most 5%"):
            estimate(holed)


def with_integral() -> Experiment:
    whole = record(sines(), outputs_of(sines()))
    return dataclasses.replace(whole, signals={**whole.signals, "E_n": whole.signals["n_e"]})


def short() -> Experiment:
    return record(multisine(), outputs_of(multisine()))


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: multisine_response(short(), 100.0), "1 whole periods after settling, expected 2"),
        (lambda: multisine_response(short(), -1.0), "period_s, settle_periods: found -1.0"),
        (lambda: multisine_response(short(), PERIOD, signals=["M_g"]), "signals: found 'M_g', expected some of"),
        (lambda: spectral_response(short(), 200.0), "1 windows of 200 s"),
        (lambda: spectral_response(short(), float("nan")), "segment_s: found nan"),
        (lambda: spectral_response(short(), 20.0, estimator="H3"), "estimator is 'H3', expected 'H1' or 'H2'"),
        (lambda: spectral_response(short(), 20.0, band_hz=(0.01, 0.02)), "holds none of the bins every 0.1 Hz"),
        (lambda: spectral_response([], 20.0), "experiments: found none"),
        (lambda: local_response(short(), (1.0, 0.5)), "band_hz: found 1.0 to 0.5 Hz"),
        (lambda: local_response(short(), (0.1, 0.11)), "holds 2.5 bins of 0.004 Hz, expected 13 or more"),
        (lambda: local_response(short(), (0.1, 1.0)), "too little power near .* multisine_response"),
        (lambda: by_sines(with_integral()), r"no operating point for 'E_n'"),
        (lambda: stepped_sine_response([]), "experiments: found none"),
        (lambda: stepped_sine_response([short()] * 2, sines().segments), "found with 2 experiments, expected with one"),
        (
            lambda: stepped_sine_response(short(), [signals.Segment("a", 0, 9, 0.1)]),
            "experiment 'a': 0.9 periods of 0.1 Hz, expected",
        ),
    ],
)  # fmt: skip
def test_what_tells_no_response_is_refused(call, said):
    with pytest.raises(InputError, match=said):
        call()
