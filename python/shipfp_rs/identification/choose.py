"""The data choose: which elements of the one ship model act, found by fits from simple to rich and back."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.stats import chi2

from shipfp_rs.errors import IdentificationError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.blocks import Block
from shipfp_rs.identification.profile import Profile
from shipfp_rs.identification.search import Minimum, Search
from shipfp_rs.identification.starts import starts
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.structure import Structure, Torque
from shipfp_rs.support.arrays import Array

State = Literal["on", "off", "open"]

LOGGER = logging.getLogger("shipfp_rs")

FALSE_ALARM = 0.01
"""Probability that any element is taken on that does not act, if the model is right otherwise."""
REJECTED = 0.05
"""Probability below which an alternative structure is rejected: its intervals then do not count."""
CANDIDATES = ("dead_time_loop", "dead_time_set_point", "actuator_lag", "torque_limit", "twist")
"""Elements that are tried, in the order of a report."""
FIRST = ("dead_time_loop", "dead_time_set_point")
"""Elements that the first fit has: where they do not act they go again, and without them a fit may lose its way."""
INSIDE = 1e-3
"""A start of an element this part of its range inside the bound at which it is off."""


@dataclass(frozen=True)
class Rung:
    """One structure that was tried: its elements, its deviance against the chosen one, and what became of it."""

    elements: tuple[str, ...]
    deviance: float
    verdict: str

    def to_dict(self) -> dict[str, object]:
        """Return the JSON form."""
        return {"elements": list(self.elements), "deviance": self.deviance, "verdict": self.verdict}


@dataclass(frozen=True)
class Fitted:
    """A structure fitted to the data."""

    elements: tuple[str, ...]
    search: Search
    minimum: Minimum


@dataclass(frozen=True)
class Choice:
    """The structure that the data chose, those that they do not reject, and the ladder that led there."""

    best: Fitted
    rivals: tuple[Fitted, ...]
    """Other structures that the data do not reject; the union of all intervals holds after the choice."""
    evidence: Mapping[str, float]
    """Element to the rise of the deviance without it (of one that is on) or its fall with it (of one that is off)."""
    states: Mapping[str, State]
    limits: Mapping[str, float]
    """Element that is not taken on to the strength above which the data reject it, in its parameter's unit."""
    ladder: tuple[Rung, ...] = ()


def threshold(candidates: int, probability: float = FALSE_ALARM) -> float:
    """Return the fall of the deviance that takes an element on.

    An element that is off stands on a bound, so half of its chance is at zero (Chernoff 1954, Self and Liang 1987); the
    probability is shared among the candidates (Bonferroni).
    """
    return float(chi2.isf(2.0 * probability / candidates, 1))


class Chooser:
    """Fits structures of one set of experiments, warm-started from each other."""

    def __init__(
        self,
        experiments: Sequence[Experiment],
        *,
        torque: Torque,
        outputs: Sequence[str],
        forced: Sequence[str] = (),
        excluded: Sequence[str] = (),
        narrow: Mapping[str, Mapping[str, object]] | None = None,
        search: Mapping[str, object] | None = None,
    ) -> None:
        self.experiments, self.torque, self.outputs = experiments, torque, tuple(outputs)
        self.forced = tuple(forced)
        gauge = torque == "gauge" and "dM" in outputs
        self.candidates = tuple(
            name
            for name in CANDIDATES
            if name not in excluded and name not in forced and (ELEMENTS[name].needs != "gauge" or gauge)
        )
        self.narrow = narrow or {}
        self.options = {"weighting": "determinant", "noise": "ar", "max_evaluations": 200, "tolerance": 1e-10}
        self.options |= dict(search or {})

    def structure(self, elements: Sequence[str]) -> Structure:
        """Return the ship with these elements, narrowed as the user asks."""
        made = Structure.ship(
            elements, torque=self.torque, outputs=self.outputs, products="dX" not in self.outputs
        )
        for verb, given in self.narrow.items():
            known = {name: value for name, value in given.items() if name in made.names}
            made = getattr(made, f"with_{verb}")(**known)
        return made

    def search(self, elements: Sequence[str]) -> Search:
        """Return the search of a structure over all experiments."""
        structure = self.structure(elements)
        blocks = tuple(
            Block.build(one, structure, offsets=False, initial_state=True, weigh=False)
            for one in self.experiments
        )
        return Search(structure, blocks, **self.options)  # type: ignore[arg-type]

    def first(self) -> Fitted:
        """Fit the first structure from the data's own starts."""
        elements = self._ordered({*self.forced, *(name for name in FIRST if name in self.candidates)})
        search = self.search(elements)
        ends: list[Minimum] = []
        for values in starts(search.structure, self.experiments):
            try:
                ends.append(search.minimise(self._vector(search, values)))
            except (IdentificationError, SimulationError) as error:
                LOGGER.debug("identify: a start failed: %s", error)
        if not ends:
            raise IdentificationError(
                "no start that the data suggest can be simulated; check the channels' signs, units and operating point"
            )
        best = min(ends, key=lambda end: end.criterion)
        return Fitted(elements, search, search.refine(best))

    def with_elements(self, origin: Fitted, elements: Sequence[str]) -> Fitted | None:
        """Fit other elements with the weights of a fit, from its end; None where that can't be simulated."""
        ordered = self._ordered(elements)
        search = replace(self.search(ordered), weights=origin.minimum.noise)
        values = dict(zip(origin.search.unknowns, map(float, origin.minimum.vector), strict=True))
        ends = []
        for start in self._from(search, values):
            try:
                ends.append(search.minimise(start))
            except (IdentificationError, SimulationError) as error:
                LOGGER.debug("identify: %s could not be fitted: %s", ", ".join(ordered), error)
        return Fitted(ordered, search, min(ends, key=cost)) if ends else None

    def refined(self, fitted: Fitted) -> Fitted:
        """Fit weights and noise models of its own to a structure."""
        search = replace(fitted.search, weights=None)
        return Fitted(fitted.elements, search, search.refine(fitted.minimum))

    def _from(self, search: Search, values: Mapping[str, float]) -> list[Array]:
        """Start vectors of a structure from another one's end, one for each start that a new element has."""
        new = [name for name in search.names if name not in values]
        first = self._vector(search, values)
        vectors = [first]
        for name in new:
            parameter = search.structure[name]
            for start in STARTS.get(name, (parameter.start,)):
                vector = first.copy()
                vector[search.names.index(name)] = np.clip(start, parameter.lower, parameter.upper)
                vectors.append(vector)
        return vectors[1:] if new else vectors

    def _vector(self, search: Search, values: Mapping[str, float]) -> Array:
        starts = {parameter.name: parameter.start for parameter in search.free}
        vector = np.array([values.get(name, starts.get(name, 0.0)) for name in search.unknowns])
        lower, upper = search.bounds()
        return np.asarray(np.clip(vector, lower, upper))

    def _ordered(self, elements: Sequence[str] | set[str]) -> tuple[str, ...]:
        return tuple(name for name in ELEMENTS if name in elements)


STARTS: Mapping[str, tuple[float, ...]] = {
    "T_d": (0.02,),
    "T_set": (0.05,),
    "tau_act": (0.03, 0.12),
    "M_max": (1.05, 1.15, 1.3),
    "tau_twist": (1e-3,),
}
"""Where the search for a new element's parameter starts."""


def cost(fitted: Fitted | Minimum) -> float:
    """Return the weighted sum of squares of a minimum with given weights."""
    return (fitted.minimum if isinstance(fitted, Fitted) else fitted).criterion


def choose(chooser: Chooser) -> Choice:
    """Take elements on while the deviance falls enough, drop those that it does not miss, and keep what is not rejected."""
    level = threshold(max(len(chooser.candidates), 1))
    current, ladder = chooser.first(), list[Rung]()
    for _ in range(len(chooser.candidates) + 1):
        best = _gains(chooser, current, level, ladder)[0]
        if best is None:
            break
        current = chooser.refined(best)
    current, rises = _backward(chooser, current, level, ladder)
    # Weights and base are those of the structure that is left.
    _, gains = _gains(chooser, current, level, ladder)
    rivals = _rivals(chooser, current, gains, level, ladder)
    evidence = rises | {name: gain for name, (gain, _) in gains.items()}
    states: dict[str, State] = {}
    for name in chooser.candidates:
        held = {name in fitted.elements for fitted in (current, *rivals)}
        states[name] = "open" if len(held) == 2 else "on" if True in held else "off"
    limits = {name: limit for name, (_, trial) in gains.items() if (limit := _limit(trial, name)) is not None}
    return Choice(current, rivals, evidence, states, limits, tuple(ladder))


Gains = dict[str, tuple[float, Fitted]]


def _gains(
    chooser: Chooser, current: Fitted, level: float, ladder: list[Rung]
) -> tuple[Fitted | None, Gains]:
    """Return the best structure with one element more if it is worth it, and each element's fall of the deviance."""
    gains: Gains = {}
    base = chooser.with_elements(current, current.elements)
    for name in chooser.candidates:
        if base is None or name in current.elements:
            continue
        trial = chooser.with_elements(current, (*current.elements, name))
        if trial is not None:
            gains[name] = (cost(base) - cost(trial), trial)
            said = "better" if gains[name][0] > level else "no better"
            ladder.append(Rung(trial.elements, -gains[name][0], said))
    best = max(gains, key=lambda name: gains[name][0], default=None)
    return (gains[best][1] if best is not None and gains[best][0] > level else None), gains


def _backward(
    chooser: Chooser, current: Fitted, level: float, ladder: list[Rung]
) -> tuple[Fitted, dict[str, float]]:
    """Drop elements, the least missed first, while the deviance rises less than the level."""
    while True:
        base = chooser.with_elements(current, current.elements)
        rises: dict[str, float] = {}
        trials: dict[str, Fitted] = {}
        for name in current.elements:
            if name not in chooser.candidates or base is None:
                continue
            trial = chooser.with_elements(current, [other for other in current.elements if other != name])
            rises[name] = np.inf if trial is None else cost(trial) - cost(base)
            if trial is not None:
                trials[name] = trial
                said = "too poor" if rises[name] > level else "as good"
                ladder.append(Rung(trial.elements, rises[name], said))
        least = min(trials, key=lambda name: rises[name], default=None)
        if least is None or rises[least] > level:
            return current, rises
        current = chooser.refined(trials[least])


def _rivals(
    chooser: Chooser, current: Fitted, gains: Gains, level: float, ladder: list[Rung]
) -> tuple[Fitted, ...]:
    """Fit neighbours in which an element is swapped for another, and keep them and additions that are not rejected."""
    base = chooser.with_elements(current, current.elements)
    if base is None:
        return ()
    limit = threshold(1, REJECTED)
    kept = [trial for gain, trial in gains.values() if limit < gain <= level]
    for out in (name for name in current.elements if name in chooser.candidates):
        for name in gains:
            swapped = [*(other for other in current.elements if other != out), name]
            trial = chooser.with_elements(current, swapped)
            if trial is None:
                continue
            rise = cost(trial) - cost(base)
            ladder.append(Rung(trial.elements, rise, "as good" if rise < limit else "too poor"))
            if rise < limit:
                kept.append(trial)
    return tuple(kept)


def _limit(trial: Fitted, name: str) -> float | None:
    """Return how strongly an element may act that was not taken on, at 95 %; None where the data allow anything."""
    parameter = ELEMENTS[name].parameters[0]
    search = trial.search
    index = search.names.index(parameter.name)
    # A torque limit acts the less, the higher it is; all others the more.
    side = -1.0 if name == "torque_limit" else 1.0
    value = float(trial.minimum.vector[index])
    try:
        end = Profile(search, trial.minimum).end(
            index, side * max(0.05 * abs(value), 1e-3), threshold(1, REJECTED)
        )
    except (IdentificationError, SimulationError):
        return None
    return end.value if end.kind == "data" else None
