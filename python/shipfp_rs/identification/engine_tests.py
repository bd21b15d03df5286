"""Score tests for engine-side effects that the model lacks: limits, a variable gain, another lag.

The model's signals give the shape of the torque that a limiter removes or a governor adds. Such a torque acts on speed and
torque like any disturbance of the engine. The only unknown of a shape is its size in the residuals, so no fit is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping

import numpy as np

from shipfp_rs.identification.coordinates import loop_of
from shipfp_rs.identification.likelihood import ACCURACY
from shipfp_rs.identification.ship_found import BELIEVED, ShipFit
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.identification.stretches import STRETCH_S, Score, Stretches
from shipfp_rs.structures.ship import rate_limited
from shipfp_rs.structures.transfer import SLOWEST, TransferFunctions
from shipfp_rs.support.arrays import Array, ComplexArray, Values

LEVELS, SLOPES = (0.8, 0.9, 0.97, 0.995), (0.5, 0.8, 0.95, 0.99)
"""Quantiles of the torque, and of its slope, at which limits are tested."""
BANDS = (0.3, 0.6, 0.85)
"""Quantiles of the speed error. Each is the half width of a band in which another governor gain is tested."""
LAGS_S = (0.02, 0.06, 0.2, 0.6, 2.0)
"""Lags of the governor's command that are tested [s]."""
LIMITS = {"torque_limit", "rack_rate"}
"""Kinds of shapes that limiters cause; a negative size is no evidence of a limit."""
SHOWN = 16.0
"""Least decrease of the deviance for a significant shape; by chance, one of all shapes exceeds it once in a thousand."""
CONSISTENT = 2.7
"""Least consistency over stretches of time for a shape to be significant; chance exceeds it once in twenty (one-sided)."""
NEAR = 3.0
"""A limit explains another shape whose decrease of the deviance is at most this many times that of the limit."""
SURE = 60.0
"""Decrease of the deviance from which a limit is fitted even if only one stretch shows it."""
WORTH = 8.0
"""Decrease of the deviance from which a limit is fitted."""
NONE = Score(0.0, 0.0, 0.0, 0.0)
ROUNDED, NEARLY = 3.0, 0.8
"""A torque is limited from this many rounding widths M_soft below its limit, a rack from this share of its rate limit."""
BINS, LEAST_STRETCHES = 15, 4
"""Number of bins of a curve, and least stretches in a bin for a standard error."""
LEAST_PERIODS, LEAST_BAND = 30, 0.1
"""Lowest frequency of a curve: this number of periods in a record, or this share of the band if lower. Below it the
governor's integral amplifies drifts of the speed, which would hide the curve."""


def engine_tests(fit: ShipFit) -> dict[str, Score]:
    """Return the strongest score of each kind of shape; empty where no torque was measured."""
    if "dM" not in fit.question.outputs:
        return {}
    likelihood = fit.likelihood
    shapes = [_shapes(fit, index) for index in range(len(likelihood.records))]
    kinds = [kind for kind, rows in shapes[0].items() for _ in rows]
    columns = [np.array([row for rows in one.values() for row in rows]) for one in shapes]
    found: dict[str, Score] = dict.fromkeys(shapes[0], NONE)
    for kind, score in zip(kinds, Stretches(likelihood, fit.best.vector, columns).scores(), strict=True):
        if score.fall > found[kind].fall and not (kind in LIMITS and score.size < 0.0):
            found[kind] = score
    return found


def engine_curves(fit: ShipFit) -> dict[str, dict[str, list[float]]]:
    """Return the engine torque that the model lacks, as curves over the governor's error and over the rack's slope [1/s]."""
    likelihood, values = fit.likelihood, fit.values
    # The residuals of a ship that two equations do not describe are not the engine's alone.
    if "dM" not in fit.question.outputs or not fit.is_smooth:
        return {}
    ahead = values["tau_n"] - values.get("tau_prop", 0.0) if fit.question.gauge else 0.0
    torques, places = [], []
    for index, residuals in enumerate(likelihood.residuals(fit.best.vector)):
        record, rate_hz = likelihood.records[index], likelihood.records[index].rate_hz
        s = 1j * np.maximum(2.0 * np.pi * record.frequency_hz, SLOWEST)
        left = dict(zip(fit.question.outputs, np.asarray(residuals), strict=True))
        charged = 1.0 / (1.0 + s * values.get("tau_eng", 0.0))
        torque = left["dM"] + (ahead * s + charged * (_governor(values, s) - values["g"])) * left["dn"]
        least_hz = min(LEAST_PERIODS * rate_hz / record.count, LEAST_BAND * record.band_hz)
        torque[record.frequency_hz < least_hz] = 0.0
        at = np.arange(record.count) / rate_hz
        # The fuel responds with a delay to the error that the governor measured.
        seen = at - sum(values.get(name, 0.0) for name in ("T_d", "tau_act", "tau_eng"))
        _, rack, error = _signals(fit, index)
        length = max(round(STRETCH_S * rate_hz), 1)
        kept = record.tapers[0] == 1.0
        torques.append(record.in_time(torque)[kept])
        rows = np.interp(seen, at, error), np.gradient(rack) * rate_hz, at // (length / rate_hz) + 1e6 * index
        places.append(np.array(rows)[:, kept])
    error, slope, stretch = np.concatenate(places, axis=1)
    return {
        name: _binned(row, np.concatenate(torques), stretch)
        for name, row in (("error", error), ("slope", slope))
    }


def _binned(row: Array, torque: Array, stretch: Array) -> dict[str, list[float]]:
    """Return for each bin of a row its mean abscissa "at", the mean "torque", and its standard error "std" by stretches."""
    # Between steps most samples have the same value, so edges are the means of quantiles and of bins of equal width.
    even = np.linspace(0.0, 1.0, BINS + 1)
    edges = 0.5 * (np.quantile(row, even) + row.min() + (row.max() - row.min()) * even)
    place = np.clip(np.searchsorted(edges, row, side="right") - 1, 0, BINS - 1)
    found: dict[str, list[float]] = {"at": [], "torque": [], "std": []}
    for one in np.unique(place):
        inside = place == one
        mean = float(torque[inside].mean())
        held, which = np.unique(stretch[inside], return_inverse=True)
        if len(held) < LEAST_STRETCHES:
            continue
        scatter = np.bincount(which, torque[inside] - mean)
        found["at"].append(float(row[inside].mean()))
        found["torque"].append(mean)
        found["std"].append(float(np.sqrt(np.sum(scatter**2)) / np.sum(inside)))
    return found


def touched(fit: ShipFit, element: str) -> float:
    """Return the number of samples at which the model reaches a limit or its rounding."""
    values, found = fit.values, 0.0
    for index, record in enumerate(fit.likelihood.records):
        engine, rack, _ = _signals(fit, index)
        if element == "torque_limit":
            near = 1.0 + engine > values["M_max"] - ROUNDED * values["M_soft"]
        else:
            slope = np.gradient(rack) * record.rate_hz
            near = np.abs(slope) > NEARLY * values["rate"]
        found += float(np.count_nonzero(near)) * record.down
    return found


def _signals(fit: ShipFit, index: int) -> tuple[Array, Array, Array]:
    """Engine torque, rack, and governor's error in the model of a record, (K,) each."""
    values, record = fit.values, fit.likelihood.records[index]
    model = dict(zip(fit.question.outputs, fit.likelihood.modelled(fit.best.vector, index), strict=True))
    speed, engine = model["dn"], model["dM"]
    if fit.question.gauge:
        slope = np.gradient(speed) * (record.data_hz / record.down)
        engine = engine + (values["tau_n"] - values.get("tau_prop", 0.0)) * slope
    fed = engine + values.get("tau_eng", 0.0) * np.gradient(engine) * record.rate_hz
    return engine, fed - values["g"] * speed, record.set_point_low[: len(speed)] - speed


def _governor(values: Values, s: ComplexArray) -> ComplexArray:
    """Transfer function (F,) from minus the speed to the governor's torque."""
    fuel = np.exp(-s * values.get("T_d", 0.0)) / (1.0 + s * values.get("tau_act", 0.0))
    fuel = fuel / (1.0 + s * values.get("T_f", 0.0))
    return np.asarray(fuel * (values["vK_p"] + values["vK_i"] / s))


def _shapes(fit: ShipFit, index: int) -> dict[str, list[ComplexArray]]:
    """Response of a record's outputs (O, F) to each engine torque shape, by kind."""
    values, record = fit.values, fit.likelihood.records[index]
    rate_hz = record.data_hz / record.down
    engine, rack, error = _signals(fit, index)
    inside = np.arange(len(rack)) > 2.0 * rate_hz
    slopes = np.abs(np.diff(rack)) * rate_hz
    shapes = {
        "torque_limit": [np.minimum(engine, level) - engine for level in np.quantile(engine[inside], LEVELS)],
        "rack_rate": [
            rate_limited(rack, rate, rate_hz) - rack for rate in np.quantile(slopes[inside[1:]], SLOPES)
        ],
        # A gain that depends on the error, such as a dead band.
        "gain": [np.clip(error, -band, band) for band in np.quantile(np.abs(error[inside]), BANDS)],
        # An effect in one direction only, such as a slower decrease.
        "asymmetry": [error**2, np.abs(np.gradient(rack)) * rate_hz],
    }
    seen = _answers(values, record, fit)
    found = {
        kind: [
            seen(row, kind == "gain" or (kind == "asymmetry" and place == 0))
            for place, row in enumerate(rows)
        ]
        for kind, rows in shapes.items()
    }
    # "lag" is a command that acts earlier or later than in the model, as behind an inner loop.
    s, command = 1j * np.maximum(2.0 * np.pi * record.frequency_hz, SLOWEST), seen(rack, False)
    return {**found, "lag": [command * (lag * s / (1.0 + lag * s)) for lag in LAGS_S]}


def _answers(values: Values, record: Spectra, fit: ShipFit) -> Callable[[Array, bool], ComplexArray]:
    """Return the function that maps a torque (K,), or an error at the governor's input, to the outputs' response (O, F)."""
    s = 1j * np.maximum(2.0 * np.pi * record.frequency_hz, SLOWEST)
    known = {**loop_of(values), "tau_twist": 0.0}
    outputs = fit.question.outputs
    loop = TransferFunctions(outputs, fit.question.gauge, "engine")
    torque = loop.answer_to_torque(known, s)
    if "dX" in outputs:
        torque[outputs.index("dX")] = 0.0
    torque[:, 0] = 0.0
    governor = _governor(values, s)

    def answer(row: Array, by_governor: bool) -> ComplexArray:
        return np.asarray(torque * record.see(row) * (governor if by_governor else 1.0))

    return answer


def suspected(scores: Mapping[str, Score], beyond: float = 1.0) -> str | None:
    """Return the kind of the strongest effect that the model lacks; None if chance or calibration errors explain all."""
    # `beyond` is the factor by which estimates may scatter more than by chance, as for a ship at a limit.
    sure = {
        kind: score.fall * (NEAR if kind in LIMITS else 1.0)
        for kind, score in scores.items()
        if score.fall > SHOWN * beyond**2
        and score.consistency > CONSISTENT
        and score.share > ACCURACY * beyond
    }
    return max(sure, key=lambda kind: sure[kind], default=None)


def lacks_something(scores: Mapping[str, Score]) -> bool:
    """Whether any test of the engine's side shows an effect that chance does not explain."""
    return any(score.fall > SHOWN for score in scores.values())


def limits_to_try(scores: Mapping[str, Score], among: Container[str]) -> list[str]:
    """Return the limits to fit next, by low thresholds, since a fit without limits adapts to most of a limit's effect."""
    # A fit that has adapted to a limit appears to have another lag, so "lag" is no evidence against a limit.
    shapes = [score for kind, score in scores.items() if kind != "lag"]
    most = max((score.fall for score in shapes), default=0.0)
    # If any effect is significant, a limit need not be: the fit without limits may have adapted to most of its effect.
    surely = any(score.fall > BELIEVED and score.consistency > CONSISTENT for score in shapes)
    return [
        kind
        for kind in scores
        if kind in LIMITS
        and kind in among
        and (surely or scores[kind].consistency > CONSISTENT or scores[kind].fall > SURE)
        and scores[kind].fall > max(WORTH, most / NEAR)
    ]
