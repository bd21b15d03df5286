"""Sine fits: exact sines exactly, noisy ones as well as noise allows, coloured noise told from white."""

from __future__ import annotations

import doctest

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import curve_fit

from shipfp_rs.errors import InputError
from shipfp_rs.frequency import fit_lines, fit_sine, lines
from shipfp_rs.frequency.spectra import line_noise
from tests.launch import noise

RATE, COUNT = 50.0, 2000  # 40 s
SINE_HZ, AMPLITUDE, LEVEL = 0.55, 1.0, 0.2
TIME = np.arange(COUNT) / RATE
MIDDLE = TIME[-1] / 2


def sine(frequency=SINE_HZ, amplitude=AMPLITUDE, phase=0.4, time=TIME):
    """A sine whose phase refers to the middle of the window."""
    return amplitude * np.sin(2 * np.pi * frequency * (time - MIDDLE) + phase)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@settings(max_examples=40)
@given(
    periods=st.floats(2.0, 300.0),
    phase=st.floats(-3.0, 3.0),
    amplitude=st.floats(1e-3, 1e3),
    offset=st.floats(-1e3, 1e3),
    lost=st.lists(st.integers(0, COUNT - 200), max_size=3),
)
def test_an_exact_sine_is_found_exactly_whatever_is_masked(periods, phase, amplitude, offset, lost):
    frequency = periods / (COUNT / RATE)
    samples = offset + sine(frequency, amplitude, phase)
    for start in lost:
        samples[start : start + 60] = np.nan
    for fit in (
        fit_lines(samples, RATE, frequency),
        fit_sine(samples, RATE, frequency * (1 + 0.3 / periods)),
    ):
        scale = amplitude + abs(offset)
        assert fit.frequency_hz[0] == pytest.approx(frequency, rel=1e-7)
        assert fit.offset == pytest.approx(offset, abs=1e-9 * scale)
        assert fit.phasor[0] == pytest.approx(amplitude * np.exp(1j * phase), abs=1e-9 * scale)
        assert np.nanmax(np.abs(fit.residual)) < 1e-9 * scale
        np.testing.assert_array_equal(np.isnan(fit.residual), np.isnan(samples))


def test_harmonics_and_a_disturbance_are_told_apart():
    parts = {SINE_HZ: 1.0, 2 * SINE_HZ: 0.3, 3 * SINE_HZ: 0.1, 5.15: 2.0}
    samples = sum(sine(f, a, phase=f) for f, a in parts.items())
    fit = fit_sine(samples, RATE, SINE_HZ + 0.01, harmonics=2, disturbances_hz=[5.15])
    np.testing.assert_allclose(fit.frequency_hz, list(parts), rtol=1e-10)
    np.testing.assert_allclose(fit.amplitude, list(parts.values()), rtol=1e-9)


def test_the_fit_agrees_with_a_general_least_squares_routine():
    samples = 2.0 + sine() + LEVEL * np.random.default_rng(5).standard_normal(COUNT)
    fit = fit_sine(samples, RATE, SINE_HZ)

    def model(time, frequency, a, b, c):
        angle = 2 * np.pi * frequency * (time - MIDDLE)
        return a * np.sin(angle) + b * np.cos(angle) + c

    found, covariance = curve_fit(model, TIME, samples, [SINE_HZ, 1.0, 0.0, 2.0], xtol=1e-13, ftol=1e-13)
    assert fit.frequency_hz[0] == pytest.approx(found[0], rel=1e-8)
    assert fit.phasor[0] == pytest.approx(found[1] + 1j * found[2], rel=1e-6)
    # The routine takes the noise from all residuals, the fit from those near the line.
    assert fit.frequency_std_hz == pytest.approx(np.sqrt(covariance[0, 0]), rel=0.5)


@pytest.fixture(scope="module")
def white_draws():
    """250 fits with known and with fitted frequency in white noise."""
    known, fitted = [], []
    for draw in range(250):
        samples = sine() + LEVEL * np.random.default_rng([7, draw]).standard_normal(COUNT)
        known.append(fit_lines(samples, RATE, SINE_HZ))
        fitted.append(fit_sine(samples, RATE, SINE_HZ))
    return known, fitted


def test_errors_in_white_noise_reach_the_cramer_rao_bound(white_draws):
    # var A = 2 s^2/N; var phi = 2 s^2/(N A^2) at the middle whether or not the frequency is known, and four times
    # that at the record's start where it is not; var f = 6 s^2 / (pi^2 A^2 N^3) rate^2 (Rife and Boorstyn,
    # doi:10.1109/TIT.1974.1055282).
    bound = LEVEL * np.sqrt(2 / COUNT)
    frequency_bound = RATE * LEVEL / (np.pi * AMPLITUDE) * np.sqrt(6 / COUNT**3)
    for name, fits in zip(("known", "fitted"), white_draws, strict=True):
        amplitude = rms([fit.amplitude[0] - AMPLITUDE for fit in fits]) / bound
        phase = rms([fit.phase[0] - 0.4 for fit in fits]) / (bound / AMPLITUDE)
        print(f"{name} frequency: errors of amplitude {amplitude:.3f}, phase {phase:.3f} of the bound")
        assert 0.85 < amplitude < 1.2
        assert 0.85 < phase < 1.2
    frequency = rms([fit.frequency_hz[0] - SINE_HZ for fit in fits]) / frequency_bound
    at_start = [
        fit.phase[0] - 0.4 - 2 * np.pi * (fit.frequency_hz[0] - SINE_HZ) * fit.time_mid_s for fit in fits
    ]
    start = rms(at_start) / (2 * bound / AMPLITUDE)
    print(
        f"fitted frequency: errors of frequency {frequency:.3f}, phase at the start {start:.3f} of the bound"
    )
    assert 0.85 < frequency < 1.2
    assert 0.85 < start < 1.2


def test_stated_deviations_in_white_noise_are_the_bound(white_draws):
    bound = LEVEL * np.sqrt(2 / COUNT)
    for fits in white_draws:
        assert rms([fit.amplitude_std[0] for fit in fits]) == pytest.approx(bound, rel=0.1)
        assert np.mean([fit.phase_std[0] for fit in fits]) == pytest.approx(bound / AMPLITUDE, rel=0.1)
    std = np.mean([fit.frequency_std_hz for fit in white_draws[1]])
    assert std == pytest.approx(RATE * LEVEL / np.pi * np.sqrt(6 / COUNT**3), rel=0.1)


@pytest.mark.parametrize("correlation", [0.9, 0.99])
def test_stated_deviations_hold_in_coloured_noise_where_white_ones_do_not(correlation):
    errors, stated = [], []
    rows = noise((200, COUNT), correlation, 11)
    for row in rows:
        fit = fit_lines(sine() + LEVEL * row, RATE, SINE_HZ)
        errors += [fit.amplitude[0] - AMPLITUDE, (fit.phase[0] - 0.4) * AMPLITUDE]
        stated += [fit.amplitude_std[0]] * 2
    share = np.mean(np.abs(errors) < 1.96 * np.array(stated))
    white = np.mean(np.abs(errors) < 1.96 * LEVEL * np.sqrt(2 / COUNT))
    assert 0.90 < share < 0.98
    assert white < 0.75


@pytest.mark.parametrize("power", [0.0, -2.0, 1.0])
def test_the_noise_at_a_line_is_read_off_a_sloping_spectrum(power):
    rng = np.random.default_rng(3)
    frequency = np.fft.rfftfreq(COUNT, 1 / RATE)
    shape = np.concatenate([[0.0], (frequency[1:] / SINE_HZ) ** (power / 2)])
    found = []
    for _ in range(60):
        coloured = np.fft.irfft(shape * np.fft.rfft(rng.standard_normal(COUNT)), COUNT)
        found.append(line_noise(coloured, RATE, [SINE_HZ])[0])
    assert np.mean(found) == pytest.approx(1.0, rel=0.15)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: fit_lines(np.zeros((2, 2)), RATE, 1.0), r"samples: found shape \(2, 2\)"),
        (lambda: fit_lines(sine(), 0.0, 1.0), "rate_hz is 0.0"),
        (lambda: fit_lines(sine(), RATE, [30.0]), r"found \[30.0\], expected .* between 0 and 25 Hz"),
        (lambda: fit_lines(sine(), RATE, []), "frequencies_hz: found"),
        (lambda: fit_lines(sine(), RATE, [1.0, 1.001]), "can't be distinguished in a window of 40 s"),
        (lambda: fit_lines(sine(), RATE, 0.01), "0.01 Hz has 0.4 periods"),
        (lambda: fit_lines(np.full(50, np.nan), RATE, 2.0), "found 0 present, expected 4"),
        (lambda: fit_lines(sine()[:6], RATE, [9.0, 12.0, 15.0]), "found 6 present, expected more than the 7"),
        (lambda: fit_sine(np.ones(COUNT), RATE, 1.0), "no sine"),
        (lambda: fit_sine(np.ones(COUNT), RATE), "no sine"),
        (lambda: fit_sine(np.full(50, np.nan), RATE), "found 0 present"),
    ],
)
def test_what_can_not_be_fitted_is_refused(call, said):
    with pytest.raises(InputError, match=said):
        call()


def test_the_examples_run():
    found = doctest.testmod(lines)
    assert found.attempted
    assert not found.failed
