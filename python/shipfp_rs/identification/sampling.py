"""A governor that samples: its clock, where processing found it, and what it leaves open about the gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.estimate import Estimate
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.structures.combinations import slope_of
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.ship import ShipEquations
from shipfp_rs.structures.ties import bare
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.quantiles import DEVIATIONS_95

AGREE = 5.0
"""Deviations within which the governor's clocks of several experiments are one."""
PHASES = 16
"""Times within a period at which the governor may sample, over which its answer is averaged; stairs of a 16th are left."""


def clock_of(experiments: Sequence[Experiment]) -> tuple[float, float] | None:
    """Sampling period and deviation [s] that the experiments' raw torque agrees on; None where it tells none or several."""
    clocks = [experiment.governor_clock for experiment in experiments]
    periods, deviations = np.array([clock for clock in clocks if clock]).reshape(-1, 2).T
    if not len(periods) or np.ptp(periods) > AGREE * deviations.max():
        return None
    weights = 1.0 / deviations**2
    # What is common to them, the logger's clock, is not averaged out.
    return float(weights @ periods / weights.sum()), float(deviations.min())


def held(
    equations: Equations, values: Mapping[str, float], experiment: Experiment, phases: int = PHASES
) -> Array:
    """What a governor that samples gives beyond one that is half its period late, a mean over its phases, shape (O, N)."""
    mean = bare(equations)
    assert isinstance(mean, ShipEquations)
    mean = replace(mean, sharp=False)
    exact = replace(mean, mean_sampling=False)
    # The kernel's governor uses its sum before it adds to it, and so acts as one with less proportional gain.
    more = {name: values[name] + extra for name, extra in _of_the_sum(values, values["T_s"]).items()}
    samples = [
        exact.simulate({**values, **more, "T_0": values["T_s"] * phase / phases}, experiment)
        for phase in range(phases)
    ]
    return np.asarray(np.mean(samples, axis=0) - mean.simulate(values, experiment))


def _of_the_sum(values: Mapping[str, float | None], period: float) -> dict[str, float]:
    """By how much the order of using and adding to the sum changes what the proportional gain seems: K_i T_s / 2."""
    gains = [name for name in ("vK_p", "K_p") if name in values]
    return {name: 0.5 * period * float(values[name.replace("K_p", "K_i")] or 0.0) for name in gains}


def with_clock(fingerprint: Fingerprint, clock: tuple[float, float] | None) -> Fingerprint:
    """Return the fingerprint with the governor's period, and intervals that hold however the governor adds up.

    A governor that adds the error to its sum before it uses it acts as one with K_i T_s / 2 more in K_p, one that does so
    after with as much less; the fit's own K_p stands between the two.
    """
    if clock is None:
        return fingerprint
    period, std = clock
    parameters, derived = dict(fingerprint.parameters), dict(fingerprint.derived)
    values = {name: estimate.value for name, estimate in parameters.items()}
    ends = (period - DEVIATIONS_95 * std, period + DEVIATIONS_95 * std)
    parameters["T_s"] = Estimate(period, std, ends, "s", "prior")
    shift = _of_the_sum(values, period)
    for group in (parameters, derived):
        for name, estimate in group.items():
            if estimate.ci95 is None:
                continue
            either = abs(shift.get(name, 0.0) if group is parameters else slope_of(name, values, shift))
            low, high = estimate.ci95
            wider = None if estimate.std is None else float(np.hypot(estimate.std, either / np.sqrt(3.0)))
            group[name] = replace(estimate, ci95=(low - either, high + either), std=wider)
    return replace(fingerprint, parameters=parameters, derived=derived)
