"""Figures of fit: NRMSE, MSE, FPE and the information criteria (section 4.1.4 of the thesis)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def nrmse_pct(measured: npt.ArrayLike, residual: npt.ArrayLike) -> float:
    """Fit in per cent, 100 (1 - ||e|| / ||y - mean(y)||), eq. 4.9; samples where either is NaN are left out.

    Parameters
    ----------
    measured, residual
        Real or complex, shape (N,).

    Returns
    -------
    float
        100 for a perfect fit, 0 for one no better than the mean; NaN where the measured signal is constant.
    """
    y, e = np.asarray(measured), np.asarray(residual)
    keep = np.isfinite(y) & np.isfinite(e)
    return fit_pct(*(float(np.linalg.norm(part) ** 2) for part in (e[keep], y[keep] - y[keep].mean())))


def fit_pct(squares: float, spread: float) -> float:
    """Return the fit in per cent from the sums of squares of the residuals and of the measured signal about its mean."""
    return float(100.0 * (1.0 - np.sqrt(squares / spread))) if spread > 0.0 else float("nan")


def information_criteria(scatter: Array, samples: int, parameters: int) -> dict[str, float | None]:
    """Return MSE, deviance (-2 ln L), FPE (eq. 4.11), AIC, AICc, BIC and CAIC of a fit, Gaussian with a free covariance.

    Parameters
    ----------
    scatter
        Mean outer product of the residuals, shape (O, O).
    samples
        Number N of samples (each of O outputs).
    parameters
        Number of free parameters, the blocks' own unknowns included.

    Returns
    -------
    dict
        A figure is None where it is not defined: a singular scatter, or too few samples.
    """
    sign, log_determinant = np.linalg.slogdet(scatter)
    outputs = scatter.shape[0]
    figures: dict[str, float | None] = {"mse": float(np.trace(scatter)), "samples": float(samples)}
    if sign <= 0 or not np.isfinite(log_determinant) or samples <= parameters:
        return figures | dict.fromkeys(("deviance", "fpe", "aic", "aicc", "bic", "caic"))
    likelihood = samples * (log_determinant + outputs * (np.log(2.0 * np.pi) + 1.0))
    aic = likelihood + 2.0 * parameters
    rest = samples * outputs - parameters - 1
    return figures | {
        "deviance": float(likelihood),
        "fpe": float(np.exp(log_determinant) * (1 + parameters / samples) / (1 - parameters / samples)),
        "aic": float(aic),
        "aicc": float(aic + 2.0 * parameters * (parameters + 1) / rest) if rest > 0 else None,
        "bic": float(likelihood + parameters * np.log(samples)),
        "caic": float(likelihood + parameters * (np.log(samples) + 1.0)),
    }
