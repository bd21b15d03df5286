"""Frequency responses to any excitation by local polynomials, which separate leakage from the response."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency.channels import chosen_signals, to_response, whole_signal
from shipfp_rs.frequency.response import FrequencyResponse
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import ComplexArray

_DEGREE = 2
_LEAST_HALF = 6
"""Least bins on either side: 13 for the six unknowns of two quadratics leave seven for the noise."""
_SHARE = 0.05
"""Half width of the window as a share of the frequency, if that is larger: curves are smoother at high frequencies."""

_SILENT = 1e-9
"""Share of the set point's highest spectrum below which a bin is rounding."""


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
        At independent points, whose bins do not overlap; standard deviations from the fit's residuals. Noise of the set
        point is not considered.

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
    """Centre, first and last bin of adjacent windows from the first bin to the last."""
    windows: list[tuple[int, int, int]] = []
    at = max(first, 1)
    while True:
        # Half width as a share of the centre: R = share * (at + R), solved for R.
        half = max(_LEAST_HALF, round(_SHARE / (1.0 - _SHARE) * at))
        if at + 2 * half > min(last, highest - 1):
            return windows
        windows.append((at + half, at, at + 2 * half))
        at += 2 * half + 1


def _local_fit(U: ComplexArray, Y: ComplexArray, offset: npt.NDArray[np.int64]) -> tuple[complex, float]:
    """Response at offset zero, and the standard deviation of its real and imaginary parts."""
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
