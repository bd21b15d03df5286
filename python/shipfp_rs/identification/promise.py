"""What an element promises beside a fit without it, by a score test, and what leaving it out does to the estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.sampling import held
from shipfp_rs.identification.weighted_problem import Minimum, WeightedProblem
from shipfp_rs.identification.whitening import Evaluation
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.ship import TORQUE_SCALE, ShipEquations
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import bare
from shipfp_rs.support.arrays import Array

FALSE_ALARM = 0.01
"""Probability that any element is taken on that does not act, if the model is right otherwise."""
REJECTED = 0.05
"""Probability below which an alternative structure is rejected: its intervals then do not count."""
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
BESIDE: Mapping[str, tuple[dict[str, float], ...]] = {
    "twist": ({"zeta_twist": 0.2}, {"zeta_twist": 1.5}),
    "sampling": ({"update": 0.0}, {"update": 1.0}),
}
"""Where an element's other parameters start, each with all starts of the first one."""
SMALL = 0.1
"""Part of an element's start by which its effect is judged to first order."""
LEVELS = (0.98, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.6, 0.5)
"""Torque limits that are tried, as parts of the largest deviation of the engine's torque without one."""
PHASES = 4
"""Times within a sampling period at which the governor may sample, over which its effect is averaged."""
DELAYED: Mapping[str, float] = {"sampling": 0.5, "actuator_lag": 1.0}
"""Part of an element's time that a dead time in the loop makes up for: beside one only the rest shows, to second order."""
SHORTEST_TAKEN_S = 1e-3
"""Dead time below which nothing is taken from it to make up for another element [s]."""
PROPELLER_PART = 0.3
"""Part of the inertia that is taken to be the propeller's where no torque between the two tells it."""


@dataclass(frozen=True)
class Promise:
    """What an element promises: the fall of the deviance, from which start, and how strongly it may act at 95 %."""

    fall: float
    start: Mapping[str, float]
    limit: float | None
    neglect: tuple[Neglect, ...] = ()


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


def threshold(candidates: int, probability: float = FALSE_ALARM) -> float:
    """Return the fall of the deviance that takes an element on.

    An element that is off stands on a bound, so half of its chance is at zero (Chernoff 1954, Self and Liang 1987); the
    probability is shared among the candidates (Bonferroni).
    """
    return float(chi2.isf(2.0 * probability / candidates, 1))


def promise(name: str, search: WeightedProblem, minimum: Minimum, made: Structure) -> Promise:
    """Return what an element promises beside a fit; `made` is the structure with it.

    Rao's score test: of the change D of the outputs that a little of the element makes, cleared of what the fit's own
    unknowns explain, the residual e explains (D'e)^2 / D'D. Elements that would have to act the other way promise
    nothing. D is the change that a whole start makes where a little of it tells nothing: of a torque limit, and of an
    element for which a dead time makes up.
    """
    structure = replace(search.structure, equations=search.structure.equations.rough())
    made = replace(made, equations=made.equations.rough())
    blocks = tuple(replace(block, structure=structure) for block in search.blocks)
    search = replace(search, structure=structure, blocks=blocks)
    main = ELEMENTS[name].parameters[0]
    firsts = _levels(search, minimum) if name == "torque_limit" else STARTS.get(main.name, (main.start,))
    begins = [{main.name: start, **beside} for beside in BESIDE.get(name, ({},)) for start in firsts]
    found = search.values(minimum.vector)
    dead, share = found.get("T_d", 0.0), DELAYED.get(name, 0.0)
    taken = share > 0.0 and "T_d" in search.names and dead > SHORTEST_TAKEN_S
    if taken:
        # What is judged to second order, in each way that the element may act, the dead time makes up for in full.
        least = min(firsts[0], dead / share)
        times = [least if begin[main.name] == firsts[0] else begin[main.name] for begin in begins]
        begins = [
            {**begin, main.name: time, "T_d": max(dead - share * time, 0.0)}
            for begin, time in zip(begins, times, strict=True)
        ]
    others = {parameter.name: parameter.start for parameter in made.parameters}
    others["tau_prop"] = PROPELLER_PART * found["tau_n"]
    # A limit cuts off the stairs of a governor that samples, of which the records were cleared.
    stairs = name == "torque_limit" and made.settings["mean_sampling"]
    gram = np.zeros((search.size + 1 + len(begins),) * 2)
    parts = search.parts(search.filtered(minimum.vector, minimum.noise), minimum.noise)
    for place, ((block, values), part) in enumerate(zip(search.each(minimum.vector), parts, strict=True)):
        experiment = block.data
        assert isinstance(experiment, Experiment)
        still = search.structure.equations.simulate(values, experiment)
        if stairs:
            still = still + held(search.structure.equations, values, experiment, PHASES)
        changes = np.zeros((len(begins), *still.shape))
        for change, begin in zip(changes, begins, strict=True):
            try:
                if name == "sampling":
                    change[:] = _sampled(made.equations, values, experiment, begin) - still
                elif taken or name == "torque_limit":
                    full = {**others, **values, **begin}
                    change[:] = made.equations.simulate(full, experiment) - still
                    if stairs:
                        change += held(made.equations, full, experiment, PHASES)
                else:
                    # A small step: the effect of a large one is not in proportion to it, and other parameters could hide it.
                    full = {**others, **values, **begin, main.name: SMALL * begin[main.name]}
                    change[:] = (made.equations.simulate(full, experiment) - still) / SMALL
            except SimulationError:
                continue
        changed = Evaluation(np.zeros_like(still), changes * block.valid, block.valid)
        if whitening := minimum.noise.of(place):
            changed = whitening(changed)
        rows = np.concatenate([part, minimum.noise.root @ changed.jacobian])
        flat = rows.reshape(len(rows), -1)
        gram += flat @ flat.T
    starts = tuple(begin[main.name] for begin in begins)
    made_up = share if taken else None
    return _best_promise(
        gram, search.unknowns, begins, starts, falling=name == "torque_limit", made_up=made_up
    )


def _levels(search: WeightedProblem, minimum: Minimum) -> tuple[float, ...]:
    """Levels of a torque limit below the top of what the engine gives in the fit without one."""
    top = -np.inf
    for block, values in search.each(minimum.vector):
        assert isinstance(block.data, Experiment)
        top = max(top, float(np.max(_engine_torque(search.structure, values, block.data))))
    return tuple(1.0 + share * top for share in LEVELS)


def _engine_torque(structure: Structure, values: Mapping[str, float], experiment: Experiment) -> Array:
    """Deviation of the engine's own torque, shape (N,)."""
    equations = bare(structure.equations)
    assert isinstance(equations, ShipEquations)
    engine = replace(equations, outputs=("dM",), gauge=False)
    return np.asarray(engine.simulate({**values, TORQUE_SCALE: 0.0}, experiment)[0])


def _best_promise(
    gram: Array,
    names: Sequence[str],
    begins: Sequence[Mapping[str, float]],
    starts: Sequence[float],
    *,
    falling: bool,
    made_up: float | None = None,
) -> Promise:
    """Judge each start from the products of [-J, e, D1, D2, ...]; of `made_up` times its time a dead time makes up.

    A limit of an effect in proportion to its parameter follows from its estimate and deviation; of one that acts the
    more, the lower it is, it is the highest level that the residual contradicts.
    """
    unknowns = len(names)
    own, residual = slice(0, unknowns), unknowns
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    unit = gram / np.outer(size, size)
    inverse = np.linalg.pinv(unit[own, own], rcond=1e-12, hermitian=True)
    power = 1 if made_up is None else 2
    best, begin, limit = -np.inf, begins[0], None
    neglects: list[Neglect] = []
    for place, start in enumerate(starts, start=unknowns + 1):
        along = unit[own, place]
        across = (
            (unit[place, residual] - along @ inverse @ unit[own, residual]) * size[place] * size[residual]
        )
        left = (1.0 - along @ inverse @ along) * size[place] ** 2
        if gram[place, place] <= 0.0 or left < 1e-9 * size[place] ** 2:
            continue
        share, deviation = across / left, left**-0.5
        # What the element does along the unknowns, they take over with the other sign.
        taken = (inverse @ along) * size[place] / size[own]
        if falling:
            if left * (1.0 - 2.0 * share) > threshold(1, REJECTED):
                limit = start if limit is None else max(limit, start)
            # This element has no size: its effect is there as a whole, or not at all.
            fall = left * (2.0 * share - 1.0)
        else:
            fall = share * across if share > 0.0 else 0.0
        if not falling and start == starts[0]:
            # The least start is where what is seen grows in proportion.
            top = float(start * (max(share, 0.0) + 1.645 * deviation) ** (1.0 / power))
            limit = top if limit is None else max(top, limit)
            shift = dict(zip(names, map(float, taken / start), strict=True))
            shift["T_d"] = shift.get("T_d", 0.0) - (made_up or 0.0)
            seen = float(share * start**power), float(deviation * start**power)
            neglects.append(Neglect(*seen, shift, power))
        if fall > best:
            best, begin = float(fall), begins[place - unknowns - 1]
    return Promise(max(best, 0.0), begin, limit, tuple(neglects))


def _sampled(
    equations: Equations, values: dict[str, float], experiment: Experiment, begin: Mapping[str, float]
) -> Array:
    """Outputs with a governor that samples, averaged over the instants of its first sample within a period."""
    period = begin["T_s"]
    phases = [
        equations.simulate({**values, **begin, "T_0": period * phase / PHASES}, experiment)
        for phase in range(PHASES)
    ]
    return np.asarray(np.mean(phases, axis=0))
