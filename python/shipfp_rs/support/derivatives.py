"""Numerical derivatives, finite impulse response (FIR) low-pass, and interpolation of band-limited signals."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import signal
from scipy.signal import firwin, resample_poly

from shipfp_rs.support.arrays import Array

PASSBAND, STOPBAND = 0.3, 0.5
"""Edges of the low-pass's passband and stopband as fractions of the output's rate; the stopband avoids aliasing.
"""
ATTENUATION_DB = 80.0


def taps(rate: float, shift: float) -> Array:
    """Kaiser-windowed sinc low-pass for an output at `rate` times the filter's rate, delayed by `shift` filter samples."""
    count, beta = signal.kaiserord(ATTENUATION_DB, (STOPBAND - PASSBAND) * rate / 0.5)
    half = count // 2
    time = np.arange(-half, half + 1) + shift
    inside = np.sqrt(np.maximum(1.0 - (time / (half + abs(shift))) ** 2, 0.0))
    cutoff = (PASSBAND + STOPBAND) * rate
    taps = cutoff * np.sinc(cutoff * time) * np.i0(beta * inside)
    return np.asarray(taps / taps.sum())


EITHER_SIDE, RIPPLE_1E_5 = 32, ("kaiser", 10.0)
"""Number of samples on either side that contribute to an interpolated sample, and the window of the filter. The
response is flat to 1e-5 up to 0.45 of the rate. The torque follows from a small difference of set point and speed, so a
ripple of 0.1 per cent would bias a parameter by more than its interval.
"""


def interpolated(values: Array, factor: int) -> Array:
    """Samples of a band-limited signal at `factor` times its rate, with the same first and last times."""
    if factor == 1 or not len(values):
        return values
    pad = 200
    wide = np.pad(values, pad, mode="edge")
    taps = firwin(2 * EITHER_SIDE * factor + 1, 1.0 / factor, window=RIPPLE_1E_5)
    fine = resample_poly(wide - wide[0], factor, 1, window=taps)
    return np.asarray(fine[pad * factor : (pad + len(values)) * factor] + wide[0])


Function = Callable[[npt.NDArray[Any]], npt.ArrayLike]

COMPLEX_STEP = 1e-30
"""Relative imaginary step: its square is negligible against 1, so the derivative is exact to rounding."""
STEP = 1e-3
"""Relative real step; the fourth-order error is then near 1e-12 if the function is smooth over a few per cent."""
SHRINK = 0.1
"""Factor of the step's next trial, if the results of two steps differ by more than `AGREE`; at most `TRIES` trials."""
AGREE = 1e-5
TRIES = 6
ROUNDING = 1e-14
"""Relative rounding error of a computed function."""


@dataclass
class Differences:
    """Derivatives of functions of a real vector, by complex step or by extrapolated differences.

    The imaginary part of f(x + ih) gives the derivative, exact to rounding (Squire and Trapp, SIAM Review 40 (1998)
    110-112), if the function accepts complex numbers and is analytic: no abs, no comparison, no table. This is checked
    once against a central difference and stored in `complex_step`. Otherwise central differences with two step sizes
    are extrapolated to fourth order (Richardson). For smooth functions, their error is about 1e-10 times the function's
    magnitude over the parameter's. Next to a bound, one-sided differences are used, with an error of about 1e-8 times
    this ratio.

    Parameters
    ----------
    complex_step
        Whether the complex step is reliable; None to determine it.
    """

    complex_step: bool | None = None

    def __call__(
        self,
        function: Function,
        vector: Array,
        size: Array,
        lower: npt.ArrayLike = -np.inf,
        upper: npt.ArrayLike = np.inf,
    ) -> tuple[Array, Array]:
        """Return the function's value, and its derivatives with one row for each entry of the argument.

        Parameters
        ----------
        function
            Function of a vector (Q,) that returns an array of any shape.
        vector
            Point of the derivatives, shape (Q,).
        size
            Typical sizes (Q,), positive, to scale the steps of entries that are zero.
        lower, upper
            Bounds (Q,) within which the function is evaluated.

        Returns
        -------
        value, derivatives
            Array returned by the function, and an array (Q, ...) of derivatives.

        Examples
        --------
        >>> decay = lambda x: x[0] * np.exp(-x[1] * np.arange(3))
        >>> value, slope = Differences()(decay, np.array([2.0, 0.5]), np.ones(2))
        >>> slope.round(12).tolist()
        [[1.0, 0.606530659713, 0.367879441171], [0.0, -1.213061319425, -1.471517764686]]
        """
        value = np.asarray(function(vector), dtype=np.float64)
        size = np.where(vector != 0.0, np.abs(vector), size)
        if self.complex_step:
            return value, _complex_step(function, vector, size)
        room = np.array([vector - np.asarray(lower, dtype=np.float64), np.asarray(upper) - vector])

        def along(unit: Array) -> Callable[[float], Array]:
            return lambda shift: np.asarray(function(vector + shift * unit), dtype=np.float64)

        rows = zip(np.eye(len(vector)), size, *room, strict=True)
        slopes = np.array([_extrapolated(along(unit), value, *sides) for unit, *sides in rows])
        slopes = slopes.reshape(len(vector), *value.shape)
        if self.complex_step is None:
            exact = _trusted_complex_step(function, vector, size, value, slopes)
            self.complex_step = exact is not None
            slopes = slopes if exact is None else exact
        return value, slopes


def by_part(
    differences: Differences,
    function: Callable[[npt.NDArray[Any]], Sequence[npt.NDArray[Any]]],
    vector: Array,
    size: Array,
    lower: npt.ArrayLike = -np.inf,
    upper: npt.ArrayLike = np.inf,
) -> list[list[Array]]:
    """Derivatives of a function that returns several arrays: for each entry of the vector, a list of as many arrays.

    The other arguments are those of `Differences`.
    """

    def flat(at: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.concatenate([part.ravel() for part in function(at)])

    parts = function(vector)
    edges = np.cumsum([part.size for part in parts])[:-1]
    _, slopes = differences(flat, vector, size, lower, upper)
    return [
        [piece.reshape(part.shape) for piece, part in zip(np.split(row, edges), parts, strict=True)]
        for row in slopes
    ]


def _complex_step(function: Function, vector: Array, size: Array) -> Array:
    steps = COMPLEX_STEP * size
    rows = zip(vector + 1j * np.diag(steps), steps, strict=True)
    return np.array([np.imag(function(row)) / step for row, step in rows])


def _trusted_complex_step(
    function: Function, vector: Array, size: Array, value: Array, differences: Array
) -> Array | None:
    """Derivatives by complex step if they agree with the differences."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            slopes = _complex_step(function, vector, size)
    except Exception:  # any error means that the function does not accept complex numbers
        return None
    if slopes.shape != differences.shape:
        return None
    size = size.reshape(-1, *(1,) * value.ndim)
    noise = 1e-8 * np.max(np.abs(value), initial=0.0) / size
    close = np.abs(slopes - differences) <= 1e-5 * np.abs(differences).max(initial=0.0) + noise
    return slopes if close.all() else None


def _extrapolated(
    shifted: Callable[[float], Array], value: Array, size: float, below: float, above: float
) -> Array:
    """Derivative at 0, with steps of at most `below` and `above`."""
    inward = 1.0 if above >= below else -1.0
    step = STEP * size
    central = min(below, above) >= step
    if not central:
        step = min(step, max(below, above) / 2.0)

    def difference(h: float) -> Array:
        if central:
            return (shifted(h) - shifted(-h)) / (2.0 * h)
        h *= inward
        return (4.0 * shifted(h) - shifted(2.0 * h) - 3.0 * value) / (2.0 * h)

    scale = float(np.max(np.abs(value), initial=0.0))
    for _ in range(TRIES):
        coarse, fine = difference(step), difference(step / 2.0)
        apart, slope = (float(np.max(np.abs(a), initial=0.0)) for a in (fine - coarse, fine))
        if apart <= AGREE * slope + ROUNDING * scale / step:
            break
        step *= SHRINK
    return fine + (fine - coarse) / 3.0
