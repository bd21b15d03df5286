"""Indirect inference: a structure's estimates led back to the parameters of the plant that it sums up."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_interp_spline

from shipfp_rs.errors import IdentificationError, InputError
from shipfp_rs.experiment import Experiment
from shipfp_rs.fingerprint import Estimate, Fingerprint
from shipfp_rs.identification import Options, fingerprint_of, search_minima
from shipfp_rs.linear_model import linearise
from shipfp_rs.log import Channel
from shipfp_rs.low_pass import LowPass
from shipfp_rs.signals import Excitation
from shipfp_rs.simulation import simulate
from shipfp_rs.solver import Noise
from shipfp_rs.structure import Structure
from shipfp_rs.truth import true_values
from shipfp_rs.verdict import verdict
from shipfp_rs.vessel import Vessel

Array = npt.NDArray[np.float64]

LEAST_RATE_HZ = 100.0
"""A set point of a lower rate is brought above it, so that its curves stay what they were."""
LEAD_S = 10.0
"""For which the simulated ship stands at the operating point: the filters fill, and its mean is what it stands at."""
ROUNDS = 5
CLOSE = 0.2
"""Standard deviations of an estimate within which the simulated ship answers as the measured one does; the binding then
takes it the rest of the way."""
STEP = 1.0
"""Of the differences, in standard deviations of the estimate."""
STEP_OF_A_SHIP = 0.02
"""The same as a part of each parameter, where there is no estimate."""


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
    simulated with the experiments' set points, in still water, and the same structure is fitted to that; the
    parameters sought are those with which the simulated ship yields the very estimates that the measured one does.

    Parameters
    ----------
    experiments
        One or several that are fitted together, each beginning at rest.
    structure
        Linear; what it holds fixed, the vessel is given, too.
    vessel
        The ship, with all elements that act; its parameters that the structure searches for are not used.
    binding
        From `bind`, of a ship much like this one; None: it is taken about the estimates, which costs a simulation and a
        fit for each free parameter.
    options
        Of `identify`.

    Returns
    -------
    Fingerprint
        As that of `identify`, its values, standard deviations and intervals led back. settings["indirect"] holds the
        estimates of the structure itself, the last simulated ship and the structure's estimates of it, and how far
        these were off, in standard deviations.

    Raises
    ------
    InputError
        For a structure with parameters that a vessel has not, or data that do not tell all the free ones.

    Notes
    -----
    C. Gourieroux, A. Monfort, E. Renault, "Indirect inference", Journal of Applied Econometrics 8 (1993),
    10.1002/jae.3950080507. With as many estimates as parameters the covariance is B^-1 C B^-T, of the structure's own
    C and the slopes B of the binding.
    """
    records, chosen = _records(experiments), Options.of(options)
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
    for _ in range(ROUNDS):
        at, answer = simulator.estimates(names, binding.ship_of(found))
        binding = replace(binding, ship=at, found=answer)
        off = float(np.abs((found - answer) / std).max())
        if off < CLOSE:
            break
    else:
        raise IdentificationError(
            f"indirect inference: after {ROUNDS} simulated ships the structure's estimates are still {off:.2g} standard "
            "deviations from those of the data; leave out what takes the ship to its limits"
        )
    return _led_back(first, structure, binding, found, std, off)


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
    simulator = _Simulator(_records(experiments), structure, vessel, Options.of(options))
    own = parameters_of(vessel)
    names = tuple(parameter.name for parameter in structure.free)
    values = np.array([own[name] for name in names])
    return _bound(simulator, names, values, STEP_OF_A_SHIP * np.abs(values))


def _records(experiments: Experiment | Sequence[Experiment]) -> tuple[Experiment, ...]:
    return (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)


def parameters_of(vessel: Vessel) -> dict[str, float]:
    """Return a vessel's linear parameters at its operating point, the actuator's lag and the shaft's twist apart."""
    model = dict(vars(linearise(vessel)))
    lag, stiffness = vessel.actuator.lag_s, vessel.shaft.stiffness_Nm_rad
    twist = (
        0.0
        if stiffness is None
        else _shaft_torque(vessel) / (2.0 * math.pi * vessel.nominal_shaft_speed * stiffness)
    )
    return true_values(model | {"T_d": model["T_d"] - lag}) | {"tau_act": lag, "tau_twist": twist}


def with_parameters(vessel: Vessel, values: Mapping[str, float]) -> Vessel:
    """Return a vessel whose linear parameters at its operating point are those given; the others stay.

    A dead time in the loop shorter than what sampling, firing and computing take leaves the actuator's at zero.

    Parameters
    ----------
    vessel
        The ship.
    values
        Some of tau_n, tau_prop, g, v, K_p, K_i (or vK_p, vK_i), p, T_d, T_set, tau_act, tau_twist.

    Raises
    ------
    InputError
        For another name, or a ship that can't be.
    """
    if unknown := sorted(set(values) - PARAMETERS):
        raise InputError(
            f"found parameters {', '.join(unknown)}, expected some of {', '.join(sorted(PARAMETERS))}"
        )
    # Torque, drag and inertia of the water depend on each other a little: four times round and they agree.
    for _ in range(4):
        vessel = vessel.replace(_changes(vessel, values))
    return vessel


PARAMETERS = frozenset(
    ("tau_n", "tau_prop", "g", "v", "K_p", "K_i", "vK_p", "vK_i", "p", "T_d", "T_set", "tau_act", "tau_twist")
)


def _changes(vessel: Vessel, values: Mapping[str, float]) -> dict[str, float]:
    own = parameters_of(vessel)
    per_time_constant = _shaft_torque(vessel) / (2.0 * math.pi * vessel.nominal_shaft_speed)
    gains = {f"K_{k}": values[f"vK_{k}"] / own["v"] for k in ("p", "i") if f"vK_{k}" in values}
    wanted = {**values, **gains}
    more = {name: wanted[name] - own[name] for name in wanted if name in own}
    places = {
        "tau_n": ("shaft.inertia_kg_m2", vessel.shaft.inertia_kg_m2, per_time_constant),
        "tau_prop": (
            "shaft.propeller_side_inertia_kg_m2",
            vessel.shaft.propeller_side_inertia_kg_m2,
            per_time_constant,
        ),
        "g": ("operating_point.g", vessel.operating_point.g, 1.0),
        "v": ("operating_point.v", vessel.operating_point.v, 1.0),
        "K_p": ("governor.K_p", vessel.governor.K_p, 1.0),
        "K_i": ("governor.K_i", vessel.governor.K_i, 1.0),
        "p": ("propeller.torque_exponent", vessel.propeller.torque_exponent, 1.0),
        "T_set": ("governor.set_point_dead_time_s", vessel.governor.set_point_dead_time_s, 1.0),
        "tau_act": ("actuator.lag_s", vessel.actuator.lag_s, 1.0),
    }
    changes = {}
    for name, (key, present, unit) in places.items():
        if name in more:
            changes[key] = float(present or 0.0) + unit * more[name]
    if "T_d" in more:
        changes["actuator.dead_time_s"] = max(0.0, vessel.actuator.dead_time_s + more["T_d"])
    if "tau_twist" in more and values["tau_twist"] > 0.0:
        changes["shaft.stiffness_Nm_rad"] = per_time_constant / values["tau_twist"]
    return changes


def _shaft_torque(vessel: Vessel) -> float:
    return float(vessel.torque_coefficient * vessel.nominal_shaft_speed**vessel.propeller.torque_exponent)


@dataclass(frozen=True)
class _Simulator:
    """The measured trial again, on a simulated ship, and what the structure makes of it."""

    records: tuple[Experiment, ...]
    structure: Structure
    vessel: Vessel
    options: Options
    weights: Noise | None = None
    """Those of the fit to the data: without noise to weigh by, a fit to a simulated answer would end elsewhere."""

    def estimates(self, names: Sequence[str], values: Array) -> tuple[Array, Array]:
        """Return the parameters of the simulated ship (P,), near those asked for, and their estimates (P,)."""
        bounds = np.array([(self.structure[name].lower, self.structure[name].upper) for name in names]).T
        wanted = dict(zip(names, np.clip(values, *bounds).tolist(), strict=True))
        given = {
            parameter.name: parameter.start for parameter in self.structure.parameters if parameter.fixed
        }
        vessel = with_parameters(
            self.vessel, {name: value for name, value in given.items() if name in PARAMETERS} | wanted
        )
        at_the_shaft = self.structure.settings.get("speed") == "propeller"
        records = [answered(vessel, record, at_the_shaft) for record in self.records]
        options = replace(self.options, starts=1, progress=None)
        search = search_minima(records, self.structure.with_start(**wanted), options, weights=self.weights)
        own = parameters_of(vessel)
        return np.array([own[name] for name in names]), search.best.vector[: len(names)]


def answered(vessel: Vessel, record: Experiment, at_the_shaft: bool = False) -> Experiment:
    """Return what a vessel answers to a record's set point in still water, sampled and masked as the record.

    A set point that is straight between samples (hold "first", as of processed logs) is taken as low-passed, and so is
    the answer.

    Parameters
    ----------
    vessel
        The ship.
    record
        Its set point, deviating from its operating point, is put about the vessel's own.
    at_the_shaft
        Whether the speed is that of the shaft behind the twist.
    """
    up = max(1, math.ceil(LEAST_RATE_HZ / record.rate_hz))
    rate = up * record.rate_hz
    lead = up * round(LEAD_S * record.rate_hz)
    moving = _between(record, up)
    samples = np.concatenate([np.zeros(lead), moving, np.full(lead, moving[-1])])
    answer = simulate(vessel, Excitation(record.name, record.kind, rate, samples, hold=record.hold))
    gear = 60.0 * vessel.gearbox.ratio
    signals = {**answer.signals, **({"n_e": answer.signals["n_s"] * gear} if at_the_shaft else {})}
    signals = {name: signals[name] for name in record.signals if name in signals}
    point = {name: float(row[lead // 2 : lead].mean()) for name, row in signals.items() if name != "E_n"}
    if up == 1 or record.hold == "zero":
        rows = {name: row[lead : lead + up * len(record) : up] for name, row in signals.items()}
    else:
        channel = Channel(record.name, "", rate, len(samples))
        low_pass = LowPass(channel, record.rate_hz, float(lead))
        rows = {name: low_pass(_reader(row), len(record)) for name, row in signals.items()}
    rows = {name: np.where(np.isnan(record.signals[name]), np.nan, row) for name, row in rows.items()}
    # What the filter would make of the set point beyond the record's ends is not known.
    rows["n_set"] = record.signals["n_set"] - record.operating_point["n_set"] + point["n_set"]
    return replace(
        record,
        signals=rows,
        operating_point={**answer.operating_point, **point},
        provenance={"source": "simulation"},
    )


def _between(record: Experiment, up: int) -> Array:
    """Deviation of the set point [rpm] at `up` times the record's rate, shape (up N,); gaps are bridged."""
    deviation = record.signals["n_set"] - record.operating_point["n_set"]
    at = np.arange(len(deviation))
    known = np.isfinite(deviation)
    if not known.any():
        raise InputError(f"experiment {record.name!r}: every sample of n_set is masked")
    deviation = np.interp(at, at[known], deviation[known])
    if up == 1:
        return deviation
    if record.hold == "zero":
        return np.repeat(deviation, up)
    fine = np.minimum(np.arange(up * len(at)) / up, at[-1])
    return np.asarray(make_interp_spline(at, deviation, k=5)(fine))


def _reader(samples: Array) -> Any:
    return lambda start, stop: samples[start:stop].copy()


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
    first: Fingerprint, structure: Structure, binding: Binding, found: Array, std: Array, off: float
) -> Fingerprint:
    names, back = binding.names, np.linalg.inv(binding.slopes)
    covariance = back @ _covariance(first, names) @ back.T
    parameters = dict(first.parameters)
    for name, value, deviation in zip(
        names, binding.ship_of(found).tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True
    ):
        own = first.parameters[name]
        reach = deviation * ((own.ci95[1] - own.ci95[0]) / (2.0 * own.std) if own.ci95 and own.std else 1.96)
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
        first,
        parameters=parameters,
        derived={},
        covariance={"names": list(names), "matrix": covariance.tolist()},
        verdict=(
            f"Led back to the ship by simulating it; the structure alone finds {alone}.",
            *verdict(parameters, {}, first.identifiability, first.fit, structure),
        ),
        settings={**first.settings, "indirect": record},
    )
