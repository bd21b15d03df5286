"""Values as a search's start vector, steadied where they make an unstable loop, and from one structure to another."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.promise import STARTS
from shipfp_rs.identification.search import Search
from shipfp_rs.support.arrays import Array

GAINS = ("K_p", "K_i", "vK_p", "vK_i")
"""Parameters that an unstable loop has too much of."""
STEADIER = 0.8
"""Part of such gains with which a start is tried next."""
STEADYINGS = 12
"""Times that is tried."""
DELAYS = ("T_d", "T_set", "tau_act")
"""Parameters that delay the shaft's answer: what one did, another does nearly as well."""


def stable_start(search: Search, values: Mapping[str, float]) -> Array:
    """Return a start vector with the gains less until the loop is stable: that of a ship that was measured is."""
    for _ in range(STEADYINGS):
        vector = start_vector(search, values)
        try:
            search.require_stable(vector)
        except SimulationError:
            values = {name: value * (STEADIER if name in GAINS else 1.0) for name, value in values.items()}
            continue
        break
    return vector


def start_vector(search: Search, values: Mapping[str, float]) -> Array:
    """Return values in the order of the search's unknowns and within its bounds; its own starts where one is missing."""
    starts = {parameter.name: parameter.start for parameter in search.free}
    vector = np.array([values.get(name, starts.get(name, 0.0)) for name in search.unknowns])
    lower, upper = search.bounds()
    return np.asarray(np.clip(vector, lower, upper))


def starts_from(search: Search, values: Mapping[str, float]) -> list[Array]:
    """Start vectors of a structure from another one's end, one for each start that a new element has."""
    new = [name for name in search.names if name not in values]
    first = start_vector(search, values)
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
    return vectors[1:] if new else vectors
