"""Least-squares fits of sines to samples, with known frequencies or a common estimated frequency (IEEE 1057)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

from shipfp_rs.errors import InputError
from shipfp_rs.frequency.spectra import line_noise
from shipfp_rs.support.arguments import checked, positive
from shipfp_rs.support.arrays import Array, ComplexArray

_ROUNDS = 30
MOST_HARMONICS = 1000
"""Largest number of Gauss-Newton steps for a frequency; from a start within half a bin, six usually suffice."""


@dataclass(frozen=True)
class Lines:
    """Sines a + sum of b sin(2 pi f (t - t_mid) + d), fitted to samples by least squares.

    The phases refer to the middle of the window, where an error of the frequency has no effect on them.

    Parameters
    ----------
    frequency_hz
        Frequencies f, shape (L,).
    offset
        Constant part a, in the unit of the samples.
    amplitude, phase
        Amplitudes b and phases d [rad], shape (L,).
    amplitude_std, phase_std
        Standard deviations of amplitudes and phases, shape (L,), for noise with the residuals' power near each line.
        That of a phase is amplitude_std / amplitude [rad].
    time_mid_s
        Middle of the window, from its first sample [s].
    residual
        Samples minus the fit, shape (N,), NaN where a sample is missing.
    frequency_std_hz
        Standard deviation of the first frequency if it was estimated, else 0.
    """

    frequency_hz: Array
    offset: float
    amplitude: Array
    phase: Array
    amplitude_std: Array
    time_mid_s: float
    residual: Array
    frequency_std_hz: float = 0.0

    @property
    def phase_std(self) -> Array:
        """Standard deviations of the phases [rad], shape (L,)."""
        with np.errstate(divide="ignore"):
            return self.amplitude_std / self.amplitude

    @property
    def phasor(self) -> ComplexArray:
        """Amplitudes and phases as complex numbers, b exp(i d), shape (L,)."""
        return np.asarray(self.amplitude * np.exp(1j * self.phase), dtype=np.complex128)


@checked
def fit_lines(samples: npt.ArrayLike, rate_hz: float, frequencies_hz: npt.ArrayLike) -> Lines:
    """Fit an offset and sines of known frequencies; for a single sine this is the three-parameter fit of IEEE 1057.

    Parameters
    ----------
    samples
        Signal, shape (N,), NaN where a sample is missing.
    rate_hz
        Sample rate [Hz].
    frequencies_hz
        Frequencies [Hz], shape (L,), including harmonics and known disturbances. All are below half the sample rate,
        and at least half a bin (1/(2T), T the record's length) from each other and from zero.

    Raises
    ------
    InputError
        If the samples can't distinguish the frequencies.

    Notes
    -----
    In white noise of standard deviation s the standard deviations are the Cramer-Rao bounds, s sqrt(2/N) of an amplitude
    and s sqrt(2/N) / b of a phase; in coloured noise s^2 is the residuals' power near the line.

    Examples
    --------
    >>> time = np.arange(200) / 50.0
    >>> lines = fit_lines(3.0 + 2.0 * np.sin(2.0 * np.pi * 1.25 * (time - 1.99)), 50.0, [1.25])
    >>> round(lines.offset, 9), round(float(lines.amplitude[0]), 9)
    (3.0, 2.0)
    """
    frequencies = np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))
    values, time, middle = _windowed(samples, rate_hz, frequencies)
    return _solved(values, time, middle, rate_hz, frequencies)


@checked
def fit_sine(
    samples: npt.ArrayLike,
    rate_hz: float,
    near_hz: float | None = None,
    *,
    harmonics: int = 0,
    disturbances_hz: Sequence[float] = (),
) -> Lines:
    """Fit a sine of unknown frequency: the four-parameter fit of IEEE 1057.

    Parameters
    ----------
    samples, rate_hz
        As for `fit_lines`.
    near_hz
        Initial frequency [Hz], within a bin (1/T) of the sine's frequency; None: the highest peak of the spectrum.
    harmonics
        Number of harmonics to fit as well, below half the sample rate; they improve the estimate of the frequency.
    disturbances_hz
        Known frequencies of other lines to fit as well [Hz].

    Returns
    -------
    Lines
        The sine first, then its harmonics and the disturbances.

    Raises
    ------
    InputError
        If there is less than one period, or no sine within a bin of `near_hz`.
    """
    given = _checked(samples, rate_hz)
    if not 0 <= harmonics <= MOST_HARMONICS:
        raise InputError(f"harmonics is {harmonics}, expected 0 to {MOST_HARMONICS}")
    start = _highest_peak(given, rate_hz) if near_hz is None else float(near_hz)
    multiples = np.arange(1, harmonics + 2)
    multiples = multiples[(multiples == 1) | (multiples * start < 0.48 * rate_hz)]
    others = np.asarray(disturbances_hz, dtype=np.float64)
    values, time, middle = _windowed(given, rate_hz, np.concatenate([start * multiples, others]))
    bin_hz = rate_hz / len(values)
    frequency = _nearby_peak(values, time, start, bin_hz)
    for _ in range(_ROUNDS):
        frequencies = np.concatenate([frequency * multiples, others])
        lines = _solved(values, time, middle, rate_hz, frequencies, noise=False)
        slope = _frequency_slope(lines, time, multiples)
        basis = np.column_stack([_basis(time, frequencies), slope])
        step, spread = _last_coefficient(basis, lines.residual)
        frequency += step
        if not abs(frequency - start) <= 1.5 * bin_hz:
            raise InputError(
                f"near_hz: no sine within {bin_hz:.3g} Hz of {start:.6g} Hz, the fit gives {frequency:.6g} Hz; "
                "give its frequency or a longer window"
            )
        if abs(step) < 1e-9 * bin_hz:
            break
    lines = _solved(values, time, middle, rate_hz, np.concatenate([frequency * multiples, others]))
    noise = line_noise(lines.residual, rate_hz, lines.frequency_hz)[0]
    return replace(lines, frequency_std_hz=float(np.sqrt(noise) * spread))


def _checked(samples: npt.ArrayLike, rate_hz: float) -> Array:
    values = np.asarray(samples, dtype=np.float64)
    if values.ndim != 1:
        raise InputError(f"samples: found shape {values.shape}, expected one axis")
    positive("rate_hz", rate_hz)
    present = int(np.isfinite(values).sum())
    if present < 4:
        raise InputError(f"samples: found {present} present, expected 4 or more")
    return values


def _windowed(samples: npt.ArrayLike, rate_hz: float, frequencies: Array) -> tuple[Array, Array, float]:
    """Return the samples, their times from the middle of the window, and the middle; raise errors for invalid arguments."""
    values = _checked(samples, rate_hz)
    present, unknowns = int(np.isfinite(values).sum()), 2 * len(frequencies) + 1
    if present <= unknowns:
        raise InputError(f"samples: found {present} present, expected more than the {unknowns} unknowns")
    outside = ~((frequencies > 0.0) & (frequencies < 0.5 * rate_hz))
    if frequencies.ndim != 1 or not frequencies.size or outside.any():
        found = frequencies[outside].tolist() if frequencies.ndim == 1 else frequencies.shape
        raise InputError(
            f"frequencies_hz: found {found}, expected a list of numbers between 0 and {0.5 * rate_hz:g} Hz"
        )
    bin_hz = rate_hz / len(values)
    if frequencies.min() < 0.9 * bin_hz:
        raise InputError(
            f"frequencies_hz: {frequencies.min():.6g} Hz has {frequencies.min() / bin_hz:.2g} periods in the "
            "window, expected one or more"
        )
    ordered = np.sort(frequencies)
    close = np.flatnonzero(np.diff(ordered) < 0.5 * bin_hz)
    if close.size:
        k = int(close[0])
        raise InputError(
            f"frequencies_hz: {ordered[k]:.6g} and {ordered[k + 1]:.6g} Hz can't be distinguished in a window of "
            f"{1.0 / bin_hz:.4g} s, expected {0.5 * bin_hz:.3g} Hz between them"
        )
    middle = 0.5 * (len(values) - 1) / rate_hz
    return values, np.arange(len(values)) / rate_hz - middle, middle


def _basis(time: Array, frequencies: Array) -> Array:
    """Columns of the least-squares matrix: sin and cos of each line, and the constant."""
    angle = 2.0 * np.pi * time[:, None] * frequencies
    return np.concatenate([np.sin(angle), np.cos(angle), np.ones((len(time), 1))], axis=1)


def _solved(
    values: Array, time: Array, middle: float, rate_hz: float, frequencies: Array, *, noise: bool = True
) -> Lines:
    present = np.isfinite(values)
    basis = _basis(time, frequencies)
    orthogonal, triangle = np.linalg.qr(basis[present])
    solution = solve_triangular(triangle, orthogonal.T @ values[present])
    residual = values - basis @ solution
    count = len(frequencies)
    phasor = solution[:count] + 1j * solution[count : 2 * count]
    std = np.full(count, np.nan)
    if noise:
        rows = np.sum(solve_triangular(triangle, np.eye(len(triangle))) ** 2, axis=1)
        unit = 0.5 * (rows[:count] + rows[count : 2 * count])
        std = np.sqrt(unit * line_noise(residual, rate_hz, frequencies))
        # The residuals of an exact sine are only rounding errors.
        std = np.maximum(std, np.finfo(np.float64).eps * np.nanmax(np.abs(values)))
    return Lines(frequencies, float(solution[-1]), np.abs(phasor), np.angle(phasor), std, middle, residual)


def _frequency_slope(lines: Lines, time: Array, multiples: npt.NDArray[np.int64]) -> Array:
    """Derivative of the sine and its harmonics with respect to the frequency."""
    own = slice(len(multiples))
    angle = 2.0 * np.pi * time[:, None] * lines.frequency_hz[own] + lines.phase[own]
    return np.asarray(2.0 * np.pi * time * (np.cos(angle) @ (lines.amplitude[own] * multiples)))


def _last_coefficient(basis: Array, values: Array) -> tuple[float, float]:
    """Least-squares coefficient of the last column, and its standard deviation for noise of unit variance."""
    present = np.isfinite(values)
    orthogonal, triangle = np.linalg.qr(basis[present])
    last = triangle[-1, -1]
    if abs(last) < 1e-12 * np.abs(triangle).max():
        raise InputError("samples: found no sine whose frequency could be fitted, expected one")
    return float(orthogonal[:, -1] @ values[present] / last), float(1.0 / abs(last))


def _highest_peak(values: Array, rate_hz: float) -> float:
    filled = np.nan_to_num(values - np.nanmean(values))
    spectrum = np.abs(np.fft.rfft(filled * np.hanning(len(filled))))
    return float((1 + np.argmax(spectrum[1:])) * rate_hz / len(filled))


def _nearby_peak(values: Array, time: Array, start: float, bin_hz: float) -> float:
    """Frequency of the spectrum's maximum within a bin of the start, from which Gauss-Newton steps converge."""
    tried = np.maximum(start + bin_hz * np.linspace(-1.0, 1.0, 17), 0.5 * bin_hz)
    filled = np.nan_to_num(values - np.nanmean(values)) * np.hanning(len(values))
    height = [abs(np.dot(filled, np.exp(-2j * np.pi * frequency * time))) for frequency in tried]
    return float(tried[int(np.argmax(height))])
