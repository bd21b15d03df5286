"""Profile likelihoods to look at: how the best fit worsens as one parameter goes along, and whether the data end it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.stats import chi2

from shipfp_rs.errors import InputError
from shipfp_rs.identification.blocks import Data
from shipfp_rs.identification.estimates import estimates
from shipfp_rs.identification.identify import options_of
from shipfp_rs.identification.minima import search_minima
from shipfp_rs.identification.profile import End, Profile
from shipfp_rs.structures.structure import Parameter, Structure
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array

Kind = Literal["bounded", "one-sided", "flat"]

LEVEL = float(chi2.ppf(0.95, 1))
"""Deviance at the ends of a 95 % interval, 3.84."""
BEYOND = 1.5
"""How far past an end that the data set a profile is drawn, in distances from the minimum to it."""
POINTS = 12
"""Of each side."""
WITHOUT_BOUND = 10.0
"""Typical sizes to which a profile without end or bound is drawn."""


@dataclass(frozen=True)
class Likelihood:
    """Profile likelihood of one parameter.

    Parameters
    ----------
    name, unit
        Of the parameter.
    value
        At the minimum.
    values
        Of the parameter, ascending, shape (K,).
    deviance
        Twice the fall of the log likelihood below its maximum at each, all other parameters at their best, in units in
        which the 95 % interval ends at 3.84; infinite where the model can't be simulated, shape (K,).
    others
        The other searched parameters' best values along it, shape (K,) each: where a valley leads.
    interval
        Where the deviance passes 3.84; infinite where nothing ends it, a bound where that comes first.
    kind
        "bounded": the data end the interval on both sides; "one-sided": on one, a bound or nothing on the other;
        "flat": on none, the data do not tell this parameter.
    """

    name: str
    unit: str
    value: float
    values: Array
    deviance: Array
    others: Mapping[str, Array]
    interval: tuple[float, float]
    kind: Kind

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form; what is infinite is None."""

        def plain(values: Sequence[float] | Array) -> list[float | None]:
            return [float(value) if np.isfinite(value) else None for value in values]

        return {
            "name": self.name,
            "unit": self.unit,
            "value": self.value,
            "kind": self.kind,
            "interval": plain(self.interval),
            "values": plain(self.values),
            "deviance": plain(self.deviance),
            "others": {name: plain(row) for name, row in self.others.items()},
        }

    def __str__(self) -> str:
        unit = "" if self.unit == "-" else f" {self.unit}"
        low, high = self.interval
        match self.kind:
            case "bounded":
                return f"{self.name} is bounded: {self.value:.4g} ({low:.4g} to {high:.4g}){unit}"
            case "one-sided":
                return (
                    f"{self.name} is one-sided: {low:.4g} to {high:.4g}{unit}, of which the data set one end"
                )
            case _:
                return f"{self.name} is flat: the data allow everything from {low:.4g} to {high:.4g}{unit}"


@checked
def profile_likelihood(
    data: Data | Sequence[Data],
    structure: Structure,
    parameters: Sequence[str] | None = None,
    **options: Any,
) -> tuple[Likelihood, ...]:
    """Fit, then lead each parameter away from its best value and fit the others again at every step.

    Parameters
    ----------
    data, structure
        As for `identify`.
    parameters
        Names; by default all that are searched for.
    options
        Of `identify`.

    Returns
    -------
    tuple of Likelihood
        One a parameter, in the order of the names.

    Raises
    ------
    InputError
        For a name that is not searched for, and as `identify`.
    IdentificationError
        As `identify`.

    Notes
    -----
    The weights and noise models of the minimum are held. D. J. Venzon and S. H. Moolgavkar, 10.2307/2347496; for the three
    kinds A. Raue et al., 10.1093/bioinformatics/btp358, who call them identifiable, practically and structurally
    unidentifiable.

    Examples
    --------
    >>> from shipfp_rs.reproduce.fullscale import extended_structure, measured_response
    >>> data, structure = measured_response(1.637), extended_structure()
    >>> for found in profile_likelihood(data, structure, ["p", "v"], weighting="std", starts=8):
    ...     print(found.name, found.kind)
    p bounded
    v flat
    """
    ended = search_minima(data, structure, options_of(options))
    search, best = ended.search, ended.best
    wanted = search.names if parameters is None else tuple(parameters)
    for name in wanted:
        if name not in search.names:
            raise InputError(f"no free parameter {name!r}, {hints.suggestion(name, list(search.names))}")
    told, profile = estimates(search, best), Profile(search, best)
    return tuple(
        _likelihood(profile, search.free[index], index, search.names, told.values[name], told.threshold[name])
        for name, index in ((name, search.names.index(name)) for name in wanted)
    )


def _likelihood(
    profile: Profile, parameter: Parameter, index: int, names: Sequence[str], value: float, threshold: float
) -> Likelihood:
    scale = max(abs(value), parameter.scale)
    ends, sides = [], []
    for sign in (-1.0, 1.0):
        end = profile.end(index, sign * 0.01 * scale, threshold)
        bound = parameter.lower if sign < 0.0 else parameter.upper
        ends.append(end)
        reach = _reach(end, value, bound, sign * WITHOUT_BOUND * scale)
        sides.append(_side(profile, index, value, reach, threshold))
    low, high = sides
    places = np.concatenate([low[0][::-1], [value], high[0]])
    rise = np.concatenate([low[1][::-1], [0.0], high[1]])
    vectors = np.concatenate([low[2][::-1], profile.minimum[None], high[2]])
    others = {name: vectors[:, place] for place, name in enumerate(names) if place != index}
    set_by_data = sum(end.kind == "data" for end in ends)
    kinds: tuple[Kind, ...] = ("flat", "one-sided", "bounded")
    return Likelihood(
        parameter.name,
        parameter.unit,
        value,
        places,
        rise * LEVEL / threshold,
        others,
        (ends[0].value, ends[1].value),
        kinds[set_by_data],
    )


def _reach(end: End, value: float, bound: float, far: float) -> float:
    """How far to draw: past an end that the data set, else to the bound or far enough."""
    if end.kind == "data":
        wanted = value + BEYOND * (end.value - value)
    else:
        wanted = end.value if np.isfinite(end.value) else value + far
    return float(np.clip(wanted, min(bound, value), max(bound, value)))


def _side(
    profile: Profile, index: int, value: float, reach: float, threshold: float
) -> tuple[Array, Array, Array]:
    if reach == value:
        return np.empty(0), np.empty(0), np.empty((0, len(profile.minimum)))
    places = np.linspace(value, reach, POINTS + 1)[1:]
    return places, *profile.trace(index, places, threshold)
