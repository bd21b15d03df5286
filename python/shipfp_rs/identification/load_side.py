"""The load's side alone: p and the inertia behind the torque sensor from speed and torque, whatever the governor does.

    M = N^p + c_2 (N - 1)^2 + t2 dN/dt, late by T_M, over the operating point

Speed carries noise, and moving water affects speed and torque together, so that least squares are biased. Neither affects
the part of the speed that a few fixed lags of the set point, or of a measured load, explain. This part is the instrument of
two-stage least squares (Söderström and Stoica 1983). No governor, limit or actuator is modelled, so none can be wrong.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import DRIVES, Experiment
from shipfp_rs.identification.estimate import Estimate, rounded_rows
from shipfp_rs.identification.input_checks import LEAST_SWING, is_loaded, require_plausible
from shipfp_rs.identification.likelihood import ACCURACY
from shipfp_rs.identification.load_equation import SHARED, Fit, Record
from shipfp_rs.identification.question import BOUNDS, PRIORS, SIGNALS, Question
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.structures.outputs import Torque
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.threads import with_one_blas_thread
from shipfp_rs.vessel.vessel import Vessel

QUANTITIES: Mapping[str, str] = {"tau_n": "inertia", "tau_prop": "propeller_inertia"}
"""Names of inertias in SI units, as `assessment.si` has them."""
QUANTILE = 1.959964
"""Quantile of the normal distribution for 95 % intervals."""


@dataclass(frozen=True)
class LoadRecord:
    """One experiment: its torque's scale, explained share of the speed, and highest frequency that counts [Hz]."""

    name: str
    torque_scale: Estimate
    explained: float
    band_hz: float


@dataclass(frozen=True, eq=False)
class LoadSide:
    """The load's law and the inertia behind the torque's place; see `load_side`.

    `parameters` has p, c_2, T_M, "tau_prop" behind a gauge or "tau_n" at the brake, "k_L" with a measured load, and
    "torque scale" where there is one experiment. `covariance` (P, P) is in their order. `si` is the inertia in kg m2, with
    the place it is seen from. `equation` is what was fitted.
    """

    torque: Torque
    parameters: Mapping[str, Estimate]
    covariance: Array
    records: tuple[LoadRecord, ...]
    si: Mapping[str, Mapping[str, Any]]
    equation: Fit
    places: Mapping[str, int]
    """Indices of the parameters among the equation's unknowns."""

    @property
    def law(self) -> dict[str, float]:
        """Exponent p [-] and inertia "tau" [s] behind the torque, for starting values of a search."""
        p, tau = (
            self.parameters[name].value for name in ("p", "tau_prop" if self.torque == "gauge" else "tau_n")
        )
        assert p is not None
        assert tau is not None
        return {"p": p, "tau": max(tau, 0.01)}

    def __repr__(self) -> str:
        rows = [
            f"{row.name} {row.value} ± {row.std}{' s' if row.unit == 's' else ''}"
            for row in rounded_rows(self.parameters)
        ]
        return f"LoadSide({self.torque}: {'; '.join(rows)})"


@checked
@with_one_blas_thread
def load_side(
    experiments: Experiment | Sequence[Experiment],
    *,
    torque: Torque | None = None,
    vessel: Vessel | str | Path | None = None,
) -> LoadSide:
    """Identify the load from speed and torque, without a model of engine and governor.

    Parameters
    ----------
    experiments
        One, or several of the same ship that are fitted together. Each has N samples of a set point (or command), a speed
        and a torque, over 20 s or more. A load that was measured in all of them is an input, too.
    torque
        Location of the torque sensor: "gauge" between the inertias, or "brake" of the engine; None: by the signal, brake
        first.
    vessel
        Vessel as an object, name or file, whose gear ratio and efficiency give the inertia in kg m2. Without a vessel the
        inertia in kg m2 is known only for a torque M_b, referred to the engine.

    Returns
    -------
    LoadSide
        p [-], c_2 [-], delay T_M [s], torque scale [-] and tau_prop or tau_n [s] with 95 % intervals, normalised by the
        operating point, and the inertia J = tau M_0 / (2 pi n_0), n_0 in rev/s.

    Raises
    ------
    InputError
        If speed or torque was not measured, a channel can't be what it is called, or nothing excites the ship.

    Notes
    -----
    Instruments: Söderström and Stoica 1983, "Instrumental Variable Methods for System Identification", Springer. Inertia:
    eq. 3.23 of the thesis. Smooth errors of the torque's response are allowed for as in `identify`, and a shaft that twists.
    Where N^p is not the load's law, p is its slope at the operating point.
    """
    several = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    if not several:
        raise InputError("load_side: no experiment, expected one or more")
    speed, signal, side = _signals(several, torque)
    loaded = is_loaded(several)
    _require_excitation(several, loaded)
    require_plausible(several)
    spectra = [
        Spectra.of(one, ("dn", "dM"), np.array([_measured(one, speed), _measured(one, signal)]), load=loaded)
        for one in several
    ]
    return _told(several, spectra, speed, signal, side, vessel)


def _told(
    several: Sequence[Experiment],
    spectra: Sequence[Spectra],
    speed: str,
    signal: str,
    side: Torque,
    vessel: Vessel | str | Path | None = None,
) -> LoadSide:
    """Return the load identified from the records of experiments."""
    loaded = bool(len(spectra[0].load))
    accuracy = max(one.gauge_accuracy.get(signal, ACCURACY) for one in several)
    fit = Fit([Record(one) for one in spectra], side == "gauge", accuracy)
    x, covariance = fit.found()
    if x[1] + 3.0 * np.sqrt(covariance[1, 1]) < 0.0:
        raise InputError(
            f"load_side: {signal} falls while the shaft speeds up, expected it to rise; turn the sign of its scale"
        )
    low, high = BOUNDS["p"]
    if not low < x[0] < high:
        raise InputError(
            f"load_side: {signal} goes with {speed} to the power {x[0]:.3g}, expected {low:g} to {high:g}; look at both"
        )
    inertia = "tau_prop" if side == "gauge" else "tau_n"
    told = {"p": 0, "c_2": 2, inertia: 1, "T_M": 3} | ({"k_L": 6} if loaded else {})
    scales = [_estimate(x, covariance, len(SHARED) + index) for index in range(len(several))]
    parameters = {name: _estimate(x, covariance, at, name) for name, at in told.items()}
    if len(several) == 1:
        told["torque scale"], parameters["torque scale"] = len(SHARED), scales[0]
    places = list(told.values())
    records = tuple(
        LoadRecord(one.name, scale, record.share, float(one.frequency_hz[record.count - 1]))
        for one, record, scale in zip(spectra, fit.records, scales, strict=True)
    )
    si = _si(several, speed, signal, QUANTITIES[inertia], parameters[inertia], vessel)
    return LoadSide(side, parameters, covariance[np.ix_(places, places)], records, si, fit, told)


def load_side_of(question: Question, records: Sequence[Spectra] | None = None) -> LoadSide | None:
    """Return the load from speed and torque of a question's experiments alone; None where that is impossible.

    `records` are corrected by a model: without images of the set point, gaps filled.
    """
    if "dM" not in question.outputs:
        return None
    side: Torque = "gauge" if question.gauge else "brake"
    try:
        if records is None:
            return load_side(question.experiments, torque=side)
        speed, signal = (question.signal_in(question.experiments[0], output) for output in ("dn", "dM"))
        return _told(question.experiments, records, speed, signal, side)
    except (InputError, np.linalg.LinAlgError):
        return None


def _signals(experiments: Sequence[Experiment], torque: Torque | None) -> tuple[str, str, Torque]:
    """Names of speed and torque, and location of the torque sensor."""
    common = set.intersection(*(set(one.signals) for one in experiments))
    speed = next((name for name in ("n_e", "n_s") if name in common), None)
    if speed is None:
        raise InputError("load_side: no experiment has a speed, expected the signal n_e or n_s in each")
    measured = [name for name in SIGNALS if name in common]
    signal = next((name for name in measured if torque in (None, SIGNALS[name])), next(iter(measured), None))
    if signal is None:
        raise InputError(f"load_side: no torque in every experiment, expected one of {', '.join(SIGNALS)}")
    return speed, signal, torque or SIGNALS[signal]


def _measured(experiment: Experiment, name: str) -> Array:
    values = experiment.normalised(name)
    if not np.isfinite(values).any():
        raise InputError(f"experiment {experiment.name!r}: every sample of {name} is masked, expected some")
    return values


def _require_excitation(experiments: Sequence[Experiment], loaded: bool) -> None:
    for one in experiments:
        swing = max(np.std(one.dn_set), np.std(one.normalised("M_load")) if loaded else 0.0)
        if not swing >= LEAST_SWING:
            raise InputError(
                f"experiment {one.name!r}: the {DRIVES[one.driver]} moves by {100 * swing:.2g} %, expected "
                f"{100 * LEAST_SWING:g} % or more of it or of a measured load: nothing excites the ship"
            )


def _estimate(x: Array, covariance: Array, at: int, name: str = "") -> Estimate:
    value, std = float(x[at]), float(np.sqrt(covariance[at, at]))
    value += at >= len(SHARED)
    known = name in PRIORS or at >= len(SHARED)
    unit = "s" if name.startswith(("tau", "T_")) else "-"
    interval = (value - QUANTILE * std, value + QUANTILE * std)
    return Estimate(value, std, interval, unit, "prior" if known else "free")


def _si(
    experiments: Sequence[Experiment],
    speed: str,
    signal: str,
    name: str,
    tau: Estimate,
    vessel: Vessel | str | Path | None,
) -> dict[str, dict[str, Any]]:
    """Inertia in kg m2: referred to the propeller shaft with a vessel, else to the engine if the torque is its own."""
    if vessel is None and signal != "M_b":
        return {}
    rpm, moment = (abs(np.mean([one.operating_point[key] for one in experiments])) for key in (speed, signal))
    seen_from = "engine"
    if vessel is not None:
        ship = vessel if isinstance(vessel, Vessel) else Vessel.load(vessel)
        rpm, seen_from = rpm / ship.gearbox.ratio, "propeller shaft"
        moment *= ship.torque_ratio if signal == "M_b" else 1.0
    factor = float(moment / (2.0 * math.pi * rpm / 60.0))
    assert tau.value is not None
    assert tau.std is not None
    assert tau.ci95 is not None
    interval = [factor * end for end in tau.ci95]
    row = {"value": factor * tau.value, "std": factor * tau.std, "ci95": interval, "unit": "kg m2"}
    return {name: row | {"seen_from": seen_from}}
