"""The tug's trial on many simulated ships with known parameters: Table 7.1 beside the true values."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from shipfp_rs.assessment.si import with_parameters
from shipfp_rs.errors import IdentificationError, InputError
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.reproduce import Progress, Reproduction, Row, Way, fits_to, row_of
from shipfp_rs.reproduce.fullscale import thesis_structure
from shipfp_rs.reproduce.pictures import files
from shipfp_rs.reproduce.trial import EVERYTHING, LONG_CHIRP, SINES, VESSEL, Twin
from shipfp_rs.simulation.simulate import replay
from shipfp_rs.structures.structure import Structure
from shipfp_rs.sweeps.pools import pool_of
from shipfp_rs.vessel.vessel import Vessel

LOGGER = logging.getLogger("shipfp_rs")
FILES = files(("twin",))

PARTS: Mapping[str, tuple[str, ...]] = {
    "sines S2-S12": SINES[:-1],
    "chirp C11": ("C11",),
    "chirps C21-C23": LONG_CHIRP,
}
CHIRP, ALL = "chirp C11", "all"
STEPS = ("St1", "St2")
FREE = ("p", "tau_prop", "vK_p", "vK_i", "T_d", "T_set")
SHOWN = ("tau_n", "g", *FREE)
ELEMENTS = ("dead_time_loop", "dead_time_set_point", "actuator_lag", "twist", "late_torque")
KNOWN = ("tau_n", "g", "tau_act", "tau_twist")
"""Parameters that are fixed, since speeds and gauge torque do not determine tau_n, g and v separately. The actuator's lag
and the shaft's twist are known from drawings, the inertia (tau_n) from a torsional vibration calculation, the engine's
slope (g) from its factory test.
"""


def experiments_of(part: str) -> tuple[str, ...]:
    """Return the names of the experiments of a part."""
    return sum(PARTS.values(), ()) if part == ALL else PARTS[part]


def fitted_parts(twin: Twin, parts: Sequence[str]) -> dict[str, Fingerprint]:
    """Identify parts of a trial separately, given the true `KNOWN`; the other fits start at the chirp's estimates."""
    known = {name: twin.truth[name] for name in KNOWN}
    ship = Structure.ship(ELEMENTS, torque="gauge", propeller_speed=True)
    structure = ship.with_fixed(**known, zeta_twist=0.5).with_prior(T_M=(0.0, 3e-3))
    told: dict[str, Fingerprint] = {}
    for part in sorted(parts, key=lambda part: part != CHIRP):
        records = twin.experiments(experiments_of(part))
        told[part] = identify(records, structure, starts=1, vessel=VESSEL)
        if part == CHIRP:
            ended = told[part].settings["optimum"]
            structure = structure.with_start(**{name: ended[name] for name in FREE})
    return told


def fitted_as_the_thesis(twin: Twin, part: str) -> Fingerprint:
    """Fit the thesis's structure to a part of the trial, with the thesis's assumption of white noise."""
    records = twin.experiments(experiments_of(part))
    return identify(records, thesis_structure(), noise="white", starts=1, vessel=VESSEL)


@dataclass(frozen=True)
class Outcome:
    """Truth of a simulated trial, and each part's estimates; no estimates if a fit failed."""

    seed: int
    truth: Mapping[str, float]
    told: Mapping[str, Fingerprint]


def outcome(seed: int, parts: Sequence[str]) -> Outcome:
    """Simulate a trial and identify parts of it."""
    names = tuple(dict.fromkeys(name for part in parts for name in experiments_of(part)))
    twin = Twin.of(seed, names)
    try:
        return Outcome(seed, twin.truth, fitted_parts(twin, parts))
    except (InputError, IdentificationError) as refusal:
        LOGGER.warning("twin %d: %s", seed, refusal)
        return Outcome(seed, twin.truth, {})


def outcomes(seeds: Sequence[int], parts: Sequence[str]) -> Iterator[Outcome]:
    """Compute the outcomes of many seeds on all processors, and yield each on completion."""
    with pool_of("processes", None, None) as pool:
        for future in as_completed([pool.submit(outcome, seed, parts) for seed in seeds]):
            yield future.result()


class Score(NamedTuple):
    """Accuracy of a parameter over the trials that determine it; noise drives the dead time to its bound in some trials."""

    trials: int
    inside: float
    """Share of the trials whose 95 % interval contains the truth."""
    error_pct: float
    std_pct: float
    """Medians of the absolute error and of the predicted standard deviation, relative to the truth."""


def scores(found: Sequence[Outcome], part: str) -> dict[str, Score]:
    """Return each free parameter's score."""
    return {name: _score(found, part, name) for name in FREE}


def _score(found: Sequence[Outcome], part: str, name: str) -> Score:
    rows = []
    for outcome in found:
        if part in outcome.told:
            estimate, truth = outcome.told[part].parameters[name], outcome.truth[name]
            if estimate.value is not None and estimate.std is not None and estimate.ci95 is not None:
                held = not _missed({name: estimate}, outcome.truth)
                rows.append((held, abs(estimate.value / truth - 1.0), estimate.std / abs(truth)))
    inside, error, std = np.array(rows, dtype=np.float64).reshape(-1, 3).T
    return Score(len(rows), float(inside.mean()), *(100.0 * float(np.median(part)) for part in (error, std)))


def standing(found: Sequence[Outcome], part: str) -> float:
    """Return the share of trials whose residuals are consistent with the structure."""
    return float(np.mean([outcome.told[part].model_adequate is True for outcome in found if outcome.told]))


def agreement(told: Mapping[str, Fingerprint], name: str) -> list[float]:
    """Return pairwise differences of the parts' estimates of a parameter, in units of their joint standard deviation."""
    return [
        math.nan
        if one.value is None or other.value is None or not one.std or not other.std
        else abs(one.value - other.value) / math.hypot(one.std, other.std)
        for one, other in combinations((told[part].parameters[name] for part in PARTS), 2)
    ]


def fit_to_steps(twin: Twin, told: Fingerprint) -> dict[str, dict[str, float]]:
    """Return the fit to the steps [%] of the ship simulated with the estimates; the steps reach the ship's limits."""
    known = {name: twin.truth[name] for name in KNOWN}
    estimates = {name: float(e.value) for name in FREE if (e := told.parameters[name]).value is not None}
    ship = with_parameters(Vessel.load(VESSEL), {**known, **estimates})
    found = {}
    for record in twin.experiments(STEPS):
        model = replay(ship, record, at_the_shaft=True)
        found[record.name] = fits_to(record, {name: model.normalised(name) for name in ("n_e", "M_g")})
    return found


def reproduce(draws: int = 1, progress: Progress | None = None) -> Reproduction:
    """Identify the simulated tug's trial part by part, then the short chirp of drawn ships, `draws` ships in all."""
    parts = (*PARTS, ALL)
    jobs, done = 1 + len(parts) + len(PARTS) + draws - 1, 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, jobs)

    tug = Twin.of(0, EVERYTHING)
    step()
    rows = [Row("twin", "truth", "truth", "ship", {name: tug.truth[name] for name in SHOWN})]
    fingerprints: dict[str, Fingerprint] = {}

    def add(way: Way, part: str, fingerprint: Fingerprint) -> None:
        fingerprints[f"{way}, {part}"] = fingerprint
        rows.append(row_of(fingerprint, "twin", part, way))
        step()

    for part in PARTS:
        add("thesis", part, fitted_as_the_thesis(tug, part))
    for part, fingerprint in fitted_parts(tug, parts).items():
        add("ours", part, fingerprint)
    steps = fit_to_steps(tug, fingerprints[f"ours, {ALL}"])
    told = [Outcome(0, tug.truth, {CHIRP: fingerprints[f"ours, {CHIRP}"]})]
    if draws > 1:
        for one in outcomes(range(1, draws), (CHIRP,)):
            told.append(one)
            step()
    title = "The tug's trial on a ship whose parameters are known"
    verdict = tuple(_verdict(tug.truth, fingerprints, steps, told))
    return Reproduction(title, tuple(rows), verdict, fingerprints)


def table(found: Mapping[str, Score]) -> list[str]:
    """Return a line of text for each parameter."""
    lines = [f"{'':9} trials  truth inside 95 %  median error  predicted std"]
    for name, s in found.items():
        lines.append(f"{name:9} {s.trials:6d} {s.inside:18.1%} {s.error_pct:11.2f} % {s.std_pct:12.2f} %")
    return lines


def _verdict(
    truth: Mapping[str, float],
    fingerprints: Mapping[str, Fingerprint],
    steps: Mapping[str, Mapping[str, float]],
    told: Sequence[Outcome],
) -> Iterator[str]:
    ours = {part: fingerprints[f"ours, {part}"] for part in (*PARTS, ALL)}
    for part, fingerprint in ours.items():
        outside = _missed(fingerprint.parameters, truth)
        alone = f"the truth is outside of {', '.join(outside)}" if outside else "all intervals hold the truth"
        yield f"{part}: {alone}"
    yield "Largest difference between the parts, in joint standard deviations: " + ", ".join(
        f"{name} {max(agreement(ours, name), default=math.nan):.1f}" for name in FREE
    )
    for part in PARTS:
        thesis = fingerprints[f"thesis, {part}"]
        bound = [name for name, e in thesis.parameters.items() if e.status == "at_bound"]
        wrong = _missed(thesis.parameters, truth)
        called = "called wrong" if thesis.model_adequate is False else "stands"
        yield (
            f"thesis's structure, {part}: on bounds {', '.join(bound) or 'none'}; intervals that miss the truth "
            f"{', '.join(wrong) or 'none'}; structure {called}"
        )
    yield "Steps, by the simulated ship with the estimates of all: " + "; ".join(
        f"{name} speed {fit['n_e']:.1f} %, torque {fit['M_g']:.1f} %" for name, fit in steps.items()
    )
    if len(told) > 1:
        yield f"{CHIRP} alone, {len(told)} ships and seas:"
        yield from table(scores(told, CHIRP))
        yield f"The residuals leave the structure standing in {standing(told, CHIRP):.1%}"


def _missed(estimates: Mapping[str, Estimate], truth: Mapping[str, float]) -> list[str]:
    """Names of shown parameters whose interval misses the truth."""
    intervals = {name: one.ci95 for name, one in estimates.items() if name in SHOWN and one.ci95 is not None}
    return [name for name, (low, high) in intervals.items() if not low <= truth[name] <= high]
