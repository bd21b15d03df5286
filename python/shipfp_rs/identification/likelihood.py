"""The likelihood: residuals of all outputs, with their spectral matrix as noise, and priors.

Besides its parameters a model has linear unknowns with a prior, eliminated in closed form: the systematic errors. These are
relative errors of each output's response, in amplitude and phase, that vary slowly with frequency (over an octave) and are
as large as errors of gauge and calibration (Kennedy and O'Hagan 2001, doi:10.1111/1467-9868.00294). The likelihood of
spectra is that of Whittle 1953 (doi:10.1007/BF02590998).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
from scipy.stats import t as student

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.coordinates import Coordinates, prior_row
from shipfp_rs.support.arrays import DEVIATIONS_95, Array, Numbers
from shipfp_rs.support.threads import where_alone

T = TypeVar("T")

ACCURACY = 3e-3
"""Prior standard deviation of the systematic errors of an output's response, due to gauge and calibration."""
OCTAVE = 1.0
"""Width of a systematic error in octaves."""
OVER, LEAST_REACH, MOST_REACH = 0.35, 10, 40
"""Half width of the average that smooths the residuals' spectral matrix: share of the frequency's index, and limits."""
STEEP, MOST_FALL = 40, -2.0
"""Number of the lowest frequencies at which the noise may follow a power law, and that law's least exponent."""
FLOOR = 1e-3
"""Least value of that matrix's diagonal over its median."""
WHITE = 1e-3
"""Standard deviation of the noise before any estimate, relative to the operating point."""
LEAST_NOISE, LEAST_OWN = 1e-7, 1e-9
"""Least standard deviation of white noise over an output's root mean square, far above rounding; and least share of an
output's variance that is independent of other outputs."""


class Products(NamedTuple):
    """Deviance at a point of the search, its gradient times -1/2, and the Gauss-Newton matrix."""

    cost: float
    downhill: Array
    matrix: Array


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Likelihood of a model for given records; subclasses are `EquationLikelihood` and `StructureLikelihood`.

    Parameters
    ----------
    records, coordinates
        Data, each with a spectrum (O, F), and free parameters.
    accuracy
        Standard deviation of each output's systematic errors, which vary slowly with frequency, shape (O,).
    priors
        Parameter to (mean, standard deviation).
    roots
        For each record, a root of the inverse spectral matrix of its noise, (F, O, O), or (O, O) where it is white; None:
        not estimated yet.
    responses
        For each record, spectra of the model's outputs (O, F) at the parameters at which the noise was estimated. Systematic
        errors are relative to these spectra: relative to the data they would treat noise as response, and reward a smaller
        response.
    """

    records: tuple[Any, ...]
    coordinates: Coordinates
    accuracy: Array
    priors: Mapping[str, tuple[float, float]]
    roots: tuple[Numbers, ...] | None = None
    responses: tuple[Numbers, ...] = ()

    @property
    def is_quick(self) -> bool:
        """Whether an evaluation is too short for threads to pay off."""
        return False

    def each(self, jobs: Sequence[Callable[[], T]]) -> list[T]:
        """Run jobs that evaluate this likelihood, in parallel where that is faster; return the results in order."""
        return [job() for job in jobs] if self.is_quick else where_alone(jobs)

    def spectra(self, vector: Array, record: int) -> tuple[Numbers, Numbers]:
        """Residuals (O, F) of a record, and the model's derivatives by the whole search vector (P, O, F)."""
        raise NotImplementedError

    def modelled(self, vector: Array, record: int) -> Array:
        """Decimated outputs of a record, (O, K)."""
        raise NotImplementedError

    def residuals(self, vector: Array) -> list[Numbers]:
        """Residuals (O, F) of each record."""
        raise NotImplementedError

    @property
    def quantile(self) -> float:
        """Half width of a 95 % interval, in standard deviations."""
        return DEVIATIONS_95

    @property
    def untold(self) -> bool:
        """Whether there are too few samples to estimate any noise."""
        return False

    def under(self, residuals: Sequence[Numbers]) -> float:
        """Deviance of residuals under the noise that they show."""
        own = replace(self, roots=self._noise(residuals, [0.0] * len(residuals)))
        rows = [own._white(one[None], index) for index, one in enumerate(residuals)]
        return own.spread() + sum(float(np.sum(row**2)) for row in rows)

    @cached_property
    def bends(self) -> bool:
        """Whether systematic errors are included."""
        return self.roots is not None and bool(self.accuracy.any())

    def products(self, vector: Array) -> Products:
        """Deviance, gradient and Gauss-Newton matrix at a point of the search.

        Raises
        ------
        SimulationError
            If the simulation diverges or overflows, or the loop is unstable.
        """
        gram = self._gram(vector, derivatives=True)
        return Products(float(gram[0, 0]), gram[1:, 0], gram[1:, 1:])

    def cost(self, vector: Array) -> float:
        """Deviance at a point of the search; infinite where the model diverges."""
        try:
            return float(self._gram(vector, derivatives=False)[0, 0])
        except SimulationError:
            return np.inf

    def _gram(self, vector: Array, *, derivatives: bool) -> Array:
        """Gram matrix of the residual and, with `derivatives`, of the derivatives by the search vector."""
        with np.errstate(over="ignore", invalid="ignore"):
            if derivatives:
                return self.with_columns(vector, [()] * len(self.records))
            return self._gram_of(vector, [one[None] for one in self.residuals(vector)])

    def with_columns(self, vector: Array, columns: Sequence[Sequence[Numbers] | Numbers]) -> Array:
        """Gram matrix of residual, derivatives and `columns`, (1 + P + C, 1 + P + C), with systematic errors and priors.

        `columns` are spectra of the outputs (C, O, F) for each record.
        """
        rows = []
        for index, more in enumerate(columns):
            residual, jacobian = self.spectra(vector, index)
            rows.append(np.concatenate([residual[None], jacobian, *([more] if len(more) else [])]))
        return self._gram_of(vector, rows)

    def _gram_of(self, vector: Array, rows: Sequence[Numbers]) -> Array:
        """Gram matrix of each record's rows (R, O, F), residual and derivatives first, with systematic errors and priors."""
        gram, errors = np.zeros(()), np.zeros(())
        for index, own in enumerate(rows):
            white = turned(self.root(index), own)
            flat = real_rows(white)
            gram = gram + flat @ flat.T
            if self.bends:
                along = np.einsum("fab,caf->cbf", self._bent[index].conj(), white)
                parts = np.stack([along.real, along.imag], axis=2) @ self._hats[index].T
                errors = errors + parts.reshape(len(own), -1)
        return self._with_priors(vector, gram, errors)

    def _with_priors(self, vector: Array, gram: Array, errors: Array) -> Array:
        """Gram matrix with systematic errors, of whose shapes and the rows `errors` are the products, and priors."""
        if self.bends:
            gram = gram - errors @ self._errors_inverse @ errors.T
        priors = self.prior_rows(vector)[:, : len(gram)]
        size = priors.shape[1]
        gram[:size, :size] += priors.T @ priors
        if not np.isfinite(gram).all():
            raise SimulationError("the deviance is not finite")
        return np.asarray(gram)

    def _rows(self, vector: Array, index: int) -> Array:
        """Residual and derivatives of a record in units of the noise, (1 + P, R)."""
        residual, jacobian = self.spectra(vector, index)
        return self._white(np.concatenate([residual[None], jacobian]), index)

    def whitened(self, vector: Array) -> Array:
        """Residual, derivatives and systematic errors in units of the noise, with rows of the priors, (R, 1 + P + E)."""
        rows = np.concatenate([self._rows(vector, index) for index in range(len(self.records))], axis=1)
        if self.bends:
            shapes = [self._white(one, index) for index, one in enumerate(self._shapes)]
            rows = np.concatenate([rows, np.concatenate(shapes, axis=1)])
        priors = self.prior_rows(vector)
        errors = len(rows) - priors.shape[1]
        own = np.eye(errors, len(rows), priors.shape[1])
        return np.concatenate([rows.T, np.pad(priors, ((0, 0), (0, errors))), own])

    def smooth_errors(self, residuals: Sequence[Numbers]) -> tuple[Array, Array]:
        """Estimated sizes of the systematic errors in prior standard deviations (E,), and their covariance (E, E)."""
        outputs, knots = len(self.accuracy), len(self.knots())
        if not self.bends:
            return np.zeros(2 * outputs * knots), np.eye(2 * outputs * knots)
        crossed = np.zeros((outputs, 2, knots))
        for index, residual in enumerate(residuals):
            white = turned(self.root(index), residual[None])[0]
            along = np.einsum("fab,af->bf", self._bent[index].conj(), white)
            crossed += np.stack([along.real, along.imag], axis=1) @ self._hats[index].T
        return self._errors_inverse @ crossed.ravel(), self._errors_inverse

    def _left(self, residuals: Sequence[Numbers]) -> tuple[list[Numbers], list[Numbers | float]]:
        """Residuals without the systematic errors (O, F), and the covariance of these errors' estimate (O, O, F).

        The remainder is noise and everything that the model lacks. At low frequencies the errors' estimate absorbs noise, so
        the noise power is the remainder plus that covariance (Dempster, Laird and Rubin 1977,
        doi:10.1111/j.2517-6161.1977.tb01600.x).
        """
        if not self.bends:
            return list(residuals), [0.0] * len(residuals)
        outputs, knots = len(self.accuracy), len(self._hats[0])
        sizes, inverse = self.smooth_errors(residuals)
        sizes = sizes.reshape(outputs, 2, knots)
        inverse = inverse.reshape(outputs, 2, knots, outputs, 2, knots)
        both = (
            inverse[:, 0, :, :, 0]
            + inverse[:, 1, :, :, 1]
            + 1j * (inverse[:, 1, :, :, 0] - inverse[:, 0, :, :, 1])
        )
        both = np.moveaxis(both, 1, 2)
        # Only overlapping hat functions contribute: each with itself and with the next.
        next_ones = both.diagonal(1, 2, 3) + both.diagonal(-1, 2, 3)
        along = np.concatenate([both.diagonal(0, 2, 3), next_ones], axis=2)
        left: list[Numbers] = []
        unsure: list[Numbers | float] = []
        for index, (residual, hats, bands) in enumerate(zip(residuals, self._hats, self._bands, strict=True)):
            scaled = self.accuracy[:, None] * self.responses[index]
            left.append(residual - scaled * (sizes[:, 0] @ hats + 1j * (sizes[:, 1] @ hats)))
            spread = along.real @ bands + 1j * (along.imag @ bands)
            unsure.append(spread * scaled[:, None] * scaled.conj())
        return left, unsure

    def total(self, vector: Array) -> float:
        """Deviance under the noise of its own residuals, with that noise's log determinant; infinite where `cost` is.

        Minima are compared by this total, since the noise estimated at a minimum favours that minimum.
        """
        try:
            return self.with_noise(vector).own_total(vector)
        except (SimulationError, np.linalg.LinAlgError):
            return np.inf

    def own_total(self, vector: Array) -> float:
        """Deviance under the likelihood's noise, with that noise's log determinant."""
        return self.cost(vector) + self.spread()

    def spread(self) -> float:
        """Log determinants of the noise, as part of the deviance."""
        assert self.roots is not None
        return sum(map(spread_of, self.roots))

    def prior_rows(
        self, vector: Array, values: Mapping[str, float] | None = None, jacobian: Array | None = None
    ) -> Array:
        """Residuals and derivatives of the priors, in units of their deviations, shape (K, 1 + P)."""
        c = self.coordinates
        values = c.values(vector) if values is None else values
        jacobian = c.jacobian(values) if jacobian is None else jacobian
        own = len(jacobian)
        states = np.zeros((c.size - own, 1 + c.size))
        states[:, 0] = vector[own:] / -c.state_deviation
        np.fill_diagonal(states[:, 1 + own :], 1.0 / c.state_deviation)
        names, places, means, deviations = self._own_priors
        rows = np.zeros((len(names), 1 + c.size))
        rows[:, 0] = (means - [values[name] for name in names]) / deviations
        rows[:, 1 : 1 + own] = jacobian[places] / deviations[:, None]
        others = [
            prior_row(c, name, prior, values, jacobian)
            for name, prior in self.priors.items()
            if name not in names
        ]
        return np.vstack([rows, *others, states])

    @cached_property
    def _own_priors(self) -> tuple[tuple[str, ...], list[int], Array, Array]:
        """Searched parameters with a prior, their places in a search vector, and the priors' means and deviations."""
        names = tuple(name for name in self.priors if name in self.coordinates.free)
        means, deviations = np.array([self.priors[name] for name in names]).reshape(-1, 2).T
        return names, [self.coordinates.place(name) for name in names], means, deviations

    def root(self, record: int) -> Numbers:
        """Root of the inverse spectral matrix of a record's noise; a guess before the first estimate."""
        return np.eye(len(self.accuracy)) / WHITE if self.roots is None else self.roots[record]

    def _white(self, spectra: Numbers, record: int) -> Array:
        """Spectra (W, O, F) in units of the noise, as rows of real numbers (W, R)."""
        return real_rows(turned(self.root(record), spectra))

    def with_noise(self, vector: Array) -> Self:
        """Return the likelihood with the noise of the residuals at a point of the search."""
        residuals = self.residuals(vector)
        responses = tuple(record.spectrum - one for record, one in zip(self.records, residuals, strict=True))
        roots = self._noise(*self._left(residuals))
        return replace(self, roots=roots, responses=responses)

    def near(self, vector: Array) -> Self:
        """Return the likelihood with costly derivatives frozen at a point of the search; if there are none, unchanged."""
        del vector
        return self

    def settled_at(self, vector: Array) -> Self:
        """Return the likelihood with noise, and what else depends on the model, estimated at a point of the search."""
        return self.with_noise(vector)

    def resettled_at(self, vector: Array) -> Self:
        """Return the likelihood settled at a nearby point; subclasses keep what hardly depends on the point."""
        return self.settled_at(vector)

    def _noise(self, residuals: Sequence[Numbers], unsure: Sequence[Numbers | float]) -> tuple[Numbers, ...]:
        """Root of the inverse spectral matrix of each record's residuals."""
        return tuple(map(noise_root, residuals, unsure))

    def knots(self) -> Array:
        """Knots of the systematic errors, in octaves, (K,); records in time have none."""
        spectra = [record.frequency_hz for record in self.records if hasattr(record, "frequency_hz")]
        least, most = min(one[1] for one in spectra), max(one[-1] for one in spectra)
        return np.arange(np.log2(least), np.log2(most) + OCTAVE, OCTAVE)

    @cached_property
    def _hats(self) -> list[Array]:
        """Hat functions: weight of each knot's error at each frequency of each record, (K, F)."""
        knots, found = self.knots()[:, None], []
        for record in self.records:
            if hasattr(record, "frequency_hz"):
                octaves = np.log2(np.maximum(record.frequency_hz, 1e-9))
                found.append(np.maximum(1.0 - np.abs(octaves - knots) / OCTAVE, 0.0))
            else:
                found.append(np.zeros((len(knots), record.spectrum.shape[1])))
        return found

    @cached_property
    def _bands(self) -> list[Array]:
        """Products of each hat function with itself and with the next one, (2 K - 1, F); no others overlap."""
        return [np.concatenate([hats**2, hats[:-1] * hats[1:]]) for hats in self._hats]

    @cached_property
    def _bent(self) -> list[Numbers]:
        """Systematic errors of each record's outputs without their hat functions, in units of the noise, (F, O, O)."""
        return [
            np.asarray(self.root(index) * (self.accuracy[:, None] * response).T[:, None, :])
            for index, response in enumerate(self.responses)
        ]

    @cached_property
    def _errors_inverse(self) -> Array:
        """Posterior covariance of the systematic errors' sizes (E, E), E = outputs x (amplitude, phase) x knots."""
        if not self.bends:
            return np.zeros((0, 0))
        outputs, knots = len(self.accuracy), len(self._hats[0])
        total = np.zeros((outputs, 2, outputs, 2, knots, knots))
        at = np.arange(knots)
        for bent, bands in zip(self._bent, self._bands, strict=True):
            weight = np.einsum("fab,fac->bcf", bent.conj(), bent)
            for part, places in (
                (weight.real, [(0, 0, 1.0), (1, 1, 1.0)]),
                (weight.imag, [(0, 1, -1.0), (1, 0, 1.0)]),
            ):
                summed = part @ bands.T
                for a, b, sign in places:
                    block = total[:, a, :, b]
                    block[..., at, at] += sign * summed[..., :knots]
                    block[..., at[1:], at[:-1]] += sign * summed[..., knots:]
                    block[..., at[:-1], at[1:]] += sign * summed[..., knots:]
        square = np.moveaxis(total, 4, 2).reshape(2 * outputs * knots, -1)
        return np.asarray(np.linalg.inv(square + np.eye(len(square))))

    @cached_property
    def _shapes(self) -> tuple[Numbers, ...]:
        """Shapes of the systematic errors of each record, in units of their prior deviation, (E, O, F)."""
        found = []
        for hats, response in zip(self._hats, self.responses, strict=True):
            shapes = np.zeros((len(self.accuracy), 2, len(hats), *response.shape), complex)
            for output, accuracy in enumerate(self.accuracy):
                shapes[output, 0, :, output] = accuracy * hats * response[output]
                shapes[output, 1, :, output] = 1j * shapes[output, 0, :, output]
            found.append(shapes.reshape(-1, *response.shape))
        return tuple(found)


def turned(root: Numbers, spectra: Numbers) -> Numbers:
    """Multiply spectra (W, O, F) by a root (F, O, O) or (O, O)."""
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
    """Log determinants of noise by roots of its inverse, lower triangles (F, O, O); each number has two real components."""
    return -4.0 * float(np.log(np.abs(root.diagonal(0, -2, -1))).sum())


def _shape(amplitudes: Array) -> Array:
    """Power law of amplitudes (O, F) over the lowest `STEEP` frequencies, constant above them, (O, F)."""
    steep = min(STEEP, amplitudes.shape[1] - 1)
    places = np.log(np.arange(1, steep + 1))
    places -= places.mean()
    fall = np.log(amplitudes[:, 1 : steep + 1] + 1e-300) @ places / max(places @ places, 1e-300)
    # Constant below the first frequency, too, which is the mean.
    reached = np.clip(np.arange(steep + 1), 1, steep) ** np.clip(fall, MOST_FALL, 0.0)[:, None]
    return np.pad(reached, ((0, 0), (0, amplitudes.shape[1] - steep - 1)), mode="edge")


def noise_root(residual: Numbers, unsure: Numbers | float = 0.0) -> Numbers:
    """Root of the inverse smoothed spectral matrix of residuals (O, F), (F, O, O); `unsure` is added to the matrix."""
    outputs, count = residual.shape
    place = np.arange(count)
    # The torque disturbance by moving water has a steep noise spectrum at low frequencies. An average over neighbouring
    # frequencies would be biased there, so residuals are divided by the spectrum's shape before they are averaged.
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
    """Root of the inverse covariance of residuals `left` (O, R); `said` are the data (O, R).

    The unknowns absorb noise: residuals have only `share` of its power. The root is scaled by the quantile, so that all
    intervals end at the same rise of the deviance.
    """
    covariance = left @ left.T / (left.shape[1] * share)
    size = LEAST_NOISE**2 * (np.mean(said**2, axis=1) + 1e-12) + LEAST_OWN * np.diag(covariance)
    root = np.linalg.inv(np.linalg.cholesky(covariance + np.diag(size)))
    return np.asarray(root * (DEVIATIONS_95 / quantile))


@cache
def quantile_of(freedom: int) -> float:
    """Half width of a 95 % interval, in standard deviations, by Student's t: noise from few numbers is uncertain."""
    return float(student.ppf(0.975, max(freedom, 1)))


def _inverse_root(matrix: Numbers) -> Numbers:
    """Inverse Cholesky factor of matrices by lower triangles (O, O, F); `LinAlgError` where one is not positive definite."""
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
