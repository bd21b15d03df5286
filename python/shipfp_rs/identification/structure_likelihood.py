"""The likelihood of a given structure: its equations on experiments, spectra and frequency responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.likelihood import (
    ACCURACY,
    Likelihood,
    noise_root,
    quantile_of,
    real_rows,
    spread_of,
    white_root,
)
from shipfp_rs.identification.structure_coordinates import StructureCoordinates
from shipfp_rs.identification.structure_records import Evaluated, InBand, Response, Seen
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array, Numbers
from shipfp_rs.support.quantiles import DEVIATIONS_95

FIRST_NOISE = 0.1
"""Standard deviation of the noise before any estimate, over an output's spread."""


@dataclass(frozen=True, eq=False)
class StructureLikelihood(Likelihood):
    """Likelihood of a structure for given records."""

    records: tuple[Seen, ...]
    coordinates: StructureCoordinates

    @classmethod
    def of(cls, records: Sequence[Seen], structure: Structure, *, accurate: bool = False) -> Self:
        """Return a likelihood before any noise estimate; `accurate`: for simulated data, without smooth errors."""
        accuracy = np.zeros(len(structure.outputs))
        for record in records if not accurate else ():
            if isinstance(record, InBand):
                said = [record.data.gauge_accuracy.get(signal, ACCURACY) for signal in record.signals]
                accuracy = np.maximum(accuracy, said)
        return cls(
            records=tuple(records),
            coordinates=StructureCoordinates(structure, tuple(record.unknowns for record in records)),
            accuracy=accuracy,
            priors={one.name: one.prior for one in structure.free if one.prior is not None},
        )

    def known(self, vector: Array, record: int) -> dict[str, float]:
        """Parameters and a record's unknowns by name."""
        c = self.coordinates
        own = vector[c.states(record)]
        return c.values(vector) | dict(zip(self.records[record].unknowns, map(float, own), strict=True))

    def spectra(self, vector: Array, record: int) -> tuple[Numbers, Numbers]:
        """Residuals (O, F) of a record, and the model's derivatives by the whole vector (P, O, F)."""
        c, count = self.coordinates, len(self.coordinates.free)
        values = self.known(vector, record)
        residual, slopes = self._evaluate(vector, record, c.names)
        jacobian = np.zeros((c.size, *residual.shape), dtype=slopes.dtype)
        jacobian[:count] = slopes[:count]
        for name in c.logarithmic:
            jacobian[c.place(name)] *= values[name]
        jacobian[c.states(record)] = slopes[count:]
        return residual, jacobian

    def residuals(self, vector: Array) -> list[Numbers]:
        """Residuals (O, F) of each record."""
        return [self._evaluate(vector, record, ())[0] for record in range(len(self.records))]

    def _evaluate(self, vector: Array, record: int, names: Sequence[str]) -> Evaluated:
        if not self.records[record].structure.equations.stable(self.coordinates.values(vector)):
            raise SimulationError("the loop is unstable")
        return self.records[record].evaluate(self.known(vector, record), names)

    def root(self, record: int) -> Numbers:
        """Root of the inverse spectral matrix of a record's noise; before any estimate, a share of the data's spread."""
        own = self.records[record]
        if self.roots is not None:
            return self.roots[record]
        if isinstance(own, Response) and own.weighed:
            return np.eye(len(self.accuracy))
        spread = own.spectrum.std(axis=1)
        return np.diag(1.0 / (FIRST_NOISE * np.maximum(spread, 1e-6 * max(spread.max(), 1e-6))))

    @cached_property
    def _white_rows(self) -> int:
        """Number of real values of each output in records with white noise."""
        white = (one for one in self.records if _is_white(one))
        return sum(one.used * (2 if isinstance(one, Response) else 1) for one in white)

    def of_structure(self, structure: Structure) -> Self:
        """Return the likelihood of a structure with the same parameters, but other free ones."""
        return replace(self, coordinates=replace(self.coordinates, structure=structure))

    def settled_at(self, vector: Array) -> Self:
        """Return the likelihood with the noise at a vector."""
        return self.with_noise(vector)

    resettled_at = settled_at

    @property
    def freedom(self) -> int:
        """Degrees of freedom of white noise: real numbers in the data minus unknowns."""
        return len(self.accuracy) * self._white_rows - self.coordinates.size

    @property
    def quantile(self) -> float:
        """Half width of a 95 % interval, in standard deviations; larger where the noise is estimated from few numbers."""
        if not all(map(_is_white, self.records)):
            return DEVIATIONS_95
        return quantile_of(self.freedom)

    @property
    def untold(self) -> bool:
        """Whether there are too few samples to estimate any noise."""
        return all(map(_is_white, self.records)) and self.freedom <= 0

    def _noise(self, residuals: Sequence[Numbers], unsure: Sequence[Numbers | float]) -> tuple[Numbers, ...]:
        """Root of the inverse spectral matrix of each record's residuals; all frequency responses share one."""
        share = max(self.freedom, 1) / max(len(self.accuracy) * self._white_rows, 1)
        responses = [index for index, one in enumerate(self.records) if isinstance(one, Response)]
        found = {}
        for index, (record, residual, own) in enumerate(zip(self.records, residuals, unsure, strict=True)):
            if isinstance(record, InBand):
                found[index] = noise_root(residual, own)
            elif not _is_white(record):
                found[index] = np.eye(len(residual))
            else:
                pooled = [place for place in responses if _is_white(self.records[place])]
                places = pooled if index in pooled else [index]
                found[index] = self._white_root(residuals, places, share)
        return tuple(found[index] for index in range(len(self.records)))

    def _white_root(self, residuals: Sequence[Numbers], places: Sequence[int], share: float) -> Numbers:
        """Root of the inverse joint covariance of records; `share` is the degrees of freedom over the number of values."""
        left = np.concatenate([real_rows(residuals[place]) for place in places], axis=1)
        said = np.concatenate([real_rows(self.records[place].spectrum) for place in places], axis=1)
        return white_root(left, said, share, self.quantile)

    def spread(self) -> float:
        """Log determinants of the noise, as part of the deviance."""
        assert self.roots is not None
        found = 0.0
        for record, root in zip(self.records, self.roots, strict=True):
            if isinstance(record, InBand):
                found += spread_of(root)
            elif _is_white(record):
                rows = record.used * (2 if isinstance(record, Response) else 1)
                found -= 2.0 * rows * float(np.log(np.abs(np.linalg.det(root))))
        return found

    @cached_property
    def _shapes(self) -> tuple[Numbers, ...]:
        """Shapes of the smooth errors; only spectra have these."""
        spectra = replace(
            self,
            records=tuple(one for one in self.records if isinstance(one, InBand)),
            responses=tuple(
                two for one, two in zip(self.records, self.responses, strict=True) if isinstance(one, InBand)
            ),
        )
        if len(spectra.records) == len(self.records):
            return super()._shapes
        found = iter(spectra._shapes)
        shapes = [next(found) if isinstance(one, InBand) else None for one in self.records]
        count = max(len(one) for one in shapes if one is not None)
        return tuple(
            np.zeros((count, *record.spectrum.shape), record.spectrum.dtype) if one is None else one
            for one, record in zip(shapes, self.records, strict=True)
        )


def _is_white(record: Seen) -> bool:
    """Whether a record's noise has one covariance."""
    return not record.weighed if isinstance(record, Response) else not isinstance(record, InBand)
