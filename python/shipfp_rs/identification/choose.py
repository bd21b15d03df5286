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
from shipfp_rs.identification.blocks import Block, Evaluation, prewhiten
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.starts import starts
from shipfp_rs.identification.weighted_problem import Minimum, mean_scatter
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.structure import Structure, Torque
from shipfp_rs.structures.ties import bare
from shipfp_rs.support.arrays import Array

State = Literal["on", "off", "open"]

LOGGER = logging.getLogger("shipfp_rs")

FALSE_ALARM = 0.01
"""Probability that any element is taken on that does not act, if the model is right otherwise."""
REJECTED = 0.05
"""Probability below which an alternative structure is rejected: its intervals then do not count."""
CANDIDATES = (
    "dead_time_loop",
    "dead_time_set_point",
    "actuator_lag",
    "torque_limit",
    "twist",
    "late_torque",
)
"""Elements that are tried, in the order of a report."""
FIRST = ("dead_time_loop", "dead_time_set_point")
"""Elements that the first fit has: where they do not act they go again, and without them a fit may lose its way."""
SLOW = ("torque_limit", "rack_rate", "twist")
"""Elements whose passes over a record go from event to event and take twenty times as long."""
TRIAL_EVALUATIONS = 25
"""Passes over the records at most while such an element is on trial: enough to see whether it is worth more."""
PART_BEHIND = 0.9
"""Part of the time constant behind the gauge, as the first regression has it, that the whole one can't be below."""
ALIKE = ("dead_time_loop", "actuator_lag")
"""Elements that look alike below the loop's bandwidth: each is tried in the other's place."""


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
class Promise:
    """What an element promises: the fall of the deviance, from which start, and how strongly it may act at 95 %."""

    fall: float
    start: Mapping[str, float]
    limit: float | None


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
        elements = self.ordered({*self.forced, *(name for name in FIRST if name in self.candidates)})
        search = self.search(elements)
        ends: list[Minimum] = []
        begins = starts(search.structure, self.experiments)
        if "tau_prop" in begins[0] and "tau_n" not in {
            **self.narrow.get("fixed", {}),
            **self.narrow.get("prior", {}),
        }:
            # The inertia behind the gauge is part of the whole.
            least = PART_BEHIND * min(values["tau_prop"] for values in begins)
            upper = search.structure["tau_n"].upper
            self.narrow = {**self.narrow, "bounds": {"tau_n": (least, max(2.0 * least, 1.2), upper)}}
            search = self.search(elements)
        for values in begins:
            try:
                ends.append(search.minimise(self._vector(search, values)))
            except (IdentificationError, SimulationError) as error:
                LOGGER.debug("identify: a start failed: %s", error)
        if not ends:
            raise IdentificationError(
                "no start that the data suggest can be simulated; check the channels' signs, units and operating point"
            )
        best = min(ends, key=lambda end: end.criterion)
        if _is_exact(search, best):
            # Nothing but rounding is left, which no noise model describes.
            self.options["noise"] = "white"
            search = replace(search, noise="white")
        return Fitted(elements, search, search.refine(best))

    def with_elements(
        self, origin: Fitted, elements: Sequence[str], begin: Mapping[str, float] | None = None
    ) -> Fitted | None:
        """Fit other elements with the weights of a fit, from its end; None where that can't be simulated.

        `begin` holds the start of a new element's parameter; otherwise all of `STARTS` are tried.
        """
        ordered = self.ordered(elements)
        search = replace(self.search(ordered), weights=origin.minimum.noise)
        if set(ordered) & set(SLOW) - set(origin.elements):
            search = replace(search, max_evaluations=TRIAL_EVALUATIONS)
        values = dict(zip(origin.search.unknowns, map(float, origin.minimum.vector), strict=True)) | dict(
            begin or {}
        )
        ends = []
        for start in self._from(search, values):
            try:
                ends.append(search.minimise(start))
            except (IdentificationError, SimulationError) as error:
                LOGGER.debug("identify: %s could not be fitted: %s", ", ".join(ordered), error)
        return Fitted(ordered, search, min(ends, key=cost)) if ends else None

    def promise(self, origin: Fitted, name: str) -> Promise:
        """Return what an element promises beside a fit.

        Rao's score test, with the change of the outputs that a start makes in place of the derivative, which a torque
        limit does not have: of the change D, cleared of what the fit's own unknowns explain, the residual e explains
        (D'e)^2 / D'D. Elements that would have to act the other way promise nothing.
        """
        search, minimum = origin.search, origin.minimum
        parameter = ELEMENTS[name].parameters[0]
        with_it = self.structure((*origin.elements, name)).equations
        starts = STARTS.get(parameter.name, (parameter.start,))
        if name == "torque_limit":
            starts = self._levels(origin)
        evaluations = search.filtered(minimum.vector, minimum.noise)
        gram = np.zeros((search.size + 1 + len(starts),) * 2)
        parts = search.parts(evaluations, minimum.noise)
        for (block, values), part in zip(search.each(minimum.vector), parts, strict=True):
            still = search.structure.equations.simulate(values, block.data)  # type: ignore[arg-type]
            changes = np.zeros((len(starts), *still.shape))
            for place, start in enumerate(starts):
                try:
                    moved = with_it.simulate({**values, parameter.name: start}, block.data)  # type: ignore[arg-type]
                except SimulationError:
                    continue
                changes[place] = moved - still
            changes *= block.valid
            made = Evaluation(np.zeros_like(still), changes, block.valid)
            if minimum.noise.models is not None:
                made = prewhiten(made, minimum.noise.models)
            rows = np.concatenate([part, minimum.noise.root @ made.jacobian])
            flat = rows.reshape(len(rows), -1)
            gram += flat @ flat.T
        return _best_promise(gram, search.size, parameter.name, starts, falling=name == "torque_limit")

    def _levels(self, origin: Fitted) -> tuple[float, ...]:
        """Levels of a torque limit near the top of what the engine gives in the fit without one."""
        search = origin.search
        top = -np.inf
        for block, values in search.each(origin.minimum.vector):
            equations = replace(bare(search.structure.equations), outputs=("dM",), gauge=False)  # type: ignore[type-var]
            torque = equations.simulate(values, block.data)  # type: ignore[arg-type]
            top = max(top, float(np.max(torque)))
        return tuple(1.0 + share * top for share in LEVELS)

    def refined(self, fitted: Fitted) -> Fitted:
        """Fit weights and noise models of its own to a structure."""
        search = replace(fitted.search, weights=None, max_evaluations=int(self.options["max_evaluations"]))  # type: ignore[call-overload]
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

    def ordered(self, elements: Sequence[str] | set[str]) -> tuple[str, ...]:
        """Return elements in the table's order."""
        return tuple(name for name in ELEMENTS if name in elements)


STARTS: Mapping[str, tuple[float, ...]] = {
    "T_d": (0.02,),
    "T_set": (0.05,),
    "tau_act": (0.03, 0.12),
    "tau_twist": (1e-3,),
    "T_M": (2e-3,),
    "T_n": (2e-3,),
}
"""Where the search for a new element's parameter starts."""


EXACT = 1e-5
"""Residual over spread of an output below which there is no noise."""
LEVELS = (0.95, 0.85, 0.7)
"""Torque limits that are tried, as parts of the largest deviation of the engine's torque without one."""
HOPELESS = 0.5
"""Part of the deviance that takes an element on below which what it promises is not worth a fit."""


def _best_promise(
    gram: Array, unknowns: int, name: str, starts: Sequence[float], *, falling: bool
) -> Promise:
    """Judge each start from the products of [-J, e, D1, D2, ...].

    A limit of an effect in proportion to its parameter follows from its estimate and deviation; of one that acts the
    more, the lower it is, it is the highest level that the residual contradicts.
    """
    own, residual = slice(0, unknowns), unknowns
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    unit = gram / np.outer(size, size)
    inverse = np.linalg.pinv(unit[own, own], rcond=1e-12, hermitian=True)
    best, begin, limit = 0.0, starts[0], None
    for place, start in enumerate(starts, start=unknowns + 1):
        along = unit[own, place]
        across = (
            (unit[place, residual] - along @ inverse @ unit[own, residual]) * size[place] * size[residual]
        )
        left = (1.0 - along @ inverse @ along) * size[place] ** 2
        if left < 1e-9 * size[place] ** 2 or left <= 0.0:
            continue
        share, deviation = across / left, left**-0.5
        if falling:
            if left * (1.0 - 2.0 * share) > threshold(1, REJECTED):
                limit = start if limit is None else max(limit, start)
        elif limit is None:
            limit = float(start * (max(share, 0.0) + 1.645 * deviation))
        if share > 0.0 and share * across > best:
            best, begin = float(share * across), start
    return Promise(best, {name: float(begin)}, limit)


def _is_exact(search: Search, minimum: Minimum) -> bool:
    """Whether the residuals are rounding beside every output's spread: a simulation without noise."""
    count, scatter = mean_scatter(minimum.sums)
    spread = np.mean([np.diag(block.scatter) for block in search.blocks], axis=0)
    return bool((np.diag(scatter) < EXACT**2 * spread).all()) and count > 0


def cost(fitted: Fitted | Minimum) -> float:
    """Return the weighted sum of squares of a minimum with given weights."""
    return (fitted.minimum if isinstance(fitted, Fitted) else fitted).criterion


def choose(chooser: Chooser) -> Choice:
    """Take elements on while the deviance falls enough, drop those that it does not miss, and keep what is not rejected."""
    level = threshold(max(len(chooser.candidates), 1))
    ladder: list[Rung] = []
    # Without what does not act, every later fit is cheaper.
    current, _, _ = _backward(chooser, chooser.first(), level, ladder)
    gains: Gains = {}
    for _ in range(len(chooser.candidates) + 1):
        best, gains = _gains(chooser, current, level, ladder)
        if best is None:
            break
        current = chooser.refined(best)
    kept, rises, poorer = _backward(chooser, current, level, ladder)
    if kept is not current:
        # Weights and base are those of the structure that is left.
        current, (_, gains) = kept, _gains(chooser, kept, level, ladder)
    rivals = (*poorer, *_rivals(chooser, current, gains, level, ladder))
    evidence = rises | {name: gain.fall for name, gain in gains.items()}
    states: dict[str, State] = {}
    for name in chooser.candidates:
        held = {name in fitted.elements for fitted in (current, *rivals)}
        states[name] = "open" if len(held) == 2 else "on" if True in held else "off"
    limits = {name: gain.limit for name, gain in gains.items() if gain.limit is not None}
    return Choice(current, rivals, evidence, states, limits, tuple(ladder))


@dataclass(frozen=True)
class Gain:
    """Fall of the deviance with an element more, the strength at which it is rejected, and its fit, if it was worth one."""

    fall: float
    limit: float | None
    trial: Fitted | None = None


Gains = dict[str, Gain]


def _gains(
    chooser: Chooser, current: Fitted, level: float, ladder: list[Rung]
) -> tuple[Fitted | None, Gains]:
    """Return the best structure with one element more if it is worth it, and each element's fall of the deviance."""
    gains: Gains = {}
    base = chooser.with_elements(current, current.elements)
    for name in chooser.candidates:
        if base is None or name in current.elements:
            continue
        promise = chooser.promise(base, name)
        gains[name] = Gain(promise.fall, promise.limit)
        if promise.fall < HOPELESS * level:
            ladder.append(Rung(chooser.ordered((*current.elements, name)), -promise.fall, "not promising"))
            continue
        trial = chooser.with_elements(current, (*current.elements, name), promise.start)
        if trial is not None:
            gains[name] = Gain(cost(base) - cost(trial), promise.limit, trial)
            said = "better" if gains[name].fall > level else "no better"
            ladder.append(Rung(trial.elements, -gains[name].fall, said))
    fitted = [gain for gain in gains.values() if gain.trial is not None and gain.fall > level]
    return max(fitted, key=lambda gain: gain.fall).trial if fitted else None, gains


def _backward(
    chooser: Chooser, current: Fitted, level: float, ladder: list[Rung]
) -> tuple[Fitted, dict[str, float], list[Fitted]]:
    """Drop elements, the least missed first, as long as the data do not reject what is left.

    Returned are what is left, each of its elements' rise of the deviance, and the structures without an element that is
    missed too much to be dropped and too little to be sure of.
    """
    limit = threshold(1, REJECTED)
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
                said = "too poor" if rises[name] > level else "poorer" if rises[name] > limit else "as good"
                ladder.append(Rung(trial.elements, rises[name], said))
        least = min(trials, key=lambda name: rises[name], default=None)
        if least is None or rises[least] > limit:
            return current, rises, [trials[name] for name in trials if rises[name] <= level]
        current = chooser.refined(trials[least])


def _rivals(
    chooser: Chooser, current: Fitted, gains: Gains, level: float, ladder: list[Rung]
) -> tuple[Fitted, ...]:
    """Fit neighbours in which an element is swapped for another, and keep them and additions that are not rejected."""
    base = chooser.with_elements(current, current.elements)
    if base is None:
        return ()
    limit = threshold(1, REJECTED)
    kept = [gain.trial for gain in gains.values() if gain.trial is not None and limit < gain.fall <= level]
    for out in (name for name in current.elements if name in chooser.candidates and name in ALIKE):
        for name in (name for name in gains if name in ALIKE):
            swapped = [*(other for other in current.elements if other != out), name]
            trial = chooser.with_elements(current, swapped)
            if trial is None:
                continue
            rise = cost(trial) - cost(base)
            ladder.append(Rung(trial.elements, rise, "as good" if rise < limit else "too poor"))
            if rise < limit:
                kept.append(trial)
    return tuple(kept)
