"""The data choose: which elements of the one ship model act, found by fits from simple to rich and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import permutations, product
from typing import Literal

import numpy as np

from shipfp_rs.identification.chooser import CUTS, FIRST, SAME, Chooser
from shipfp_rs.identification.fitted import Fitted, cost
from shipfp_rs.identification.promise import REJECTED, Neglect, threshold
from shipfp_rs.identification.residual_tests import input_dispersion, residual_tests
from shipfp_rs.identification.second_look import second_look
from shipfp_rs.identification.start_vector import DELAYS
from shipfp_rs.optimise.normal_equations import orthonormal
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.support.threads import where_alone

State = Literal["on", "off", "open"]

UNSEEN = ("sampling",)
"""Elements that records at the rate of an experiment hardly show, and no search can find: a period has a minimum of its own
beside every multiple of the record's length. The intervals are widened by what they could change in the estimates."""
TAKEN_S = 0.02
"""What a delay on its bound takes from another one, to see whether it acts all the same [s]."""
ALIKE = (("dead_time_loop", "actuator_lag"), ("twist", "late_torque"))
"""Elements that look alike below the loop's or the shaft's bandwidth: each is tried in the other's place."""
ROUNDS = 3
"""Turns of taking elements on and dropping them, at most."""
SURE = 1000.0
"""Rise of the deviance, by its curvature, from which on no fit is needed to see that an element acts."""
HOPELESS = 0.5
"""Part of the deviance that takes an element on below which what it promises is not worth a fit."""

CONTRADICTED = 3.0
"""Dispersion above which the set point explains more of the residuals than chance does in one record of a thousand."""


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
    neglected: Mapping[str, tuple[Neglect, ...]] = field(default_factory=dict)
    """What elements that are off may do to the estimates all the same."""


def choose(chooser: Chooser) -> Choice:
    """Take elements on while the deviance falls enough, drop those that it does not miss, and keep what is not rejected."""
    level = threshold(max(len(chooser.candidates), 1))
    ladder: list[Rung] = []
    current = _without_least(chooser, chooser.first(), level, ladder)
    current, gains, rises, poorer = _back_and_forth(chooser, current, level, ladder, looks_again=True)
    if CUTS in current.elements:
        chooser.clears_limits = True
        current, gains, rises, poorer = _back_and_forth(chooser, chooser.refined(current), level, ladder)
    current = chooser.refined(current, last=True)
    for name in (name for name in UNSEEN if name in chooser.candidates and name not in current.elements):
        promise = chooser.promise(current.base, name)
        gains[name] = Gain(promise.fall, promise.limit, None, promise.neglect)
        ladder.append(Rung(chooser.ordered((*current.elements, name)), -promise.fall, "not promising"))
    rivals = [
        *_again(chooser, current, poorer),
        *_rivals(chooser, current, gains, level, ladder),
        *_elsewhere(chooser, current),
    ]
    # With more unknowns it must be worth as much as an element.
    worth = {id(one): cost(one) + level * (one.search.size > current.search.size) for one in rivals}
    better = min(rivals, key=lambda one: worth[id(one)], default=None)
    if better is not None and worth[id(better)] < cost(current.base) - SAME:
        # The structure that fits best becomes the result; the others are kept as alternatives.
        other = chooser.refined(better, last=True)
        if other.minimum.converged or not current.minimum.converged:
            rivals = [one for one in rivals if one is not better] + [current]
            current = other
    evidence = rises | {name: gain.fall for name, gain in gains.items() if name not in rises}
    states: dict[str, State] = {}
    for name in chooser.candidates:
        held = {name in fitted.elements for fitted in (current, *rivals)}
        seen = name in UNSEEN and evidence.get(name, 0.0) > level
        # An element that is let act although the data do not ask for it keeps the others' intervals honest.
        asked = name in current.elements and rises.get(name, np.inf) <= level
        states[name] = "open" if len(held) == 2 or seen or asked else "on" if True in held else "off"
    limits = {name: gain.limit for name, gain in gains.items() if gain.limit is not None}
    neglected = {name: gain.neglect for name, gain in gains.items()}
    return Choice(current, tuple(rivals), evidence, states, limits, tuple(ladder), neglected)


def _back_and_forth(
    chooser: Chooser, current: Fitted, level: float, ladder: list[Rung], *, looks_again: bool = False
) -> tuple[Fitted, Gains, dict[str, float], list[Fitted]]:
    """Take elements on and drop them until nothing changes; if so asked, look again where what was found does not stand.

    Returned are what is left, what every other element would gain, each own element's rise of the deviance without it, and
    the structures without an element that is missed too little to be sure of.
    """
    current, gains = _forward(chooser, current, level, ladder)
    if looks_again and (quiet := chooser.quietened(current)):
        current, gains = _forward(chooser, quiet, level, ladder)
    if looks_again and (apart := dispersion(current)) > CONTRADICTED:
        other = second_look(chooser, current, _swapped(chooser, current))
        # Records of different fits are cleared of different things: their deviances alone do not tell which one is right.
        if dispersion(other) < apart:
            other = chooser.quietened(other) or other
            current, gains = _forward(chooser, other, level, ladder)
    for _ in range(ROUNDS):
        kept, rises, poorer = _backward(chooser, current, level, ladder)
        if kept is current:
            break
        # Weights and base are those of the structure that is left, beside which another element may be worth more.
        current, gains = _forward(chooser, kept, level, ladder)
        if current is kept:
            break
    return current, gains, rises, poorer


def _swapped(chooser: Chooser, current: Fitted) -> list[tuple[str, ...]]:
    """Return the elements of structures that may do instead: with one swapped for its like."""
    return [
        tuple(other if name == out else name for name in current.elements)
        for alike in ALIKE
        for out, other in permutations(alike)
        if out in current.elements and other not in current.elements and {out, other} <= {*chooser.candidates}
    ]


def _forward(chooser: Chooser, current: Fitted, level: float, ladder: list[Rung]) -> tuple[Fitted, Gains]:
    """Take elements on, the best first, as long as the deviance falls enough; return each other one's gain."""
    gains: Gains = {}
    for _ in range(len(chooser.candidates) + 1):
        best, gains = _gains(chooser, current, level, ladder)
        # Beside what the set point still explains of the residuals, a fall may be nothing; weights of its own cost time.
        if best is None or _fall(gains, best) < level * dispersion(best):
            break
        grown = chooser.refined(best)
        if _fall(gains, grown) < level * dispersion(grown):
            break
        current = grown
    return current, gains


def _without_least(chooser: Chooser, current: Fitted, level: float, ladder: list[Rung]) -> Fitted:
    """Return a fit without the dead time in the loop if the least of it is too much already."""
    name = FIRST[0]
    if name not in chooser.candidates or name not in current.elements or not _is_off(current, name):
        return current
    trial = chooser.with_elements(current, [other for other in current.elements if other != name])
    if trial is None or cost(trial) > cost(current.base) - level:
        return current
    ladder.append(Rung(trial.elements, cost(trial) - cost(current.base), "better"))
    return chooser.refined(trial)


def dispersion(fitted: Fitted) -> float:
    """Return the residual's power along what the set point drives over that of noise, one where noise is all that is left.

    The law of a deviance holds for what is left of it after division by that (McCullagh and Nelder 1989, section 4.5).
    """
    tests = residual_tests(fitted.search, fitted.minimum)
    samples = sum(block.count for block in fitted.search.blocks)
    return max(input_dispersion(test.figures(), samples) for test in tests.values())


def _fall(gains: Gains, grown: Fitted) -> float:
    """Fall of the deviance that took the grown structure's last element on."""
    return max(
        (
            gain.fall
            for gain in gains.values()
            if gain.trial is not None and gain.trial.elements == grown.elements
        ),
        default=0.0,
    )


def _again(chooser: Chooser, current: Fitted, fits: Sequence[Fitted]) -> list[Fitted]:
    """Fits with the weights of the last one, as far as these do not reject them."""
    limit = cost(current.base) + threshold(1, REJECTED)
    found = []
    for fitted in fits:
        begin = dict(zip(fitted.search.unknowns, map(float, fitted.minimum.vector), strict=True))
        trial = chooser.with_elements(current, fitted.elements, begin, worth=limit)
        if trial is not None and cost(trial) < limit:
            found.append(trial)
    return found


def _elsewhere(chooser: Chooser, current: Fitted) -> list[Fitted]:
    """Fits of the same structure that ended elsewhere and are not rejected: the data do not say which it is."""
    least, found = cost(current.base), []
    for values in chooser.elsewhere:
        begin = {name: value for name, value in values.items() if name in current.search.unknowns}
        trial = chooser.with_elements(current, current.elements, begin, worth=least + threshold(1, REJECTED))
        if trial is not None and cost(trial) < least + threshold(1, REJECTED):
            found.append(trial)
    return found


@dataclass(frozen=True)
class Gain:
    """Fall of the deviance with an element more, the strength at which it is rejected, and its fit, if it was worth one."""

    fall: float
    limit: float | None
    trial: Fitted | None = None
    neglect: tuple[Neglect, ...] = ()


Gains = dict[str, Gain]


def _gains(
    chooser: Chooser, current: Fitted, level: float, ladder: list[Rung]
) -> tuple[Fitted | None, Gains]:
    """Return the best structure with one element more if it is worth it, and each element's fall of the deviance."""
    gains: Gains = {}
    # What a large misfit asks for need not show in the small: then each is tried.
    contradicted = dispersion(current) > CONTRADICTED
    names = [name for name in chooser.candidates if name not in current.elements and name not in UNSEEN]
    least = -np.inf if contradicted else HOPELESS * level
    for name, gain in zip(
        names, where_alone([partial(_gain, chooser, current, name, least) for name in names]), strict=True
    ):
        gains[name] = gain
        tried = "better" if gain.fall > level else "no better"
        said = "not promising" if gain.trial is None else tried
        ladder.append(Rung(chooser.ordered((*current.elements, name)), -gain.fall, said))
    fitted = [
        (gain.fall, gain.trial) for gain in gains.values() if gain.trial is not None and gain.fall > level
    ]
    if not fitted:
        return None, gains
    most, best = max(fitted, key=lambda pair: pair[0])
    if len(fitted) == 1:
        return best, gains
    # A flexible shaft also does what a late torque does, with more parameters.
    near = most - level * dispersion(best)
    _, simplest = min(fitted, key=lambda pair: (pair[0] < near, pair[1].search.size, -pair[0]))
    return simplest, gains


def _gain(chooser: Chooser, current: Fitted, name: str, least: float) -> Gain:
    """Return what an element promises beside a fit and, where that is at least so much, what a fit with it gains."""
    still = current.base
    promise = chooser.promise(still, name)
    hoped = Gain(promise.fall, promise.limit, None, promise.neglect)
    if promise.fall < least:
        return hoped
    trial = chooser.with_elements(current, (*current.elements, name), promise.start)
    return hoped if trial is None else replace(hoped, fall=cost(still) - cost(trial), trial=trial)


def _backward(
    chooser: Chooser, current: Fitted, level: float, ladder: list[Rung]
) -> tuple[Fitted, dict[str, float], list[Fitted]]:
    """Drop elements, the least missed first, as long as the data do not reject what is left.

    Returned are what is left, each of its elements' rise of the deviance, and the structures without an element that is
    missed too much to be dropped and too little to be sure of.
    """
    limit = threshold(1, REJECTED)
    moved: set[str] = set()
    while True:
        still = current.base
        rises: dict[str, float] = {}
        trials: dict[str, Fitted] = {}
        sure = {
            name: fall
            for name in current.elements
            if name in chooser.candidates and (fall := _by_curvature(current, name)) > SURE
        }
        for name, fall in sure.items():
            rises[name] = fall
            ladder.append(Rung(tuple(other for other in current.elements if other != name), fall, "too poor"))
        names = [name for name in current.elements if name in chooser.candidates and name not in sure]
        worth = cost(still) + 2.0 * level
        jobs = [
            partial(
                chooser.with_elements,
                current,
                [other for other in current.elements if other != name],
                worth=worth,
            )
            for name in names
        ]
        for name, trial in zip(names, where_alone(jobs), strict=True):
            rises[name] = np.inf if trial is None else cost(trial) - cost(still)
            if trial is not None:
                trials[name] = trial
                said = "too poor" if rises[name] > level else "poorer" if rises[name] > limit else "as good"
                ladder.append(Rung(trial.elements, rises[name], said))
        idle = [
            name for name in trials if rises[name] <= limit and (name not in FIRST or _is_off(current, name))
        ]
        least = min(idle, key=lambda name: rises[name], default=None)
        if least is None:
            return current, rises, [trials[name] for name in trials if rises[name] <= level]
        # Once moved off its bound a delay that comes back to it goes.
        inside = _inside(chooser, current, least) if least in FIRST and least not in moved else None
        moved.add(least)
        current = chooser.refined(trials[least] if inside is None else inside)


def _by_curvature(fitted: Fitted, name: str) -> float:
    """Rise of the deviance without an element, by its curvature at the minimum; none for one that is off at no bound."""
    base, parameter = fitted.base, ELEMENTS[name].parameters[0].name
    if name == CUTS or parameter not in base.search.names:
        return 0.0
    place = base.search.names.index(parameter)
    gram = base.search.gram(base.minimum.vector, base.minimum.noise, base.minimum.sums)[:-1, :-1]
    others = np.arange(len(gram)) != place
    half = orthonormal(gram[np.ix_(others, others)])
    told = gram[place, place] - float(np.sum(np.square(half.T @ gram[others, place])))
    size = float(base.minimum.vector[place]) - base.search.structure[parameter].lower
    return float(max(told, 0.0) * size**2)


def _inside(chooser: Chooser, current: Fitted, name: str) -> Fitted | None:
    """Return a fit in which a delay that stands on its bound acts, if there is one as good: from others some is taken."""
    own = ELEMENTS[name].parameters[0].name
    values = dict(zip(current.search.unknowns, map(float, current.minimum.vector), strict=True))
    for other in DELAYS:
        if other == own or values.get(other, 0.0) < 1.5 * TAKEN_S:
            continue
        begin = {**values, own: TAKEN_S, other: values[other] - TAKEN_S}
        trial = chooser.with_elements(current, current.elements, begin)
        if trial is not None and cost(trial) < cost(current.base) - SAME and not _is_off(trial, name):
            return trial
    return None


def _is_off(fitted: Fitted, name: str) -> bool:
    """Whether an element's parameter stands on the bound at which it does as good as nothing."""
    parameter = fitted.search.structure[ELEMENTS[name].parameters[0].name]
    values = dict(zip(fitted.search.names, fitted.minimum.vector, strict=False))
    return bool(values.get(parameter.name, np.inf) <= parameter.lower * (1.0 + 1e-6) + 1e-9)


def _rivals(
    chooser: Chooser, current: Fitted, gains: Gains, level: float, ladder: list[Rung]
) -> tuple[Fitted, ...]:
    """Fit neighbours in which an element is swapped for another, and keep those that are not rejected."""
    still = current.base
    limit = threshold(1, REJECTED)
    kept = []
    for alike in ALIKE:
        own = [name for name in current.elements if name in chooser.candidates and name in alike]
        for out, name in product(own, (name for name in gains if name in alike)):
            swapped = [*(other for other in current.elements if other != out), name]
            trial = chooser.with_elements(current, swapped, worth=cost(still) + 2.0 * level)
            if trial is None:
                continue
            rise = cost(trial) - cost(still)
            ladder.append(Rung(trial.elements, rise, "as good" if rise < limit else "too poor"))
            if rise < limit:
                kept.append(trial)
    return tuple(kept)
