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
Drawn = tuple[Array, Array, Array]
"""Values, rises of the cost and all best values along one side."""

LEVEL = float(chi2.ppf(0.95, 1))
"""Deviance at the ends of a 95 % interval, 3.84."""
BEYOND = 1.5
"""How far past an end that the data set a profile is drawn, in distances from the minimum to it."""
POINTS = 12
"""Of each side."""
CONFIRMED = 0.9
"""Part of the level that the deviance past an end reaches, or the end is none."""
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
    lower, low = _side(profile, parameter, index, value, -1.0, threshold)
    upper, high = _side(profile, parameter, index, value, 1.0, threshold)
    places = np.concatenate([low[0][::-1], [value], high[0]])
    rise = np.concatenate([low[1][::-1], [0.0], high[1]])
    vectors = np.concatenate([low[2][::-1], profile.minimum[None], high[2]])
    others = {name: vectors[:, place] for place, name in enumerate(names) if place != index}
    set_by_data = sum(end.kind == "data" for end in (lower, upper))
    kinds: tuple[Kind, ...] = ("flat", "one-sided", "bounded")
    return Likelihood(
        parameter.name,
        parameter.unit,
        value,
        places,
        rise * LEVEL / threshold,
        others,
        (lower.value, upper.value),
        kinds[set_by_data],
    )


def _side(
    profile: Profile, parameter: Parameter, index: int, value: float, sign: float, threshold: float
) -> tuple[End, Drawn]:
    """Return the end on one side and what is drawn of it.

    Along a floor the search for an end may lose the other parameters, and where it does so hangs on the last digit. Such
    an end is none if the deviance drawn past it stays below the level.
    """
    scale = max(abs(value), parameter.scale)
    bound = parameter.lower if sign < 0.0 else parameter.upper
    far = bound if np.isfinite(bound) else value + sign * WITHOUT_BOUND * scale
    end = profile.end(index, sign * 0.01 * scale, threshold)
    passed = value + BEYOND * (end.value - value) if end.kind == "data" else far
    reach = float(np.clip(passed, min(bound, value), max(bound, value)))
    drawn = _drawn(profile, index, value, reach, threshold)
    if end.kind == "bound" or (end.kind == "data" and drawn[1].max(initial=0.0) > CONFIRMED * threshold):
        return end, drawn
    if reach != far:
        drawn = _drawn(profile, index, value, far, threshold)
    return _end_of(drawn, value, bound, sign, threshold), drawn


def _end_of(drawn: Drawn, value: float, bound: float, sign: float, threshold: float) -> End:
    """Where what is drawn first passes the level."""
    places, rise = np.append(value, drawn[0]), np.append(0.0, drawn[1])
    above = np.flatnonzero(rise >= threshold)
    if not above.size:
        return End(bound, "bound") if np.isfinite(bound) else End(sign * np.inf, "open")
    first = slice(above[0] - 1, above[0] + 1)
    return End(float(np.interp(np.sqrt(threshold), np.sqrt(rise[first]), places[first])), "data")


def _drawn(profile: Profile, index: int, value: float, reach: float, threshold: float) -> Drawn:
    if reach == value:
        return np.empty(0), np.empty(0), np.empty((0, len(profile.minimum)))
    places = np.linspace(value, reach, POINTS + 1)[1:]
    return places, *profile.trace(index, places, threshold)
