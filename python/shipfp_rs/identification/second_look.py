"""A second look: the data's own starts once more, with the elements that were found meanwhile."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from shipfp_rs.errors import IdentificationError, SimulationError
from shipfp_rs.identification.chooser import NEARLY, SAME, Chooser
from shipfp_rs.identification.first_ends import START_EVALUATIONS, distinct, ends_of
from shipfp_rs.identification.fitted import Fitted, cost
from shipfp_rs.identification.promise import PROPELLER_PART
from shipfp_rs.identification.search import LITTLE, Search
from shipfp_rs.identification.starts import both_ended
from shipfp_rs.support.threads import where_alone

LOGGER = logging.getLogger("shipfp_rs")

LITTLE_LAG_S = 0.01
"""Lag beside a start, whose dead times have all of the delay already [s]."""
TWISTS = tuple(product((0.25, 0.6), (5e-4, 2e-3, 8e-3)))
"""Part of the inertia behind the shaft, and its twist, from which a structure with a twist is tried: a light end and a heavy
one, on a stiff shaft and a soft one, may swing at the same frequency."""


def second_look(chooser: Chooser, current: Fitted, others: Sequence[Sequence[str]] = ()) -> Fitted:
    """Fit structures from the data's own starts; return the best end, or the fit given where none is better.

    The first structure, without a shaft's twist or a lag, may have led all starts to delays from which the right ones are
    not found any more. Beside the fit's own structure `others` are tried, by their elements.
    """
    values = current.search.values(current.minimum.vector)
    here = _brief(current.search).minimise(current.minimum.vector)
    fits = []
    for elements in (current.elements, *map(chooser.ordered, others)):
        own = current.search if elements == current.elements else _search(chooser, current, elements)
        known = {"tau_prop": PROPELLER_PART * values["tau_n"], **values}
        known = {name: known[name] for name in own.names if name in known}
        begins = [{**known, "tau_act": LITTLE_LAG_S, **begin} for begin in chooser.begins]
        if "tau_twist" in own.names and "tau_prop" not in chooser.begins[0]:
            begins += [
                {**known, "tau_prop": part * values["tau_n"], "tau_twist": twist} for part, twist in TWISTS
            ]
        ends = ends_of(_brief(own), begins)
        beside = [here] if own is current.search else []
        fits += [
            Fitted(elements, own, end)
            for end in distinct(own, [*beside, *ends])
            if end is not here and end.criterion < here.criterion + NEARLY
        ]
    found = where_alone([partial(_refined, chooser, fit) for fit in fits])
    best = min((fit for fit in found if fit is not None), key=cost, default=current)
    return best if cost(best) < cost(current) - SAME else current


def _brief(search: Search) -> Search:
    return replace(
        search,
        noise="white",
        weights=None,
        enough=LITTLE,
        worth=np.inf,
        max_evaluations=START_EVALUATIONS,
    )


def _search(chooser: Chooser, current: Fitted, elements: Sequence[str]) -> Search:
    """Return the search of other elements over the records of a fit, on its way to a minimum."""
    search = chooser.search(elements, current.records)
    if "twist" in elements and "tau_prop" in current.search.names:
        behind = current.search.values(current.minimum.vector)["tau_prop"]
        search = replace(search, structure=both_ended(search.structure, behind))
    return search


def _refined(chooser: Chooser, fit: Fitted) -> Fitted | None:
    try:
        return chooser.refined(fit)
    except (IdentificationError, SimulationError) as error:
        LOGGER.debug("identify: the end of another start could not be fitted: %s", error)
        return None
