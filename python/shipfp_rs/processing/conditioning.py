"""Preparation of an experiment's signals for a fit: operating point, trend, torque at another position on the shaft."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import DRIVES, Experiment
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.checks import one_of
from shipfp_rs.support.spikes import bridge
from shipfp_rs.vessel.vessel import Vessel

Side = Literal["engine", "propeller"]

MOST_DEGREE = 3
"""Highest degree of a trend; a higher polynomial would follow the slow sines of a trial."""
LEAST_LOADED = 0.5
"""Least ratio of the operating point's torque to the torque's swing, with a measured load or in open loop."""
TORQUES = ("M_b", "M_s", "M_g")
LEAST_OWN = 0.2
"""Least fraction of the set point's power that is not a polynomial trend."""


def about_local_point(experiment: Experiment) -> Experiment:
    """Return the experiment relative to the means of its own signals, not the trial's operating point.

    The offset of the torque differs between experiments (1651 to 1721 Nm in appendix E); deviations from one point for
    all of them would include it. Over whole periods of an oscillation the mean is the operating point; over steps, or over
    part of a period, it is not.

    Examples
    --------
    >>> from shipfp_rs import signals, simulate
    >>> sine = signals.sine_sequence([0.1], 4, 13.0)
    >>> local = about_local_point(simulate(Vessel.load("stan-launch-804"), sine))
    >>> bool(abs(local.normalised("n_e").mean()) < 1e-12)
    True
    """
    means = {
        name: float(np.nanmean(experiment.signals[name]))
        for name in experiment.operating_point
        if name in experiment.signals and name != "E_n"
    }
    return replace(experiment, operating_point={**experiment.operating_point, **means})


def driven_point(
    point: dict[str, float],
    windows: Sequence[Mapping[str, Array]],
    torque_Nm: float | None,
    to_shaft: float = 1.0,
) -> dict[str, float]:
    """Operating point; the means of the windows if its torque is near zero and there is a load or command.

    Torques are normalised by the torque of the operating point. For an idling engine these ratios are large and of little
    use, so the mean under load is the better steady state. Quantities missing from the point also take their means. With a
    given torque, `torque_Nm`, the load's mean is shifted by the same difference as the torque, times `to_shaft`.
    """
    every = {name: np.concatenate([signals[name] for signals in windows]) for name in windows[0]}
    means = {name: float(np.nanmean(values)) for name, values in every.items()}
    known = {**means, **point}
    inputs = [name for name in (*TORQUES, "command", "M_load") if name in every]
    if torque_Nm is not None and "M_load" in every and "M_load" not in point:
        known["M_load"] += to_shaft * (torque_Nm - means[inputs[0]])
    if torque_Nm is not None or not {"command", "M_load"} & set(inputs):
        return known
    swing = float(np.nanmax(every[inputs[0]]) - np.nanmin(every[inputs[0]]))
    return known if abs(known[inputs[0]]) > LEAST_LOADED * swing else means


def conditioned(experiment: Experiment, detrend: int, normalise: Literal["global", "local"]) -> Experiment:
    """Remove drift of degree `detrend` from an experiment, or of lower degree if the set point is such a trend itself.

    With `normalise` "local" the result is relative to its own means.
    """
    if detrend:
        degree = 0 if set_point_is_trend(experiment, detrend) else detrend
        experiment = detrended(experiment, degree) if degree else experiment
        experiment = replace(experiment, provenance={**experiment.provenance, "detrend": degree})
    return about_local_point(experiment) if normalise == "local" else experiment


def detrended(experiment: Experiment, degree: int = 1) -> Experiment:
    """Remove slow drift from the outputs of an experiment; its inputs stay unchanged.

    A polynomial of time is fitted to every output, together with the set point and its slope, which represent the plant's
    response. The polynomial without its mean is subtracted, so the operating point is unchanged. This removes, for example,
    the temperature drift of a gauge.

    Parameters
    ----------
    experiment
        Signals with NaN where masked; the result has NaN there, too.
    degree
        Degree of the polynomial, 1 to 3.

    Raises
    ------
    InputError
        For another degree, or if the set point is such a polynomial, since the response to it looks like drift.
    """
    if not 1 <= degree <= MOST_DEGREE:
        raise InputError(f"degree: found {degree}, expected 1 to {MOST_DEGREE}")
    if set_point_is_trend(experiment, degree):
        raise InputError(
            f"experiment {experiment.name!r}: the set point itself is a trend; its answer looks like drift, "
            "leave the signals as they are"
        )
    polynomials = _polynomials(experiment, degree)
    set_point = experiment.signals[experiment.driver] - experiment.signals[experiment.driver].mean()
    answer = np.column_stack([set_point, np.gradient(set_point)])
    answer /= np.maximum(np.abs(answer).max(axis=0), np.finfo(np.float64).tiny)
    basis = np.column_stack([np.ones(len(experiment)), polynomials, answer])

    def without(values: Array) -> Array:
        known = np.isfinite(values)
        trend = polynomials @ np.linalg.lstsq(basis[known], values[known])[0][1 : degree + 1]
        return np.asarray(values - trend + trend[known].mean())

    signals = {
        name: without(values) if name not in DRIVES and np.isfinite(values).any() else values
        for name, values in experiment.signals.items()
    }
    return replace(experiment, signals=signals)


def set_point_is_trend(experiment: Experiment, degree: int = 1) -> bool:
    """Whether the set point is close to a polynomial of time, so that the response to it looks like drift."""
    set_point = experiment.signals[experiment.driver] - experiment.signals[experiment.driver].mean()
    basis = np.column_stack([np.ones(len(experiment)), _polynomials(experiment, degree)])
    left = set_point - basis @ np.linalg.lstsq(basis, set_point)[0]
    return bool(set_point.any() and left @ left < LEAST_OWN * (set_point @ set_point))


def torque_across_inertia(experiment: Experiment, vessel: Vessel, side: Side) -> Array:
    """Convert the gauge torque between the inertias to the torque on one side of both [Nm], shape (N,).

    On the engine's side M_s = M_g + 2 pi J_1 dn_s/dt, normalised M_b* = M_g* + tau_1 s n* with
    tau_1 = 2 pi J_1 n_s0 / M_s0; on the propeller's side M_p = M_g - 2 pi J_2 dn_s/dt. A constant factor can't convert
    between them, since the inertias' torques depend on the acceleration.

    Parameters
    ----------
    experiment
        Experiment with M_g [Nm] and n_e [rpm].
    vessel
        Source of the gear ratio and both inertias.
    side
        "engine": M_s, before the gearbox's shaft; "propeller": M_p.

    Returns
    -------
    ndarray
        Torque, NaN where torque or speed is. The slope of the speed is that of a cubic spline, with an error of 0.1 % up
        to a tenth of the sample rate and of -2 % at a fifth.

    Raises
    ------
    InputError
        If the experiment has no M_g or no n_e, or for another side.
    """
    one_of("side", side, ("engine", "propeller"))
    for name in ("M_g", "n_e"):
        if name not in experiment.signals:
            raise InputError(
                f"experiment {experiment.name!r}: no signal {name!r}; found {', '.join(experiment.signals)}"
            )
    propeller_side = vessel.propeller_side_inertia
    inertia = vessel.inertia - propeller_side if side == "engine" else -propeller_side
    n_s = experiment.signals["n_e"] / 60.0 / vessel.gearbox.ratio
    missing = np.isnan(n_s)
    if missing.all():
        return np.full(len(n_s), np.nan)
    slope = CubicSpline(experiment.time, bridge(n_s, missing))(experiment.time, 1)
    # Beside a gap the slope would be that of the interpolation.
    beside = missing.copy()
    beside[1:] |= missing[:-1]
    beside[:-1] |= missing[1:]
    slope[beside] = np.nan
    return np.asarray(experiment.signals["M_g"] + 2.0 * math.pi * inertia * slope)


def _polynomials(experiment: Experiment, degree: int) -> Array:
    """Legendre polynomials of time without the constant, shape (N, degree)."""
    time = np.linspace(-1.0, 1.0, len(experiment))
    return np.asarray(np.polynomial.legendre.legvander(time, degree)[:, 1:])
