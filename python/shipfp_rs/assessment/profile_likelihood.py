"""Whether data bound a parameter: profile likelihoods, and the leverage of a frequency response's points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.stats import chi2

from shipfp_rs.errors import InputError
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.basins import descend
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identifiability import Sensitivity
from shipfp_rs.identification.identify import options_of
from shipfp_rs.identification.noise import real_rows
from shipfp_rs.identification.profiles import Interval, figures_of, profiled
from shipfp_rs.identification.structure_estimates import StructureEstimates
from shipfp_rs.identification.structure_fit import LAST as SETTLED
from shipfp_rs.identification.structure_fit import STEPS, StructureQuestion, fit_structure, refined
from shipfp_rs.identification.structure_models import Data, seen
from shipfp_rs.structures.structure import Parameter, Structure
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array, Brief
from shipfp_rs.support.files import finite
from shipfp_rs.support.threads import with_one_blas_thread


@checked
def leverage(
    data: FrequencyResponse, structure: Structure, fingerprint: Fingerprint
) -> Mapping[str, tuple[Array, Array]]:
    """Return the leverage of each point's amplitude and phase.

    The diagonal of the hat matrix: 0 if the fit would be the same without the point, 1 if the point alone determines a
    direction of the parameters. The sum of all leverages is the number of identifiable directions, less the
    information from priors.

    Parameters
    ----------
    data
        Response of the fit, with standard deviations.
    structure
        Structure of the fit.
    fingerprint
        Result of `identify(data, structure, noise="std")`.

    Returns
    -------
    dict
        For each signal name the leverage of amplitudes and of phases, shape (F,) each; zero where a point is missing.

    Raises
    ------
    InputError
        If the fit was not weighted by the points' standard deviations.

    Notes
    -----
    D. C. Hoaglin and R. E. Welsch, "The hat matrix in regression and ANOVA", 10.1080/00031305.1978.10479237.
    """
    if (noise := fingerprint.settings.get("noise")) != "std":
        raise InputError(f"leverage: the fit's noise is {noise!r}, expected 'std'")
    record = seen(data, structure, "std")
    values = dict(fingerprint.optimum)
    free = structure.free
    _, slopes = record.evaluate(values, [parameter.name for parameter in free])
    rows = real_rows(slopes).T
    scale = np.array([max(abs(values[parameter.name]), parameter.scale) for parameter in free])
    priors = [
        row / parameter.prior[1]
        for row, parameter in zip(np.eye(len(free)), free, strict=True)
        if parameter.prior is not None
    ]
    told = Sensitivity.of(np.vstack([rows, *priors]), [parameter.name for parameter in free], scale)
    share = np.einsum("ri,ij,rj->r", rows, told.covariance(), rows).reshape(2, len(structure.outputs), -1)
    whole = np.zeros((*share.shape[:2], len(data)))
    whole[..., record.valid] = share
    return {signal: (whole[0, place], whole[1, place]) for place, signal in enumerate(record.signals)}


Kind = Literal["bounded", "one-sided", "flat"]
Drawn = tuple[Array, Array, Array]
"""Values of a parameter on one side of the minimum, increases of the cost there, and best values of all parameters."""

LEVEL = float(chi2.ppf(0.95, 1))
"""Deviance at the ends of a 95 % interval, 3.84."""
BEYOND = 1.5
"""Length of a profile on a side where the data determine the interval's end, in distances from minimum to end."""
POINTS = 12
"""Points on each side."""
CONFIRMED = 0.9
"""Fraction of the level that the deviance must reach in a profile past an end; otherwise the end is searched anew."""
FAR = 100.0
"""Largest deviance relative to the level that is used to interpolate an end."""
WITHOUT_BOUND = 10.0
"""Length of a profile on a side without end or bound: a multiple of the parameter's typical size."""


@dataclass(frozen=True, repr=False)
class Likelihood(Brief):
    """Profile likelihood of one parameter.

    Parameters
    ----------
    name, unit
        Name and unit of the parameter.
    value
        Value at the minimum.
    values
        Values of the parameter, ascending, shape (K,).
    deviance
        Twice the decrease of the log likelihood from its maximum at each value, with all other parameters optimised, in
        units in which the 95 % interval ends at 3.84; infinite where the model can't be simulated, shape (K,).
    others
        Best values of the other searched parameters along the profile, shape (K,) each.
    interval
        Ends at which the deviance exceeds 3.84, or the parameter's bound if that comes first; infinite if there
        is neither.
    kind
        "bounded": the data limit the interval on both sides; "one-sided": the data limit it on one side only;
        "flat": the data limit neither side and do not determine this parameter.
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
        """Return the JSON form; infinite values are None."""
        return {
            "name": self.name,
            "unit": self.unit,
            "value": self.value,
            "kind": self.kind,
            "interval": finite(self.interval),
            "values": finite(self.values.tolist()),
            "deviance": finite(self.deviance.tolist()),
            "others": {name: finite(row.tolist()) for name, row in self.others.items()},
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
@with_one_blas_thread
def profile_likelihood(
    data: Data | Sequence[Data],
    structure: Structure,
    parameters: Sequence[str] | None = None,
    **options: Any,
) -> tuple[Likelihood, ...]:
    """Compute profile likelihoods: vary each parameter from its best value and refit the others at every step.

    Parameters
    ----------
    data, structure
        See `identify`.
    parameters
        Names; by default all searched parameters.
    options
        Options of `identify`.

    Returns
    -------
    tuple of Likelihood
        One per parameter, in the order of the names.

    Raises
    ------
    InputError
        For a parameter that is not searched; also see `identify`.
    IdentificationError
        See `identify`.

    Notes
    -----
    The noise is kept as at the minimum. D. J. Venzon and S. H. Moolgavkar, 10.2307/2347496; for the three
    kinds A. Raue et al., 10.1093/bioinformatics/btp358, who call them identifiable, practically and structurally
    unidentifiable.

    Examples
    --------
    >>> from shipfp_rs.reproduce.fullscale import extended_structure, measured_response
    >>> data, structure = measured_response(1.637), extended_structure()
    >>> for found in profile_likelihood(data, structure, ["p", "v"], noise="std", starts=8):
    ...     print(found.name, found.kind)
    p bounded
    v flat
    """
    chosen = options_of(options)
    records = (data,) if isinstance(data, Data) else tuple(data)
    fit = fit_structure(StructureQuestion(records, structure, chosen))
    names = fit.likelihood.coordinates.names
    wanted = names if parameters is None else tuple(parameters)
    for name in wanted:
        if name not in names:
            raise InputError(f"no free parameter {name!r}, {hints.suggestion(name, list(names))}")
    fit, _, intervals = profiled(fit, figures_of(wanted), refined, {})
    told = StructureEstimates(fit)
    free = {one.name: one for one in structure.free}
    return tuple(_likelihood(told, free[name], intervals[name]) for name in wanted)


def _likelihood(told: StructureEstimates, parameter: Parameter, found: Interval) -> Likelihood:
    value, names = told.values[parameter.name], told.fit.likelihood.coordinates.names
    sides = [
        _side(told, parameter, sign, end, kind)
        for sign, end, kind in zip((-1.0, 1.0), (found.low, found.high), found.kinds, strict=True)
    ]
    (lower, low), (upper, high) = sides
    best = [[told.values[name] for name in names]]
    rows = np.concatenate([low[2][::-1], best, high[2]])
    kinds: tuple[Kind, ...] = ("flat", "one-sided", "bounded")
    return Likelihood(
        parameter.name,
        parameter.unit,
        value,
        np.concatenate([low[0][::-1], [value], high[0]]),
        np.concatenate([low[1][::-1], [0.0], high[1]]),
        {name: rows[:, place] for place, name in enumerate(names) if name != parameter.name},
        (lower[0], upper[0]),
        kinds[sum(by_data for _, by_data in (lower, upper))],
    )


def _side(
    told: StructureEstimates, parameter: Parameter, sign: float, end: float, kind: str
) -> tuple[tuple[float, bool], Drawn]:
    """End of the interval on one side, whether the data determine it, and the profile on that side.

    The end of the fit's interval is tested by another profile, which extends past that end. If the deviance in this
    profile stays below 90 % of the level, the end is searched anew.
    """
    value = told.values[parameter.name]
    bound = parameter.lower if sign < 0.0 else parameter.upper
    scale = max(abs(value), parameter.scale)
    far = bound if np.isfinite(bound) else value + sign * WITHOUT_BOUND * scale
    if kind == "data" and sign * (bound - end) > 0.0:
        passed = value + BEYOND * (end - value)
        drawn = _drawn(told, parameter, value, min(max(passed, min(far, value)), max(far, value)))
        if drawn[1].max(initial=0.0) > CONFIRMED * LEVEL:
            return (float(end), True), drawn
    drawn = _drawn(told, parameter, value, far)
    places, rise = np.append(value, drawn[0]), np.append(0.0, drawn[1])
    above = np.flatnonzero(rise >= LEVEL)
    if not above.size:
        return (bound if np.isfinite(bound) else sign * np.inf, False), drawn
    first = slice(above[0] - 1, above[0] + 1)
    known = np.minimum(rise[first], FAR * LEVEL)
    return (float(np.interp(np.sqrt(LEVEL), np.sqrt(known), places[first])), True), drawn


def _drawn(told: StructureEstimates, parameter: Parameter, value: float, reach: float) -> Drawn:
    """Deviance with the parameter at values up to `reach` and all others optimised."""
    names = told.fit.likelihood.coordinates.names
    if reach == value:
        return np.empty(0), np.empty(0), np.empty((0, len(names)))
    spaced = np.geomspace if parameter.name in told.fit.likelihood.coordinates.logarithms else np.linspace
    places = spaced(value, reach, POINTS + 1)[1:]
    best = told.fit.best
    vector = np.delete(best.vector, names.index(parameter.name))
    before, rises, rows = vector, [], []
    for place in places:
        given = told.structure.with_fixed(**{parameter.name: float(place)})
        likelihood = told.fit.likelihood.of_structure(given)
        # Start from an extrapolation of the previous minima, and from the previous point.
        ends = [
            descend(likelihood, start, steps=STEPS, settled=SETTLED)
            for start in (2.0 * vector - before, vector)
        ]
        end = min(ends, key=lambda one: one.cost)
        if np.isfinite(end.cost):
            before, vector = vector, end.vector
        rises.append(max(end.cost - best.cost, 0.0))
        values = likelihood.coordinates.values(vector)
        rows.append([values[name] for name in names])
    return places, np.array(rises), np.array(rows)
