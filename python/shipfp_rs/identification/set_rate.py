"""Rate limit (ramp) of the set point: the drive or governor lets its set point rise and fall at a limited rate only.

The ramp acts on the recorded set point, outside the loop. For a given rate the limited set point is therefore known, and the
rest of the ship has no limit. The rate is searched on a grid, the other parameters by descents.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from shipfp_rs.identification.basins import descend
from shipfp_rs.identification.profiles import RISE, Interval
from shipfp_rs.identification.question import Question
from shipfp_rs.identification.ship_found import BELIEVED, ShipFit, settled
from shipfp_rs.structures.ship import rate_limited
from shipfp_rs.support.arrays import Array

STEEPEST, GRID = 0.97, 14
"""Highest tried rate, as a quantile of the set point's slopes, and the number of tried rates."""
ROUNDS, STEPS = 2, 12
"""Number of descents for each tried rate, each with the noise of the previous one, and largest number of their steps."""
REFINED, NEAR = 8, (0.97, 1.0, 1.03)
"""Number of further rates near the best rate, and factors on the best rate for repeated descents."""
APART = 0.01
"""Least difference of the set points with and without a ramp, over the set point's range, at which the ramp acts."""


Search = Callable[[Question], ShipFit]
"""Maps a question to the fit of the ship without limits."""


def with_set_rate(fit: ShipFit, search: Search, until: float | None, *, surely: bool = False) -> ShipFit:
    """Return the fit with a ramp on the set point, if the ramp makes it likelier; `surely`: in any case."""
    records = fit.likelihood.records
    slopes = np.concatenate([np.abs(np.diff(one.set_point)) * one.data_hz for one in records])
    steepest = float(np.quantile(slopes[slopes > 1e-3 * slopes.max()], STEEPEST)) if slopes.any() else 0.0
    if steepest <= 0.0:
        return fit
    known, found = _searched(fit, fit.best.vector, np.geomspace(1e-2 * steepest, steepest, GRID), until)
    rate = min(known, key=lambda one: known[one])
    if not surely and (fit.total - known[rate] < 2.0 * BELIEVED or not _in_a_row(fit, rate)):
        return fit
    # The fit without a ramp is biased by the ramp, so the ship is fitted again with the rate that was found first.
    behind = search(replace(fit.question, fixed={**fit.question.fixed, "set_rate": rate}))
    start = behind.best.vector if behind.total < known[rate] else found[rate]
    known, found = _searched(fit, start, rate * np.array(NEAR), until)
    rate = min(known, key=lambda one: known[one])
    best = settled(behind_ramp(fit, rate, found[rate]), until)
    return replace(
        best,
        gains={**fit.gains, "set_rate": fit.total - best.total},
        ramp=_interval(known, rate, _in_a_row(fit, rate)),
    )


def _in_a_row(fit: ShipFit, rate: float) -> float:
    """Mean number of consecutive samples at which a ramp acts."""
    acting = [
        np.abs(one.set_point - rate_limited(one.set_point, rate, one.data_hz)) > APART * np.ptp(one.set_point)
        for one in fit.likelihood.records
    ]
    runs = sum(int(np.count_nonzero(np.diff(one.astype(int), prepend=0) > 0)) for one in acting)
    return sum(int(one.sum()) for one in acting) / max(runs, 1)


def _searched(
    fit: ShipFit, start: Array, grid: Array, until: float | None
) -> tuple[dict[float, float], dict[float, Array]]:
    """Return the total deviance and the search vector for rates on a grid, refined about the best."""
    known: dict[float, float] = {}
    found: dict[float, Array] = {}

    def tried(rate: float) -> None:
        near = min(found, key=lambda other: abs(np.log(other / rate)), default=None)
        one = behind_ramp(fit, rate, start if near is None else found[near])
        likelihood, end = one.likelihood, one.best
        for _ in range(ROUNDS):
            if not np.isfinite(end.cost):
                break
            likelihood = likelihood.resettled_at(end.vector)
            end = descend(likelihood, end.vector, steps=STEPS, settled=1.0, until=until)
        known[rate] = likelihood.total(end.vector) if np.isfinite(end.cost) else np.inf
        found[rate] = end.vector

    # Slow ramps come last: each descent begins at the minimum of the next faster one.
    for rate in sorted(grid.tolist(), reverse=True):
        tried(rate)
    for _ in range(REFINED):
        best = min(known, key=lambda one: known[one])
        ends = [
            max((one for one in known if one < best), default=best),
            min((one for one in known if one > best), default=best),
        ]
        wider = max(ends, key=lambda one: abs(np.log(one / best)))
        tried(float(np.sqrt(best * wider)))
    return known, found


def behind_ramp(fit: ShipFit, rate: float, vector: Array) -> ShipFit:
    """Return the fit with the set points limited to a rate; the descent starts at a search vector."""
    likelihood = fit.likelihood
    records = (
        one.with_set_point(rate_limited(one.set_point, rate, one.data_hz)) for one in likelihood.records
    )
    c = replace(likelihood.coordinates, given={**likelihood.coordinates.given, "set_rate": rate})
    question = replace(fit.question, fixed={**fit.question.fixed, "set_rate": rate})
    likelihood = replace(likelihood.with_records(records), coordinates=c).settled_at(vector)
    end = descend(likelihood, vector)
    return replace(fit, likelihood=likelihood, basins=(end,), question=question)


def _interval(known: dict[float, float], best: float, in_a_row: float) -> Interval:
    """Return the interval of the rate, which ends where the total deviance has risen by `RISE`."""
    ends = []
    for side in (-1.0, 1.0):
        beyond = {
            abs(np.log(one / best)): known[one] - known[best] for one in known if (one - best) * side > 0.0
        }
        # Near the minimum the deviance is a parabola; the first point with a clear rise determines its curvature.
        risen = next((one for one in sorted(beyond) if beyond[one] > 0.5 * RISE), None)
        reach = np.inf if risen is None else risen * np.sqrt(RISE / beyond[risen])
        # A low-passed jump is known to half a sample, so the rate to half a sample of the `in_a_row` at which it acts.
        ends.append(float(best * np.exp(side * np.hypot(reach, 0.5 / max(in_a_row, 1.0)))))
    return Interval(best, ends[0], ends[1], ("data", "data"))
