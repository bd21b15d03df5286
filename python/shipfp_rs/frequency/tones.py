"""Frequency responses to sines, by sine fits to all channels, and to any excitation, by local polynomials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency.lines import MOST_HARMONICS, Lines, fit_lines, fit_sine
from shipfp_rs.frequency.spectra import FrequencyResponse, chosen_signals, to_response, whole_signal
from shipfp_rs.signals.excitation import Segment
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array, ComplexArray

_LEAST_PERIODS = 2
"""Fewest periods of a multisine; with fewer, there are no bins between its lines to estimate the noise."""
_EXCITED = 0.05
"""Least amplitude of an excited line, relative to the set point's highest line."""


@checked
def stepped_sine_response(
    experiments: Experiment | Sequence[Experiment],
    segments: Sequence[Segment] = (),
    *,
    signals: Sequence[str] | None = None,
    harmonics: int = 2,
    disturbances_hz: Sequence[float] = (),
    settle_periods: float = 1.0,
) -> FrequencyResponse:
    """Estimate the response to a sequence of sines, with frequencies that are estimated from the set point.

    Parameters
    ----------
    experiments
        One experiment that is divided by `segments`, or one experiment for each sine.
    segments
        Time range of each sine in the experiment [s] and its approximate frequency, as in `Excitation.segments`; the
        frequency is estimated from the set point, and used for all channels.
    signals
        Outputs; None: all that every experiment has.
    harmonics
        Number of harmonics to fit as well; their amplitude relative to the sine's is in the provenance.
    disturbances_hz
        Known lines [Hz], such as shaft and blade passage, also fitted if away from the sine and below half the rate.
    settle_periods
        Initial periods of each sine that are omitted, in which the ship settles.

    Returns
    -------
    FrequencyResponse
        Response of the channels, each normalised by its fitted offset (E_n by its operating point). The variance is the
        sum of the variances due to noise of set point and output near the sine's frequency.

    Raises
    ------
    InputError
        If a sine can't be fitted.

    Notes
    -----
    IEEE 1057, four parameters for the set point and three for the others. Frequencies estimated for each channel would turn
    the phases by 2 pi times their error times the time from the phase reference.
    """
    given = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    names = chosen_signals(given, signals)
    if len(segments) > 0 and len(given) != 1:
        raise InputError(f"segments: found with {len(given)} experiments, expected with one")
    windows: list[tuple[Experiment, float | None]] = [(experiment, None) for experiment in given]
    if len(segments) > 0:
        windows = [
            (given[0].window(s.start_s, min(s.stop_s, given[0].duration), name=s.label), s.frequency_hz)
            for s in segments
        ]
    fits: list[dict[str, Lines]] = []
    for window, near_hz in windows:
        try:
            fits.append(_fitted(window, near_hz, names, harmonics, disturbances_hz, settle_periods))
        except InputError as error:
            raise InputError(f"experiment {window.name!r}: {error}") from error
    order = np.argsort([fit["n_set"].frequency_hz[0] for fit in fits])
    fits = [fits[k] for k in order]
    frequency = np.array([fit["n_set"].frequency_hz[0] for fit in fits])
    points = {}
    for name in names:
        pairs = [
            _ratio(fit[name], fit["n_set"], _reference(given[0], name, fit[name]), fit["n_set"].offset)
            for fit in fits
        ]
        response, std = (np.array(column) for column in zip(*pairs, strict=True))
        points[name] = (response[:, 0], std[:, 0], None)
    provenance = {
        "method": "sine fits, IEEE 1057",
        "frequency_std_hz": [fit["n_set"].frequency_std_hz for fit in fits],
        "offset": {name: [fit[name].offset for fit in fits] for name in ("n_set", *names)},
        "distortion": {name: [_distortion(fit[name]) for fit in fits] for name in ("n_set", *names)},
    }
    return to_response("stepped sines", frequency, points, given[0].operating_point, provenance)


@checked
def multisine_response(
    experiment: Experiment,
    period_s: float,
    *,
    frequencies_hz: npt.ArrayLike | None = None,
    signals: Sequence[str] | None = None,
    settle_periods: float = 1.0,
) -> FrequencyResponse:
    """Estimate the response to a periodic excitation at its lines, with coherence.

    Parameters
    ----------
    experiment
        Record that starts with the excitation.
    period_s
        Period of the excitation [s].
    frequencies_hz
        Excited lines [Hz], shape (F,); None: the lines of the set point above a twentieth of its highest line.
    signals
        Outputs; None: all.
    settle_periods
        Initial periods that are omitted, in which the ship settles.

    Returns
    -------
    FrequencyResponse
        The noise is estimated between the lines. The coherence is that of a single period: signal over signal plus noise, in
        set point and output.

    Raises
    ------
    InputError
        If fewer than two whole periods remain.
    """
    names = chosen_signals([experiment], signals)
    if not (np.isfinite(period_s) and period_s > 0.0 and settle_periods >= 0.0):
        raise InputError(
            f"period_s, settle_periods: found {period_s}, {settle_periods}, "
            "expected period_s above 0, settle_periods 0 or more"
        )
    periods = int(experiment.duration / period_s - settle_periods + 1e-9)
    if periods < _LEAST_PERIODS:
        raise InputError(
            f"period_s: {periods} whole periods after settling, expected {_LEAST_PERIODS} or more to estimate "
            "the noise between the lines"
        )
    start_s = settle_periods * period_s
    window = experiment.window(start_s, start_s + periods * period_s)
    frequency = (
        _excited(window, period_s)
        if frequencies_hz is None
        else np.atleast_1d(np.asarray(frequencies_hz, float))
    )
    lines = {
        name: fit_lines(window.normalised(name), window.rate_hz, frequency) for name in ("n_set", *names)
    }
    noise = {name: periods * fit.phase_std**2 for name, fit in lines.items()}
    points = {
        name: (
            *_ratio(lines[name], lines["n_set"], 1.0, 1.0),
            np.asarray(1.0 / ((1.0 + noise[name]) * (1.0 + noise["n_set"]))),
        )
        for name in names
    }
    provenance = {"method": "multisine lines", "periods": periods, "settle_periods": settle_periods}
    return to_response(experiment.name, frequency, points, experiment.operating_point, provenance)


def _fitted(
    window: Experiment,
    near_hz: float | None,
    names: Sequence[str],
    harmonics: int,
    disturbances_hz: Sequence[float],
    settle_periods: float,
) -> dict[str, Lines]:
    """Fit all channels of a sine, the set point first."""
    rate = window.rate_hz
    if near_hz is None:
        near_hz = float(fit_sine(window.signals["n_set"], rate).frequency_hz[0])
    if (window.duration - settle_periods / near_hz) * near_hz < 1.0:
        raise InputError(
            f"{window.duration * near_hz:.3g} periods of {near_hz:.4g} Hz, expected one or more after the "
            f"{settle_periods:g} in which the ship settles"
        )
    settled = window.window(settle_periods / near_hz, window.duration)
    bin_hz = rate / len(settled)
    if not 0 <= harmonics <= MOST_HARMONICS:
        raise InputError(f"harmonics is {harmonics}, expected 0 to {MOST_HARMONICS}")
    multiples = near_hz * np.arange(1, harmonics + 2)
    apart = [
        line
        for line in disturbances_hz
        if line < 0.5 * rate - bin_hz and np.abs(line - multiples).min() > 1.5 * bin_hz
    ]
    set_point = fit_sine(settled.signals["n_set"], rate, near_hz, harmonics=harmonics, disturbances_hz=apart)
    fits = {name: fit_lines(settled.signals[name], rate, set_point.frequency_hz) for name in names}
    return {"n_set": set_point, **fits}


def _distortion(fit: Lines) -> float:
    """Root sum of squares of the harmonics' amplitudes, over the sine's amplitude."""
    order = fit.frequency_hz[1:] / fit.frequency_hz[0]
    return float(np.linalg.norm(fit.amplitude[1:][np.abs(order - np.round(order)) < 1e-9]) / fit.amplitude[0])


def _reference(experiment: Experiment, name: str, fit: Lines) -> float:
    """Divisor that normalises a channel: its offset, or for the integrated error the engine's speed (eq. 3.15)."""
    if name != "E_n":
        return fit.offset
    if name not in experiment.operating_point:
        raise InputError(
            f"experiment {experiment.name!r}: no operating point for 'E_n', expected the engine's speed in rev/s; "
            "give operating_point['E_n'] or leave 'E_n' out of signals"
        )
    return experiment.operating_point[name]


def _ratio(
    output: Lines, set_point: Lines, point: float, set_point_point: float
) -> tuple[ComplexArray, Array]:
    """Normalised ratio of output and set point, and the relative standard deviation of its real and imaginary part."""
    response = (output.phasor / point) / (set_point.phasor / set_point_point)
    return np.asarray(response), np.hypot(output.phase_std, set_point.phase_std)


def _excited(window: Experiment, period_s: float) -> Array:
    """Multiples of 1/period at which the set point has power."""
    highest = int(0.5 * window.rate_hz * period_s - 1e-9)
    periods = round(window.duration / period_s)
    # A Hann window over the record reduces the leakage of a period that is not a whole number of samples.
    values = window.normalised("n_set")
    spectrum = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values))))
    lines = np.arange(1, highest + 1)
    height = spectrum[np.minimum(lines * periods, len(spectrum) - 1)]
    if not height.size or height.max() == 0.0:
        raise InputError(
            f"experiment {window.name!r}: the set point has no line at multiples of 1/period_s = {1.0 / period_s:.4g} Hz"
        )
    return np.asarray(lines[height > _EXCITED * height.max()] / period_s)


_DEGREE = 2
_LEAST_HALF = 6
"""Least number of bins on either side: 13 bins in total, minus the six unknowns of two quadratics, leave seven degrees
of freedom for the noise.
"""
_SHARE = 0.05
"""Half width of the window relative to its frequency, if this is wider than the least number of bins; a response varies
more slowly at high frequencies.
"""

_SILENT = 1e-9
"""Magnitude of the set point's spectrum, relative to its maximum, below which a bin has only rounding errors."""


@checked
def local_response(
    experiment: Experiment, band_hz: tuple[float, float], *, signals: Sequence[str] | None = None
) -> FrequencyResponse:
    """Estimate a response by local polynomials: for chirps, steps and noise, without windows, from a single record.

    Near each frequency the spectra obey Y = G U + T, with leakage T due to the record's ends. G and T are smooth, while the
    spectrum U of the excitation is not: quadratics for G and T, fitted to a few bins, separate them.

    Parameters
    ----------
    experiment
        Record, preferably of one excitation from rest to rest. Masked samples are interpolated.
    band_hz
        Lowest and highest frequency that the set point excites [Hz].
    signals
        Outputs; None: all.

    Returns
    -------
    FrequencyResponse
        Response at independent points, whose bins do not overlap, with standard deviations from the fit's residuals.
        Noise of the set point is not considered.

    Raises
    ------
    InputError
        If the band has too few bins, or the set point has no power in it.

    Notes
    -----
    Pintelon, Schoukens, Vandersteen and Barbe, doi:10.1016/j.ymssp.2009.08.009. Between samples the set point is linear and
    the ship's response is not: at f a simulated response has a relative error of (pi f / rate)^2 / 3, 3e-4 at a hundredth of
    the rate. Signals that were low-passed before sampling have no such error.
    """
    names = chosen_signals([experiment], signals)
    low, high = band_hz
    resolution = experiment.rate_hz / len(experiment)
    if not 0.0 < low < high < 0.5 * experiment.rate_hz:
        raise InputError(
            f"band_hz: found {low} to {high} Hz, expected ascending between 0 and {0.5 * experiment.rate_hz:g} Hz"
        )
    windows = _windows(round(low / resolution), int(high / resolution), len(experiment) // 2)
    if not windows:
        raise InputError(
            f"band_hz: {low:g} to {high:g} Hz holds {(high - low) / resolution:.3g} bins of {resolution:.3g} Hz, "
            f"expected {2 * _LEAST_HALF + 1} or more; take a wider band or a longer record"
        )
    U, points, bridged = _spectrum(experiment, experiment.driver)[0], {}, {}
    loudest = np.abs(U).max()
    for name in names:
        Y, bridged[name] = _spectrum(experiment, name)
        pairs = []
        for centre, first, last in windows:
            bins = slice(first, last + 1)
            if np.sum(np.abs(U[bins]) > _SILENT * loudest) <= 2 * (_DEGREE + 1):
                raise InputError(
                    f"band_hz: the set point has too little power near {centre * resolution:.4g} Hz; take a band that "
                    "it excites throughout, or multisine_response for separate lines"
                )
            pairs.append(_local_fit(U[bins], Y[bins], np.arange(first, last + 1) - centre))
        response, std = (np.array(column) for column in zip(*pairs, strict=True))
        points[name] = (response, std / np.abs(response), None)
    centres = np.array([centre for centre, _, _ in windows])
    provenance = {
        "method": "local polynomials",
        "half_width_bins": [last - centre for centre, _, last in windows],
        "bridged": bridged,
    }
    return to_response(experiment.name, centres * resolution, points, experiment.operating_point, provenance)


def _spectrum(experiment: Experiment, name: str) -> tuple[ComplexArray, float]:
    values, share = whole_signal(experiment, name)
    return np.fft.rfft(values - values.mean()), share


def _windows(first: int, last: int, highest: int) -> list[tuple[int, int, int]]:
    """Centre, first and last bin of each of the adjacent windows between two bins."""
    windows: list[tuple[int, int, int]] = []
    at = max(first, 1)
    while True:
        # The half width R is a share of the centre: R = share * (at + R), solved for R.
        half = max(_LEAST_HALF, round(_SHARE / (1.0 - _SHARE) * at))
        if at + 2 * half > min(last, highest - 1):
            return windows
        windows.append((at + half, at, at + 2 * half))
        at += 2 * half + 1


def _local_fit(U: ComplexArray, Y: ComplexArray, offset: npt.NDArray[np.int64]) -> tuple[complex, float]:
    """Response at the window's centre, and the standard deviation of its real and imaginary parts."""
    powers = (offset / np.abs(offset).max())[:, None] ** np.arange(_DEGREE + 1)
    scale = np.abs(U).max()
    basis = np.concatenate([powers * (U / scale)[:, None], powers], axis=1)
    orthogonal, triangle = np.linalg.qr(basis)
    inverse = np.linalg.inv(triangle)
    solution = inverse @ (orthogonal.conj().T @ Y)
    rest = Y - basis @ solution
    noise = np.sum(np.abs(rest) ** 2) / (len(Y) - basis.shape[1])
    spread = np.sqrt(0.5 * noise * np.sum(np.abs(inverse[0]) ** 2))
    return complex(solution[0] / scale), float(spread / scale)
