"""The search of a given structure: descents from several starts, each under the noise of its own residuals."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from shipfp_rs.errors import IdentificationError, InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.basins import (
    Basin,
    Minima,
    best_basins,
    descend,
    distinct,
    expected,
    settle,
)
from shipfp_rs.identification.coordinates import Coordinates
from shipfp_rs.identification.first_guesses import LoopSpectra, guesses_from, guesses_in_open_loop
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.question import Options
from shipfp_rs.identification.sampling import SHORTEST_S
from shipfp_rs.identification.ship_model import Ship, ShipModel, unknowns_of
from shipfp_rs.identification.structure_models import (
    Data,
    InBand,
    Samples,
    Seen,
    banded,
    seen,
    structure_likelihood,
)
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support import hints
from shipfp_rs.support.arrays import Array

LOGGER = logging.getLogger("shipfp_rs")

ROUNDS, STILL = 200, 1e-3
"""Largest number of descents, each with the noise estimated at the previous minimum, and the squared step, in standard
deviations, below which they stop. A few descents suffice for noise; the misfit of a model to simulated data may take a
hundred."""
UNMOVED = 3e-7
"""Largest step of a search vector's entries below which the descents stop, too: without noise the deviations go to zero."""
STEPS, SETTLED, LAST = 100, 1e-4, 1e-9
"""Largest number of steps of a descent, decrease of the deviance below which it stops, and the smaller decrease for the last
descent, which takes one or two steps more."""
ROUNDING = 1e-9
"""Relative decrease of a deviance that may be due to rounding errors."""
OFF_BY = 0.1
"""Prior deviation of the offsets and scales of a ship's records, relative to the operating point."""
DRAWS = 100
"""Largest number of random draws to find a start with a stable loop."""


GUESSED = 2
"""Number of starts from regressions; those of least deviance are kept."""


@dataclass(frozen=True)
class StructureQuestion:
    """The task of a fit by a structure's own equations; `assumed` are fixed parameters that were not given."""

    data: tuple[Data, ...]
    structure: Structure
    options: Options
    assumed: tuple[str, ...] = ()


@dataclass(frozen=True)
class StructureFit(Minima):
    """The result of the search of a given structure; `records` are its data."""

    likelihood: Likelihood
    question: StructureQuestion
    records: tuple[Seen, ...]
    settled: float | None = None  # total deviance of the best minimum, with its own noise

    @property
    def structure(self) -> Structure:
        """The fitted structure."""
        return self.question.structure

    @property
    def total(self) -> float:
        """Deviance of the best minimum, log determinant included, with the noise estimated from its own residuals."""
        return super().total if self.settled is None else self.settled

    def known(self, record: int) -> dict[str, float]:
        """Parameters and a record's unknowns at the best minimum, by name."""
        return self.likelihood.known(self.best.vector, record)


def fit_structure(question: StructureQuestion) -> StructureFit:
    """Search the parameters of a structure that best explain the data."""
    structure, options = question.structure, question.options
    options.require()
    records, likelihood = likelihood_of(question)
    starts = options.starts_for(structure)
    LOGGER.info(
        "identify: %s, %d free parameters, %s, %d starts",
        structure.name,
        len(likelihood.coordinates.free),
        ", ".join(record.data.name for record in records),
        starts,
    )
    until = None if options.time_limit_s is None else time.monotonic() + options.time_limit_s
    vectors = [
        *start_vectors(records, likelihood, structure, starts, options.seed),
        *guessed_vectors(records, likelihood, structure),
    ]
    likelihood, basins, total = best_basins(likelihood, vectors, until=until, alone=_settled)
    basins = _sharpened(likelihood, basins, until)
    return StructureFit(likelihood, tuple(distinct(likelihood, basins)), question, records, total)


def refined(fit: StructureFit) -> StructureFit:
    """Return the fit with its best minimum under the noise of its own residuals."""
    end = _settled(fit.likelihood, fit.best.vector, until=None)
    if not np.isfinite(end.cost):
        raise IdentificationError("identify: the structure cannot be simulated at a lower minimum")
    likelihood = fit.likelihood.settled_at(end.vector)
    basins = _sharpened(likelihood, [descend(likelihood, end.vector)], None)
    return replace(fit, likelihood=likelihood, basins=tuple(basins), settled=end.cost)


def structure_at(question: StructureQuestion, values: Mapping[str, float]) -> StructureFit:
    """Return the expected fit of a structure whose true parameters are known."""
    records, likelihood = likelihood_of(question)
    vector = likelihood.coordinates.vector(values)
    likelihood = likelihood.settled_at(vector)
    return StructureFit(likelihood, (expected(likelihood, vector),), question, records)


def _sharpened(likelihood: Likelihood, basins: Sequence[Basin], until: float | None) -> list[Basin]:
    """Return the minima after a last, more precise descent."""
    last = SETTLED if isinstance(likelihood.models[0], ShipModel) else LAST
    settled = max(last, ROUNDING * basins[0].cost)
    return [descend(likelihood, one.vector, steps=STEPS, settled=settled, until=until) for one in basins]


def _settled(likelihood: Likelihood, vector: Array, *, until: float | None) -> Basin:
    """Return the minimum under the noise of its own residuals; the cost is the total deviance."""
    start = Basin(np.inf, vector, False)
    try:
        likelihood = likelihood.settled_at(vector)
    except (SimulationError, np.linalg.LinAlgError):
        return start
    likelihood, end = settle(
        likelihood, start, rounds=ROUNDS, still=STILL, least=UNMOVED, settled=SETTLED, until=until
    )
    return Basin(likelihood.total(end.vector), end.vector, end.settled)


def likelihood_of(question: StructureQuestion) -> tuple[tuple[Seen, ...], Likelihood]:
    """Return the data in the form compared with a structure, and the likelihood before any noise estimate."""
    items, structure, options = question.data, question.structure, question.options
    if not items:
        raise InputError("identify: no data given, expected an Experiment or a FrequencyResponse")
    for item in items:
        if not isinstance(item, Experiment | FrequencyResponse):
            raise InputError(
                f"identify: data of type {type(item).__name__}, expected Experiment or FrequencyResponse"
            )
        if isinstance(item, FrequencyResponse) and structure.settings["kind"] in ("linear", "ship"):
            _require_sense(item)
    records = tuple(
        seen(item, structure.part(item.name), options.noise, at_rest=options.at_rest) for item in items
    )
    if not structure.free:
        raise InputError(f"structure {structure.name!r} has no free parameter; nothing to identify")
    own = structure_likelihood(records, structure, accurate=options.at_rest)
    return records, _in_closed_form(records, structure, own) or own


def _in_closed_form(records: Sequence[Seen], structure: Structure, own: Likelihood) -> Likelihood | None:
    """Return the likelihood by the ship's two equations; None if the structure has more, or data are no spectra."""
    models = []
    for record in records:
        ship = Ship.of(record.structure)
        if ship is None or not isinstance(record, InBand):
            return None
        noise: Literal["white", "coloured"] = "white" if record.white else "coloured"
        unknowns = unknowns_of(ship.equations)
        models.append(ShipModel(record=record.record, unknowns=unknowns, noise=noise, **ship._asdict()))
    if len({(one.gauge, one.open_loop, one.behind_twist, one.noise) for one in models}) > 1:
        return None
    return replace(
        own,
        models=tuple(models),
        coordinates=Coordinates.of(structure, [one.unknowns for one in models], OFF_BY),
        accuracy=0.0 * own.accuracy if models[0].noise == "white" else own.accuracy,
    )


def start_vectors(
    records: Sequence[Seen], likelihood: Likelihood, structure: Structure, count: int, seed: int | None
) -> list[Array]:
    """Return the declared start and `count` - 1 random ones with stable loops."""
    c = likelihood.coordinates
    vectors = [c.vector({one.name: one.start for one in structure.free})]
    random = np.random.default_rng(seed)
    for _ in range(count - 1):
        for _ in range(DRAWS):
            vector = c.vector({one.name: one.drawn(random) for one in structure.free})
            values = c.values(vector)
            if all(record.structure.equations.stable(values) for record in records):
                vectors.append(vector)
                break
    return vectors


def guessed_vectors(records: Sequence[Seen], likelihood: Likelihood, structure: Structure) -> list[Array]:
    """Return the best starts from regressions of spectra, for a drive train with unknown dead times."""
    # Declared and random starts may all lead to a minimum with wrong dead times.
    free = {one.name for one in structure.free}
    if (
        structure.settings["kind"] not in ("linear", "ship", "commanded")
        or not ({"T_d", "T_set"} & free or structure.settings["kind"] == "commanded")
        or "dn" not in structure.outputs
        or any(isinstance(one, Samples) and one.data.duration < SHORTEST_S for one in records)
    ):
        return []
    spectra = [
        LoopSpectra.of((one if isinstance(one, InBand) else banded(one)).record, structure.outputs)
        if isinstance(one, Samples)
        else LoopSpectra.of_response(
            one.data.frequency_hz[one.valid], dict(zip(structure.outputs, one.spectrum, strict=True))
        )
        for one in records
    ]
    c = likelihood.coordinates
    gauge = "tau_prop" in structure.names
    declared = {one.name: one.start for one in structure.parameters}
    if structure.settings["kind"] == "commanded":
        guesses = guesses_in_open_loop(spectra, gauge)
        vectors = [c.vector({**declared, **{n: v for n, v in one.items() if n in free}}) for one in guesses]
        return sorted(vectors, key=likelihood.cost)[:GUESSED]
    vectors = []
    for guess in guesses_from(spectra, gauge):
        # Regressions determine only ratios to the inertia.
        tau = guess["tau_n"] if "tau_n" in free else declared["tau_n"]
        ratio = tau / guess["tau_n"]
        known = {
            **guess,
            "tau_n": tau,
            "g": guess["p"] - (guess["p"] - guess["g"]) * ratio,
            "vK_p": guess["vK_p"] * ratio,
            "vK_i": guess["vK_i"] * ratio,
        }
        known |= {name: known[f"v{name}"] / declared.get("v", 1.0) for name in ("K_p", "K_i")}
        values = declared | {name: value for name, value in known.items() if name in free}
        vectors.append(c.vector(values))
    return sorted(vectors, key=likelihood.cost)[:GUESSED]


def _require_sense(data: FrequencyResponse) -> None:
    """Refuse a speed that leads its set point, or that follows it slowly with a gain other than 1 (eq. 3.31)."""
    speed = next((name for name in ("n_e", "n_s") if name in data.response), None)
    if speed is None:
        return
    slowest = np.argsort(data.frequency_hz)[:3]
    response = data.response[speed][slowest]
    gain, phase = np.abs(response), np.angle(response)
    if not np.isfinite(response).all() or len(slowest) < 3:
        return
    if (phase > 3.0 * data.phase_std.get(speed, np.zeros(len(data)))[slowest] + 0.005).all() and (
        phase < 1.5
    ).all():
        raise InputError(
            f"{data.name!r}: {speed} leads the set point by {phase[0]:.3g} rad at {data.frequency_hz[slowest[0]]:.4g} Hz, "
            "expected it to follow; the sign of the phase turned? give the complex conjugate"
        )
    if (np.abs(phase) < 0.3).all() and (hint := hints.likely_ratio(float(gain.mean()), hints.PEAK_TO_PEAK)):
        raise InputError(
            f"{data.name!r}: {speed} follows the set point with a gain of {gain.mean():.3g} at its lowest frequencies, "
            f"expected 1{hint} give both channels alike"
        )
