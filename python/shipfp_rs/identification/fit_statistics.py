"""Figures of fit: NRMSE, MSE, FPE and the information criteria (section 4.1.4 of the thesis)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def nrmse_pct(measured: npt.ArrayLike, residual: npt.ArrayLike) -> float:
    """Return 100 (1 - ||e|| / ||y - mean(y)||), eq. 4.9, of real or complex y and e (N,); NaN where y is constant."""
    # Samples where either is NaN are left out. A perfect fit has 100, one that is no better than the mean has 0.
    y, e = np.asarray(measured), np.asarray(residual)
    keep = np.isfinite(y) & np.isfinite(e)
    return fit_pct(*(float(np.linalg.norm(part) ** 2) for part in (e[keep], y[keep] - y[keep].mean())))


def fit_pct(squares: float, spread: float) -> float:
    """Return the fit in per cent from the sums of squares of the residuals and of the measured signal about its mean."""
    return float(100.0 * (1.0 - np.sqrt(squares / spread))) if spread > 0.0 else float("nan")


def information_criteria(scatter: Array, samples: int, parameters: int) -> dict[str, float | None]:
    """Return MSE, deviance (-2 ln L), FPE (eq. 4.11), AIC, AICc, BIC and CAIC of a Gaussian fit with a free covariance."""
    # `scatter` (O, O) is the mean outer product of the residuals; `parameters` counts the unknowns of records, too. Figures
    # are None where they are not defined: a singular scatter, or too few samples.
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
