"""Conversion of a fingerprint to SI units and to a vessel, priors from drawings, and responses with deviations."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.assessment.closed_loop import structure_of
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.frequency.spectra import UNKNOWN_AMPLITUDE, UNKNOWN_PHASE
from shipfp_rs.identification.draws import Draws
from shipfp_rs.identification.estimate import scaled
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fingerprint_content import ALARM
from shipfp_rs.identification.inertias import (
    BEFORE_METER,
    ENGINE_SIDE,
    INERTIAS,
    operating_point,
)
from shipfp_rs.identification.whole_ship import whole_ship
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import true_values
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import DEVIATIONS_95, Array, Values
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.steady_state import droop_about, steady_state
from shipfp_rs.vessel.torsion import Line, Seen
from shipfp_rs.vessel.vessel import Vessel

SAME_RATIO = 0.02
"""Largest relative difference between the gear ratios of a torsional line and of its vessel; teeth can be counted."""
CONTRADICTED = Sentence(
    "Known beforehand: {name} = {mean} ± {std} s; from the data alone: {value} ± {spread} s. That is {apart} standard "
    "deviations apart, more than chance: look at the drawing and its units, the place of the gauge, and the scale of the "
    "torque channel."
)
FAR_OFF = 2.0
"""Ratio of the measured torque to that of the vessel file, or the inverse ratio, above which a doubt is reported."""
QUANTITIES: Mapping[str, tuple[str, str]] = {
    "tau_n": ("inertia", "kg m2"),
    "tau_prop": ("propeller_inertia", "kg m2"),
    "g": ("engine_slope", "Nm/rpm"),
    "vK_p": ("proportional_gain", "Nm/rpm"),
    "vK_i": ("integral_gain", "Nm/(rpm s)"),
    "p": ("propeller_exponent", "-"),
    "T_d": ("dead_time_loop", "s"),
    "T_set": ("dead_time_set_point", "s"),
    "tau_act": ("actuator_lag", "s"),
    "T_f": ("speed_filter", "s"),
    "tau_eng": ("engine_lag", "s"),
    "M_max": ("torque_limit", "Nm"),
}
"""Quantity in SI units for each parameter, and its unit."""


def in_si(fingerprint: Fingerprint, vessel: Vessel) -> dict[str, dict[str, Any]]:
    """Convert the parameters to SI units, with intervals, for the mean operating point of the data.

    Parameters
    ----------
    fingerprint
        Normalised estimates; the operating points are in its data.
    vessel
        Source of the gear ratio and efficiency between engine and shaft; without an efficiency the gearbox is lossless.

    Returns
    -------
    dict
        {"value", "std", "ci95", "unit"} of each quantity; undetermined parameters have none. Inertias are
        referred to the propeller shaft, gains act on the engine's speed in rpm, and the torque limit is that of
        the engine. If the model ends at a torque meter, "inertia_before_meter" is the inertia up to the meter,
        and "inertia" is that of the whole ship, if it is known.

    Notes
    -----
    Eq. 3.23 of the thesis: tau_n = 2 pi I_p n_s0 / M_s0 with n_s0 in rev/s of the shaft; dM/dn = g M_0 / n_0.
    """
    point = operating_point(fingerprint)
    if point is None:
        return {}
    engine_rpm, torque, signal = point
    shaft_torque = torque * vessel.torque_ratio if signal == ENGINE_SIDE else torque
    shaft_speed = engine_rpm / 60.0 / vessel.gearbox.ratio
    slope = abs(shaft_torque) / (abs(engine_rpm) * vessel.torque_ratio)
    factors = {
        "kg m2": abs(shaft_torque) / (2.0 * math.pi * abs(shaft_speed)),
        "Nm/rpm": slope,
        "Nm/(rpm s)": slope,
        "Nm": abs(shaft_torque) / vessel.torque_ratio,
    }
    found: dict[str, dict[str, Any]] = {}
    for one in (fingerprint, whole_ship(fingerprint)):
        left_out = INERTIAS if one.ends_at_meter else {}
        known = {name: row for name, row in one.parameters.items() if row.value is not None}
        found |= {
            quantity: scaled(known[name], factors.get(unit, 1.0), unit)
            for name, (quantity, unit) in QUANTITIES.items()
            if name in known and name not in left_out
        }
        if one.ends_at_meter and "tau_n" in known:
            found[BEFORE_METER["tau_n"]] = scaled(known["tau_n"], factors["kg m2"], "kg m2")
    return found


def doubts(fingerprint: Fingerprint, vessel: Vessel) -> list[str]:
    """Remarks on a gearbox with unknown losses, or a torque far from that of the vessel file."""
    point = operating_point(fingerprint)
    if point is None:
        return []
    lossless = vessel.gearbox.ratio != 1.0 and not vessel.given("gearbox.efficiency")
    found: list[str] = []
    if lossless:
        found.append(
            Sentence("The vessel file lacks gearbox.efficiency: in SI units the gearbox loses nothing.")
        )
    known = vessel.given("operating_point.n_e_rpm", "propeller.torque_exponent")
    if not known or not any(vessel.given(f"operating_point.{name}") for name in ("M_b_Nm", "M_s_Nm")):
        return found
    engine_rpm, torque, signal = point
    expected = vessel.nominal_brake_torque * (1.0 if signal == ENGINE_SIDE else vessel.torque_ratio)
    expected *= (abs(engine_rpm) / vessel.operating_point.n_e_rpm) ** vessel.propeller.torque_exponent
    if not 1.0 / FAR_OFF < abs(torque) / expected < FAR_OFF:
        found.append(
            Sentence(
                "The torque {signal} is {torque} Nm at {speed} rpm, but {expected} Nm by the vessel file: look at the"
                " scale of the torque channel. Inertias and gains in SI units are wrong by the same factor.",
                signal=signal,
                torque=f"{abs(torque):.4g}",
                speed=f"{abs(engine_rpm):.4g}",
                expected=f"{expected:.4g}",
            )
        )
    return found


def vessel_priors(
    vessel: Vessel, experiments: Sequence[Experiment], std_pct: float | None
) -> dict[str, tuple[float, float]]:
    """Priors (mean, standard deviation) from a vessel's inertias and stiffness (eq. 3.23); none without `std_pct`."""
    # The first experiment gives the operating point. A side of the gauge without a given inertia has no prior.
    if std_pct is None:
        return {}
    drawn = Seen(
        vessel.inertia if vessel.given("shaft.inertia_kg_m2") else None,
        vessel.propeller_side_inertia if vessel.given("shaft.propeller_side_inertia_kg_m2") else None,
        vessel.shaft.stiffness_Nm_rad if vessel.given("shaft.stiffness_Nm_rad") else None,
        vessel.gearbox.ratio,
    )
    return _priors(drawn, vessel, experiments, std_pct)


def _priors(
    drawn: Seen, vessel: Vessel, experiments: Sequence[Experiment], std_pct: float
) -> dict[str, tuple[float, float]]:
    point = experiments[0].operating_point
    signal = next((name for name in ("M_g", "M_s", "M_b") if name in point), None)
    if signal is None or "n_e" not in point:
        return {}
    shaft_torque = abs(point[signal]) * (vessel.torque_ratio if signal == "M_b" else 1.0)
    turn = 2.0 * math.pi * abs(point["n_e"]) / 60.0 / vessel.gearbox.ratio
    found = {
        "tau_n": turn * (drawn.inertia or 0.0) / shaft_torque,
        "tau_prop": turn * (drawn.propeller_side_inertia or 0.0) / shaft_torque,
        "tau_twist": shaft_torque / (turn * (drawn.stiffness or math.inf)),
    }
    return {name: (value, 0.01 * std_pct * value) for name, value in found.items() if value > 0.0}


@checked
def torsional_priors(
    line: Any,
    experiments: Sequence[Experiment],
    vessel: Vessel,
    *,
    gauge: str | None = None,
    std_pct: float = 5.0,
) -> dict[str, tuple[float, float]]:
    """Return the priors (mean, standard deviation) of parameters that follow from a torsional calculation.

    `tau_n` follows from all inertias, `tau_prop` from those behind the gauge, and `tau_twist` from the
    compliance between engine and propeller, each in s (eq. 3.23 of the thesis). The result is for
    `identify(priors=...)`.

    Parameters
    ----------
    line
        File of discs, shafts and gears, or an `opentorsion.Assembly`; the first disc is at the engine's end, the last one is
        the propeller with its water.
    experiments, vessel
        The operating point is that of the first experiment. The vessel must have the gear ratio of the line.
    gauge
        Name of the shaft with the torque gauge, or of the disc ahead of the gauge. "shaft 3" is the third shaft
        if it has no name. None: no `tau_prop`.
    std_pct
        Standard deviation of inertias and stiffness [%].

    Raises
    ------
    InputError
        If the file, the line or a name can't be used, or its gear ratio is not the vessel's.

    Examples
    --------
    >>> torsional_priors("line.json", trials, tug, gauge="tail shaft")  # doctest: +SKIP
    {'tau_n': (1.18, 0.06), 'tau_prop': (0.43, 0.02), 'tau_twist': (6e-05, 3e-06)}
    """
    if isinstance(line, str | Path):
        line = Line.read(line)
    seen = (line if isinstance(line, Line) else Line.of_assembly(line)).seen(gauge)
    if abs(seen.ratio / vessel.gearbox.ratio - 1.0) > SAME_RATIO:
        raise InputError(
            f"torsion.file: found an engine that turns {seen.ratio:.4g} times as fast as the propeller, expected "
            f"{vessel.gearbox.ratio:.4g}, the gearbox.ratio of vessel {vessel.name!r}"
        )
    return _priors(seen, vessel, experiments, std_pct)


def against_priors(fingerprint: Fingerprint, priors: Mapping[str, tuple[float, float]]) -> Iterator[Sentence]:
    """Yield a sentence for each prior that the data contradict by more than chance, once in a hundred fits.

    The load's side is estimated from data alone. Elsewhere a prior (m, s) is taken out of the estimate x with variance v,
    which leaves (x / v - m / s^2) / (1 / v - 1 / s^2).
    """
    for name, (mean, std) in priors.items():
        alone, found = fingerprint.load_side.get(name), fingerprint.parameters.get(name)
        if alone is not None and alone.value is not None and alone.std is not None:
            value, spread = alone.value, alone.std
        elif found is not None and found.value is not None and found.std is not None and found.std < std:
            weight = found.std**-2 - std**-2
            value, spread = (found.value * found.std**-2 - mean * std**-2) / weight, weight**-0.5
        else:
            continue
        apart = abs(value - mean) / math.hypot(std, spread)
        if math.erfc(apart / math.sqrt(2.0)) < ALARM / len(priors):
            yield Sentence(
                CONTRADICTED,
                name=name,
                mean=f"{mean:.4g}",
                std=f"{std:.2g}",
                value=f"{value:.4g}",
                spread=f"{spread:.2g}",
                apart=f"{apart:.2g}",
            )


@checked
def parameters_of(vessel: Vessel, n_e_rpm: float | None = None) -> dict[str, float]:
    """Return a vessel's linear parameters, with separate actuator lag and torsional compliance of the shaft.

    Parameters
    ----------
    vessel
        The ship.
    n_e_rpm
        Engine speed of the operating point [rpm]; None: that of the vessel.
    """
    model = dict(vars(linearise(vessel, n_e_rpm)))
    lag, stiffness = vessel.actuator.lag_s, vessel.shaft.stiffness_Nm_rad
    point = steady_state(vessel, n_e_rpm)
    more = {"tau_act": lag, "tau_twist": 0.0}
    if stiffness is not None:
        more["tau_twist"] = point.M_s / (2.0 * math.pi * point.n_s * stiffness)
    if vessel.governor.droop:
        more["droop"] = droop_about(vessel, point)
    return true_values(model | {"T_d": model["T_d"] - lag}) | more


@checked
def with_parameters(vessel: Vessel, values: Mapping[str, float]) -> Vessel:
    """Return a vessel with the given linear parameters at its operating point; the others are unchanged.

    If the given dead time of the loop is shorter than that of sampling, firing and computing, the actuator's
    dead time is zero.

    Parameters
    ----------
    vessel
        The ship.
    values
        Some of tau_n, tau_prop, g, v, K_p, K_i (or vK_p, vK_i), p, T_d, T_set, tau_act, tau_twist.

    Raises
    ------
    InputError
        For an unknown parameter name, or a physically impossible ship.
    """
    if unknown := sorted(set(values) - PARAMETERS):
        raise InputError(
            f"found parameters {', '.join(unknown)}, expected some of {', '.join(sorted(PARAMETERS))}"
        )
    # Torque, drag and the water's inertia depend weakly on each other, so four iterations suffice.
    for _ in range(4):
        vessel = vessel.replace(_changes(vessel, values))
    return vessel


PLACES: Mapping[str, str] = {
    "tau_n": "shaft.inertia_kg_m2",
    "tau_prop": "shaft.propeller_side_inertia_kg_m2",
    "g": "operating_point.g",
    "v": "operating_point.v",
    "K_p": "governor.K_p",
    "K_i": "governor.K_i",
    "p": "propeller.torque_exponent",
    "T_set": "governor.set_point_dead_time_s",
    "tau_act": "actuator.lag_s",
}
"""Key of the vessel file to which a parameter is proportional or equal."""
PARAMETERS = frozenset((*PLACES, "vK_p", "vK_i", "T_d", "tau_twist"))


def _changes(vessel: Vessel, values: Mapping[str, float]) -> dict[str, float]:
    own = parameters_of(vessel)
    per_time_constant = vessel.nominal_propeller_torque / (2.0 * math.pi * vessel.nominal_shaft_speed)
    gains = {f"K_{k}": values[f"vK_{k}"] / own["v"] for k in ("p", "i") if f"vK_{k}" in values}
    wanted = {**values, **gains}
    more = {name: wanted[name] - own[name] for name in wanted if name in own}
    changes = {}
    for name in [name for name in PLACES if name in more]:
        section, key = PLACES[name].split(".")
        unit = per_time_constant if name in ("tau_n", "tau_prop") else 1.0
        changes[PLACES[name]] = float(getattr(getattr(vessel, section), key) or 0.0) + unit * more[name]
    if "T_d" in more:
        changes["actuator.dead_time_s"] = max(0.0, vessel.actuator.dead_time_s + more["T_d"])
    if "tau_twist" in more and values["tau_twist"] > 0.0:
        changes["shaft.stiffness_Nm_rad"] = per_time_constant / values["tau_twist"]
    return changes


SMALL = 0.01
"""Size of a step, relative to the operating speed, for which a ship is nearly linear."""
LEAD_S, DRAWS, ONE_DEVIATION = 1.0, 100, 0.6827
"""Time before the step [s], half the number of drawn ships, and share of the ships within one standard deviation."""


@dataclass(frozen=True)
class StepResponse:
    """Response to a small set-point step at 0 s, relative to the step: time [s] (N,), mean and std (N,) by output."""

    time: Array
    mean: Mapping[str, Array]
    std: Mapping[str, Array]


def response_with_deviation(
    fingerprint: Fingerprint,
    frequency_hz: npt.ArrayLike,
    structure: Structure | None = None,
    *,
    draws: Draws | None = None,
) -> FrequencyResponse:
    """Return the fitted model's response by output, with standard deviations.

    Parameters
    ----------
    fingerprint
        Result of the fit. Undetermined directions of the parameters do not change the response.
    frequency_hz
        Frequencies in ascending order [Hz], shape (F,).
    structure
        Structure of the fingerprint; None rebuilds a linear one.
    draws
        Draws of the fingerprint, whose scatter is the deviation. None draws from the covariance, cut at the
        bounds.

    Returns
    -------
    FrequencyResponse
        Response by output ("dn", "dM", ...), with relative `amplitude_std` and `phase_std` in rad.

    Raises
    ------
    InputError
        If the structure is not linear and not given.
    """
    structure = structure or structure_of(fingerprint)
    frequency = np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))

    def seen(values: Values) -> Array:
        found, _ = structure.equations.response(values, frequency, ())
        return np.array([np.log(np.abs(found)), np.unwrap(np.angle(found))])

    response, _ = structure.equations.response(fingerprint.optimum, frequency, ())
    amplitude, phase = deviation_of(fingerprint, structure, seen, draws)
    amplitude, phase = np.minimum(amplitude, UNKNOWN_AMPLITUDE), np.minimum(phase, UNKNOWN_PHASE)
    return FrequencyResponse(
        structure.name,
        frequency,
        {
            name: np.asarray(row, dtype=np.complex128)
            for name, row in zip(structure.outputs, response, strict=True)
        },
        amplitude_std=dict(zip(structure.outputs, amplitude, strict=True)),
        phase_std=dict(zip(structure.outputs, phase, strict=True)),
    )


def step_with_deviation(
    fingerprint: Fingerprint,
    duration_s: float = 20.0,
    rate_hz: float = 50.0,
    structure: Structure | None = None,
    *,
    draws: Draws | None = None,
) -> StepResponse:
    """Return the fitted model's response to a step of the set point, with standard deviations.

    Parameters
    ----------
    fingerprint, structure, draws
        See `response_with_deviation`.
    duration_s, rate_hz
        Time after the step [s] and sample rate [Hz].

    Raises
    ------
    InputError
        See `response_with_deviation`.
    """
    structure = structure or structure_of(fingerprint)
    time = np.arange(-LEAD_S, duration_s, 1.0 / rate_hz)
    step = Experiment(
        "step", rate_hz, {"n_set": np.where(time >= 0.0, 1.0 + SMALL, 1.0)}, {"n_set": 1.0}, hold="zero"
    )

    def seen(values: Values) -> Array:
        return structure.equations.simulate(values, step) / SMALL

    found = (seen(fingerprint.optimum), deviation_of(fingerprint, structure, seen, draws))
    return StepResponse(time, *(dict(zip(structure.outputs, rows, strict=True)) for rows in found))


def deviation_of(
    fingerprint: Fingerprint,
    structure: Structure,
    seen: Callable[[Values], Array],
    draws: Draws | None = None,
) -> Array:
    """Change of a model's response that 68 % of drawn ships do not exceed."""
    # Drawn ships replace derivatives: a torque jumps where a dead time ends, and a stiff shaft's simulation may fail.
    values, found = fingerprint.optimum, []
    here = seen(values)
    for moved in _by_covariance(fingerprint, structure) if draws is None else draws.of(dict):
        with contextlib.suppress(SimulationError):  # no such ship
            found.append(np.abs(seen({**values, **moved}) - here))
    return np.asarray(np.quantile(found or [np.zeros_like(here)], ONE_DEVIATION, axis=0))


def _by_covariance(fingerprint: Fingerprint, structure: Structure) -> Iterator[dict[str, float]]:
    """Yield parameters drawn from the covariance, cut at their bounds."""
    values, names = dict(fingerprint.optimum), list(fingerprint.covariance["names"])
    matrix = np.array(fingerprint.covariance["matrix"], dtype=np.float64).reshape(len(names), len(names))
    random = np.random.default_rng(0)
    draws = random.multivariate_normal(
        np.zeros(len(names)), matrix, DRAWS, method="eigh", check_valid="ignore"
    )
    moves = dict(zip(names, np.concatenate([draws, -draws]).T, strict=True))
    # The covariance lacks a parameter that lies on a bound; such a parameter reaches to the end of its interval.
    for name, estimate in fingerprint.parameters.items():
        if estimate.status == "at_bound" and estimate.ci95 is not None and name not in names:
            low, high = np.array(estimate.ci95) - values[name]
            far = high if high > -low else low
            moves[name] = np.abs(random.standard_normal(2 * DRAWS)) * far / DEVIATIONS_95
    for draw in range(2 * DRAWS):
        yield {
            name: float(np.clip(values[name] + by[draw], structure[name].lower, structure[name].upper))
            for name, by in moves.items()
        }
