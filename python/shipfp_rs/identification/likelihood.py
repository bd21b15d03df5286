"""The one likelihood: residuals of all outputs together, coloured by their own spectral matrix, with priors.

Beside its parameters a model has unknowns that are linear and have a prior, eliminated in closed form: smooth multiplicative
errors of each output's response, amplitude and phase, an octave wide, of the size that gauge and calibration leave open
(Kennedy and O'Hagan 2001, doi:10.1111/1467-9868.00294). Whittle 1953 (doi:10.1007/BF02590998) is the likelihood of spectra.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from scipy.stats import t as student

from shipfp_rs.errors import SimulationError
from shipfp_rs.support.arrays import Array, Numbers
from shipfp_rs.support.quantiles import DEVIATIONS_95
from shipfp_rs.support.threads import where_alone

T = TypeVar("T")

ACCURACY = 3e-3
"""Smooth relative error of an output's response that gauge and calibration leave open, one standard deviation."""
OCTAVE = 1.0
"""Width of these errors in octaves."""
OVER, LEAST_REACH, MOST_REACH = 0.35, 10, 40
"""Frequencies on either side over which the residuals' spectral matrix is averaged: a third of the own one, within these."""
STEEP, MOST_FALL = 40, -2.0
"""Number of the lowest frequencies over which noise may fall by a power of the frequency, and the greatest fall."""
FLOOR = 1e-3
"""Least of that matrix, over its median."""
WHITE = 1e-3
"""Noise over the operating point before any was estimated."""
LEAST_NOISE, LEAST_OWN = 1e-7, 1e-9
"""Least deviation of white noise over an output's own root mean square, far above rounding, and least part of an output's
variance that is its own."""
SMALL = 1e-6
"""Step of a difference, over a value or one."""

Slopes = Mapping[str, Mapping[int, float]]
"""Derivatives of the parameters by the places of a vector: {parameter: {place: slope}}."""
Figure = Callable[[Mapping[str, float]], float]
"""What follows from the parameters."""


@dataclass(frozen=True)
class Itself:
    """A parameter as a figure."""

    name: str

    def __call__(self, values: Mapping[str, float]) -> float:
        """Return it."""
        return values[self.name]


class Products(NamedTuple):
    """Deviance at a vector, half its gradient's negative, and the Gauss-Newton matrix."""

    cost: float
    downhill: Array
    matrix: Array


class Space(Protocol):
    """Coordinates: free parameters as a vector, with the records' own unknowns behind them."""

    @property
    def free(self) -> Mapping[str, tuple[float, float]]:
        """Free parameters with their bounds."""

    @property
    def given(self) -> Mapping[str, float]:
        """Parameters that are not searched."""

    @property
    def records(self) -> int:
        """Number of records."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""

    @property
    def size(self) -> int:
        """Length of a vector."""

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of a vector."""

    @property
    def state_deviation(self) -> float:
        """Prior deviation of the records' unknowns, over the operating point."""

    def place(self, name: str) -> int:
        """Place of a parameter in a vector."""

    def states(self, record: int) -> slice:
        """Places of a record's own unknowns."""

    def values(self, vector: Array) -> dict[str, float]:
        """Return the parameters in their own units, those given included."""

    def states_at(self, vector: Array) -> list[dict[str, float]]:
        """Return each record's own unknowns by name."""

    def vector(self, values: Mapping[str, float], states: Sequence[Mapping[str, float]] = ()) -> Array:
        """Return the vector of values within the bounds."""

    def slopes(self, values: Mapping[str, float]) -> dict[str, dict[int, float]]:
        """Derivatives of the parameters by the places of a vector."""

    def gradient(self, figure: Figure, vector: Array) -> Array:
        """Derivative of a figure by a vector, shape (P,)."""


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Of a model, given records; `EquationLikelihood` and `StructureLikelihood` say which.

    Parameters
    ----------
    records, coordinates
        Data, each with a spectrum (O, F), and free parameters.
    accuracy
        Smooth relative error of each output's response, one standard deviation, shape (O,).
    priors
        Parameter to (mean, standard deviation).
    roots
        For each record the root of the inverse spectral matrix of its noise, (F, O, O), or (O, O) where it is white;
        None: not estimated yet.
    responses
        For each record the spectra of the model's outputs at the vector that the noise is from, (O, F): what smooth errors
        are relative to. Relative to the data's they would take noise for a response, and be rewarded for shrinking it.
    """

    records: tuple[Any, ...]
    coordinates: Space
    accuracy: Array
    priors: Mapping[str, tuple[float, float]]
    roots: tuple[Numbers, ...] | None = None
    responses: tuple[Numbers, ...] = ()

    @property
    def is_quick(self) -> bool:
        """Whether an evaluation is too short for a thread of its own to pay off."""
        return False

    def each(self, jobs: Sequence[Callable[[], T]]) -> list[T]:
        """Run jobs that evaluate this likelihood, in parallel where that is quicker; return their results in order."""
        return [job() for job in jobs] if self.is_quick else where_alone(jobs)

    def spectra(self, vector: Array, record: int) -> tuple[Numbers, Numbers]:
        """Residuals (O, F) of a record and the model's derivatives by the whole vector (P, O, F)."""
        raise NotImplementedError

    def modelled(self, vector: Array, record: int) -> Array:
        """Decimated outputs of a record, (O, K)."""
        raise NotImplementedError

    def residuals(self, vector: Array) -> list[Numbers]:
        """For each record the residuals at a vector, (O, F)."""
        raise NotImplementedError

    @property
    def quantile(self) -> float:
        """Half of an interval of 95 per cent over the standard deviation."""
        return DEVIATIONS_95

    @property
    def untold(self) -> bool:
        """Whether there are too few samples to estimate any noise."""
        return False

    def under(self, residuals: Sequence[Numbers]) -> float:
        """Deviance of residuals under their own noise."""
        own = replace(self, roots=self._noise(residuals, [0.0] * len(residuals)))
        rows = [own._white(one[None], index) for index, one in enumerate(residuals)]
        return own.spread() + sum(float(np.sum(row**2)) for row in rows)

    @cached_property
    def bends(self) -> bool:
        """Whether there are smooth errors."""
        return self.roots is not None and bool(self.accuracy.any())

    def products(self, vector: Array) -> Products:
        """Deviance, gradient and Gauss-Newton matrix at a vector.

        Raises
        ------
        SimulationError
            Where the model runs away, or leaves the numbers.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            rows = [self._rows(vector, index) for index in range(len(self.records))]
            return self._products(vector, np.concatenate(rows, axis=1))

    def _products(self, vector: Array, rows: Array) -> Products:
        """The same of residual and derivatives, or of residuals alone, in units of the noise, (1 + P, R)."""
        gram = rows @ rows.T
        if self.bends:
            shapes, inverse = self._errors
            along = rows @ shapes.T
            gram -= along @ inverse @ along.T
        priors = self.prior_rows(vector)[:, : len(rows)]
        gram += priors.T @ priors
        if not np.isfinite(gram).all():
            raise SimulationError("the deviance is not finite")
        return Products(float(gram[0, 0]), gram[1:, 0], gram[1:, 1:])

    def _rows(self, vector: Array, index: int) -> Array:
        """Residual and derivatives of a record in units of the noise, (1 + P, R)."""
        residual, jacobian = self.spectra(vector, index)
        return self._white(np.concatenate([residual[None], jacobian]), index)

    def whitened(self, vector: Array) -> Array:
        """Residual, derivatives and smooth errors in units of the noise, with the priors' rows, (R, 1 + P + E)."""
        rows = np.concatenate([self._rows(vector, index) for index in range(len(self.records))], axis=1)
        if self.bends:
            rows = np.concatenate([rows, self._errors[0]])
        priors = self.prior_rows(vector)
        errors = len(rows) - priors.shape[1]
        own = np.eye(errors, len(rows), priors.shape[1])
        return np.concatenate([rows.T, np.pad(priors, ((0, 0), (0, errors))), own])

    def smooth_errors(self, residuals: Sequence[Numbers]) -> tuple[Array, Array]:
        """Sizes of the smooth errors that residuals show, in prior deviations (E,), and what these are unsure by (E, E)."""
        shapes, unsure = self._errors
        white = np.concatenate([self._white(one[None], index)[0] for index, one in enumerate(residuals)])
        return unsure @ (shapes @ white), unsure

    def _left(self, residuals: Sequence[Numbers]) -> tuple[list[Numbers], list[Numbers]]:
        """What the smooth errors leave of the residuals, (O, F), and the covariance of what they took, (O, O, F).

        What is left is noise, and all that the model lacks. At low frequencies the errors take noise along, so its power is
        what is left and what they are unsure of (Dempster, Laird and Rubin 1977, doi:10.1111/j.2517-6161.1977.tb01600.x).
        """
        if not self.bends:
            return list(residuals), [np.zeros((len(one), *one.shape), complex) for one in residuals]
        sizes, inverse = self.smooth_errors(residuals)
        left = [
            one - np.tensordot(sizes, shapes, 1) for one, shapes in zip(residuals, self._shapes, strict=True)
        ]
        unsure = [
            np.einsum("eof,epf->opf", np.tensordot(inverse, shapes, 1), shapes.conj())
            for shapes in self._shapes
        ]
        return left, unsure

    def cost(self, vector: Array) -> float:
        """Deviance at a vector; infinite where the model diverges."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                rows = [self._white(one[None], index) for index, one in enumerate(self.residuals(vector))]
                return self._products(vector, np.concatenate(rows, axis=1)).cost
        except SimulationError:
            return np.inf

    def total(self, vector: Array) -> float:
        """Deviance at a vector under the noise of its own residuals, with that noise's determinant; infinite as `cost`.

        Only so two ends compare that leave different residuals: under the noise of the one the other is at a disadvantage.
        """
        try:
            own = self.with_noise(vector)
            return own.cost(vector) + own.spread()
        except (SimulationError, np.linalg.LinAlgError):
            return np.inf

    def spread(self) -> float:
        """Deviance of the determinants of the noise."""
        assert self.roots is not None
        return sum(map(spread_of, self.roots))

    def prior_rows(
        self, vector: Array, values: Mapping[str, float] | None = None, slopes: Slopes | None = None
    ) -> Array:
        """Residuals and derivatives of the priors, in units of their deviations, shape (K, 1 + P).

        Parameters and their derivatives may be given where they are known.
        """
        c = self.coordinates
        values = c.values(vector) if values is None else values
        slopes = c.slopes(values) if slopes is None else slopes
        first, own = len(self.priors), len(c.free)
        rows = np.zeros((first + len(vector) - own, len(vector) + 1))
        for row, (name, (mean, deviation)) in zip(rows, self.priors.items(), strict=False):
            row[0] = (mean - values[name]) / deviation
            for place, slope in slopes.get(name, {}).items():
                row[1 + place] = slope / deviation
        rows[first:, 0] = -vector[own:] / c.state_deviation
        rows[first:, 1 + own :][np.diag_indices(len(vector) - own)] = 1.0 / c.state_deviation
        return rows

    def root(self, record: int) -> Numbers:
        """Root of the inverse spectral matrix of a record's noise; a guess before any was estimated."""
        return np.eye(len(self.accuracy)) / WHITE if self.roots is None else self.roots[record]

    def _white(self, spectra: Numbers, record: int) -> Array:
        """Spectra (W, O, F) in units of the noise, as rows of real numbers (W, R)."""
        return real_rows(turned(self.root(record), spectra))

    def in_units_of_noise(self, spectra: Numbers, record: int) -> Array:
        """Spectra (O, F) of a record in units of its noise, as real numbers (R,)."""
        return np.asarray(self._white(spectra[None], record)[0])

    def with_noise(self, vector: Array) -> Self:
        """Return the likelihood whose noise is that of the residuals at a vector."""
        residuals = self.residuals(vector)
        responses = tuple(record.spectrum - one for record, one in zip(self.records, residuals, strict=True))
        roots = self._noise(*self._left(residuals))
        return replace(self, roots=roots, responses=responses)

    def _noise(self, residuals: Sequence[Numbers], unsure: Sequence[Numbers | float]) -> tuple[Numbers, ...]:
        """For each record the root of the inverse spectral matrix of its residuals."""
        return tuple(map(noise_root, residuals, unsure))

    def with_noise_of(self, other: Likelihood) -> Self:
        """Return the likelihood with the noise of another one of the same records."""
        return replace(self, roots=other.roots, responses=other.responses)

    def knots(self) -> Array:
        """Octaves at which smooth errors have sizes of their own, (K,)."""
        least = min(record.frequency_hz[1] for record in self.records)
        most = max(record.frequency_hz[-1] for record in self.records)
        return np.arange(np.log2(least), np.log2(most) + OCTAVE, OCTAVE)

    def hats(self, frequency_hz: Array) -> Array:
        """Weights by which sizes at the knots make the error at each frequency, (K, F)."""
        octaves = np.log2(np.maximum(frequency_hz, 1e-9))
        return np.asarray(np.maximum(1.0 - np.abs(octaves - self.knots()[:, None]) / OCTAVE, 0.0))

    @cached_property
    def _shapes(self) -> tuple[Numbers, ...]:
        """For each record the shapes of the smooth errors in units of their prior deviation, (E, O, F)."""
        knots, found = self.knots(), []
        for record, response in zip(self.records, self.responses, strict=True):
            hats = self.hats(record.frequency_hz)
            shapes = np.zeros((len(self.accuracy), 2, len(knots), *response.shape), complex)
            for output, accuracy in enumerate(self.accuracy):
                shapes[output, 0, :, output] = accuracy * hats * response[output]
                shapes[output, 1, :, output] = 1j * shapes[output, 0, :, output]
            found.append(shapes.reshape(-1, *response.shape))
        return tuple(found)

    @cached_property
    def _errors(self) -> tuple[Array, Array]:
        """The shapes in units of the noise as rows of all records' numbers (E, R), and what their sizes vary by (E, E)."""
        rows = np.concatenate(
            [self._white(shapes, index) for index, shapes in enumerate(self._shapes)], axis=1
        )
        return rows, np.linalg.inv(rows @ rows.T + np.eye(len(rows)))


def turned(root: Numbers, spectra: Numbers) -> Numbers:
    """Spectra (W, O, F) through a root (F, O, O) or (O, O)."""
    if root.ndim == 2:
        return np.asarray(root @ spectra)
    found = np.zeros_like(spectra)
    for a, b in zip(*np.tril_indices(root.shape[1]), strict=True):  # roots are lower triangles
        found[:, a] += np.ascontiguousarray(root[:, a, b]) * spectra[:, b]
    return found


def real_rows(spectra: Numbers) -> Array:
    """Complex or real numbers (W, O, F) as rows of real ones, (W, R)."""
    flat = spectra.reshape(len(spectra), -1)
    return np.concatenate([flat.real, flat.imag], axis=1) if np.iscomplexobj(flat) else np.asarray(flat)


def spread_of(root: Numbers) -> float:
    """Deviance of noise's determinants by the roots of its inverse, lower triangles (F, O, O); a number has two parts."""
    return -4.0 * float(np.log(np.abs(root.diagonal(0, -2, -1))).sum())


def _shape(amplitudes: Array) -> Array:
    """How amplitudes (O, F) fall from the lowest frequency on, by a power of it, and stay from `STEEP` on, (O, F)."""
    steep = min(STEEP, amplitudes.shape[1] - 1)
    places = np.log(np.arange(1, steep + 1))
    places -= places.mean()
    fall = np.log(amplitudes[:, 1 : steep + 1] + 1e-300) @ places / max(places @ places, 1e-300)
    # Below the first frequency, at the mean, it rises no further.
    reached = np.clip(np.arange(steep + 1), 1, steep) ** np.clip(fall, MOST_FALL, 0.0)[:, None]
    return np.pad(reached, ((0, 0), (0, amplitudes.shape[1] - steep - 1)), mode="edge")


def noise_root(residual: Numbers, unsure: Numbers | float = 0.0) -> Numbers:
    """Root of the inverse of the smoothed spectral matrix of residuals (O, F), with what is unsure of them, (F, O, O)."""
    outputs, count = residual.shape
    place = np.arange(count)
    # Moving water is slow: at low frequencies its noise is steep, and a mean over some of them is right where it is flat.
    shape = _shape(np.abs(residual))
    a, b = np.tril_indices(outputs)
    both = shape[a] * shape[b]
    products = residual[a] * residual[b].conj()
    products = (products + (unsure[a, b] if isinstance(unsure, np.ndarray) else unsure)) / both
    reach = np.clip((OVER * place).astype(int), LEAST_REACH, max(min(MOST_REACH, count // 8), LEAST_REACH))
    first, last = np.maximum(place - reach, 0), np.minimum(place + reach, count - 1)
    sums = np.zeros((len(a), count + 1), products.dtype)
    np.cumsum(products, axis=-1, out=sums[:, 1:])
    matrix = (sums.take(last + 1, 1) - sums.take(first, 1)) * (0.5 / (last + 1 - first)) * both
    matrix[a == b] += FLOOR * np.median(matrix[a == b].real, axis=1, keepdims=True) + 1e-18
    lower = np.zeros((outputs, outputs, count), matrix.dtype)
    lower[a, b] = matrix
    return np.moveaxis(_inverse_root(lower), -1, 0)


def white_root(left: Array, said: Array, share: float, quantile: float) -> Array:
    """Root of the inverse of one covariance of residuals (O, R), a share of what was; `said` is the data's, (O, R).

    It allows for what the unknowns took of the residuals, and for the quantile, so that all intervals end at the same rise.
    """
    covariance = left @ left.T / (left.shape[1] * share)
    size = LEAST_NOISE**2 * (np.mean(said**2, axis=1) + 1e-12) + LEAST_OWN * np.diag(covariance)
    root = np.linalg.inv(np.linalg.cholesky(covariance + np.diag(size)))
    return np.asarray(root * (DEVIATIONS_95 / quantile))


@cache
def quantile_of(freedom: int) -> float:
    """Half of an interval of 95 per cent over the standard deviation: noise from few numbers is uncertain itself."""
    return float(student.ppf(0.975, max(freedom, 1)))


def _inverse_root(matrix: Numbers) -> Numbers:
    """Inverse of the Cholesky factor of matrices by their lower triangles, (O, O, F), a lower triangle.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where one is not positive definite.
    """
    root, found = np.zeros_like(matrix), np.zeros_like(matrix)
    for a in range(len(matrix)):
        for b in range(a + 1):
            rest = matrix[a, b] - np.sum(root[a, :b] * root[b, :b].conj(), axis=0)
            if a == b:
                if not (rest.real > 0.0).all():
                    raise np.linalg.LinAlgError("a spectral matrix is not positive definite")
                root[a, a] = np.sqrt(rest.real)
            else:
                root[a, b] = rest / root[b, b]
        found[a, a] = 1.0 / root[a, a]
        for b in range(a):
            found[a, b] = -found[a, a] * np.sum(root[a, b:a] * found[b:a, b], axis=0)
    return found
