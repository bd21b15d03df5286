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
from shipfp_rs.experiments.interpolation import band_limited
from shipfp_rs.identification.blocks import Block, Evaluation, prewhiten
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.starts import starts
from shipfp_rs.identification.weighted_problem import Minimum, mean_scatter
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.ship import TORQUE_SCALE, ShipEquations
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
    "sampling",
)
"""Elements that are tried, in the order of a report."""
FIRST = ("dead_time_loop", "dead_time_set_point")
"""Elements that the first fit has: where they do not act they go again, and without them a fit may lose its way."""
SLOW = ("torque_limit", "rack_rate")
"""Elements whose passes over a record go from event to event and take twenty times as long."""
SAME = 0.5
"""Difference of the deviance that is not worth another choice."""
TOLD = 10.0
"""Fall of the deviance from which on the outputs tell how the set point runs between its samples."""
NEARLY = 100.0
"""Difference of the deviance, with white noise, within which the end of another start may be as good with coloured noise."""
NEARBY_S = 0.02
"""Difference of every delay within which two ends are one [s]."""
TRIAL_FALL = 0.02
"""Fall of the deviance that is not worth a step of a trial: what it is judged by is more than a hundred times as much."""
SLOW_FALL = 1e-3
"""The same for the last step of a fit with an element whose passes take long."""
TRIAL_EVALUATIONS = 25
"""Passes over the records at most while such an element is on trial: enough to see whether it is worth more."""
UNSEEN = ("sampling",)
"""Elements that records at the rate of an experiment hardly show, and no search can find: a period has a minimum of its own
beside every multiple of the record's length. What they may do to the estimates widens the intervals."""
TAKEN_S = 0.02
"""What a delay on its bound takes from another one, to see whether it acts all the same [s]."""
PROPELLER_PART = 0.3
"""Part of the inertia that is taken to be the propeller's where no torque between the two tells it."""
PHASES = 4
"""Times within a sampling period at which the governor may sample, over which its effect is averaged."""
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
    neglect: tuple[Neglect, ...] = ()
    moves: Mapping[str, float] = field(default_factory=dict)
    """What the other unknowns then change by, to first order."""


@dataclass(frozen=True)
class Neglect:
    """What leaving an element out does to the estimates, to first order in its strength."""

    estimate: float
    """Strength that the residuals ask for, which may be below zero."""
    deviation: float
    """Standard deviation of that strength."""
    shift: Mapping[str, float]
    """Change of each parameter for a unit of strength."""
    power: int = 1
    """What the residuals see grows with this power of the strength; estimate and deviation are of that power."""


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
        self.candidates = tuple(
            name
            for name in CANDIDATES
            if name not in excluded and name not in forced
        )
        self.narrow = narrow or {}
        self.band_limited = False
        """Whether the set point between its samples is taken for a band-limited signal."""
        self.elsewhere: list[dict[str, float]] = []
        """Ends of other starts that fit nearly as well as the best one."""
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
        ends.sort(key=lambda end: end.criterion)
        self.elsewhere = _apart(search, ends)
        search, best = self._interpolated(elements, search, ends[0])
        if _is_exact(search, best):
            # Nothing but rounding is left, which no noise model describes.
            self.options["noise"] = "white"
            search = replace(search, noise="white")
        return Fitted(elements, search, search.refine(best))

    def _interpolated(
        self, elements: Sequence[str], search: Search, best: Minimum
    ) -> tuple[Search, Minimum]:
        """Take the set point between its samples for what the outputs follow better: straight lines, or a band-limited signal."""
        smoothed = [band_limited(one) if one.hold == "first" else one for one in self.experiments]
        straight, self.experiments = self.experiments, smoothed
        other = self.search(elements)
        try:
            trial = other.minimise(best.vector)
        except (IdentificationError, SimulationError) as error:
            LOGGER.debug("identify: a band-limited set point could not be simulated: %s", error)
        else:
            if trial.criterion < best.criterion - TOLD:
                self.band_limited = True
                return other, trial
        self.experiments = straight
        return search, best

    def with_elements(
        self,
        origin: Fitted,
        elements: Sequence[str],
        begin: Mapping[str, float] | None = None,
        worth: float = np.inf,
    ) -> Fitted | None:
        """Fit other elements with the weights of a fit, from its end; None where that can't be simulated.

        `begin` holds the start of a new element's parameter; otherwise all of `STARTS` are tried. A fit that can't get
        its cost below `worth` is given up.
        """
        ordered = self.ordered(elements)
        search = replace(self.search(ordered), weights=origin.minimum.noise, enough=TRIAL_FALL, worth=worth)
        if set(ordered) & set(SLOW):
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
        made = self.structure((*origin.elements, name))
        with_it = made.equations
        others = {parameter.name: parameter.start for parameter in made.parameters}
        others["tau_prop"] = PROPELLER_PART * origin.search.values(minimum.vector)["tau_n"]
        starts = self._levels(origin) if name == "torque_limit" else STARTS.get(parameter.name, (parameter.start,))
        begins = [{parameter.name: start, **beside} for beside in BESIDE.get(name, ({},)) for start in starts]
        starts = tuple(begin[parameter.name] for begin in begins)
        evaluations = search.filtered(minimum.vector, minimum.noise)
        gram = np.zeros((search.size + 1 + len(starts),) * 2)
        parts = search.parts(evaluations, minimum.noise)
        for (block, values), part in zip(search.each(minimum.vector), parts, strict=True):
            still = search.structure.equations.simulate(values, block.data)  # type: ignore[arg-type]
            changes = np.zeros((len(starts), *still.shape))
            for place, start in enumerate(starts):
                try:
                    if name == "torque_limit":
                        changes[place] = self._limited(search, values, block, start) - still
                    elif name == "sampling":
                        changes[place] = _sampled(with_it, values, block.data, begins[place]) - still  # type: ignore[arg-type]
                    else:
                        # A small step: what the others take over of a large one, they don't to first order.
                        full = {**others, **values, **begins[place], parameter.name: SMALL * start}
                        changes[place] = (with_it.simulate(full, block.data) - still) / SMALL  # type: ignore[arg-type]
                except SimulationError:
                    continue
            changes *= block.valid
            made = Evaluation(np.zeros_like(still), changes, block.valid)
            if minimum.noise.models is not None:
                made = prewhiten(made, minimum.noise.models)
            rows = np.concatenate([part, minimum.noise.root @ made.jacobian])
            flat = rows.reshape(len(rows), -1)
            gram += flat @ flat.T
        power = 2 if name == "sampling" and "dead_time_loop" in origin.elements else 1
        return _best_promise(
            gram, search.unknowns, begins, starts, falling=name == "torque_limit", power=power
        )

    def _levels(self, origin: Fitted) -> tuple[float, ...]:
        """Levels of a torque limit near the top of what the engine gives in the fit without one."""
        search = origin.search
        top = -np.inf
        for block, values in search.each(origin.minimum.vector):
            equations = replace(bare(search.structure.equations), outputs=("dM",), gauge=False)  # type: ignore[type-var]
            torque = equations.simulate(values, block.data)  # type: ignore[arg-type]
            top = max(top, float(np.max(torque)))
        return tuple(1.0 + share * top for share in LEVELS)

    def _limited(self, search: Search, values: Mapping[str, float], block: Block, level: float) -> Array:
        """Outputs with the torque limited, to first order: what is above the level is a load that slows the shaft down."""
        equations = bare(search.structure.equations)
        assert isinstance(equations, ShipEquations)
        experiment = block.data
        assert isinstance(experiment, Experiment)
        engine = replace(equations, outputs=("dM",), gauge=False).simulate(
            {**values, TORQUE_SCALE: 0.0}, experiment
        )[0]
        above = np.maximum(1.0 + engine - level, 0.0)
        outputs = equations.simulate_loaded(values, experiment, above)
        if "dM" in equations.outputs:
            outputs[equations.outputs.index("dM")] -= (1.0 + values[TORQUE_SCALE]) * above
        return outputs

    def refined(self, fitted: Fitted) -> Fitted:
        """Fit weights and noise models of its own to a structure."""
        slow = set(fitted.elements) & set(SLOW)
        enough, intervals = (SLOW_FALL, "symmetric") if slow else (None, str(self.options.get("intervals", "profile")))
        search = replace(fitted.search, weights=None, enough=enough, intervals=intervals, worth=np.inf, max_evaluations=int(self.options["max_evaluations"]))  # type: ignore[call-overload]
        return Fitted(fitted.elements, search, search.refine(fitted.minimum))

    def _from(self, search: Search, values: Mapping[str, float]) -> list[Array]:
        """Start vectors of a structure from another one's end, one for each start that a new element has."""
        new = [name for name in search.names if name not in values]
        first = self._vector(search, values)
        vectors = [first]
        # What an element did that goes is done by another delay, as well as that can.
        gone = [values[name] for name in DELAYS if name in values and name not in search.names]
        for name in DELAYS if gone else ():
            if name in search.names and name in values:
                vector = first.copy()
                place = search.names.index(name)
                vector[place] = np.clip(vector[place] + sum(gone), *(bound[place] for bound in search.bounds()))
                vectors.append(vector)
        for name in new:
            parameter = search.structure[name]
            for start in STARTS.get(name, (parameter.start,)):
                vector = first.copy()
                vector[search.names.index(name)] = np.clip(start, parameter.lower, parameter.upper)
                vectors.append(vector)
        return vectors[1:] if new and len(vectors) > 1 else vectors

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
    "tau_twist": (1e-3, 4e-3),
    "T_M": (2e-3,),
    "T_n": (2e-3,),
    "T_s": (0.0137,),
}
"""Where the search for a new element's parameter starts."""


SMALL = 0.1
"""Part of an element's start by which its effect is judged to first order."""
BESIDE: Mapping[str, tuple[dict[str, float], ...]] = {
    "twist": ({"zeta_twist": 0.2}, {"zeta_twist": 1.5}),
    "sampling": ({"update": 0.0}, {"update": 1.0}),
}
"""Where an element's other parameters start, each with all starts of the first one."""
DELAYS = ("T_d", "T_set", "tau_act")
"""Parameters that delay the shaft's answer: what one did, another does nearly as well."""
EXACT = 1e-5
"""Residual over spread of an output below which there is no noise."""
LEVELS = (0.98, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.6, 0.5)
"""Torque limits that are tried, as parts of the largest deviation of the engine's torque without one."""
HOPELESS = 0.5
"""Part of the deviance that takes an element on below which what it promises is not worth a fit."""


def _best_promise(
    gram: Array,
    names: Sequence[str],
    begins: Sequence[Mapping[str, float]],
    starts: Sequence[float],
    *,
    falling: bool,
    power: int = 1,
) -> Promise:
    """Judge each start from the products of [-J, e, D1, D2, ...].

    A limit of an effect in proportion to its parameter follows from its estimate and deviation; of one that acts the
    more, the lower it is, it is the highest level that the residual contradicts.
    """
    unknowns = len(names)
    own, residual = slice(0, unknowns), unknowns
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    unit = gram / np.outer(size, size)
    inverse = np.linalg.pinv(unit[own, own], rcond=1e-12, hermitian=True)
    best, begin, limit = 0.0, begins[0], None
    neglects: list[Neglect] = []
    moves: dict[str, float] = {}
    for place, start in enumerate(starts, start=unknowns + 1):
        along = unit[own, place]
        across = (
            (unit[place, residual] - along @ inverse @ unit[own, residual]) * size[place] * size[residual]
        )
        left = (1.0 - along @ inverse @ along) * size[place] ** 2
        if left < 1e-9 * size[place] ** 2 or left <= 0.0:
            continue
        share, deviation = across / left, left**-0.5
        # What the element does along the unknowns, they take over with the other sign.
        taken = (inverse @ along) * size[place] / size[own]
        if falling:
            if left * (1.0 - 2.0 * share) > threshold(1, REJECTED):
                limit = start if limit is None else max(limit, start)
            # Its effect is not in proportion to anything: it is there as a whole, or not.
            fall, part = left * (2.0 * share - 1.0), 1.0
        else:
            fall, part = share * across if share > 0.0 else 0.0, share
        if not falling:
            top = float(start * (max(share, 0.0) + 1.645 * deviation) ** (1.0 / power))
            limit = top if limit is None else max(top, limit)
            shift = dict(zip(names, map(float, taken / start), strict=True))
            if "T_s" in begins[0] and "T_d" in shift:
                shift["T_d"] -= 0.5
            seen = float(share * start**power), float(deviation * start**power)
            neglects.append(Neglect(*seen, shift, power))
        if fall > best:
            best, begin = float(fall), begins[place - unknowns - 1]
            moves = dict(zip(names, map(float, taken * part ** (1.0 / power)), strict=True))
    return Promise(best, begin, limit, tuple(neglects), moves)


def _sampled(
    equations: Equations, values: dict[str, float], experiment: Experiment, begin: Mapping[str, float]
) -> Array:
    """Outputs with a governor that samples, averaged over when it does; half its period is taken off a dead time in the loop."""
    period = begin["T_s"]
    if "T_d" in values:
        values = {**values, "T_d": max(values["T_d"] - 0.5 * period, 0.0)}
    phases = [
        equations.simulate({**values, **begin, "T_0": period * phase / PHASES}, experiment)
        for phase in range(PHASES)
    ]
    return np.asarray(np.mean(phases, axis=0))


def _is_exact(search: Search, minimum: Minimum) -> bool:
    """Whether the residuals are rounding beside every output's spread: a simulation without noise."""
    count, scatter = mean_scatter(minimum.sums)
    spread = np.mean([np.diag(block.scatter) for block in search.blocks], axis=0)
    return bool((np.diag(scatter) < EXACT**2 * spread).all()) and count > 0


def _apart(search: Search, ends: Sequence[Minimum]) -> list[dict[str, float]]:
    """Values at ends that fit nearly as well as the first and lie elsewhere."""
    found: list[dict[str, float]] = []
    delays = [place for place, name in enumerate(search.names) if name in DELAYS]
    seen = [ends[0].vector]
    for end in ends[1:]:
        near = any((np.abs(end.vector - other)[delays] < NEARBY_S).all() for other in seen)
        if end.criterion - ends[0].criterion < NEARLY and not near:
            found.append(dict(zip(search.unknowns, map(float, end.vector), strict=True)))
            seen.append(end.vector)
    return found


def cost(fitted: Fitted | Minimum) -> float:
    """Return the weighted sum of squares of a minimum with given weights."""
    return (fitted.minimum if isinstance(fitted, Fitted) else fitted).criterion


def choose(chooser: Chooser) -> Choice:
    """Take elements on while the deviance falls enough, drop those that it does not miss, and keep what is not rejected."""
    level = threshold(max(len(chooser.candidates), 1))
    ladder: list[Rung] = []
    current = chooser.first()
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
    rivals = [*poorer, *_rivals(chooser, current, gains, level, ladder), *_elsewhere(chooser, current)]
    better = min(rivals, key=cost, default=None)
    if better is not None and cost(better) < _base_cost(current) - SAME:
        # What fits best stands for all; the others stay its rivals.
        rivals = [one for one in rivals if one is not better] + [current]
        current = chooser.refined(better)
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


def _base_cost(current: Fitted) -> float:
    return cost(_base(current))


def _base(fitted: Fitted) -> Fitted:
    """Return a fit as one among its own trials: with the same weights, the same passes, and the sum of squares as its cost."""
    noise = replace(fitted.minimum.noise, sharp=False)
    search = replace(fitted.search, weights=noise, enough=TRIAL_FALL)
    sums = search.sums(fitted.minimum.vector, noise)
    criterion = float(search.gram(fitted.minimum.vector, noise, sums)[-1, -1])
    return Fitted(
        fitted.elements, search, replace(fitted.minimum, noise=noise, criterion=criterion, sums=sums)
    )


def _elsewhere(chooser: Chooser, current: Fitted) -> list[Fitted]:
    """Fits of the same structure that ended elsewhere and are not rejected: the data do not say which it is."""
    least, found = _base_cost(current), []
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
    base = _base(current)
    for name in chooser.candidates:
        if name in current.elements:
            continue
        promise = chooser.promise(base, name)
        gains[name] = Gain(promise.fall, promise.limit, None, promise.neglect)
        if name in UNSEEN or promise.fall < HOPELESS * level:
            ladder.append(Rung(chooser.ordered((*current.elements, name)), -promise.fall, "not promising"))
            continue
        trial = chooser.with_elements(current, (*current.elements, name), promise.start)
        if trial is not None:
            gains[name] = Gain(cost(base) - cost(trial), promise.limit, trial, promise.neglect)
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
        base = _base(current)
        rises: dict[str, float] = {}
        trials: dict[str, Fitted] = {}
        for name in current.elements:
            if name not in chooser.candidates:
                continue
            without = [other for other in current.elements if other != name]
            trial = chooser.with_elements(current, without, worth=cost(base) + 2.0 * level)
            rises[name] = np.inf if trial is None else cost(trial) - cost(base)
            if trial is not None:
                trials[name] = trial
                said = "too poor" if rises[name] > level else "poorer" if rises[name] > limit else "as good"
                ladder.append(Rung(trial.elements, rises[name], said))
        idle = [name for name in trials if rises[name] <= limit and (name not in FIRST or _is_off(current, name))]
        least = min(idle, key=lambda name: rises[name], default=None)
        if least is None:
            return current, rises, [trials[name] for name in trials if rises[name] <= level]
        inside = _inside(chooser, current, least) if least in FIRST else None
        current = chooser.refined(trials[least] if inside is None else inside)


def _inside(chooser: Chooser, current: Fitted, name: str) -> Fitted | None:
    """Return a fit in which a delay that stands on its bound acts, if there is one as good: from others some is taken."""
    own = ELEMENTS[name].parameters[0].name
    values = dict(zip(current.search.unknowns, map(float, current.minimum.vector), strict=True))
    for other in DELAYS:
        if other == own or values.get(other, 0.0) < 1.5 * TAKEN_S:
            continue
        begin = {**values, own: TAKEN_S, other: values[other] - TAKEN_S}
        trial = chooser.with_elements(current, current.elements, begin)
        if trial is not None and cost(trial) < _base_cost(current) - SAME and not _is_off(trial, name):
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
    """Fit neighbours in which an element is swapped for another, and keep them and additions that are not rejected."""
    base = _base(current)
    limit = threshold(1, REJECTED)
    kept = []
    for out in (name for name in current.elements if name in chooser.candidates and name in ALIKE):
        for name in (name for name in gains if name in ALIKE):
            swapped = [*(other for other in current.elements if other != out), name]
            trial = chooser.with_elements(current, swapped, worth=cost(base) + 2.0 * level)
            if trial is None:
                continue
            rise = cost(trial) - cost(base)
            ladder.append(Rung(trial.elements, rise, "as good" if rise < limit else "too poor"))
            if rise < limit:
                kept.append(trial)
    return tuple(kept)
