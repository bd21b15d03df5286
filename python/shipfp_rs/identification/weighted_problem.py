"""A structure and its data as one weighted least-squares problem: residuals, sensitivities and the noise of both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.identification.blocks import Block
from shipfp_rs.identification.whitening import Evaluation, Whitening
from shipfp_rs.optimise.normal_equations import Products
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array

NOTHING_LEFT = "no valid sample is left to fit; widen the window or repair the log"


@dataclass(frozen=True)
class Noise:
    """What is known of the residuals: what leaves them white, and the inverse root of the covariance of what is left."""

    root: Array
    whitening: Whitening | None = None
    sharp: bool = True
    """Whether passes over the records must be far more exact than the noise; on the way to a minimum they need not."""


@dataclass(frozen=True)
class Minimum:
    """One minimum found: the full vector (parameters, then every block's unknowns), its criterion, how it ended.

    `sums` are every block's there, filtered by the noise's models.
    """

    vector: Array
    criterion: float
    converged: bool
    message: str
    evaluations: int
    noise: Noise
    sums: Sequence[Products]


@dataclass(frozen=True)
class WeightedProblem:
    """A structure, its data and the way to weigh them."""

    structure: Structure
    blocks: tuple[Block, ...]
    weighting: str
    noise: str
    intervals: str = "profile"

    @cached_property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters searched for."""
        return self.structure.free

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters searched for."""
        return tuple(parameter.name for parameter in self.free)

    @cached_property
    def unknowns(self) -> tuple[str, ...]:
        """Names along the full vector; those of several experiments carry its name."""
        several = len(self.blocks) > 1
        own = [
            f"{name} ({block.data.name})" if several else name
            for block in self.blocks
            for name in block.nuisance
        ]
        return (*self.names, *own)

    @cached_property
    def size(self) -> int:
        """Length of the full vector."""
        return len(self.free) + sum(len(block.nuisance) for block in self.blocks)

    def values(self, vector: Array) -> dict[str, float]:
        """Return every parameter by name, fixed and tied ones included."""
        values = {parameter.name: parameter.start for parameter in self.structure.parameters}
        found = {name: float(value) for name, value in zip(self.names, vector, strict=False)}
        return self.structure.complete(values | found)

    def places(self) -> Iterator[slice]:
        """Yield the places of each block's own unknowns in the full vector."""
        start = len(self.free)
        for block in self.blocks:
            yield slice(start, start + len(block.nuisance))
            start += len(block.nuisance)

    def each(self, vector: Array) -> Iterator[tuple[Block, dict[str, float]]]:
        """Yield every block with the values of all that its model depends on."""
        values = self.values(vector)
        for block, own in zip(self.blocks, self.places(), strict=True):
            yield block, values | dict(zip(block.nuisance, map(float, vector[own]), strict=True))

    def evaluate(self, vector: Array, names: Sequence[str] | None = None) -> list[Evaluation]:
        """Evaluate every block; each Jacobian has the block's own columns last, after those of `names` (None: all)."""
        names = self.names if names is None else names
        return [block.evaluate(values, names) for block, values in self.each(vector)]

    def filtered(self, minimum: Minimum) -> list[Evaluation]:
        """Evaluate every block and prewhiten the experiments, without the columns of offsets."""
        return [
            block.filtered(values, self.names, minimum.noise.whitening, constants=False)
            for block, values in self.each(minimum.vector)
        ]

    def whitened(self, minimum: Minimum) -> tuple[list[Evaluation], Array, Array]:
        """Return the filtered evaluations, the stacked weighted residuals (R,) and their Jacobian (R, Q).

        The Jacobian is that of the residual, minus that of the model. Long records are turned into as few rows as have
        the same products.
        """
        vector, noise = minimum.vector, minimum.noise
        evaluations = [
            block.turned(values, self.names, noise.whitening, noise.root, sums)
            for (block, values), sums in zip(self.each(vector), minimum.sums, strict=True)
        ]
        parts = [part.reshape(len(part), -1).T for part in self._parts(evaluations, noise)]
        rows = np.concatenate([*parts, self.priors(vector)])
        return evaluations, rows[:, -1], rows[:, :-1]

    def sums(self, vector: Array, noise: Noise) -> list[Products]:
        """Pass over the data once: every block's sums of products, filtered by the noise's models."""
        with np.errstate(over="ignore", invalid="ignore"):
            return [
                block.products(values, self.names, noise.whitening, sharp=noise.sharp)
                for block, values in self.each(vector)
            ]

    def gram(self, vector: Array, noise: Noise, sums: Sequence[Products]) -> Array:
        """Products (Q + 1, Q + 1) of the columns of [-d(model)/d(unknowns), e], weighted, with priors."""
        priors = self.priors(vector)
        gram = np.asarray(priors.T @ priors)
        with np.errstate(over="ignore", invalid="ignore"):
            for grid, products in zip(self._grids, sums, strict=True):
                gram[grid] += products.gram(noise.root)
        return gram

    @cached_property
    def _grids(self) -> list[tuple[npt.NDArray[np.intp], ...]]:
        """Places of each block's columns and residual in the products of all."""
        places = [np.r_[: len(self.free), own.start : own.stop, self.size] for own in self.places()]
        return [np.ix_(place, place) for place in places]

    @cached_property
    def linear(self) -> npt.NDArray[np.bool_]:
        """True for the unknowns in which the residual is linear and the cost quadratic, shape (Q,)."""
        own = [name in block.linear for block in self.blocks for name in block.nuisance]
        return np.array([False] * len(self.free) + own)

    def _parts(self, evaluations: Sequence[Evaluation], noise: Noise) -> Iterator[Array]:
        """Yield each block's [-d(model)/d(vector), e], weighted, shape (Q + 1, O, R)."""
        start, free = len(self.free), len(self.free)
        for block, evaluation in zip(self.blocks, evaluations, strict=True):
            part = rows = _weighted(evaluation, noise)
            if len(self.blocks) > 1:
                part = np.zeros((self.size + 1, *rows.shape[1:]))
                part[:free], part[-1] = rows[:free], rows[-1]
                part[start : start + len(block.nuisance)] = rows[free:-1]
            start += len(block.nuisance)
            yield part

    def priors(self, vector: Array) -> Array:
        """Rows [J, e] of the priors, (mean - value) / std."""
        rows = [(index, *p.prior) for index, p in enumerate(self.free) if p.prior is not None]
        table = np.zeros((len(rows), self.size + 1))
        for row, (index, mean, std) in enumerate(rows):
            table[row, index] = -1.0 / std
            table[row, -1] = (mean - vector[index]) / std
        return table

    def curved(self, kept: Array, step: Array, held: int | None = None) -> Array:
        """Return where a step of the unknowns in which the model is not linear leads along the structure's valley."""
        return self.structure.equations.curved(self.kept_names, kept, step, held)

    @cached_property
    def kept_names(self) -> tuple[str, ...]:
        """Names of the unknowns in which the model is not linear, a block's own ones without its name."""
        own = [name for block in self.blocks for name in block.nuisance]
        names = [*self.names, *own]
        return tuple(name for name, linear in zip(names, self.linear, strict=True) if not linear)

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the full vector; a block's own unknowns have none."""
        open_end = np.full(self.size - len(self.free), np.inf)
        lower = np.array([parameter.lower for parameter in self.free])
        upper = np.array([parameter.upper for parameter in self.free])
        return np.concatenate([lower, -open_end]), np.concatenate([upper, open_end])

    def noise_at(self, noise: Noise, count: int, scatter: Array) -> tuple[Noise, float]:
        """Return the weights that follow from the filtered residuals, and the criterion by which minima are ranked.

        The weights are the identity, inverse standard deviations, or the inverse root of the covariance. With them the
        criterion is N ln det of the scatter of so many samples' residuals.
        """
        outputs = len(scatter)
        if self.weighting == "variance":
            scatter = np.diag(np.diag(scatter))
        criterion = float(count * np.linalg.slogdet(scatter + 1e-300 * np.eye(outputs))[1])
        # A perfect fit leaves no scatter to weigh by; this floor is far below any measurement.
        floor = 1e-24 + 1e-14 * np.trace(scatter) / outputs
        factor = np.linalg.cholesky(scatter + floor * np.eye(outputs))
        return replace(noise, root=np.linalg.inv(factor)), criterion

    def initial_noise(self) -> Noise:
        """Weights before the first fit: by the spread of each measured output."""
        outputs = len(self.structure.outputs)
        if self.weighting in ("none", "std"):
            return Noise(np.eye(outputs))
        spread = np.sum([np.diag(block.scatter) for block in self.blocks], axis=0)
        return Noise(np.diag(1.0 / np.sqrt(np.maximum(spread / len(self.blocks), 1e-24))))

    def require_stable(self, vector: Array) -> None:
        """Raise SimulationError where the structure knows that its closed loop is unstable."""
        if not self.structure.equations.stable(self.values(vector)):
            raise SimulationError("the closed loop is unstable, a ship that was measured is not")


def mean_scatter(sums: Sequence[Products]) -> tuple[int, Array]:
    """Return the number of samples and the mean outer product of their residuals, shape (O, O)."""
    count = sum(part.count for part in sums)
    if count == 0:
        raise InputError(NOTHING_LEFT)
    return count, np.asarray(sum(part.scatter for part in sums) / count)


def _weighted(evaluation: Evaluation, noise: Noise) -> Array:
    """Weighted rows of [-d(model)/d(unknown), e], shape (Q + 1, O, R)."""
    rows = np.empty((len(evaluation.jacobian) + 1, *evaluation.residual.shape))
    np.matmul(-noise.root, evaluation.jacobian, out=rows[:-1])
    np.matmul(noise.root, evaluation.residual, out=rows[-1])
    return rows
