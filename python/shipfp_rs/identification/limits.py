"""Whether a limit acts: by how much the deviance falls with it, before any is fitted.

Torque that a limiter takes away is known from the smooth model's own torque, and acts on speed and torque as any disturbance
does. For a few levels the part that the residuals show of it is a score test with one unknown.
"""

from __future__ import annotations

import numpy as np

from shipfp_rs.identification.coordinates import loop_of
from shipfp_rs.identification.equation_likelihood import EquationLikelihood
from shipfp_rs.identification.ship_found import LIMITED, ShipFit
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.structures.transfer import SLOWEST, TransferFunctions
from shipfp_rs.support.arrays import Array, ComplexArray, Values

LEVELS, SLOPES = (0.8, 0.9, 0.97, 0.995), (0.5, 0.8, 0.95, 0.99)
"""Quantiles of the torque, and of its slope, at which a limit is tried."""


def falls_by_limits(fit: ShipFit) -> dict[str, float]:
    """Return by how much the deviance falls with a limit of torque or of rate at its best level; 0 where none helps."""
    if "dM" not in fit.question.outputs:
        return dict.fromkeys(LIMITED, 0.0)
    likelihood, values = fit.likelihood, fit.values
    assert isinstance(likelihood, EquationLikelihood)
    columns = [
        np.array(
            [
                _answer(values, record, fit, torque)
                for rows in _taken_away(record, fit, index).values()
                for torque in rows
            ]
        )
        for index, record in enumerate(likelihood.records)
    ]
    gram = likelihood.with_columns(fit.best.vector, columns)
    size = 1 + likelihood.coordinates.size
    known = gram[1:size, 1:size]
    scale = np.sqrt(np.maximum(np.diag(known), 1e-30))
    inner = np.linalg.pinv(known / np.outer(scale, scale), rcond=1e-10, hermitian=True) / np.outer(
        scale, scale
    )
    found = dict.fromkeys(("torque_limit", "rack_rate"), 0.0)
    for place in range(size, len(gram)):
        element = "torque_limit" if place < size + len(LEVELS) else "rack_rate"
        projected = gram[place, 1:size] @ inner
        along = gram[0, place] - projected @ gram[1:size, 0]
        left = gram[place, place] - projected @ gram[1:size, place]
        # A limiter takes torque away: a negative part is none.
        if along > 0.0 and left > 1e-9 * gram[place, place]:
            found[element] = max(found[element], float(along**2 / left))
    return found


def _taken_away(record: Spectra, fit: ShipFit, index: int) -> dict[str, list[Array]]:
    """Torque (K,) that a limit at each level adds to the model's engine, zero or less where it holds back a rise."""
    values = fit.values
    model = dict(zip(record.outputs, fit.likelihood.modelled(fit.best.vector, index), strict=True))
    speed, engine = model["dn"], model["dM"]
    if fit.question.gauge:
        engine = (
            engine + (values["tau_n"] - values.get("tau_prop", 0.0)) * np.gradient(speed) * record.rate_hz
        )
    inside = record.tapers[0] > 0.5
    limited = [np.minimum(engine, level) - engine for level in np.quantile(engine[inside], LEVELS)]
    rack = engine - values["g"] * speed
    steps = np.abs(np.diff(rack))
    rates = [_rate_limited(rack, rate) - rack for rate in np.quantile(steps[inside[1:]], SLOPES)]
    return {"torque_limit": limited, "rack_rate": rates}


def _rate_limited(signal: Array, most: float) -> Array:
    """A signal (K,) that follows another one by `most` a sample at most."""
    found = signal.copy()
    for k in range(1, len(found)):
        found[k] = found[k - 1] + min(max(signal[k] - found[k - 1], -most), most)
    return found


def _answer(values: Values, record: Spectra, fit: ShipFit, torque: Array) -> ComplexArray:
    """How the outputs (O, F) of a record answer to a torque on the engine's side (K,)."""
    s = 1j * np.maximum(2.0 * np.pi * record.frequency_hz, SLOWEST)
    known = {**loop_of(values), "tau_twist": 0.0}
    loop = TransferFunctions(record.outputs, fit.question.gauge, "engine")
    speed = record.tapered(torque, 1)[0] * s / loop.characteristic(known, s)
    behind = known.get("tau_prop", 0.0) if fit.question.gauge else known["tau_n"]
    rows = {"dn": speed, "dM": (known["p"] + behind * s) * speed, "dX": np.zeros_like(speed)}
    found = np.array([rows[output] for output in record.outputs])
    found[:, 0] = 0.0
    return found
