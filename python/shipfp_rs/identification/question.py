"""The question of a fit: its outputs, parameters, tried elements, fixed values, priors and search options."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.coordinates import Coordinates
from shipfp_rs.identification.input_checks import is_loaded, set_point_moves
from shipfp_rs.identification.likelihood import ACCURACY, Likelihood
from shipfp_rs.identification.limited_ship import LimitedShip
from shipfp_rs.identification.sampling import Between
from shipfp_rs.identification.ship_model import ShipModel, unknowns_of
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.structures.elements import ABSENT, ELEMENTS, LATE_CHANNELS, QUANTITIES
from shipfp_rs.structures.parameter import BRAKE, Torque
from shipfp_rs.structures.ship import ShipEquations, rate_limited
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array

NoiseModel = Literal["coloured", "white", "std"]
Intervals = Literal["profile", "symmetric"]
MOST_STARTS = 10_000
"""Largest number of starts of a search; each takes about a second."""


@dataclass(frozen=True)
class Options:
    """Options of a search; see `identify`."""

    noise: NoiseModel | None = None
    intervals: Intervals = "profile"
    starts: int | None = None
    seed: int | None = 0
    time_limit_s: float | None = None
    at_rest: bool = False
    """Whether records were simulated from a steady state, without initial state, offset or gauge error."""

    def starts_for(self, structure: Structure) -> int:
        """Return the number of starts: as given, or 5 where a dead time is free (the cost then has several minima), or 1."""
        if self.starts is not None:
            return self.starts
        # In open loop, regressions over a grid of dead times give further starts.
        if structure.settings["kind"] == "commanded":
            return 1
        return 5 if any(parameter.name in ("T_d", "T_set") for parameter in structure.free) else 1

    def require(self) -> None:
        """Raise `InputError` for an unknown value."""
        if self.noise is not None:
            _require_one_of("noise", self.noise, NoiseModel)
        _require_one_of("intervals", self.intervals, Intervals)
        if self.starts is not None and not 1 <= self.starts <= MOST_STARTS:
            raise InputError(f"starts is {self.starts}, expected 1 to {MOST_STARTS}")


def _require_one_of(name: str, found: str, known: Any) -> None:
    if found not in get_args(known):
        raise InputError(f"{name} {found!r}, expected one of {', '.join(get_args(known))}")


PRIORS = {one.name: one.prior for one in QUANTITIES.values() if one.prior is not None}
"""Prior mean and standard deviation of parameters and combinations; all ships are near these means."""
OF_LOADED: Mapping[str, tuple[float, float]] = {"p": (0.5, 0.5), "g": (-0.5, 0.7)}
"""Priors with a measured load: p then describes the shaft's losses, from about 0 to 1, and g an engine at constant fuel."""
REACH = 4.0
"""Distance of a search bound from a prior's mean, in the prior's standard deviations."""


def within_reach(bounds: tuple[float, float], prior: tuple[float, float] | None) -> tuple[float, float]:
    """Return search bounds near a prior; beyond them a parameter would compensate for an effect that the model lacks."""
    if prior is None:
        return bounds
    return max(bounds[0], prior[0] - REACH * prior[1]), min(bounds[1], prior[0] + REACH * prior[1])


BEHIND_SHAFT = {"tau_prop/tau_n": (0.4, 0.12)}
"""Prior of the share of the inertia behind a flexible shaft, for data with the engine's torque."""
SIGNALS: Mapping[str, Torque] = {"M_b": "brake", "M_s": "brake", "M_g": "gauge"}
"""Torque signals, best first, with the location of their sensor."""
BOUNDS: Mapping[str, tuple[float, float]] = {one.name: (one.lower, one.upper) for one in QUANTITIES.values()}
"""Search bounds of parameters, the same as those that structures declare."""
OF_SIGNALS: Mapping[str, str] = {
    "n_e": "dn",
    "n_s": "dn",
    **dict.fromkeys(SIGNALS, "dM"),
    "X_f": "dX",
    "E_n": "dE",
}
"""Outputs by the names of their signals."""
TRIED: Mapping[str, tuple[str, ...]] = {
    "torque_limit": ("M_max", "M_soft"),
    "rack_rate": ("rate",),
    "set_rate": ("set_rate",),
    "droop": ("droop",),
}
"""Elements that are tried, with the parameters of each element. Limits are tried because they have no value without effect;
a droop is tried because, if always fitted, it would widen the intervals of the many ships without droop."""


@dataclass(frozen=True)
class Question:
    """The task of a fit of a ship: data, compared outputs, searched parameters and tried elements."""

    experiments: tuple[Experiment, ...]
    outputs: tuple[str, ...]
    gauge: bool  # whether the torque is measured by a gauge between the inertias
    signals: Mapping[str, str]
    always: tuple[str, ...]  # parameters that are always searched
    tried: tuple[str, ...]  # elements that are tried
    fixed: Mapping[str, float] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    accuracy: Mapping[str, float] = field(default_factory=dict)  # of gauge and calibration [-]
    loaded: bool = False  # whether a measured load drives the ship, too
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=lambda: BOUNDS)
    structure: Structure | None = None  # the given structure; None: the full ship
    propeller: bool = False  # whether the speed is measured on the propeller's side of the flexible shaft
    assumed: tuple[str, ...] = ()  # fixed parameters that were neither given nor estimated
    options: Options = field(default_factory=Options)

    def __post_init__(self) -> None:
        for name in (
            "tau_n",
            "v",
            *(limit for limit in ("M_max", "rate", "set_rate") if limit in self.always),
        ):
            if self.fixed.get(name, 1.0) <= 0.0:
                raise InputError(f"parameter {name}: fixed at {self.fixed[name]:g}, expected more than 0")
        for one in self.experiments:
            for output in self.outputs:
                name = self.signal_in(one, output)
                if not np.isfinite(one.signals[name]).any():
                    raise InputError(
                        f"experiment {one.name!r}: every sample of {name} is masked, expected some; leave the output out"
                    )

    def signal_in(self, experiment: Experiment, output: str) -> str:
        """Return the name of an output's signal in an experiment."""
        if self.structure is None:
            return self.signals[output]
        return self.structure.signal_for(output, experiment.signals, experiment.name)

    def _accuracy(self, output: str) -> float:
        """Accuracy of an output: the given one, else the largest of the experiments, each with a default."""
        said = [one.gauge_accuracy.get(self.signal_in(one, output), ACCURACY) for one in self.experiments]
        return self.accuracy.get(output, max(said))

    def _measured(self, experiment: Experiment) -> Array:
        return np.array(
            [experiment.normalised(self.signal_in(experiment, output)) for output in self.outputs]
        )

    def coordinates(self, elements: Sequence[str], unknowns: tuple[str, ...]) -> Coordinates:
        """Return the search coordinates: parameters with these tried elements, and the unknowns of each record."""
        names = [*self.always, *(name for element in elements for name in TRIED[element])]
        priors = self._priors(names)
        free = {
            name: self.bounds[name]
            if name in self.priors
            else within_reach(self.bounds[name], priors.get(name))
            for name in names
            if name not in self.fixed
        }
        given = {**dict.fromkeys(ABSENT, 0.0), "p": 2.0, **self.fixed}
        given = {name: value for name, value in given.items() if name not in free}
        return Coordinates(free, given, (unknowns,) * len(self.experiments))

    def _priors(self, free: Container[str]) -> dict[str, tuple[float, float]]:
        own = self.structure is None
        every = {
            **PRIORS,
            **(OF_LOADED if self.loaded and own else {}),
            **(BEHIND_SHAFT if not self.gauge and own else {}),
            **self.priors,
        }
        late = max((apart_s(one, self.signals.values()) for one in self.experiments), default=0.0)
        every |= {
            name: (every[name][0], float(np.hypot(every[name][1], late)))
            for name in LATE_CHANNELS
            if name not in self.priors
        }
        return {
            name: prior
            for name, prior in every.items()
            if all(one in free for one in name.replace("-", "/").split("/"))
        }

    def likelihood(self, between: Between | None = None) -> Likelihood:
        """Return the likelihood of the ship without tried elements; `between`: see `Spectra.of`."""
        equations = ShipEquations(
            self.outputs, self.gauge, self.propeller, loaded=self.loaded, mean_sampling=True
        )
        unknowns = unknowns_of(equations)
        coordinates = self.coordinates((), unknowns)
        records = [
            Spectra.of(one, self.outputs, self._measured(one), load=self.loaded, between=between)
            for one in self.experiments
        ]
        smooth = Likelihood(
            models=tuple(
                ShipModel(record=self._behind_ramp(record), unknowns=unknowns, equations=equations)
                for record in records
            ),
            coordinates=coordinates,
            accuracy=np.array([self._accuracy(output) for output in self.outputs]),
            priors=self._priors(coordinates.free),
        )
        return self.with_elements(smooth, ())

    def _behind_ramp(self, record: Spectra) -> Spectra:
        """Return a record with its set point's rate limited, if a limit is fixed."""
        rate = self.fixed.get("set_rate")
        if rate is None:
            return record
        return record.with_set_point(rate_limited(record.set_point, rate, record.data_hz))

    def with_elements(self, likelihood: Likelihood, elements: Sequence[str]) -> Likelihood:
        """Return the likelihood of the same records with the given tried elements."""
        coordinates = self.coordinates(elements, likelihood.models[0].unknowns)
        models = likelihood.models
        if {"M_max", "rate"} & {*coordinates.free, *coordinates.given} and not likelihood.limited:
            models = tuple(
                LimitedShip(**{one.name: getattr(model, one.name) for one in fields(ShipModel)})
                for model in models
            )
        return replace(
            likelihood, models=models, coordinates=coordinates, priors=self._priors(coordinates.free)
        )


def question_of(
    experiments: Sequence[Experiment],
    *,
    torque: Torque | None = None,
    outputs: Sequence[str] | None = None,
    elements: Mapping[str, bool] | None = None,
    fixed: Mapping[str, float] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    accuracy: Mapping[str, float] | None = None,
    options: Options | None = None,
) -> Question:
    """Return the question of the full ship with the outputs that all experiments measured; arguments as in `identify`."""
    elements, known = dict(elements or {}), dict(fixed or {})
    for name in elements:
        if name not in ELEMENTS:
            raise InputError(f"elements: no {name!r}, expected some of {', '.join(ELEMENTS)}")
    _require_parameters({"fixed": known, "priors": priors or {}})
    _require_values(known, priors or {})
    # A tried element whose parameter is fixed is part of the ship.
    elements = {name: True for name, own in TRIED.items() if not known.keys().isdisjoint(own)} | elements
    common = set.intersection(*(set(one.signals) for one in experiments))
    speed = next((name for name in ("n_e", "n_s") if name in common), None)
    if speed is None:
        raise InputError("identify: no experiment has a speed, expected the signal n_e or n_s")
    place, outputs, signals = _compared(outputs, torque, common, speed)
    _require_outputs(outputs, signals, common)
    gauge = place == "gauge" and "dM" in outputs
    loaded = is_loaded(experiments) and elements.get("load", True)
    beside = ["v"] if "dX" in outputs else []
    always = ["tau_n", "g", *beside, "vK_p", "vK_i", "p", *(["tau_prop"] if gauge else [])]
    elements.setdefault("late_brake", BRAKE in outputs)
    assumed = ("k_L",) if loaded and "dM" not in outputs and "k_L" not in known else ()
    if "dM" not in outputs:
        # Only speed and torque together reveal a late torque channel or a flexible shaft.
        elements |= {"late_torque": False, "twist": False}
        # The speed alone determines ratios to the inertia; with a measured load it determines the inertia.
        known = {"tau_n": 1.0, "p": 2.0, **known} if not loaded else {"k_L": 1.0, **known}
        elements.setdefault("curvature", False)
    if loaded:
        elements["load"] = True
        if not set_point_moves(experiments):
            # The ratio of torque to speed depends on a single dead time only.
            elements = {"dead_time_set_point": False} | elements
    for name, element in ELEMENTS.items():
        if elements.get(name, element.always):
            always += [one.name for one in element.parameters if one.name not in always and one.name != "T_0"]
    if known.get("T_d") == 0.0:
        known.setdefault("T_s", 0.0)  # the sampling period is part of the dead time
    if known.get("tau_twist") == 0.0:
        always = [name for name in always if name != "zeta_twist"]
    elif "tau_twist" in always and "tau_prop" not in always:
        always.append("tau_prop")
    tried = tuple(name for name in TRIED if name not in elements)
    return Question(
        experiments=tuple(experiments),
        outputs=tuple(outputs),
        gauge=gauge,
        signals=signals,
        always=tuple(always),
        tried=tried,
        fixed=known,
        priors=dict(priors or {}),
        accuracy=dict(accuracy or {}),
        loaded=loaded,
        propeller="tau_twist" in always and all(one.speed_side == "propeller" for one in experiments),
        assumed=assumed,
        options=options or Options(),
    )


def is_ship(structure: Structure) -> bool:
    """Whether the ship's search supports a structure, which may have no other equations, ties or parameters."""
    equations, names = structure.equations, {parameter.name for parameter in structure.parameters}
    return (
        structure.settings["kind"] == "ship"
        and isinstance(equations, ShipEquations)
        and not equations.envelope
        and ("T_s" not in names or equations.mean_sampling)
        and not set(structure.outputs) - set(_core.EQUATION_OUTPUTS)
        and not {"K_p", "K_i", "K_d"} & {parameter.name for parameter in structure.free}
        and "dn" in structure.outputs
        and names <= BOUNDS.keys()
        and bool(structure.free)
        and not structure.ties
    )


def question_of_ship(
    experiments: Sequence[Experiment], structure: Structure, options: Options | None = None
) -> Question:
    """Return the question of a given structure with a ship's equations (see `is_ship`)."""
    equations = structure.equations
    assert isinstance(equations, ShipEquations)
    names = {parameter.name: parameter for parameter in structure.parameters}
    fixed = {name: one.start for name, one in names.items() if one.fixed}
    if "M_soft" in fixed:
        fixed["M_soft"] = max(fixed["M_soft"], BOUNDS["M_soft"][0])
    first = experiments[0]
    signals = {
        output: structure.signal_for(output, first.signals, first.name) for output in structure.outputs
    }
    return Question(
        experiments=tuple(experiments),
        outputs=structure.outputs,
        gauge=equations.gauge,
        signals=signals,
        always=tuple(parameter.name for parameter in structure.free),
        tried=(),
        fixed=fixed,
        priors={name: one.prior for name, one in names.items() if one.prior is not None},
        loaded=equations.loaded,
        bounds={name: (one.lower, one.upper) for name, one in names.items()},
        structure=structure,
        propeller=equations.propeller_speed and "tau_twist" in names,
        options=options or Options(),
    )


def apart_s(experiment: Experiment, signals: Iterable[str]) -> float:
    """Standard deviation [s] of the delay between a log's channels, uniform within half a sample of the slowest one."""
    recorded = experiment.provenance.get("recorded") or {}
    rates = [float(one["rate_hz"]) for one in recorded.values() if one.get("signal") in set(signals)]
    return 1.0 / (min(rates, default=math.inf) * math.sqrt(12.0))


def _require_parameters(tables: Mapping[str, Mapping[str, object]]) -> None:
    for table, names in tables.items():
        for name in names:
            if name not in BOUNDS:
                raise InputError(f"{table}: no parameter {name!r}, expected some of {', '.join(BOUNDS)}")


def _require_values(fixed: Mapping[str, float], priors: Mapping[str, tuple[float, float]]) -> None:
    for table, values in (("fixed", fixed), ("priors", {name: mean for name, (mean, _) in priors.items()})):
        for name, value in values.items():
            low, high = BOUNDS[name]
            if not (low <= value <= high or value == 0.0):  # zero switches most parameters off
                raise InputError(f"{table}.{name}: found {value:g}, expected {low:g} to {high:g}")
    for name, (_, std) in priors.items():
        if not std > 0.0:
            raise InputError(f"priors.{name}: found a standard deviation of {std:g}, expected more than 0")


def _compared(
    outputs: Sequence[str] | None, torque: Torque | None, common: set[str], speed: str
) -> tuple[Torque, list[str], dict[str, str]]:
    """Location of the torque sensor, compared outputs, and signals of the outputs."""
    sides: dict[str, str] = {side: name for name, side in reversed(list(SIGNALS.items())) if name in common}
    first = next((name for name in SIGNALS if name in common), "")
    both = outputs is not None and _are_both_torques(outputs)
    named = [SIGNALS[output] for output in (*(outputs or ()), first) if output in SIGNALS]
    place: Torque = torque or ("gauge" if both else [*named, SIGNALS["M_b"]][0])
    chosen = sides.get(place, first)
    of_signals = {**OF_SIGNALS, **(dict.fromkeys(("M_b", "M_s"), BRAKE) if both else {})}
    measured = ["dn", *(["dM"] if chosen else []), *(["dX"] if "X_f" in common else [])]
    found = measured if outputs is None else [of_signals.get(output, output) for output in outputs]
    signals = {"dn": speed, "dM": chosen, "dX": "X_f", "dE": "E_n", BRAKE: sides.get("brake", "M_b")}
    return place, found, signals


def _are_both_torques(outputs: Sequence[str]) -> bool:
    """Whether both the brake's and a gauge's torque are compared."""
    asked = set(outputs)
    return BRAKE in asked or (bool({"dM", "M_g"} & asked) and bool({"M_b", "M_s"} & asked))


def _require_outputs(outputs: Sequence[str], signals: Mapping[str, str], common: Container[str]) -> None:
    for output in outputs:
        if output not in signals:
            raise InputError(f"outputs: no {output!r}, expected some of {', '.join(signals)}")
        if signals[output] not in common:
            raise InputError(f"outputs: {output!r} was not measured in every experiment")
        if output not in _core.EQUATION_OUTPUTS:
            raise InputError(
                f"outputs: {output!r} follows from 'dn', expected some of dn, dM, dX, dM_b; or give a structure"
            )
    if BRAKE in outputs and ("dM" not in outputs or signals["dM"] != "M_g"):
        raise InputError(
            "outputs: the brake's torque 'dM_b' stands beside a gauge's, expected the signal M_g, too"
        )
    if "dn" not in outputs:
        raise InputError(
            "outputs: no 'dn', expected the speed among them: the loop cannot be identified without it"
        )
