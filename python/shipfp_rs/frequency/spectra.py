"""Frequency responses by averaged periodograms: H1 and H2, with coherence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency.response import FrequencyResponse
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.spikes import bridge

Estimator = Literal["H1", "H2"]

_OVERLAP = 0.5
_KEPT = 2
"""Only every second bin is used: with a Hann window these are nearly independent (correlation 1/36)."""


@checked
def spectral_response(
    experiments: Experiment | Sequence[Experiment],
    segment_s: float,
    *,
    estimator: Estimator = "H1",
    signals: Sequence[str] | None = None,
    band_hz: tuple[float, float] | None = None,
) -> FrequencyResponse:
    """Estimate a response by averaged periodograms of half overlapping Hann windows (Welch), with coherence.

    Parameters
    ----------
    experiments
        One or several of the same rate, averaged together. Masked samples are interpolated.
    segment_s
        Length of the windows [s], much longer than the ship's transient response, which their ends truncate.
    estimator
        "H1": cross spectrum over the set point's, unbiased by noise of the output; "H2": output's spectrum over the cross
        spectrum, unbiased by noise of the set point. The true response is between them.
    signals
        Outputs; None: all that every experiment has.
    band_hz
        Lowest and highest frequency [Hz] with power of the set point; None: all.

    Returns
    -------
    FrequencyResponse
        At every second bin, so that the points are independent.

    Raises
    ------
    InputError
        If fewer than two windows fit.

    Notes
    -----
    The relative standard deviation is sqrt((1 - c) / (2 c n)) with the coherence c and n independent windows (Bendat
    and Piersol, Random Data, 4th edition, table 9.6), where n allows for the overlap (Welch,
    doi:10.1109/TAU.1967.1161901).
    """
    given = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    names = chosen_signals(given, signals)
    rate = given[0].rate_hz
    if any(experiment.rate_hz != rate for experiment in given):
        raise InputError(f"experiments: found rates {sorted({e.rate_hz for e in given})} Hz, expected one")
    size = _samples_of(segment_s, given)
    step = round((1.0 - _OVERLAP) * size)
    window = np.hanning(size + 1)[:-1]

    def spectra(name: str) -> ComplexArray:
        parts = []
        for experiment in given:
            values = whole_signal(experiment, name)[0]
            if len(values) >= size:
                pieces = np.lib.stride_tricks.sliding_window_view(values, size)[::step]
                centred = pieces - pieces.mean(axis=1, keepdims=True)
                parts.append(np.fft.rfft(centred * window, axis=1))
        return np.concatenate(parts) if parts else np.empty((0, size // 2 + 1), dtype=np.complex128)

    U = spectra("n_set")
    if len(U) < 2:
        raise InputError(
            f"segment_s: {len(U)} windows of {segment_s:g} s in the record, expected two or more"
        )
    frequency = np.asarray(np.fft.rfftfreq(size, 1.0 / rate), dtype=np.float64)
    low, high = band_hz or (0.0, np.inf)
    bins = np.arange(_KEPT, len(frequency) - 1, _KEPT)
    bins = bins[(frequency[bins] >= low) & (frequency[bins] <= high)]
    if not bins.size:
        raise InputError(
            f"band_hz: {low:g} to {high:g} Hz holds none of the bins every {_KEPT * rate / size:g} Hz"
        )
    U = U[:, bins]
    # Neighbouring segments share half their samples, but less power because of the window.
    shared = float(np.sum(window[step:] * window[: size - step]) / np.sum(window**2))
    independent = len(U) / (1.0 + 2.0 * shared**2 * (len(U) - 1) / len(U))
    power_in = np.sum(np.abs(U) ** 2, axis=0)
    points = {}
    for name in names:
        Y = spectra(name)[:, bins]
        cross, power_out = np.sum(Y * U.conj(), axis=0), np.sum(np.abs(Y) ** 2, axis=0)
        if not (np.abs(cross) > 0.0).all():
            raise InputError(
                f"band_hz: no power of 'n_set' and {name!r} in common at {frequency[bins][np.abs(cross) == 0.0][0]:g} Hz"
            )
        coherence = np.minimum(np.abs(cross) ** 2 / (power_in * power_out), 1.0)
        response = cross / power_in if estimator == "H1" else power_out / cross.conj()
        points[name] = (response, np.sqrt((1.0 - coherence) / (2.0 * coherence * independent)), coherence)
    provenance = {
        "method": f"{estimator}, averaged periodograms",
        "segment_s": segment_s,
        "windows": len(U),
        "independent_windows": independent,
    }
    return to_response(given[0].name, frequency[bins], points, given[0].operating_point, provenance)


def _samples_of(segment_s: float, experiments: list[Experiment]) -> int:
    rate = experiments[0].rate_hz
    longest_s = max(experiment.duration for experiment in experiments)
    size = round(segment_s * rate) if 0.0 < segment_s <= longest_s else 0
    if size < 8:
        raise InputError(
            f"segment_s: found {segment_s}, expected 8 samples, {8 / rate:g} s, to {longest_s:g} s"
        )
    return size


Points = Mapping[str, tuple[ComplexArray, Array, Array | None]]
"""Signal to its response, the relative standard deviation of each quadrature, and its coherence."""

_MOST_MASKED = 0.05
"""Largest share of a signal that is interpolated linearly for a spectrum."""


def chosen_signals(experiments: Sequence[Experiment], signals: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the outputs: the given ones, or all that every experiment has, without set point and command."""
    if not experiments:
        raise InputError("experiments: found none, expected at least one")
    common = [name for name in experiments[0].signals if all(name in e.signals for e in experiments)]
    names = (
        tuple(name for name in common if name not in ("n_set", "command"))
        if signals is None
        else tuple(signals)
    )
    for name in names:
        if name not in common:
            raise InputError(f"signals: found {name!r}, expected some of {', '.join(common)}")
    if not names:
        raise InputError("signals: the experiments have no output in common, only the set point")
    return names


def whole_signal(experiment: Experiment, name: str) -> tuple[Array, float]:
    """Return the normalised deviation with masked samples interpolated, and their share."""
    values = experiment.normalised(name)
    missing = np.isnan(values)
    share = float(missing.mean())
    if share > _MOST_MASKED:
        raise InputError(
            f"experiment {experiment.name!r}: {share:.0%} of {name!r} is masked, at most {_MOST_MASKED:.0%} can be "
            "bridged for a spectrum; cut the window, or use stepped_sine_response or multisine_response, which need "
            "no bridge"
        )
    return bridge(values, missing), share


def to_response(
    name: str,
    frequency_hz: Array,
    points: Points,
    operating_point: Mapping[str, float],
    provenance: Mapping[str, Any],
) -> FrequencyResponse:
    """Assemble a response; amplitude and phase have the standard deviations of the quadratures."""
    # Residuals of exact data are only rounding; zero standard deviations would give infinite weights.
    std = {key: np.maximum(deviation, np.finfo(np.float64).eps) for key, (_, deviation, _) in points.items()}
    return FrequencyResponse(
        name=name,
        frequency_hz=frequency_hz,
        response={key: response for key, (response, _, _) in points.items()},
        amplitude_std=std,
        phase_std=std,
        operating_point=operating_point,
        provenance=provenance,
        coherence={key: coherence for key, (_, _, coherence) in points.items() if coherence is not None},
    )


_REACH = 10
"""Number of bins on either side of a line for its noise estimate."""


def line_noise(residual: npt.ArrayLike, rate_hz: float, frequencies_hz: npt.ArrayLike) -> Array:
    """Return for each line the variance of white noise with the same power as the residuals have near the line.

    A power law is fitted to the periodogram at neighbouring bins by maximum likelihood (Whittle). The periodogram has no
    window, since a steep spectrum leaks into the fitted line in the same way.

    Parameters
    ----------
    residual
        Samples minus the fitted lines, shape (N,), NaN where missing.
    rate_hz
        Sample rate [Hz].
    frequencies_hz
        Frequencies of all fitted lines [Hz], shape (L,).

    Returns
    -------
    ndarray
        Noise variance, shape (L,), unit of the residual squared. Since it is estimated from few bins, it is increased to
        the variance of Student's distribution with the same degrees of freedom. For a line with neighbours on one
        side only it is the mean of these bins, without neighbours the residuals' variance.

    Notes
    -----
    GUM Supplement 1 (JCGM 101:2008), section 6.4.9: v / (v - 2) for v degrees of freedom.
    """
    values = np.asarray(residual, dtype=np.float64)
    lines = np.asarray(frequencies_hz, dtype=np.float64) * len(values) / rate_hz
    present = np.isfinite(values)
    spectrum = np.abs(np.fft.rfft(np.where(present, values, 0.0))) ** 2 / present.sum()
    found = np.empty(len(lines))
    for k, line in enumerate(lines):
        # At most an octave: over a wider band the noise is no power law.
        first, last = (
            max(round(line) - _REACH, int(line / 2), 1),
            min(round(line) + _REACH, int(2 * line) + 2),
        )
        bins = np.arange(first, min(last + 1, len(spectrum) - 1))
        # A bin or more away from every line the fit removes nothing, and the residuals are noise.
        beside = bins[np.abs(bins[:, None] - lines).min(axis=1, initial=np.inf) > 1.0 - 1e-6]
        below = int(np.sum(beside < line))
        if min(below, len(beside) - below) >= 2:
            found[k] = _power_law(beside / line, spectrum[beside])
        elif beside.size:
            found[k] = _student(spectrum[beside].mean(), 2.0 * len(beside))
        else:
            found[k] = np.sum(values[present] ** 2) / max(present.sum() - 2 * len(lines) - 1, 1)
    return found


def _power_law(ratio: Array, power: Array) -> float:
    """Fit a power law to exponentially distributed periodogram values, and return its value at ratio 1."""
    floor = np.finfo(np.float64).tiny + 1e-12 * power.max()
    design = np.column_stack([np.ones(len(ratio)), np.log(ratio)])
    # The mean logarithm of an exponential variable is Euler's constant below the logarithm of its mean.
    best = np.linalg.lstsq(design, np.log(power + floor) + np.euler_gamma)[0]
    for _ in range(8):
        model = np.exp(np.clip(design @ best, -700.0, 700.0))
        best = best + np.linalg.lstsq(design, np.clip(power / model - 1.0, -1.0, 2.0))[0]
    # The logarithm of chi-squared of v degrees of freedom has the variance 2 / v.
    return _student(float(np.exp(best[0])), 2.0 / float(np.linalg.inv(design.T @ design)[0, 0]))


def _student(variance: float, freedom: float) -> float:
    return float(variance * freedom / max(freedom - 2.0, 1.0))
