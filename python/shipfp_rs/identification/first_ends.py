"""Where the searches from the data's own starts end: the first fits, with a lag for a dead time, with a torque limit."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from shipfp_rs.errors import IdentificationError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.search import Search
from shipfp_rs.identification.start_vector import DELAYS, stable_start
from shipfp_rs.identification.weighted_problem import Minimum
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.threads import where_alone

LOGGER = logging.getLogger("shipfp_rs")

NEARBY_S = 0.02
"""Difference of every delay within which two ends are one [s]."""
START_EVALUATIONS = 25
"""Passes after which of all starts whose ends are near each other only the best one goes on."""
REACHED = 0.99
"""Part of the samples below the torque at which the search for a limit starts: at a limit many samples are alike."""
LEAST_LAG_S = 0.03
"""Lag from which the search for one starts at least [s]."""
LIMITED_STARTS = 3
"""Starts at most that are tried with a limit."""


def ends_of(search: Search, begins: Sequence[Mapping[str, float]]) -> list[Minimum]:
    """Return the minima that searches from some values lead to, the best first; none where nothing can be simulated."""
    brief = replace(search, max_evaluations=START_EVALUATIONS)
    found = where_alone([partial(_end, brief, stable_start(search, values)) for values in begins])
    ends = distinct(search, [end for end in found if end is not None])
    further = where_alone([partial(_further, search, end) for end in ends])
    return sorted(further, key=_criterion)


def _further(search: Search, end: Minimum) -> Minimum:
    """Return where a search goes on to that came to no end."""
    return end if end.converged else _end(search, end.vector) or end


def _end(search: Search, start: Array) -> Minimum | None:
    """Return where a search ends; None where it can't be simulated."""
    try:
        return search.minimise(start)
    except (IdentificationError, SimulationError) as error:
        LOGGER.debug("identify: a start failed: %s", error)
        return None


def with_lag(begins: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """Return starts with a lag of the actuator in place of the dead time in the loop."""
    return [
        {name: value for name, value in values.items() if name != "T_d"}
        | {"tau_act": max(values.get("T_d", 0.0), LEAST_LAG_S)}
        for values in begins
    ]


def at_limit(
    search: Search, experiments: Sequence[Experiment], begins: Sequence[Mapping[str, float]]
) -> list[dict[str, float]]:
    """Return starts with a torque limit where the measured torque has its highest level; none without a torque."""
    structure = search.structure
    if "dM" not in structure.outputs:
        return []
    torques = [one.normalised(structure.signal_for("dM", one.signals, one.name)) for one in experiments]
    level = 1.0 + float(np.nanquantile(np.concatenate(torques), REACHED))
    return [{**values, "M_max": level} for values in begins[:LIMITED_STARTS]]


def distinct(search: Search, ends: Sequence[Minimum]) -> list[Minimum]:
    """Return ends, the best first, less those whose delays a better one has."""
    delays = [place for place, name in enumerate(search.names) if name in DELAYS]
    kept: list[Minimum] = []
    for end in sorted(ends, key=_criterion):
        if not any((np.abs(end.vector - other.vector)[delays] < NEARBY_S).all() for other in kept):
            kept.append(end)
    return kept


def _criterion(minimum: Minimum) -> float:
    return minimum.criterion
