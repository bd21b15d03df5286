"""The data choose: which elements of the one ship model act, found by fits from simple to rich and back."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.stats import chi2

from shipfp_rs.errors import IdentificationError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.blocks import Block
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
    ladder: tuple[Rung, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)


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
        self.tried: dict[tuple[str, ...], Fitted] = {}

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
    current, ladder, evidence = chooser.first(), [], dict[str, float]()
    for _ in range(len(chooser.candidates) + 1):
        base = chooser.with_elements(current, current.elements)
        if base is None:
            break
        gains: dict[str, tuple[float, Fitted]] = {}
        for name in chooser.candidates:
            if name in current.elements:
                continue
            trial = chooser.with_elements(base_with(current, base), (*current.elements, name))
            if trial is not None:
                gains[name] = (cost(base) - cost(trial), trial)
                evidence[name] = gains[name][0]
                ladder.append(
                    Rung(
                        trial.elements, -gains[name][0], "taken on" if gains[name][0] > level else "no better"
                    )
                )
        best = max(gains, key=lambda name: gains[name][0], default="")
        if not best or gains[best][0] <= level:
            break
        current = chooser.refined(gains[best][1])
    current = _backward(chooser, current, level, evidence, ladder)
    rivals = _rivals(chooser, current, level, evidence, ladder)
    states: dict[str, State] = {}
    for name in chooser.candidates:
        held = {name in fitted.elements for fitted in (current, *rivals)}
        states[name] = "open" if len(held) == 2 else "on" if True in held else "off"
    return Choice(current, rivals, evidence, states, tuple(ladder))


def base_with(current: Fitted, base: Fitted) -> Fitted:
    """Return a fit with the weights of the current one and the end of the base."""
    return Fitted(current.elements, current.search, replace(current.minimum, vector=base.minimum.vector))


def _backward(
    chooser: Chooser, current: Fitted, level: float, evidence: dict[str, float], ladder: list[Rung]
) -> Fitted:
    """Drop elements, the least missed first, while the deviance rises less than the level."""
    while True:
        base = chooser.with_elements(current, current.elements)
        rises: dict[str, tuple[float, Fitted]] = {}
        for name in current.elements:
            if name not in chooser.candidates or base is None:
                continue
            trial = chooser.with_elements(current, [other for other in current.elements if other != name])
            if trial is None:
                evidence[name] = np.inf
                continue
            rises[name] = (cost(trial) - cost(base), trial)
            evidence[name] = rises[name][0]
            ladder.append(
                Rung(trial.elements, rises[name][0], "too poor" if rises[name][0] > level else "as good")
            )
        least = min(rises, key=lambda name: rises[name][0], default="")
        if not least or rises[least][0] > level:
            return current
        current = chooser.refined(rises[least][1])


def _rivals(
    chooser: Chooser, current: Fitted, level: float, evidence: Mapping[str, float], ladder: list[Rung]
) -> tuple[Fitted, ...]:
    """Fit neighbours in which an element is added or swapped for another, and keep those that the data do not reject."""
    base = chooser.with_elements(current, current.elements)
    if base is None:
        return ()
    kept = []
    limit = float(chi2.isf(2.0 * REJECTED, 1))
    removable = [name for name in current.elements if name in chooser.candidates]
    for out in removable:
        for name in chooser.candidates:
            if name in current.elements:
                continue
            trial = chooser.with_elements(
                current, [*(other for other in current.elements if other != out), name]
            )
            if trial is None:
                continue
            rise = cost(trial) - cost(base)
            near = rise < limit
            ladder.append(Rung(trial.elements, rise, "as good" if near else "too poor"))
            if near:
                kept.append(trial)
    for name in chooser.candidates:
        # Weak evidence, not enough to take the element on: with and without it both count.
        if name not in current.elements and limit < evidence.get(name, 0.0) <= level:
            trial = chooser.with_elements(current, [*current.elements, name])
            if trial is not None:
                kept.append(trial)
    return tuple(kept)
