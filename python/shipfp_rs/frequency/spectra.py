"""Frequency responses by averaged periodograms: H1 and H2, with coherence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency.channels import chosen_signals, to_response, whole_signal
from shipfp_rs.frequency.response import FrequencyResponse
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import ComplexArray

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
