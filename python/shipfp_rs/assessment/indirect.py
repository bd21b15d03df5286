"""Indirect inference: a structure's estimates led back to the parameters of the plant that it sums up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from shipfp_rs.assessment.ship_parameters import PARAMETERS, parameters_of, with_parameters
from shipfp_rs.errors import IdentificationError, InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.identification.identify import options_of
from shipfp_rs.identification.minima import search_minima
from shipfp_rs.identification.options import Options
from shipfp_rs.identification.outcome import fingerprint_of
from shipfp_rs.identification.verdict import verdict
from shipfp_rs.identification.weighted_problem import Noise
from shipfp_rs.simulation.replay import answered
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.vessel.vessel import Vessel

ROUNDS = 5
CLOSE = 0.2
"""Standard deviations of an estimate within which the simulated ship answers as the measured one does; the binding then
takes it the rest of the way."""
STEP = 2.0
"""Of the differences, in standard deviations of the estimate: over the whole of its interval."""
STEP_OF_A_SHIP = 0.1
"""The same as a part of each parameter, where there is no estimate. What an engine does once a firing makes waves in the
answer to a dead time, of the period of the firings: the slope is meant that is left of them."""


@dataclass(frozen=True)
class Binding:
    """How a structure's estimates move with the parameters of the ship that they are found of.

    Parameters
    ----------
    names
        Parameters.
    ship, found
        Those of a simulated ship, and what the structure finds of it, shape (P,).
    slopes
        Change of the estimate in row i with the ship's parameter in column k, shape (P, P); the unit matrix for a
        structure that is the plant's own.
    """

    names: tuple[str, ...]
    ship: Array
    found: Array
    slopes: Array

    def about(self, fingerprint: Fingerprint) -> Binding:
        """Return the same slopes about the ship that led another inference back."""
        record = fingerprint.settings["indirect"]
        ship, found = (
            np.array([record[key][name] for name in self.names]) for key in ("simulated", "of_the_simulated")
        )
        return replace(self, ship=ship, found=found)

    def ship_of(self, found: Array) -> Array:
        """Return the parameters of the ship of which the structure finds these, to first order."""
        return np.asarray(self.ship + np.linalg.solve(self.slopes, found - self.found))


@checked
def indirect_inference(
    experiments: Experiment | Sequence[Experiment],
    structure: Structure,
    vessel: Vessel,
    *,
    binding: Binding | None = None,
    **options: Any,
) -> Fingerprint:
    """Fit a structure, and take off its estimates what it lacks beside the vessel's own plant.

    A structure without a ship's limits, sampling or curvature finds parameters that are a little off, by the same
    amount in each trial, however long: intervals that tell of noise alone do not hold the truth. Here the vessel is
    simulated with the experiments' set points, in still water, and what the structure lacks beside that answer is taken
    off the data; the parameters sought are those with which the structure, fitted to the rest, moves no more.

    Parameters
    ----------
    experiments
        One or several that are fitted together, each beginning at rest.
    structure
        Linear; what it holds fixed, the vessel is given, too.
    vessel
        The ship, with all elements that act; its parameters that the structure searches for are not used.
    binding
        From `bind`, of a ship much like this one; None: it is taken about the estimates, which costs two simulations
        and fits for each free parameter.
    options
        Of `identify`.

    Returns
    -------
    Fingerprint
        As that of `identify`, its values, standard deviations and intervals led back, its fit and residual tests those
        of the simulated ship. settings["indirect"] holds the estimates of the structure itself, the last simulated ship
        and the structure's estimates of it, and how far these were off, in standard deviations.

    Raises
    ------
    InputError
        For a structure with parameters that a vessel has not, or data that do not tell all the free ones.

    Notes
    -----
    C. Gourieroux, A. Monfort, E. Renault, "Indirect inference", Journal of Applied Econometrics 8 (1993),
    10.1002/jae.3950080507. The simulated ship's residuals e fulfil J'We = 0 with the structure's derivatives J and the
    weights W of e itself. With as many estimates as parameters the covariance is B^-1 C B^-T, of the structure's own C for
    residuals e and the slopes B of the binding.
    """
    # A profile's ends are those of the structure, not of the ship.
    records, chosen = _records(experiments), options_of({"intervals": "symmetric", **options})
    ended = search_minima(records, structure, chosen)
    first = fingerprint_of(ended, vessel=vessel.name)
    simulator = _Simulator(records, structure, vessel, chosen, ended.best.noise)
    names, found = _told(first, structure)
    std = np.sqrt(np.diag(_covariance(first, names)))
    if binding is None:
        binding = _bound(simulator, names, found, STEP * std)
    elif binding.names != names:
        raise InputError(
            f"binding is of {', '.join(binding.names)}, expected one of {', '.join(names)}; take it with bind(...)"
        )
    ship = binding.ship_of(found)
    for _ in range(ROUNDS):
        answer = simulator.answer(names, ship)
        # Fitted to what was measured less what it lacks, the structure leaves what the simulated ship does not explain,
        # and ends off its estimates by as much as this ship is off the measured one.
        rest = fingerprint_of(
            search_minima(
                answer.taken_off(records, structure, first.settings["optimum"]),
                structure.with_start(**dict(zip(names, found.tolist(), strict=True))),
                replace(chosen, starts=1, progress=None),
            ),
            vessel=vessel.name,
        )
        off = _told(rest, structure)[1] - found
        far = float(np.abs(off / np.sqrt(np.diag(_covariance(rest, names)))).max())
        binding = replace(binding, ship=answer.ship, found=found - off)
        ship = binding.ship_of(found)
        if far < CLOSE:
            return _led_back(first, rest, structure, binding, found, std, far)
    raise IdentificationError(
        f"indirect inference: after {ROUNDS} simulated ships the structure's estimates are still {far:.2g} standard "
        "deviations from those of the data; leave out what takes the ship to its limits"
    )


@checked
def bind(
    experiments: Experiment | Sequence[Experiment],
    structure: Structure,
    vessel: Vessel,
    **options: Any,
) -> Binding:
    """Return how a structure's estimates move with a vessel's parameters, about the vessel as it is.

    Parameters
    ----------
    experiments, structure, options
        As for `indirect_inference`; of the experiments only the set points and their gaps count.
    vessel
        The ship.
    """
    simulator = _Simulator(_records(experiments), structure, vessel, options_of(options))
    own = parameters_of(vessel)
    names = tuple(parameter.name for parameter in structure.free)
    values = np.array([own[name] for name in names])
    return _bound(simulator, names, values, STEP_OF_A_SHIP * np.abs(values))


def _records(experiments: Experiment | Sequence[Experiment]) -> tuple[Experiment, ...]:
    return (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)


@dataclass(frozen=True)
class _Simulator:
    """The measured trial again, on a simulated ship, and what the structure makes of it."""

    records: tuple[Experiment, ...]
    structure: Structure
    vessel: Vessel
    options: Options
    weights: Noise | None = None
    """Those of the fit to the data: without noise to weigh by, a fit to a simulated answer would end elsewhere."""

    def answer(self, names: Sequence[str], values: Array) -> _Answer:
        """Simulate a ship near the one asked for."""
        wanted = self._within_bounds(names, values)
        given = {
            parameter.name: parameter.start for parameter in self.structure.parameters if parameter.fixed
        }
        vessel = with_parameters(
            self.vessel, {name: value for name, value in given.items() if name in PARAMETERS} | wanted
        )
        at_the_shaft = self.structure.settings.get("speed") == "propeller"
        own = parameters_of(vessel)
        ship = np.array([own[name] for name in names])
        return _Answer(ship, [answered(vessel, record, at_the_shaft) for record in self.records])

    def estimates(self, names: Sequence[str], values: Array) -> tuple[Array, Array]:
        """Return the parameters of the simulated ship (P,), near those asked for, and their estimates (P,)."""
        answer = self.answer(names, values)
        structure = self.structure.with_start(**self._within_bounds(names, answer.ship))
        options = replace(self.options, starts=1, progress=None)
        search = search_minima(answer.records, structure, options, weights=self.weights)
        return answer.ship, search.best.vector[: len(names)]

    def _within_bounds(self, names: Sequence[str], values: Array) -> dict[str, float]:
        bounds = np.array([(self.structure[name].lower, self.structure[name].upper) for name in names]).T
        return dict(zip(names, np.clip(values, *bounds).tolist(), strict=True))


@dataclass(frozen=True)
class _Answer:
    """A simulated ship's parameters (P,), and what it answered."""

    ship: Array
    records: Sequence[Experiment]

    def taken_off(
        self, measured: Sequence[Experiment], structure: Structure, values: Mapping[str, float]
    ) -> list[Experiment]:
        """Return what was measured less what the structure with these values lacks beside the simulated ship."""
        rest = []
        for record, answer in zip(measured, self.records, strict=True):
            lacking = structure.measured(answer) - structure.equations.simulate(dict(values), record)
            changed = dict(record.signals)
            for output, row in zip(structure.outputs, lacking, strict=True):
                name = structure.signal_for(output, record.signals, record.name)
                changed[name] = record.signals[name] - record.operating_point[name] * row
            rest.append(replace(record, signals=changed))
        return rest


def _told(fingerprint: Fingerprint, structure: Structure) -> tuple[tuple[str, ...], Array]:
    """Names and values of the free parameters."""
    names = tuple(parameter.name for parameter in structure.free)
    missing = [
        name for name in names if name not in fingerprint.covariance["names"] or fingerprint[name].std is None
    ]
    if missing:
        raise InputError(
            f"indirect inference: the data do not tell {', '.join(missing)}; fix them or give them a prior, then try again"
        )
    return names, np.array([fingerprint.settings["optimum"][name] for name in names])


def _covariance(fingerprint: Fingerprint, names: Sequence[str]) -> Array:
    places = [fingerprint.covariance["names"].index(name) for name in names]
    return np.array(fingerprint.covariance["matrix"])[np.ix_(places, places)]


def _bound(simulator: _Simulator, names: tuple[str, ...], values: Array, steps: Array) -> Binding:
    """Differences to either side: what an engine does once a firing makes small waves that one side would follow."""
    ship, found = simulator.estimates(names, values)
    columns = []
    for place, step in enumerate(steps):
        moved = np.zeros_like(values)
        moved[place] = step
        (above, answer_above), (below, answer_below) = (
            simulator.estimates(names, values + side * moved) for side in (1.0, -1.0)
        )
        columns.append((answer_above - answer_below) / (above[place] - below[place]))
    return Binding(names, ship, found, np.array(columns).T)


def _led_back(
    first: Fingerprint,
    rest: Fingerprint,
    structure: Structure,
    binding: Binding,
    found: Array,
    std: Array,
    off: float,
) -> Fingerprint:
    names, back = binding.names, np.linalg.inv(binding.slopes)
    covariance = back @ _covariance(rest, names) @ back.T
    parameters = dict(rest.parameters)
    for name, value, deviation in zip(
        names, binding.ship_of(found).tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True
    ):
        own = rest.parameters[name]
        reach = deviation * _quantile(own)
        parameters[name] = Estimate(value, deviation, (value - reach, value + reach), own.unit, own.status)
    alone = ", ".join(f"{name} {value:.4g}" for name, value in zip(names, found.tolist(), strict=True))
    rows = {
        "of_the_structure": found,
        "std_of_the_structure": std,
        "simulated": binding.ship,
        "of_the_simulated": binding.found,
    }
    record = {key: dict(zip(names, row.tolist(), strict=True)) for key, row in rows.items()} | {"off": off}
    return replace(
        rest,
        parameters=parameters,
        derived={},
        covariance={"names": list(names), "matrix": covariance.tolist()},
        verdict=(
            f"Led back to the ship by simulating it; the structure alone finds {alone}.",
            *verdict(
                parameters,
                {},
                rest.identifiability,
                rest.fit,
                replace(structure, name=f"simulated {rest.vessel}"),
                any_colour=rest.settings["covariance"] == "sandwich",
            ),
        ),
        settings={**first.settings, "indirect": record},
    )


def _quantile(estimate: Estimate) -> float:
    """Standard deviations to the end of an interval, on the side that no bound cuts."""
    if estimate.value is None or estimate.std is None or estimate.ci95 is None:
        return 1.96
    low, high = estimate.ci95
    return max(estimate.value - low, high - estimate.value) / estimate.std
