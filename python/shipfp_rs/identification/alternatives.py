"""Parameter sets that the data do not reject beside the estimate: of rival structures, and with what was left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from shipfp_rs.identification.choose import Choice
from shipfp_rs.identification.promise import PROPELLER_PART, Neglect
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.support.quantiles import DEVIATIONS_95


def alternatives(choice: Choice) -> list[dict[str, Any]]:
    """Return elements and parameters of every alternative; what follows from parameters follows from these too.

    An alternative with "neglected", an element's name, is the estimate moved to where a fit with that element at its 95 %
    limit would be, to first order. One without is a structure that fits as well, at its own estimate.
    """
    found = []
    for rival in choice.rivals:
        values = _of(rival.search.values(rival.minimum.vector), rival.search.structure.names)
        if "tau_prop" in choice.best.search.structure.names:
            # Before a shaft that does not twist all of the inertia is one.
            values.setdefault("tau_prop", values["tau_n"])
        found.append({"elements": list(rival.elements), "optimum": values})
    for name, ways in choice.neglected.items():
        found += [{**moved, "neglected": name} for moved in _moved(choice, name, ways)]
    return found


def _moved(choice: Choice, name: str, ways: tuple[Neglect, ...]) -> Iterator[dict[str, Any]]:
    search, parameters = choice.best.search, ELEMENTS[name].parameters
    values = _of(search.values(choice.best.minimum.vector), search.structure.names)
    for way in ways:
        strength = max(way.estimate, 0.0) + DEVIATIONS_95 * way.deviation
        strength = strength ** (1.0 / way.power)
        if not np.isfinite(strength):
            continue
        # A dead time that an element takes over may have been none.
        there = values | ({"T_d": 0.0} if "T_d" in way.shift and "T_d" not in values else {})
        moved = {key: value + strength * way.shift.get(key, 0.0) for key, value in there.items()}
        for parameter in search.structure.parameters:
            moved[parameter.name] = float(np.clip(moved[parameter.name], parameter.lower, parameter.upper))
        moved["T_d"] = max(moved.get("T_d", 0.0), 0.0)
        for parameter in parameters[1:]:
            moved[parameter.name] = parameter.start
        moved[parameters[0].name] = strength
        moved.setdefault("tau_prop", PROPELLER_PART * moved["tau_n"])
        yield {"elements": [*choice.best.elements, name], "optimum": moved}


def _of(values: Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
    return {name: float(values[name]) for name in names}
