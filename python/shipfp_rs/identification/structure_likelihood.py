"""The likelihood of a given structure: its own equations on experiments, spectra and frequency responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.stats import t as student

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.likelihood import (
    ACCURACY,
    SMALL,
    Figure,
    Likelihood,
    noise_root,
    real_rows,
    spread_of,
)
from shipfp_rs.identification.structure_records import Evaluated, Response, Seen, Spectra
from shipfp_rs.structures.structure import Parameter, Structure
from shipfp_rs.support.arrays import Array, Numbers
from shipfp_rs.support.quantiles import DEVIATIONS_95

STATE_DEVIATION = 1.0
"""Prior deviation of initial states and offsets, over the operating point: so wide that few data notice it."""
LEAST_NOISE, LEAST_OWN = 1e-7, 1e-9
"""Least deviation of white noise over an output's own root mean square, far above rounding, and least part of an output's
variance that is its own."""
FIRST_NOISE = 0.1
"""White noise over an output's spread before any was estimated."""


@dataclass(frozen=True)
class StructureCoordinates:
    """Free parameters of a structure between their bounds, as a vector, with the unknowns of its records behind them."""

    structure: Structure
    unknowns: tuple[tuple[str, ...], ...]
    """Of each record."""

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters."""
        return self.structure.free

    @cached_property
    def free(self) -> dict[str, tuple[float, float]]:
        """Free parameters with their bounds."""
        return {one.name: (one.lower, one.upper) for one in self.parameters}

    @cached_property
    def given(self) -> dict[str, float]:
        """Parameters that are not searched."""
        return {one.name: one.start for one in self.structure.parameters if one.fixed}

    @property
    def records(self) -> int:
        """Number of records."""
        return len(self.unknowns)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.free)

    @cached_property
    def size(self) -> int:
        """Length of a vector."""
        return len(self.free) + sum(map(len, self.unknowns))

    @property
    def state_deviation(self) -> float:
        """Prior deviation of the records' unknowns, over the operating point."""
        return STATE_DEVIATION

    def place(self, name: str) -> int:
        """Place of a parameter in a vector."""
        return self.names.index(name)

    def states(self, record: int) -> slice:
        """Places of a record's own unknowns."""
        first = len(self.free) + sum(map(len, self.unknowns[:record]))
        return slice(first, first + len(self.unknowns[record]))

    @cached_property
    def logarithmic(self) -> frozenset[str]:
        """Parameters that are searched by their logarithm."""
        return frozenset(one.name for one in self.parameters if one.logarithmic)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of a vector."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        for place, (name, ends) in enumerate(self.free.items()):
            low[place], high[place] = np.log(ends) if name in self.logarithmic else ends
        return low, high

    def values(self, vector: Array) -> dict[str, float]:
        """Return the parameters in their own units, those given and tied included."""
        found = dict(self.given)
        for name, x in zip(self.names, vector, strict=False):
            low, high = self.free[name]
            # An exponential of a logarithm may miss a bound by rounding.
            found[name] = float(np.clip(np.exp(x), low, high)) if name in self.logarithmic else float(x)
        return self.structure.complete(found)

    def states_at(self, vector: Array) -> list[dict[str, float]]:
        """Return each record's unknowns by name."""
        return [
            dict(zip(names, vector[self.states(record)].tolist(), strict=True))
            for record, names in enumerate(self.unknowns)
        ]

    def vector(self, values: Mapping[str, float], states: Sequence[Mapping[str, float]] = ()) -> Array:
        """Return the vector of values within the bounds; records' unknowns are zero unless given."""
        vector = np.zeros(self.size)
        for place, name in enumerate(self.names):
            value = values[name]
            vector[place] = np.log(max(value, self.free[name][0])) if name in self.logarithmic else value
        for record, row in enumerate(states):
            vector[self.states(record)] = [row.get(name, 0.0) for name in self.unknowns[record]]
        return np.clip(vector, *self.bounds)

    def slopes(self, values: Mapping[str, float]) -> dict[str, dict[int, float]]:
        """Derivatives of the free parameters by the places of a vector."""
        return {
            name: {place: values[name] if name in self.logarithmic else 1.0}
            for place, name in enumerate(self.names)
        }

    def gradient(self, figure: Figure, vector: Array) -> Array:
        """Derivative of a figure by a vector, tied parameters included, shape (P,)."""
        low, high = self.bounds
        found = np.zeros(self.size)
        for place in range(len(self.free)):
            step = SMALL * max(1.0, abs(vector[place]))
            up, down = vector.copy(), vector.copy()
            up[place] = min(vector[place] + step, high[place])
            down[place] = max(vector[place] - step, low[place])
            found[place] = (figure(self.values(up)) - figure(self.values(down))) / (up[place] - down[place])
        return found


@dataclass(frozen=True, eq=False)
class StructureLikelihood(Likelihood):
    """Of a structure, given records."""

    records: tuple[Seen, ...]
    coordinates: StructureCoordinates

    @classmethod
    def of(cls, records: Sequence[Seen], structure: Structure, *, accurate: bool = False) -> Self:
        """Return it with no noise estimated yet; accurate: without smooth errors, as of data that were computed."""
        accuracy = np.zeros(len(structure.outputs))
        for record in records if not accurate else ():
            if isinstance(record, Spectra):
                said = [record.data.gauge_accuracy.get(signal, ACCURACY) for signal in record.signals]
                accuracy = np.maximum(accuracy, said)
        return cls(
            records=tuple(records),
            coordinates=StructureCoordinates(structure, tuple(record.unknowns for record in records)),
            accuracy=accuracy,
            priors={one.name: one.prior for one in structure.free if one.prior is not None},
        )

    def known(self, vector: Array, record: int) -> dict[str, float]:
        """Parameters and a record's own unknowns by name."""
        c = self.coordinates
        own = vector[c.states(record)]
        return c.values(vector) | dict(zip(self.records[record].unknowns, map(float, own), strict=True))

    def spectra(self, vector: Array, record: int) -> tuple[Numbers, Numbers]:
        """Residuals (O, F) of a record and the model's derivatives by the whole vector (P, O, F)."""
        c, count = self.coordinates, len(self.coordinates.free)
        values = self.known(vector, record)
        residual, slopes = self._evaluate(vector, record, c.names)
        jacobian = np.zeros((c.size, *residual.shape), dtype=slopes.dtype)
        jacobian[:count] = slopes[:count]
        for name in c.logarithmic:
            jacobian[c.place(name)] *= values[name]
        jacobian[c.states(record)] = slopes[count:]
        return residual, jacobian

    def residuals(self, vector: Array, *, wet: bool = True) -> list[Numbers]:
        """For each record the residuals at a vector, (O, F)."""
        del wet
        return [self._evaluate(vector, record, ())[0] for record in range(len(self.records))]

    def _evaluate(self, vector: Array, record: int, names: Sequence[str]) -> Evaluated:
        if not self.records[record].structure.equations.stable(self.coordinates.values(vector)):
            raise SimulationError("the loop is unstable")
        return self.records[record].evaluate(self.known(vector, record), names)

    def modelled(self, vector: Array, record: int) -> Array:
        """Decimated outputs of a record of spectra, (O, K)."""
        own = self.records[record]
        assert isinstance(own, Spectra)
        model, _ = own.simulated(self.known(vector, record), ())
        return own.record.as_recorded(model)

    def root(self, record: int) -> Numbers:
        """Root of the inverse spectral matrix of a record's noise; a part of what it shows before any was estimated."""
        own = self.records[record]
        if self.roots is not None:
            return self.roots[record]
        if isinstance(own, Response) and own.weighed:
            return np.eye(len(self.accuracy))
        spread = own.spectrum.std(axis=1)
        return np.diag(1.0 / (FIRST_NOISE * np.maximum(spread, 1e-6 * max(spread.max(), 1e-6))))

    @cached_property
    def _white_rows(self) -> int:
        """Real numbers of each output in the records whose noise is one covariance."""
        white = (one for one in self.records if _is_white(one))
        return sum(one.used * (2 if isinstance(one, Response) else 1) for one in white)

    @property
    def freedom(self) -> int:
        """Numbers that are left over to tell the noise from, less the unknowns."""
        return len(self.accuracy) * self._white_rows - self.coordinates.size

    @property
    def quantile(self) -> float:
        """Half of an interval of 95 per cent over the standard deviation: noise from few numbers is uncertain itself."""
        if not all(map(_is_white, self.records)):
            return DEVIATIONS_95
        return float(student.ppf(0.975, max(self.freedom, 1)))

    @property
    def untold(self) -> bool:
        """Whether there are too few samples to estimate any noise."""
        return all(map(_is_white, self.records)) and self.freedom <= 0

    def under(self, residuals: Sequence[Numbers]) -> float:
        """Deviance of residuals under their own noise."""
        roots = self._noise(residuals, [np.zeros((len(one), *one.shape)) for one in residuals])
        own = replace(self, roots=roots)
        rows = [own._white(one[None], index) for index, one in enumerate(residuals)]
        return own.spread() + sum(float(np.sum(row**2)) for row in rows)

    def _noise(self, residuals: Sequence[Numbers], unsure: Sequence[Numbers]) -> tuple[Numbers, ...]:
        """For each record the root of the inverse spectral matrix of its residuals; one for all responses.

        White noise allows for what the unknowns took of the residuals, and for the quantile, so that all intervals end at
        the same rise.
        """
        share = max(self.freedom, 1) / max(len(self.accuracy) * self._white_rows, 1)
        responses = [index for index, one in enumerate(self.records) if isinstance(one, Response)]
        found = {}
        for index, (record, residual, own) in enumerate(zip(self.records, residuals, unsure, strict=True)):
            if isinstance(record, Spectra):
                found[index] = noise_root(residual, own)
            elif not _is_white(record):
                found[index] = np.eye(len(residual))
            else:
                pooled = [place for place in responses if _is_white(self.records[place])]
                places = pooled if index in pooled else [index]
                found[index] = self._white_root(residuals, places, share)
        return tuple(found[index] for index in range(len(self.records)))

    def _white_root(self, residuals: Sequence[Numbers], places: Sequence[int], share: float) -> Numbers:
        """Root of the inverse of one covariance of records; share: of the numbers that the unknowns leave."""
        left = np.concatenate([real_rows(residuals[place]) for place in places], axis=1)
        said = np.concatenate([real_rows(self.records[place].spectrum) for place in places], axis=1)
        covariance = left @ left.T / (left.shape[1] * share)
        size = LEAST_NOISE**2 * (np.mean(said**2, axis=1) + 1e-12) + LEAST_OWN * np.diag(covariance)
        root = np.linalg.inv(np.linalg.cholesky(covariance + np.diag(size)))
        return np.asarray(root * (DEVIATIONS_95 / self.quantile))

    def spread(self) -> float:
        """Deviance of the determinants of the noise."""
        assert self.roots is not None
        found = 0.0
        for record, root in zip(self.records, self.roots, strict=True):
            if isinstance(record, Spectra):
                found += spread_of(root)
            elif _is_white(record):
                rows = record.used * (2 if isinstance(record, Response) else 1)
                found -= 2.0 * rows * float(np.log(np.abs(np.linalg.det(root))))
        return found

    @cached_property
    def _shapes(self) -> tuple[Numbers, ...]:
        """The shapes of the smooth errors, which only spectra have."""
        spectra = replace(
            self,
            records=tuple(one for one in self.records if isinstance(one, Spectra)),
            responses=tuple(
                two for one, two in zip(self.records, self.responses, strict=True) if isinstance(one, Spectra)
            ),
        )
        if len(spectra.records) == len(self.records):
            return super()._shapes
        found = iter(spectra._shapes)
        shapes = [next(found) if isinstance(one, Spectra) else None for one in self.records]
        count = max(len(one) for one in shapes if one is not None)
        return tuple(
            np.zeros((count, *record.spectrum.shape), record.spectrum.dtype) if one is None else one
            for one, record in zip(shapes, self.records, strict=True)
        )


def _is_white(record: Seen) -> bool:
    """Whether a record's noise is one covariance."""
    return not record.weighed if isinstance(record, Response) else not isinstance(record, Spectra)
