"""The likelihood: residuals of all outputs, with their spectral matrix as noise, and priors.

Besides its parameters a model has linear unknowns with a prior, the systematic errors, which are eliminated in closed form.
They are relative errors of each output's response in amplitude and phase. They vary slowly with frequency (over an octave)
and are as large as errors of gauge and calibration (Kennedy and O'Hagan 2001, doi:10.1111/1467-9868.00294).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.coordinates import Coordinates, prior_row, wall_rows
from shipfp_rs.identification.model import Model, Units
from shipfp_rs.identification.noise import noise_root, quantile_of, real_rows, spread_of, turned, white_root
from shipfp_rs.identification.ship_model import ShipModel
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import DEVIATIONS_95, Array, Numbers
from shipfp_rs.support.threads import where_alone

T = TypeVar("T")

ACCURACY = 3e-3
"""Prior standard deviation of the systematic errors of an output's response, due to gauge and calibration."""
OCTAVE = 1.0
"""Width of a systematic error in octaves."""
STEP = 1e-4
"""Step of a difference quotient by an entry of a search vector, relative to the width of its bounds if that is below 1."""
QUICK = 60_000
"""Size of a derivative matrix below which threads do not pay off, since a kernel call takes half a millisecond."""


class Products(NamedTuple):
    """Deviance at a point of the search, its gradient times -1/2, and the Gauss-Newton matrix."""

    cost: float
    downhill: Array
    matrix: Array


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Likelihood of models for their records."""

    models: tuple[Model, ...]  # of each record
    coordinates: Coordinates
    accuracy: Array  # standard deviation of each output's systematic errors (O,)
    priors: Mapping[str, tuple[float, float]]  # parameter to (mean, standard deviation)
    # Root of the inverse spectral matrix of each record's noise, (F, O, O), or (O, O) if white. None: not estimated yet.
    roots: tuple[Numbers, ...] | None = None
    # Spectra (O, F) of the model's outputs at the parameters at which the noise was estimated. Systematic errors are
    # relative to them: errors relative to the data would treat noise as response, and reward a smaller response.
    responses: tuple[Numbers, ...] = ()
    about: Array | None = (
        None  # point at which derivatives of effects without closed form are computed; None: each point
    )

    @property
    def records(self) -> tuple[Any, ...]:
        """The data of each record in the form that is compared with the model."""
        return tuple(model.record for model in self.models)

    @property
    def limited(self) -> bool:
        """Whether a limit of torque or rate acts."""
        return self.models[0].limited

    def with_models(self, **changes: Any) -> Self:
        """Return the likelihood with fields of all its models changed."""
        return replace(self, models=tuple(replace(model, **changes) for model in self.models))  # type: ignore[type-var]

    def with_records(self, records: Iterable[Any]) -> Self:
        """Return the likelihood of other records of the same ships."""
        pairs = zip(self.models, records, strict=True)
        return replace(self, models=tuple(replace(model, record=record) for model, record in pairs))  # type: ignore[type-var]

    def of_structure(self, structure: Structure) -> Self:
        """Return the likelihood of a structure that has the same parameters, but of which others are free."""
        c = self.coordinates
        return replace(self, coordinates=Coordinates.of(structure, c.unknowns, c.state_deviation))

    @cached_property
    def is_quick(self) -> bool:
        """Whether an evaluation is too short for threads to pay off."""
        fused = all(isinstance(model, ShipModel) and not model.limited for model in self.models)
        return fused and self.coordinates.size * sum(model.spectrum.shape[1] for model in self.models) < QUICK

    def each(self, jobs: Sequence[Callable[[], T]]) -> list[T]:
        """Run jobs that evaluate this likelihood, in parallel where that is faster; return the results in order."""
        return [job() for job in jobs] if self.is_quick else where_alone(jobs)

    def points(self, vector: Array) -> list[tuple[Model, dict[str, float], Array]]:
        """Each record's model, with the parameters and the record's unknowns at a point of the search."""
        values = self.coordinates.values(vector)
        return [
            (model, values, vector[self.coordinates.states(index)]) for index, model in enumerate(self.models)
        ]

    @property
    def _all(self) -> range:
        return range(len(self.models))

    def known(self, vector: Array, record: int) -> dict[str, float]:
        """Parameters and a record's unknowns by name."""
        return self.coordinates.values(vector) | self.coordinates.states_at(vector)[record]

    def residuals(self, vector: Array) -> list[Numbers]:
        """Residuals (O, F) of each record."""
        return [self.residual(vector, index) for index in self._all]

    def residual(self, vector: Array, record: int) -> Numbers:
        """Residuals (O, F) of a record."""
        model, values, own = self.points(vector)[record]
        found = model.rows(values, own, ())[0]
        return np.asarray(found - model.effect(values, own)) if model.has_effect else found

    def modelled(self, vector: Array, record: int) -> Array:
        """Modelled outputs of a record, decimated (O, K)."""
        model = self.models[record]
        assert isinstance(model, ShipModel)
        return model.modelled(self.residual(vector, record))

    def spectra(self, vector: Array, record: int) -> tuple[Numbers, Numbers]:
        """Residuals (O, F) of a record, and the model's derivatives by the whole search vector (P, O, F)."""
        rows = self._local(vector, record)
        jacobian = np.zeros((self.coordinates.size, *rows.shape[1:]), rows.dtype)
        jacobian[self._places(record)] = rows[1:]
        return rows[0], jacobian

    def _local(self, vector: Array, record: int) -> Numbers:
        """Residual and derivatives (1 + W + U, O, F) by the entries of a search vector that a record depends on."""
        model, values, own = self.points(vector)[record]
        rows = model.rows(values, own, self.coordinates.names)
        rows = np.tensordot(self._turn(model, values, self.coordinates.jacobian(values)).T, rows, 1)
        if model.has_effect:
            effect = model.effect(values, own)
            moves = self._moves(vector, record, effect) if self.about is None else self._moves_about[record]
            rows = rows - np.concatenate([effect[None], -moves])
        return np.asarray(rows)

    def _moves(self, vector: Array, record: int, effect: Numbers) -> Numbers:
        """Derivatives (W + U, O, F) of a record's effect, by difference quotients."""
        low, high = self.coordinates.bounds

        def move(place: int) -> Numbers:
            step = STEP * min(high[place] - low[place], 1.0)
            step = step if vector[place] + step <= high[place] else -step
            moved = vector.copy()
            moved[place] += step
            model, values, own = self.points(moved)[record]
            return np.asarray((model.effect(values, own) - effect) / step)

        return np.array(self.each([partial(move, int(place)) for place in self._places(record)]))

    @cached_property
    def _moves_about(self) -> list[Numbers]:
        assert self.about is not None
        about = self.about
        effects = [model.effect(values, own) for model, values, own in self.points(about)]
        return [self._moves(about, index, effect) for index, effect in enumerate(effects)]

    def _places(self, record: int) -> npt.NDArray[np.intp]:
        """Indices of the free parameters and a record's unknowns in a search vector."""
        own, states = len(self.coordinates.names), self.coordinates.states(record)
        return np.array([*range(own), *range(states.start, states.stop)])

    @cached_property
    def _columns(self) -> list[npt.NDArray[np.intp]]:
        """Columns of each record's residual and derivatives among those of the whole search vector."""
        return [np.append(0, 1 + self._places(index)) for index in self._all]

    def _turn(self, model: Model, values: Mapping[str, float], by: Array) -> Array:
        """Derivatives of a model's own columns by the entries of a search vector that it depends on."""
        link, count = model.link(values, self.coordinates.names) @ by, len(model.unknowns)
        (rows, columns) = link.shape
        turn = np.zeros((1 + rows + count, 1 + columns + count))
        turn[0, 0] = 1.0
        turn[1 : 1 + rows, 1 : 1 + columns] = link
        turn[1 + rows :, 1 + columns :] = np.eye(count)
        return turn

    @property
    def quantile(self) -> float:
        """Half width of a 95 % interval, in standard deviations; larger where the noise is estimated from few numbers."""
        return quantile_of(self.freedom) if self._is_white else DEVIATIONS_95

    @property
    def _is_white(self) -> bool:
        return all(model.noise == "white" for model in self.models)

    @cached_property
    def _white_numbers(self) -> int:
        """Number of real numbers in all spectra with white noise."""
        numbers = sum(model.numbers for model in self.models if model.noise == "white")
        return len(self.accuracy) * numbers

    @property
    def freedom(self) -> int:
        """Degrees of freedom of white noise: real numbers in the data minus unknowns."""
        return self._white_numbers - self.coordinates.size

    @property
    def untold(self) -> bool:
        """Whether there are too few samples to estimate any noise."""
        return self._is_white and self.freedom <= 0

    def under(self, residuals: Sequence[Numbers]) -> float:
        """Deviance of residuals with the noise that is estimated from them."""
        own = replace(self, roots=self._noise(residuals, [0.0] * len(residuals)))
        return own.spread() + float(np.sum(own._white_rows(one[None] for one in residuals) ** 2))

    @cached_property
    def bends(self) -> bool:
        """Whether systematic errors are included."""
        return self.roots is not None and bool(self.accuracy.any())

    def products(self, vector: Array) -> Products:
        """Deviance, gradient and Gauss-Newton matrix; `SimulationError` for a model that diverges or an unstable loop."""
        with np.errstate(over="ignore", invalid="ignore"):
            gram = self.gram(vector)
        return Products(float(gram[0, 0]), gram[1:, 0], gram[1:, 1:])

    def cost(self, vector: Array) -> float:
        """Deviance at a point of the search; infinite where the model diverges."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                return float(self.gram(vector, derivatives=False)[0, 0])
        except SimulationError:
            return np.inf

    def gram(
        self, vector: Array, columns: Sequence[Numbers] = (), *, derivatives: bool = True, fused: bool = True
    ) -> Array:
        """Gram matrix of residual, derivatives and `columns`, (1 + P + C, 1 + P + C), with systematic errors and priors."""
        # `columns` are spectra of the outputs (C, O, F) for each record. `fused`: a kernel computes products where it can.
        values = self.coordinates.values(vector)
        by = self.coordinates.jacobian(values) if derivatives else np.zeros((0, 0))
        names = self.coordinates.names if derivatives else ()
        size, more = self.coordinates.size if derivatives else 0, len(columns[0]) if columns else 0
        gram = np.zeros((1 + size + more, 1 + size + more))
        errors = np.zeros((len(gram), self._error_count))
        for index, model in enumerate(self.models):
            at = self._columns[index] if derivatives else np.zeros(1, int)
            at = np.append(at, np.arange(1 + size, len(gram))) if columns else at
            if isinstance(model, ShipModel) and fused and not (columns or model.has_effect):
                own = vector[self.coordinates.states(index)]
                products, crossed = model.products(values, own, names, self._units[index])
                if derivatives:
                    turn = self._turn(model, values, by)
                    products, crossed = turn.T @ products @ turn, crossed @ turn
                along = crossed.T
            else:
                rows = self._local(vector, index) if derivatives else self.residual(vector, index)[None]
                if columns:
                    rows = np.concatenate([rows, columns[index]])
                white = turned(self.root(index), rows)
                flat = real_rows(white)
                products, along = flat @ flat.T, self.along_errors(index, white)
            gram[at[:, None], at] += products
            if self.bends:
                errors[at] += along
        if self.bends:
            gram -= errors @ self.errors_inverse @ errors.T
        priors = (
            self.prior_rows(vector, values, by) if derivatives else self.prior_rows(vector, values)[:, :1]
        )
        own_size = priors.shape[1]
        gram[:own_size, :own_size] += priors.T @ priors
        if not np.isfinite(gram).all():
            raise SimulationError("the deviance is not finite")
        return gram

    @cached_property
    def is_fused(self) -> bool:
        """Whether a kernel computes the products of all records."""
        return all(isinstance(model, ShipModel) and not model.has_effect for model in self.models)

    def row_units(self, rows: Sequence[Numbers]) -> list[Units]:
        """Convert rows (O, F) of each record to units of the noise, in the form of `along`; only if `is_fused`."""
        found = []
        for index, (model, row) in enumerate(zip(self.models, rows, strict=True)):
            assert isinstance(model, ShipModel)
            # The kernel accepts only systematic errors: a row becomes an error of the first output, with a hat of ones.
            bent = np.zeros((row.shape[1], len(row), len(row)), complex)
            bent[:, :, 0] = row.T
            found.append(model.units(self.root(index), (bent, np.ones((1, row.shape[1])))))
        return found

    def along(self, vector: Array, rows: Sequence[Units]) -> Array:
        """Products (1 + P,) of residual and derivatives with rows of `row_units`."""
        found = np.zeros(1 + self.coordinates.size)
        values = self.coordinates.values(vector)
        by = self.coordinates.jacobian(values)
        for index, (model, row) in enumerate(zip(self.models, rows, strict=True)):
            assert isinstance(model, ShipModel)
            own = vector[self.coordinates.states(index)]
            crossed = model.products(values, own, self.coordinates.names, row)[1][0]
            found[self._columns[index]] += crossed @ self._turn(model, values, by)
        return found

    @cached_property
    def _units(self) -> list[Units]:
        """Noise and systematic errors of each record, in the form of the kernel."""
        found = []
        for index, model in enumerate(self.models):
            assert isinstance(model, ShipModel)
            bent = (self._bent[index], self._hats[index]) if self.bends else None
            found.append(model.units(self.root(index), bent))
        return found

    def along_errors(self, record: int, white: Numbers) -> Array:
        """Products of rows (R, O, F), in units of the noise, with the systematic errors, (R, E)."""
        if not self.bends:
            return np.zeros((len(white), 0))
        along = np.einsum("fab,caf->cbf", self._bent[record].conj(), white)
        parts = np.stack([along.real, along.imag], axis=2) @ self._hats[record].T
        return np.asarray(parts.reshape(len(white), -1))

    def whitened(self, vector: Array) -> Array:
        """Residual, derivatives and systematic errors in units of the noise, with rows of the priors, (R, 1 + P + E)."""
        rows = self._white_rows(
            np.concatenate([r[None], j]) for r, j in map(partial(self.spectra, vector), self._all)
        )
        if self.bends:
            rows = np.concatenate([rows, self._white_rows(self.shapes)])
        priors = self.prior_rows(vector)
        errors = len(rows) - priors.shape[1]
        own = np.eye(errors, len(rows), priors.shape[1])
        return np.concatenate([rows.T, np.pad(priors, ((0, 0), (0, errors))), own])

    def _white_rows(self, spectra: Iterable[Numbers]) -> Array:
        """Spectra (W, O, F) of each record in units of the noise, as rows of real numbers of all records, (W, R)."""
        rows = [real_rows(turned(self.root(index), one)) for index, one in enumerate(spectra)]
        return np.concatenate(rows, axis=1)

    def smooth_errors(self, residuals: Sequence[Numbers]) -> tuple[Array, Array]:
        """Estimated sizes of the systematic errors in prior standard deviations (E,), and their covariance (E, E)."""
        if not self.bends:
            size = 2 * len(self.accuracy) * len(self.knots())
            return np.zeros(size), np.eye(size)
        along = sum(
            self.along_errors(index, turned(self.root(index), residual[None]))[0]
            for index, residual in enumerate(residuals)
        )
        return self.errors_inverse @ along, self.errors_inverse

    def _left(self, residuals: Sequence[Numbers]) -> tuple[list[Numbers], list[Numbers | float]]:
        """Residuals without the systematic errors (O, F), and the covariance of these errors' estimate (O, O, F)."""
        # The remainder is noise and everything that the model lacks. At low frequencies the errors' estimate absorbs noise,
        # so the noise power is the remainder plus that covariance (Dempster, Laird and Rubin 1977,
        # doi:10.1111/j.2517-6161.1977.tb01600.x).
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
        """Deviance with noise estimated at the same point, log determinant included; infinite where `cost` is."""
        # Minima are compared by this total, since the noise estimated at a minimum favours that minimum.
        try:
            return self.with_noise(vector).own_total(vector)
        except (SimulationError, np.linalg.LinAlgError):
            return np.inf

    def own_total(self, vector: Array) -> float:
        """Deviance under the likelihood's noise, log determinant included, less the deviance expected of `information`."""
        return self.cost(vector) + self.spread() - sum(model.expected for model in self.models)

    def spread(self) -> float:
        """Log determinants of the noise, a part of the deviance."""
        assert self.roots is not None
        found = 0.0
        for model, root in zip(self.models, self.roots, strict=True):
            if model.noise == "coloured":
                found += spread_of(root)
            elif model.noise == "white":
                found -= 2.0 * model.numbers * float(np.log(np.abs(np.diag(root))).sum())
        return found

    def prior_rows(
        self, vector: Array, values: Mapping[str, float] | None = None, jacobian: Array | None = None
    ) -> Array:
        """Residuals and derivatives (K, 1 + P) of priors, of active penalties, and of the models' further information."""
        c = self.coordinates
        values = c.values(vector) if values is None else values
        jacobian = c.jacobian(values) if jacobian is None else jacobian
        walls = wall_rows(c, values, jacobian) if self.models[0].has_walls else []
        own = self.own_prior_rows(vector, values, jacobian)
        return np.vstack([own, *walls, *self._further_rows(vector, values, jacobian)])

    def own_prior_rows(self, vector: Array, values: Mapping[str, float], jacobian: Array) -> Array:
        """Residuals and derivatives (K, 1 + P) of the priors of parameters and of the records' unknowns."""
        c, own = self.coordinates, len(jacobian)
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

    def _further_rows(self, vector: Array, values: Mapping[str, float], jacobian: Array) -> list[Array]:
        """Rows (K, 1 + P) of the models' further information, and a row for the loop that active clamps open."""
        found, c = [], self.coordinates
        for index, model in enumerate(self.models):
            rows = model.information(values, vector[c.states(index)], c.names)
            if rows is not None:
                whole = np.zeros((len(rows), 1 + c.size))
                whole[:, self._columns[index]] = rows @ self._turn(model, values, jacobian)
                found.append(whole)
        if any(model.held for model in self.models):
            size, row = self._opened(values), np.zeros((1, 1 + c.size))
            row[0, 0] = -size
            for place in range(len(c.names)):
                moved = vector.copy()
                moved[place] += STEP
                row[0, 1 + place] = (self._opened(c.values(moved)) - size) / STEP
            found.append(row)
        return found

    def _opened(self, values: Mapping[str, float]) -> float:
        """Root of the deviance that is added because the loop is open while a clamp is active."""
        return float(np.sqrt(max(sum(model.opened(values) for model in self.models), 0.0)))

    @cached_property
    def _own_priors(self) -> tuple[tuple[str, ...], list[int], Array, Array]:
        """Searched parameters with a prior, their places in a search vector, and the priors' means and deviations."""
        names = tuple(name for name in self.priors if name in self.coordinates.free)
        means, deviations = np.array([self.priors[name] for name in names]).reshape(-1, 2).T
        return names, [self.coordinates.place(name) for name in names], means, deviations

    def root(self, record: int) -> Numbers:
        """Root of the inverse spectral matrix of a record's noise; a guess before the first estimate."""
        return self.models[record].first_root if self.roots is None else self.roots[record]

    def with_noise(self, vector: Array) -> Self:
        """Return the likelihood with noise and further information estimated from the residuals at a point of the search."""
        points, free = self.points(vector), self.coordinates.free
        now = replace(self, models=tuple(model.prepared(values) for model, values, _ in points))
        residuals = now.residuals(vector)
        roots = now._noise(*now._left(residuals))
        responses = tuple(
            model.bent(model.spectrum - residual, values, self.accuracy, free)
            for (model, values, _), residual in zip(points, residuals, strict=True)
        )
        found = replace(now, roots=roots, responses=responses)
        left, _ = found._left(residuals)
        models = tuple(
            model.informed(one, values, own, self.accuracy, free)
            for (model, values, own), one in zip(found.points(vector), left, strict=True)
        )
        return replace(found, models=models)

    def near(self, vector: Array) -> Self:
        """Return a likelihood whose effects without a closed form have constant derivatives, those at a point."""
        return replace(self, about=vector) if self.limited else self

    def corrected(self, vector: Array) -> Self:
        """Return the likelihood with each record corrected by its model at a point of the search."""
        models = tuple(model.corrected(values, own) for model, values, own in self.points(vector))
        return replace(self, models=models)

    def settled_at(self, vector: Array) -> Self:
        """Return the likelihood with records corrected, and noise estimated, at a point of the search."""
        return self.corrected(vector).with_noise(vector)

    def resettled_at(self, vector: Array) -> Self:
        """Return the likelihood settled at a nearby point; images of a set point change little, and are kept unless held."""
        corrected = any(model.is_corrected(self.coordinates.free) for model in self.models)
        return self.settled_at(vector) if corrected else self.with_noise(vector)

    def _noise(self, residuals: Sequence[Numbers], unsure: Sequence[Numbers | float]) -> tuple[Numbers, ...]:
        """Root of the inverse spectral matrix of each record's residuals; responses with white noise share one."""
        share = max(self.freedom, 1) / max(self._white_numbers, 1)
        pooled = [i for i, one in enumerate(self.models) if one.noise == "white" and one.is_pooled]
        found: list[Numbers] = []
        for index, (model, residual, own) in enumerate(zip(self.models, residuals, unsure, strict=True)):
            if model.noise == "coloured":
                root = noise_root(residual, own)
            elif model.noise == "known":
                root = np.eye(len(residual))
            else:
                places = pooled if index in pooled else [index]
                rows, said = (
                    np.concatenate([real_rows(self.models[at].compared(of[at])) for at in places], axis=1)
                    for of in (residuals, [one.spectrum for one in self.models])
                )
                root = white_root(rows, said, share, self.quantile)
            found.append(root * model.told)
        return tuple(found)

    def knots(self) -> Array:
        """Knots of the systematic errors, in octaves, (K,)."""
        spectra = [model.frequency_hz for model in self.models if model.frequency_hz is not None]
        least, most = min(one[1] for one in spectra), max(one[-1] for one in spectra)
        return np.arange(np.log2(least), np.log2(most) + OCTAVE, OCTAVE)

    @cached_property
    def _error_count(self) -> int:
        return 2 * len(self.accuracy) * len(self._hats[0]) if self.bends else 0

    @cached_property
    def _hats(self) -> list[Array]:
        """Hat functions: weight of each knot's error at each frequency of each record, (K, F)."""
        knots, found = self.knots()[:, None], []
        for model in self.models:
            if model.frequency_hz is not None:
                octaves = np.log2(np.maximum(model.frequency_hz, 1e-9))
                found.append(np.maximum(1.0 - np.abs(octaves - knots) / OCTAVE, 0.0))
            else:
                found.append(np.zeros((len(knots), model.spectrum.shape[1])))
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
    def errors_inverse(self) -> Array:
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
    def white_shapes(self) -> list[Numbers]:
        """Shapes of the systematic errors of each record in units of the noise, without means, (E, O, F)."""
        found = [turned(self.root(index), shapes) for index, shapes in enumerate(self.shapes)]
        for one in found:
            one[..., 0] = 0.0
        return found

    @cached_property
    def shapes(self) -> tuple[Numbers, ...]:
        """Shapes of the systematic errors of each record, in units of their prior deviation, (E, O, F)."""
        found = []
        for hats, response in zip(self._hats, self.responses, strict=True):
            shapes = np.zeros((len(self.accuracy), 2, len(hats), *response.shape), complex)
            for output, accuracy in enumerate(self.accuracy):
                shapes[output, 0, :, output] = accuracy * hats * response[output]
                shapes[output, 1, :, output] = 1j * shapes[output, 0, :, output]
            found.append(shapes.reshape(-1, *response.shape))
        return tuple(found)
