"""Data, a structure and options to the minima of a search."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import IdentificationError, InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.blocks import Block, Data
from shipfp_rs.identification.options import Options
from shipfp_rs.identification.search import Search, start_vectors
from shipfp_rs.identification.weighted_problem import Minimum
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support import hints

Array = npt.NDArray[np.float64]

LOGGER = logging.getLogger("shipfp_rs")

AS_LOW = 1e-6
"""Minima whose criteria differ by less are the same."""


@dataclass(frozen=True)
class Found:
    """A search, the minima that it found, the best one of them refined, and the settings for the record."""

    search: Search
    best: Minimum
    minima: Sequence[Minimum]
    settings: Mapping[str, Any]
    seed: int | None


def search_minima(data: Data | Sequence[Data], structure: Structure, options: Options) -> Found:
    """Search as `identify` does, and judge nothing yet.

    Raises
    ------
    InputError, IdentificationError
        As `identify`.
    """
    options.require(structure)
    starts, search = options.starts_for(structure), _search(data, structure, options)
    LOGGER.info(
        "identify: %s, %d free parameters, %s, %d starts",
        structure.name,
        len(search.free),
        ", ".join(block.data.name for block in search.blocks),
        starts,
    )
    minima = _minima(search, start_vectors(search, starts, options.seed))
    # Only the best minimum is refined with noise models, which take most of the time.
    best = search.refine(minima[0])
    settings = {
        "weighting": search.weighting,
        "noise": search.noise,
        "intervals": search.intervals,
        "starts": starts,
        "time_limit_s": options.time_limit_s,
    }
    return Found(search, best, minima, settings, options.seed)


def _search(data: Data | Sequence[Data], structure: Structure, options: Options) -> Search:
    """Build the weighted problem; what the options leave open follows from the kind of data."""
    blocks = _blocks(data, structure, weigh=options.weighting == "std", at_rest=options.at_rest)
    in_time = any(isinstance(block.data, Experiment) for block in blocks)
    search = Search(
        structure,
        blocks,
        options.weighting,
        options.noise or ("ar" if in_time else "white"),
        options.intervals,
        time_limit_s=options.time_limit_s,
    )
    if not search.free:
        raise InputError(f"structure {structure.name!r} has no free parameter; nothing to identify")
    return search


def _blocks(
    data: Data | Sequence[Data], structure: Structure, *, weigh: bool, at_rest: bool
) -> tuple[Block, ...]:
    items = [data] if isinstance(data, Experiment | FrequencyResponse) else list(data)
    if not items:
        raise InputError("identify: no data given, expected an Experiment or a FrequencyResponse")
    for item in items:
        if not isinstance(item, Experiment | FrequencyResponse):
            raise InputError(
                f"identify: data of type {type(item).__name__}, expected Experiment or FrequencyResponse"
            )
        if weigh and isinstance(item, Experiment):
            raise InputError(
                f"{item.name!r}: weighting 'std' is for frequency responses, an experiment has no deviations"
            )
        if isinstance(item, FrequencyResponse) and structure.settings["kind"] in ("linear", "ship"):
            _require_sense(item)
    return tuple(Block.build(item, structure.part(item.name), weigh=weigh, at_rest=at_rest) for item in items)


def _require_sense(data: FrequencyResponse) -> None:
    """Refuse a speed that leads its set point, or that follows it slowly with another gain than 1 (eq. 3.31)."""
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


def _minima(search: Search, vectors: Sequence[Array]) -> list[Minimum]:
    found, failures = [], []
    for done, start in enumerate(vectors):
        try:
            found.append(search.minimise(start))
            LOGGER.debug("identify: start %d led to the criterion %.9g", done + 1, found[-1].criterion)
        except IdentificationError as error:
            failures.append(str(error))
    if not found:
        raise IdentificationError(f"none of {len(vectors)} starts led to a minimum; the first: {failures[0]}")
    found.sort(key=lambda minimum: minimum.criterion)
    # Among minima of the same height take one at which the search converged.
    as_low = (minimum for minimum in found if minimum.criterion <= found[0].criterion + AS_LOW)
    best = next((minimum for minimum in as_low if minimum.converged), found[0])
    return [best, *(minimum for minimum in found if minimum is not best)]
