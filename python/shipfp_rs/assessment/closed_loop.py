"""Poles, margins and gains of the identified speed loop, each with the deviation that the data leave."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from math import comb, factorial
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from shipfp_rs.assessment.prediction import structure_of
from shipfp_rs.errors import InputError
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.identification.identifiability import gradient_of
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.vessel.linear_model import LinearModel, Output

QUANTILE = 1.959964
TOLD = 1e-4
"""Part of a figure's own size by which it may change along a direction that the data leave open."""
PADE = 5
SLOWEST = 5
"""Roots of the approximation that are led to exact ones: two, their conjugates, and one to spare."""
SEARCHED_HZ = np.geomspace(1e-4, 1e2, 1200)
KNOWN = ("tau_n", "g", "v", "K_p", "K_i", "vK_p", "vK_i", "p", "tau_prop", "T_d", "T_set")
"""Parameters that the figures are computed from."""
TORQUES: Mapping[str, Output] = {"brake": "dM_b", "gauge": "dM_g"}


def closed_loop(fingerprint: Fingerprint) -> dict[str, Estimate]:
    """Return what a control engineer asks of a speed loop.

    Parameters
    ----------
    fingerprint
        Of a linear structure.

    Returns
    -------
    dict
        Name to estimate with 95 % interval, first order in the covariance of the parameters: real and imaginary part of
        the two slowest poles, of pairs the upper one [rad/s], with a dead time in the loop exactly; crossover [Hz], phase
        margin [deg], gain margin [-]; bandwidth of the speed, where its gain has fallen by 3 dB [Hz]; slow and fast gain of
        the torque [-] (eq. 3.39, 3.40). What the data do not tell has no value.

    Raises
    ------
    InputError
        Where the structure is not linear.

    Examples
    --------
    >>> from shipfp_rs.reproduce.fullscale import extended_structure, measured_response
    >>> from shipfp_rs import identify
    >>> found = closed_loop(identify(measured_response(1.637), extended_structure(), weighting="std", starts=8))
    >>> found["phase margin"].unit
    'deg'
    """
    if fingerprint.structure.get("kind") != "linear":
        raise InputError(
            f"structure {fingerprint.structure.get('name')!r} of the fingerprint is not linear, expected one; another "
            "has no poles"
        )
    values = dict(fingerprint.settings["optimum"])
    beyond = sorted(set(values) - set(KNOWN))
    if beyond:
        raise InputError(
            f"structure {fingerprint.structure.get('name')!r} has {', '.join(beyond)}, expected {', '.join(KNOWN)} alone; "
            "fit a linear structure without them to have its poles"
        )
    return {
        name: _estimate(fingerprint, values, unit, figure)
        for name, (unit, figure) in _figures(fingerprint, values).items()
    }


def poles_of(model: LinearModel) -> ComplexArray:
    """Return the two slowest poles of the loop with its dead time, of pairs the upper one [rad/s], shape (2,) or (1,).

    Roots of s (tau_n s + p - g) + v (K_p s + K_i) exp(-s T_d): those that a Pade approximation of the dead time has are
    led to the exact ones by Newton's method.
    """
    a, gain, integral = model.p - model.g, model.v * model.K_p, model.v * model.K_i
    T, late, early = model.T_d, np.array([1.0]), np.array([1.0])
    if T > 0.0:
        orders = np.arange(PADE, -1, -1)
        early = np.array([comb(PADE, k) * factorial(2 * PADE - k) * T**k for k in orders])
        late = early * (-1.0) ** orders
    poles = np.roots(np.polyadd(np.polymul([model.tau_n, a, 0.0], early), np.polymul([gain, integral], late)))
    poles = poles.astype(np.complex128)
    poles = poles[np.argsort(-poles.real)][:SLOWEST]
    for _ in range(20):
        turned = np.exp(-poles * T)
        value = poles * (model.tau_n * poles + a) + (gain * poles + integral) * turned
        slope = 2.0 * model.tau_n * poles + a + (gain - T * (gain * poles + integral)) * turned
        poles = poles - value / slope
    upper = poles[(poles.imag > -1e-9 * np.abs(poles)) & np.isfinite(poles)]
    upper = np.where(np.abs(upper.imag) < 1e-9 * np.abs(upper), upper.real, upper)
    kept = [pole for place, pole in enumerate(upper) if not np.isclose(pole, upper[:place], rtol=1e-6).any()]
    return np.array(sorted(kept, key=lambda pole: -pole.real)[:2])


Figure = Callable[[LinearModel], float]


def _figures(fingerprint: Fingerprint, values: Mapping[str, float]) -> dict[str, tuple[str, Figure]]:
    figures: dict[str, tuple[str, Figure]] = {}
    for place, pole in enumerate(poles_of(_model(values))):
        figures[f"pole {place + 1}, real"] = "rad/s", partial(_pole, place, np.real)
        if pole.imag > 0.0:
            figures[f"pole {place + 1}, imaginary"] = "rad/s", partial(_pole, place, np.imag)
    torque = TORQUES[str(fingerprint.structure.get("torque", "brake"))]
    return figures | {
        "crossover": ("Hz", _crossover),
        "phase margin": ("deg", _phase_margin),
        "gain margin": ("-", _gain_margin),
        "bandwidth": ("Hz", _bandwidth),
        f"{torque}(0)": ("-", lambda model: model.dc_gain(torque)),
        f"{torque}(inf)": ("-", lambda model: model.high_frequency_gain(torque)),
    }


def _pole(place: int, part: Callable[[Any], Any], model: LinearModel) -> float:
    poles = poles_of(model)
    return float(part(poles[place])) if place < len(poles) else float("nan")


def _model(values: Mapping[str, float]) -> LinearModel:
    known = {"p": 2.0, "tau_prop": 0.0, "T_d": 0.0, "T_set": 0.0, **values}
    if "vK_p" in known:
        known |= {"v": 1.0, "K_p": known["vK_p"], "K_i": known["vK_i"]}
    names = ("tau_n", "g", "v", "K_p", "K_i", "p", "tau_prop", "T_d", "T_set")
    return LinearModel(**{name: known[name] for name in names})


def _open_loop(model: LinearModel, frequency_hz: npt.ArrayLike) -> ComplexArray:
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    governor = model.v * (model.K_p + model.K_i / s) * np.exp(-s * model.T_d)
    return np.asarray(governor / (model.tau_n * s + model.p - model.g))


def _turned(model: LinearModel, frequency_hz: npt.ArrayLike) -> Array:
    """Phase of the open loop [deg] without turns lost: each part's own, and the dead time's."""
    w = 2.0 * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    governor = np.arctan2(w * model.K_p, model.K_i) - 0.5 * np.pi
    return np.degrees(governor - np.arctan2(w * model.tau_n, model.p - model.g) - w * model.T_d)


def _passed(value: Callable[[npt.ArrayLike], Array]) -> float:
    """The lowest searched frequency at which a function of it passes zero [Hz]; NaN where it does not."""
    change = np.flatnonzero(np.diff(np.sign(value(SEARCHED_HZ))) != 0.0)
    if not len(change):
        return float("nan")
    low, high = SEARCHED_HZ[change[0]], SEARCHED_HZ[change[0] + 1]
    return float(brentq(lambda frequency: float(value(frequency)), low, high, xtol=1e-14, rtol=1e-13))


def _crossover(model: LinearModel) -> float:
    return _passed(lambda frequency: np.abs(_open_loop(model, frequency)) - 1.0)


def _phase_margin(model: LinearModel) -> float:
    return 180.0 + float(_turned(model, _crossover(model)))


def _gain_margin(model: LinearModel) -> float:
    """What the gain may grow by before the loop swings; NaN where it may grow without end."""
    frequency = _passed(lambda frequency: _turned(model, frequency) + 180.0)
    return float(1.0 / np.abs(_open_loop(model, frequency))) if np.isfinite(frequency) else float("nan")


def _bandwidth(model: LinearModel) -> float:
    def above(frequency: npt.ArrayLike) -> Array:
        loop = _open_loop(model, frequency)
        return np.asarray(np.abs(loop / (1.0 + loop)) - np.sqrt(0.5))

    return _passed(above)


def _estimate(
    fingerprint: Fingerprint,
    values: Mapping[str, float],
    unit: str,
    figure: Figure,
) -> Estimate:
    def of(values: Mapping[str, float]) -> float:
        return figure(_model(values))

    value = of(values)
    unknown = partial(Estimate, None, unit=unit, status="unidentifiable")
    if not np.isfinite(value):
        return unknown(reason="there is none")
    structure = structure_of(fingerprint)
    free = [
        name
        for name, estimate in fingerprint.parameters.items()
        if estimate.status != "fixed" and name not in structure.ties
    ]
    slopes = dict(zip(free, gradient_of(of, values, free, structure.ties), strict=True))
    for entry in fingerprint.identifiability.null_space:
        # Directions are changes relative to the parameter, or to its typical size where that is larger.
        change = sum(
            slopes[name] * max(abs(values[name]), structure[name].scale) * part
            for name, part in entry["direction"].items()
        )
        if abs(change) > TOLD * max(abs(value), 1e-9):
            return unknown(reason=f"changes along what the data leave open: {entry['combination']}")
    names = list(fingerprint.covariance["names"])
    gradient = np.array([slopes[name] for name in names])
    matrix = np.array(fingerprint.covariance["matrix"], dtype=np.float64).reshape(len(names), len(names))
    std = float(np.sqrt(max(gradient @ matrix @ gradient, 0.0)))
    return Estimate(value, std, (value - QUANTILE * std, value + QUANTILE * std), unit)
