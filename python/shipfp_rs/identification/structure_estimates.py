"""The fingerprint of a given structure: values, intervals, and reasons where the data determine none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.adequacy import misses_of, misses_pct, stands, structure_test
from shipfp_rs.identification.coordinates import Figure
from shipfp_rs.identification.estimate import (
    ASSUMED,
    Estimate,
    Identifiability,
    Status,
    unidentifiable,
    with_interval,
)
from shipfp_rs.identification.fingerprint import (
    Fingerprint,
    record_row,
    search_settings,
)
from shipfp_rs.identification.fit_statistics import information_criteria
from shipfp_rs.identification.identifiability import (
    Sensitivity,
    describe,
    gradient_of,
    why_unknown,
    without_nuisance,
)
from shipfp_rs.identification.profiles import (
    RISE,
    Interval,
    Profiles,
    figures_of,
    profiled,
    scaled_inverse,
)
from shipfp_rs.identification.residual_tests import residual_tests
from shipfp_rs.identification.ship_model import ShipModel
from shipfp_rs.identification.structure_fit import StructureFit, refined
from shipfp_rs.identification.structure_models import InBand, Response, Samples, Seen
from shipfp_rs.identification.verdict import Told
from shipfp_rs.structures.structure import Parameter, Structure
from shipfp_rs.structures.ties import COMBINATIONS
from shipfp_rs.support.arrays import DEVIATIONS_95, Array, Mask, Numbers
from shipfp_rs.support.sentences import Sentence

ON_BOUND = 1e-5
"""Largest distance at which a parameter is on a bound, relative to the bound's size or, if less, the width between the
bounds."""
CUT = 10.0
"""Along a null direction parameters can move only until one of them meets a bound. A parameter that moves by less than this
many standard deviations still has an interval."""
SHORT = 1e-3
"""A parameter also has an interval if it moves by less than this share of the width between its bounds (see `CUT`)."""
EDGE = 1e-6
"""Share of the parameter's size that replaces `CUT` where the standard deviation is zero."""
SHARPER = 1.0 / 3.0
"""Largest ratio of a listed combination's relative deviation to the largest relative deviation of combined parameters."""
STILL = 1e-4
"""Largest p-value of the explained deviance at which the fit is significant."""

TAKEN_FOR_TORQUE = Sentence(
    "The command is taken as the drive's torque (v = 1, g = 0), since no torque was measured. Of any other "
    "command only tau_n / v and (p - g) / v are known."
)


@dataclass(frozen=True)
class StructureEstimates:
    """Estimates of each parameter and their covariance at a minimum."""

    fit: StructureFit

    @property
    def structure(self) -> Structure:
        """The fitted structure."""
        return self.fit.structure

    @cached_property
    def values(self) -> dict[str, float]:
        """Parameters at the best minimum; values very close to a bound are set to it."""
        values = self.fit.likelihood.coordinates.values(self.fit.best.vector)
        for parameter in self.structure.free:
            bound = _bound(parameter, values[parameter.name])
            if bound is not None:
                values[parameter.name] = bound
        return self.structure.complete(values)

    @cached_property
    def narrower(self) -> float:
        """Factor on standard deviations by curvature, so that all 95 % intervals end at the same rise of the deviance."""
        return DEVIATIONS_95 / self.fit.likelihood.quantile

    @cached_property
    def own(self) -> Array:
        """Derivatives (R, P) by the free parameters in units of the noise, with the records' unknowns projected out."""
        likelihood, count = self.fit.likelihood, len(self.structure.free)
        jacobian = likelihood.whitened(self.fit.best.vector)[:, 1:]
        if not _responds(self.fit):
            priors = (
                len(likelihood.prior_rows(self.fit.best.vector))
                + jacobian.shape[1]
                - likelihood.coordinates.size
            )
            jacobian[: len(jacobian) - priors] = 0.0
        by = likelihood.coordinates.jacobian(self.values).diagonal()
        return np.asarray(without_nuisance(jacobian, count) / by)

    @cached_property
    def scale(self) -> Array:
        """Typical sizes of the parameters, also for values near zero, (P,)."""
        return np.array([max(abs(self.values[one.name]), one.scale) for one in self.structure.free])

    @cached_property
    def everything(self) -> Sensitivity:
        """Sensitivity of the data to all free parameters."""
        return Sensitivity.of(self.own, [one.name for one in self.structure.free], self.scale)

    @cached_property
    def inward(self) -> npt.NDArray[np.int_]:
        """+1 for each parameter on its lower bound, -1 on its upper one, 0 between them."""
        return np.array([_inward(one, self.values[one.name]) for one in self.structure.free], dtype=int)

    @cached_property
    def on_bound(self) -> Mask:
        """Whether a bound holds each parameter."""
        return self.everything.held_by_bounds(self.inward)

    @cached_property
    def held(self) -> Mask:
        """Whether the data press each parameter to a bound: beyond it the deviance would fall by more than the quantile."""
        now = self.fit.best.products or self.fit.likelihood.products(self.fit.best.vector)
        count = len(self.inward)
        held = np.zeros(count, dtype=bool)
        for index in map(int, np.flatnonzero(self.on_bound)):
            others = [i for i in range(len(now.downhill)) if i >= count or not self.on_bound[i] or i == index]
            place = others.index(index)
            variance = scaled_inverse(now.matrix[np.ix_(others, others)])[place, place]
            held[index] = now.downhill[index] ** 2 * variance > RISE
        return held

    @cached_property
    def inner(self) -> Sensitivity:
        """Sensitivity of the data to the parameters that are not held."""
        names = [name for name, held in zip(self.everything.names, self.held, strict=True) if not held]
        return Sensitivity.of(self.own[:, ~self.held], names, self.scale[~self.held])

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the parameters that are not held, (P, P); infinite where too few samples leave it unknown."""
        covariance = self.inner.covariance() * self.narrower**2
        return np.full_like(covariance, np.inf) if self.fit.likelihood.untold else covariance

    @cached_property
    def reasons(self) -> dict[str, str]:
        """Reason why the data do not determine a parameter, for each such parameter."""
        centre = np.array([self.values[one.name] for one in self.structure.free])
        low, high = np.array([(one.lower, one.upper) for one in self.structure.free]).T
        reach = self.everything.reach(centre, low, high)
        reasons = {
            one.name: self._reason(index, one, float(reach[index]))
            for index, one in enumerate(self.structure.free)
            if not self.held[index]
        }
        return {name: reason for name, reason in reasons.items() if reason}

    def _reason(self, index: int, parameter: Parameter, reach: float) -> str:
        """Reason why a parameter has no interval, empty if it has one; `reach` is its range along null directions."""
        place = self.inner.names.index(parameter.name)
        variance = float(self.covariance[place, place])
        # A parameter on a bound has an interval even where bounds cut a null direction.
        open_over = CUT * float(np.sqrt(variance)) + EDGE * self.scale[index]
        cut = reach < min(open_over, SHORT * (parameter.upper - parameter.lower))
        reason = "" if self.on_bound[index] or cut else why_unknown(self.everything, index)
        if not reason and not np.isfinite(variance):
            reason = Sentence("too few samples for an uncertainty")
        return reason

    @property
    def figures(self) -> dict[str, Figure]:
        """Parameters whose interval is wanted: neither held by a bound nor undetermined."""
        return figures_of([name for name in self.inner.names if name not in self.reasons])

    def parameters(self, intervals: Mapping[str, Interval]) -> dict[str, Estimate]:
        """Return the estimates of all parameters, with the intervals of `figures`."""
        found = {
            one.name: self._estimate(index, one, intervals) for index, one in enumerate(self.structure.free)
        }
        for one in self.structure.parameters:
            if one.fixed:
                reason = ASSUMED if one.name in self.fit.question.assumed else "given"
                found[one.name] = Estimate(one.start, unit=one.unit, status="fixed", reason=reason)
        return with_tied(found, self.structure)

    def _estimate(self, index: int, parameter: Parameter, intervals: Mapping[str, Interval]) -> Estimate:
        value, unit, bounds = self.values[parameter.name], parameter.unit, (parameter.lower, parameter.upper)
        is_lower = value == parameter.lower
        if self.held[index]:
            said = (
                Sentence("pressed against its lower bound {bound}")
                if is_lower
                else Sentence("pressed against its upper bound {bound}")
            )
            where = Sentence(said, bound=f"{value:g}")
            return Estimate(value, unit=unit, status="at_bound", reason=where)
        if parameter.name in self.reasons:
            return unidentifiable(self.reasons[parameter.name], unit)
        interval, quantile = intervals[parameter.name].ends, self.fit.likelihood.quantile
        status: Status = "free" if parameter.prior is None else "prior"
        estimate = with_interval(value, interval, unit, status, bounds=bounds, quantile=quantile)
        if not self.inward[index] or estimate.ci95 is None:
            return estimate
        said = (
            Sentence("on its lower bound {bound}; the data allow up to {end}")
            if is_lower
            else Sentence("on its upper bound {bound}; the data allow down to {end}")
        )
        where = Sentence(said, bound=f"{value:g}", end=f"{estimate.ci95[1 if is_lower else 0]:.4g}")
        return replace(estimate, std=None, status="at_bound", reason=where)

    def derived(self, parameters: Mapping[str, Estimate]) -> dict[str, Estimate]:
        """Return the combinations that the data determine, although they hardly determine one of the parameters."""
        found: dict[str, Estimate] = {}
        if self.fit.likelihood.untold:
            return found
        curved = self.structure.settings["kind"] == "ship"
        for name, (unit, function) in COMBINATIONS.items():
            try:
                value = function(self.values)
                gradient = gradient_of(function, self.values, self.everything.names, self.structure.ties)
            except (KeyError, ZeroDivisionError):
                continue
            members = [n for n, slope in zip(self.everything.names, gradient, strict=True) if slope != 0.0]
            # A nonlinear model makes every parameter slightly identifiable. Then combinations that are much better known
            # than one of their parameters count, too.
            each = all(parameters[member].status in ("free", "prior", "fixed") for member in members)
            if (each and not curved) or not self.everything.tells(gradient):
                continue
            part = np.array([gradient[self.everything.names.index(n)] for n in self.inner.names])
            if not np.any(part) or not self.inner.tells(part):
                continue
            std = float(np.sqrt(max(part @ self.covariance @ part, 0.0)))
            if not np.isfinite(std) or std > abs(value):
                continue
            widest = max((_relative(parameters[member]) for member in members), default=0.0)
            if each and std / abs(value) > SHARPER * widest:
                continue
            half = self.fit.likelihood.quantile * std
            ends = value - half, value + half
            found[name] = with_interval(value, ends, unit, quantile=self.fit.likelihood.quantile)
        return found

    @cached_property
    def identifiability(self) -> Identifiability:
        """Rank, null directions, and which further information would determine all parameters."""
        return describe(self.everything)

    def covariances(self) -> Mapping[str, Any]:
        """Return the JSON form of the covariance, empty if one is unknown."""
        if not np.isfinite(self.covariance).all():
            return {"names": [], "matrix": []}
        return {"names": list(self.inner.names), "matrix": self.covariance.tolist()}


def _responds(fit: StructureFit) -> bool:
    """Whether the fit explains the data better than constants, by a likelihood ratio; True with frequency responses."""
    likelihood = fit.likelihood
    if any(isinstance(record, Response) for record in fit.records):
        return True
    # Without excitation, initial states and the parameters of their decay can still be fitted to noise.
    still: list[Numbers] = []
    for record in fit.records:
        own, constant = record.spectrum, np.ones(record.spectrum.shape[1], dtype=complex)
        if isinstance(record, InBand):
            constant = record.seen(np.ones_like(record.measured))[0]
        share = own @ constant.conj() / np.vdot(constant, constant).real
        left = own - share[:, None] * constant if record.unknowns else own
        if isinstance(likelihood.models[0], ShipModel):
            left[:, 0] = 0.0
        still.append(left if np.iscomplexobj(own) else left.real)
    before = likelihood.under(still)
    after = likelihood.under(likelihood.residuals(fit.best.vector))
    return bool(chi2.sf(before - after, likelihood.coordinates.size) < STILL)


def with_tied(parameters: Mapping[str, Estimate], structure: Structure) -> dict[str, Estimate]:
    """Add tied parameters, in the structure's order."""
    found = dict(parameters)
    for name, tie in structure.ties.items():
        other = parameters[tie.to]
        low, high = sorted(map(tie, other.ci95 or (0.0, 0.0)))
        found[name] = Estimate(
            None if other.value is None else tie(other.value),
            None if other.std is None else abs(tie.factor) * other.std,
            None if other.ci95 is None else (low, high),
            structure[name].unit,
            other.status,
            Sentence("tied as {tie}", tie=tie),
        )
    return {name: found[name] for name in structure.names}


def _bound(parameter: Parameter, value: float) -> float | None:
    for bound in (parameter.lower, parameter.upper):
        room = ON_BOUND * min(abs(bound) or np.inf, parameter.upper - parameter.lower)
        if np.isfinite(bound) and abs(value - bound) <= room:
            return bound
    return None


def _inward(parameter: Parameter, value: float) -> int:
    return int(value == parameter.lower) - int(value == parameter.upper)


def _relative(estimate: Estimate) -> float:
    if estimate.std is None or not estimate.value:
        return 0.0
    return estimate.std / abs(estimate.value)


def _with_intervals(fit: StructureFit) -> tuple[StructureEstimates, Mapping[str, Interval]]:
    """Return the estimates and intervals at the lowest minimum: a profile may find a lower minimum than the fit."""
    found = StructureEstimates(fit)
    if fit.question.options.intervals == "symmetric":
        profiles = Profiles(fit.likelihood, list(fit.basins))
        return found, {name: profiles.symmetric(figure) for name, figure in found.figures.items()}
    bounds = {one.name: (one.lower, one.upper) for one in fit.structure.free}
    lower, profiles, intervals = profiled(fit, found.figures, refined, bounds)
    if lower is not fit:
        found = StructureEstimates(lower)
        wanted = {name: figure for name, figure in found.figures.items() if name not in intervals}
        intervals |= {name: profiles.interval(figure) for name, figure in wanted.items()}
    return found, intervals


def structure_told(fit: StructureFit) -> Told:
    """Return the fingerprint of a structure's fit, and what its verdict needs."""
    structure, options = fit.structure, fit.question.options
    found, intervals = _with_intervals(fit)
    fit, parameters = found.fit, found.parameters(intervals)
    derived = found.derived(parameters)
    records, tests = fit.records, residual_tests(fit)
    by_record = _fits(fit)
    rows = _mean_fits(records, structure, by_record)
    table = {
        output: row | (tests[output].figures() if output in tests else {}) for output, row in rows.items()
    }
    overall = _overall(fit, found)
    overall |= structure_test({output: test.figures() for output, test in tests.items()})
    # In closed form the misfit is computed as for a ship, whose elements are selected; else residuals test the structure.
    closed = isinstance(fit.likelihood.models[0], ShipModel) and fit.likelihood.models[0].noise != "white"
    samples = next((test.samples for test in tests.values()), 1)
    missed = misses_pct(fit.likelihood, fit.best.vector) if closed else []
    misses = dict(zip(structure.outputs, missed, strict=True)) if closed else misses_of(table, samples)
    tested = "structure_p" in overall
    adequate = {
        "stands": stands(misses, None if closed else overall.get("structure_p")),
        "misses_pct": misses,
    }
    fingerprint = Fingerprint(
        parameters=parameters,
        derived=derived,
        covariance=found.covariances(),
        identifiability=found.identifiability,
        fit={**table, "overall": overall},
        residuals={output: test.correlograms() for output, test in tests.items()},
        structure=structure.to_dict(),
        data=tuple(
            record_row(
                record.data, dict(zip(structure.outputs, record.signals, strict=True)), fits, record.used
            )
            for record, fits in zip(records, by_record, strict=True)
        ),
        settings={
            "noise": _noise(records),
            "intervals": options.intervals,
            "starts": options.starts_for(structure),
            "time_limit_s": options.time_limit_s,
            **search_settings(fit, {name: found.values[name] for name in structure.names}),
        },
        adequate=adequate if closed or tested else {},
        verdict=(TAKEN_FOR_TORQUE,) if "v" in fit.question.assumed else (),
    )
    return Told(
        fingerprint,
        [record.data for record in records if isinstance(record.data, Experiment)],
        is_short=not (closed or tested) and any(isinstance(one, Samples) for one in records),
        contradicted=not (closed and adequate["stands"]),
    )


def _noise(records: Sequence[Seen]) -> str:
    kinds = [
        "coloured"
        if isinstance(one, InBand) and not one.white
        else "std"
        if isinstance(one, Response) and one.weighed
        else "white"
        for one in records
    ]
    return kinds[0]


def _fits(fit: StructureFit) -> list[list[float]]:
    """Fit of each output's simulation, for each record [%]."""
    return [record.fit_pct(fit.known(index)) for index, record in enumerate(fit.records)]


def _mean_fits(
    records: Sequence[Seen], structure: Structure, by_record: Sequence[Sequence[float]]
) -> dict[str, dict[str, float | None]]:
    weights = [record.used for record in records]
    return {
        output: {"nrmse_pct": float(np.average([row[place] for row in by_record], weights=weights))}
        for place, output in enumerate(structure.outputs)
    }


def _overall(fit: StructureFit, found: StructureEstimates) -> dict[str, float | None]:
    """Figures of the whole fit: information criteria for white noise, chi-squared for known deviations."""
    likelihood, vector = fit.likelihood, fit.best.vector
    outputs, rank = len(likelihood.accuracy), found.everything.rank
    unknown = likelihood.coordinates.size - len(likelihood.coordinates.free)
    residuals = likelihood.residuals(vector)
    rows = np.concatenate(
        [np.concatenate([one.real, one.imag], axis=1) if np.iscomplexobj(one) else one for one in residuals],
        axis=1,
    )
    samples = rows.shape[1]
    if _noise(fit.records) == "white":
        return information_criteria(rows @ rows.T / samples, samples, rank + unknown)
    figures: dict[str, float | None] = {"samples": float(samples), "deviance": fit.total}
    if _noise(fit.records) == "std":
        freedom = samples * outputs - rank - unknown
        figures |= {"chi_squared": likelihood.cost(vector), "degrees_of_freedom": float(freedom)}
    return figures
