"""Noise of a fit, coloured or white: roots (inverse Cholesky factors) of the residuals' spectral matrix.

The likelihood of spectra is that of Whittle 1953 (doi:10.1007/BF02590998).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.stats import t as student

from shipfp_rs.support.arrays import DEVIATIONS_95, Array, Numbers

OVER, LEAST_REACH, MOST_REACH = 0.35, 10, 40
"""Half width of the moving average that smooths the residuals' spectral matrix: share of the frequency's index, and least
and largest number of frequencies."""
STEEP, MOST_FALL = 40, -2.0
"""Number of the lowest frequencies at which the noise may follow a power law, and that law's least exponent."""
FLOOR = 1e-3
"""Value added to the spectral matrix's diagonal, relative to the diagonal's median over frequencies."""
LEAST_NOISE, LEAST_OWN = 1e-7, 1e-9
"""Least standard deviation of white noise relative to an output's root mean square, far above rounding errors; and least
share of an output's noise variance that is independent of other outputs."""


def turned(root: Numbers, spectra: Numbers) -> Numbers:
    """Multiply spectra (W, O, F) by a root (F, O, O) or (O, O)."""
    if root.ndim == 2:
        return np.asarray(root @ spectra)
    found = np.zeros_like(spectra)
    for a, b in zip(*np.tril_indices(root.shape[1]), strict=True):  # roots are lower triangles
        found[:, a] += np.ascontiguousarray(root[:, a, b]) * spectra[:, b]
    return found


def real_rows(spectra: Numbers) -> Array:
    """Return complex or real arrays (W, O, F) as real rows (W, R), real parts before imaginary parts."""
    flat = spectra.reshape(len(spectra), -1)
    return np.concatenate([flat.real, flat.imag], axis=1) if np.iscomplexobj(flat) else np.asarray(flat)


def spread_of(root: Numbers) -> float:
    """Sum of the log determinants of the noise, from roots (F, O, O); each complex number has two real components."""
    return -4.0 * float(np.log(np.abs(root.diagonal(0, -2, -1))).sum())


def _shape(amplitudes: Array) -> Array:
    """Power law fitted to amplitudes (O, F) over the lowest `STEEP` frequencies, constant above them, shape (O, F)."""
    steep = min(STEEP, amplitudes.shape[1] - 1)
    places = np.log(np.arange(1, steep + 1))
    places -= places.mean()
    fall = np.log(amplitudes[:, 1 : steep + 1] + 1e-300) @ places / max(places @ places, 1e-300)
    # The mean, at frequency 0, gets the value of the first frequency.
    reached = np.clip(np.arange(steep + 1), 1, steep) ** np.clip(fall, MOST_FALL, 0.0)[:, None]
    return np.pad(reached, ((0, 0), (0, amplitudes.shape[1] - steep - 1)), mode="edge")


def noise_root(residual: Numbers, unsure: Numbers | float = 0.0) -> Numbers:
    """Root (F, O, O) for the smoothed spectral matrix of residuals (O, F), to which `unsure` is added."""
    outputs, count = residual.shape
    place = np.arange(count)
    # The torque disturbance by moving water has a steep noise spectrum at low frequencies. An average over neighbouring
    # frequencies would be biased there, so residuals are divided by the spectrum's shape before they are averaged.
    shape = _shape(np.abs(residual))
    a, b = np.tril_indices(outputs)
    both = shape[a] * shape[b]
    products = residual[a] * residual[b].conj()
    products = (products + (unsure[a, b] if isinstance(unsure, np.ndarray) else unsure)) / both
    reach = np.clip((OVER * place).astype(int), LEAST_REACH, max(min(MOST_REACH, count // 8), LEAST_REACH))
    first, last = np.maximum(place - reach, 0), np.minimum(place + reach, count - 1)
    sums = np.zeros((len(a), count + 1), products.dtype)
    np.cumsum(products, axis=-1, out=sums[:, 1:])
    matrix = (sums.take(last + 1, 1) - sums.take(first, 1)) * (0.5 / (last + 1 - first)) * both
    matrix[a == b] += FLOOR * np.median(matrix[a == b].real, axis=1, keepdims=True) + 1e-18
    lower = np.zeros((outputs, outputs, count), matrix.dtype)
    lower[a, b] = matrix
    return np.moveaxis(_inverse_root(lower), -1, 0)


def white_root(left: Array, said: Array, share: float, quantile: float) -> Array:
    """Root (O, O) of the inverse covariance of residuals `left` (O, R) from data `said` (O, R)."""
    # The fitted unknowns absorb noise: residuals have only `share` of its power.
    covariance = left @ left.T / (left.shape[1] * share)
    size = LEAST_NOISE**2 * (np.mean(said**2, axis=1) + 1e-12) + LEAST_OWN * np.diag(covariance)
    root = np.linalg.inv(np.linalg.cholesky(covariance + np.diag(size)))
    # With this scale, all 95 % intervals end at the same rise of the deviance.
    return np.asarray(root * (DEVIATIONS_95 / quantile))


@cache
def quantile_of(freedom: int) -> float:
    """Half width of a 95 % interval, in standard deviations, by Student's t, since noise from few numbers is uncertain."""
    return float(student.ppf(0.975, max(freedom, 1)))


def _inverse_root(matrix: Numbers) -> Numbers:
    """Inverse Cholesky factors of matrices, lower triangles (O, O, F); `LinAlgError` if one is not positive definite."""
    root, found = np.zeros_like(matrix), np.zeros_like(matrix)
    for a in range(len(matrix)):
        for b in range(a + 1):
            rest = matrix[a, b] - np.sum(root[a, :b] * root[b, :b].conj(), axis=0)
            if a == b:
                if not (rest.real > 0.0).all():
                    raise np.linalg.LinAlgError("a spectral matrix is not positive definite")
                root[a, a] = np.sqrt(rest.real)
            else:
                root[a, b] = rest / root[b, b]
        found[a, a] = 1.0 / root[a, a]
        for b in range(a):
            found[a, b] = -found[a, a] * np.sum(root[a, b:a] * found[b:a, b], axis=0)
    return found
