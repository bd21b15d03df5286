"""Speed after a load step, compared with the governing classes of ISO 8528-5."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from shipfp_rs.assessment.closed_loop import LONGEST, PADE, estimated, once
from shipfp_rs.assessment.prediction import structure_of
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.structures.elements import LATE_CHANNELS
from shipfp_rs.structures.linearised import state_space
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array, Values

STEP_PCT = 10.0
"""Step of the load [% of the operating torque]. The standard's steps depend on the engine's mean effective pressure, which
is not in a log; a step of ten per cent is far from limits and nonlinearity.
"""
INSTANTS = 1500
WHOLE_PCT = 100.0
"""Largest step that is stated: the model does not hold above the operating torque."""

State = Literal["pass", "fail", "open"]


@dataclass(frozen=True)
class Limits:
    """Requirements of a class on load increase: frequency deviation [%], recovery time [s], its band [%]."""

    deviation_pct: float
    recovery_s: float
    band_pct: float


CLASSES: Mapping[str, Limits] = {
    "G1": Limits(25.0, 10.0, 3.5),
    "G2": Limits(20.0, 5.0, 2.0),
    "G3": Limits(15.0, 3.0, 2.0),
}
"""ISO 8528-5:2022, table of operating limits: transient frequency deviation on load increase, frequency recovery time,
frequency tolerance band alpha_f.
"""


@dataclass(frozen=True)
class Governing:
    """Performance against a class: largest fall of speed [%], recovery time [s], largest step that meets both [%]."""

    limits: Limits
    deviation: Estimate
    recovery: Estimate
    largest: Estimate
    state: State


def governing(fingerprint: Fingerprint, structure: Structure | None = None) -> dict[str, Governing]:
    """Whether the linearised loop meets each class, for a load step of 10 % of the operating torque.

    The state is "open" if the interval contains the limit, or there is no interval.
    """
    model = structure or structure_of(fingerprint)
    # All figures need the load steps of the same ships.
    falls = once(partial(_fall, model))

    def told(unit: str, figure: Callable[[Array, Array], float], least: float | None) -> Estimate:
        return estimated(fingerprint, model, unit, lambda values: figure(*falls(values)), least)

    deviation = told("%", lambda _, off: float(off.max()) * STEP_PCT / 100.0, None)
    bands = {limits.band_pct for limits in CLASSES.values()}
    recoveries = {band: told("s", partial(_recovery, band), 0.0) for band in bands}
    found = {}
    for name, limits in CLASSES.items():
        recovery = recoveries[limits.band_pct]
        largest = told("%", partial(_largest, limits), 0.0)
        states = {_state(deviation, limits.deviation_pct), _state(recovery, limits.recovery_s)}
        state: State = "fail" if "fail" in states else "open" if "open" in states else "pass"
        found[name] = Governing(limits, deviation, recovery, largest, state)
    return found


def _state(estimate: Estimate, limit: float) -> State:
    if estimate.value is None or estimate.ci95 is None or estimate.ci95[0] <= limit < estimate.ci95[1]:
        return "open"
    return "pass" if estimate.ci95[1] <= limit else "fail"


def _fall(structure: Structure, values: Values) -> tuple[Array, Array]:
    """Times [s] and speed deviation after a load step of the operating torque [%]; empty if unstable."""
    space = state_space(structure, {**values, **dict.fromkeys(LATE_CHANNELS, 0.0)}, PADE, driven_by="load")
    slowest = -np.linalg.eigvals(space.A).real.max()
    if slowest <= 0.0 or "dn" not in space.outputs:
        return np.array([0.0]), np.array([np.nan])
    times = np.linspace(0.0, LONGEST / slowest, INSTANTS)
    return times, 100.0 * np.abs(space.step(times)[space.outputs.index("dn")])


def _recovery(band_pct: float, times: Array, off: Array) -> float:
    """Time after which the speed stays within a band [s]; zero if it never leaves it."""
    off = off * STEP_PCT / 100.0
    outside = np.flatnonzero(~(off <= band_pct))
    if not len(outside):
        return 0.0
    last = outside[-1]
    if last + 1 >= len(times):
        return float("nan")
    share = (off[last] - band_pct) / (off[last] - off[last + 1])
    return float(times[last] + share * (times[last + 1] - times[last]))


def _largest(limits: Limits, times: Array, off: Array) -> float:
    """Largest load step within both limits of a class [% of the operating torque]."""
    late = max(np.interp(limits.recovery_s, times, off), *off[times > limits.recovery_s], 0.0)
    most = min(limits.deviation_pct / off.max(), limits.band_pct / max(late, 1e-9))
    return float(min(100.0 * most, WHOLE_PCT))
