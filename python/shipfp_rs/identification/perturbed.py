"""Draws of a fingerprint's parameters: the estimates that other noise of the same kind would give.

Each draw adds random noise, systematic errors and prior means to the residuals and searches the minimum again. The minima
spread along valleys of the deviance, up to the bounds. This is randomised maximum likelihood (Oliver, He and Reynolds 1996).
The draws follow the likelihood times Jeffreys' measure, which does not depend on the choice of parameters. If every
parameter has a prior, weights make the draws follow the posterior (as in Bardsley et al. 2014, doi:10.1137/140964023). Only
second derivatives of the model are neglected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from shipfp_rs.errors import IdentificationError, InputError
from shipfp_rs.identification.basins import Basin, descend
from shipfp_rs.identification.draws import Draws
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.likelihood import Likelihood, Products
from shipfp_rs.identification.model import Units
from shipfp_rs.identification.rebuilt import Rebuilt, rebuilt
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import COMBINATIONS
from shipfp_rs.support.arrays import Array, Numbers
from shipfp_rs.support.threads import where_alone, with_one_blas_thread

MOST_DRAWS, CHUNK = 1_000_000, 25
"""Largest number of draws, and number of draws per job."""
SETTLED, STEPS = 0.05, 30
"""Decrease of the deviance below which a descent stops, and largest number of its steps."""
LEAST_FOUND = 0.9
"""Least share of descents that end in a minimum."""


@dataclass(frozen=True)
class Perturbed:
    """A likelihood of perturbed data: a row per record is added to the residuals, `means` to the means of the priors."""

    likelihood: Likelihood
    means: Array
    rows: Sequence[Units] = ()  # perturbations in the kernel's layout, without systematic errors
    columns: Sequence[Numbers] = ()  # perturbations as spectra (1, O, F), where there is no kernel

    @classmethod
    def of(cls, likelihood: Likelihood, random: np.random.Generator, size: float) -> Self:
        """Return a likelihood with drawn noise, systematic errors and prior means, each scaled by `size`."""
        rows, along = [], np.zeros(0)
        errors = random.standard_normal(len(likelihood.errors_inverse))
        for index, model in enumerate(likelihood.models):
            row = random.standard_normal(model.spectrum.shape).astype(model.spectrum.dtype)
            if np.iscomplexobj(row):
                row = row + 1j * random.standard_normal(row.shape)
            if likelihood.bends:
                row = row + np.tensordot(errors, likelihood.white_shapes[index], 1)
                along = likelihood.along_errors(index, row[None])[0] + (along if index else 0.0)
            rows.append(size * row)
        c = likelihood.coordinates
        means = size * random.standard_normal(len(likelihood.priors) + c.size - len(c.names))
        if not likelihood.is_fused:
            roots = (likelihood.root(index) for index in range(len(rows)))
            spectra = [np.linalg.solve(root, row.T[..., None]) for root, row in zip(roots, rows, strict=True)]
            return cls(likelihood, means, columns=[one[..., 0].T[None] for one in spectra])
        if likelihood.bends:
            sizes = size * likelihood.errors_inverse @ along
            pairs = zip(rows, likelihood.white_shapes, strict=True)
            rows = [row - np.tensordot(sizes, shapes, 1) for row, shapes in pairs]
        return cls(likelihood, means, likelihood.row_units(rows))

    @property
    def coordinates(self) -> Any:
        """Coordinates of the search."""
        return self.likelihood.coordinates

    def near(self, vector: Array) -> Self:
        """Return this object unchanged: derivatives without closed form are kept as computed at the minimum."""
        del vector
        return self

    def products(self, vector: Array) -> Products:
        """Deviance (up to a constant), gradient and Gauss-Newton matrix at a point of the search."""
        if self.likelihood.is_fused:
            found, along = self.likelihood.products(vector), self.likelihood.along(vector, self.rows)
        else:
            with np.errstate(over="ignore", invalid="ignore"):
                gram = self.likelihood.gram(vector, self.columns)
            found, along = Products(float(gram[0, 0]), gram[1:-1, 0], gram[1:-1, 1:-1]), gram[:-1, -1]
        c = self.likelihood.coordinates
        values = c.values(vector)
        along = along + self.means @ self.likelihood.own_prior_rows(vector, values, c.jacobian(values))
        return found._replace(cost=found.cost + 2.0 * along[0], downhill=found.downhill + along[1:])


@with_one_blas_thread
def draws_of(fingerprint: Fingerprint, n: int, seed: int, structure: Structure | None = None) -> Draws:
    """Return draws of a fingerprint's parameters; see `Fingerprint.draws`."""
    if not 1 <= n <= MOST_DRAWS:
        raise InputError(f"n is {n}, expected 1 to {MOST_DRAWS}")
    if not fingerprint.engine_described:
        raise InputError(
            "draws: the fingerprint tells the load's side alone, since the data contradict the model of drive and governor"
        )
    fit, optimum = rebuilt(fingerprint, structure), fingerprint.optimum
    c = fit.likelihood.coordinates
    unknown = {name for name, one in fingerprint.parameters.items() if one.status == "unidentifiable"}
    names = [name for name in optimum if name in c.free or name not in unknown]
    derived = [name for name in fingerprint.derived if name not in names]
    random = np.random.default_rng(seed)
    chosen = random.choice(len(fit.basins), size=n, p=_chances(fit)).tolist()
    seeds = random.integers(2**63, size=n).tolist()
    parts = np.array_split(np.arange(n), -(-n // CHUNK))
    # One likelihood for all draws from a minimum: derivatives without closed form are computed once.
    about = [fit.likelihood.near(one.vector) for one in fit.basins]
    jobs = [partial(_minima, fit, about, [(chosen[at], seeds[at]) for at in part]) for part in parts]
    ends = [end for found in where_alone(jobs) for end in found if np.isfinite(end.cost)]
    if len(ends) < LEAST_FOUND * n:
        raise IdentificationError(
            f"draws: found a minimum for {len(ends)} of {n} draws, expected {LEAST_FOUND:.0%}; give a structure with fewer "
            "elements, or fixed parameters or priors"
        )
    every = [{**optimum, **c.values(end.vector)} for end in ends]
    table = np.array(
        [[*(one[name] for name in names), *(COMBINATIONS[name][1](one) for name in derived)] for one in every]
    )
    if not set(c.names) <= set(fit.likelihood.priors):
        again = np.arange(n) % len(table)  # other draws replace the few without a minimum
        return Draws((*names, *derived), table[again], len(table))
    weights = _posterior(fit, [end.vector for end in ends])
    return Draws((*names, *derived), table[_resampled(weights, n, random)], round(1.0 / np.sum(weights**2)))


def _posterior(fit: Rebuilt, points: Sequence[Array]) -> Array:
    """Weights with which the minima follow the posterior distribution."""
    # The probability density of the minima is proportional to exp(-g' H^-1 g / 2) sqrt(det H), with the gradient g and the
    # curvature H of the unperturbed deviance at a minimum. The factor sqrt(det H) is Jeffreys' measure.
    c, found = fit.likelihood.coordinates, []
    for point in points:
        now = fit.likelihood.products(point)
        explained = now.downhill @ np.linalg.solve(now.matrix, now.downhill)
        scale = np.linalg.slogdet(c.jacobian(c.values(point)))[1] - 0.5 * np.linalg.slogdet(now.matrix)[1]
        found.append(scale - 0.5 * (now.cost - explained) / fit.widening**2)
    return np.asarray(softmax(found))


def _resampled(weights: Array, n: int, random: np.random.Generator) -> npt.NDArray[np.intp]:
    """Indices of n draws with these weights by systematic resampling, in random order."""
    places = np.searchsorted(np.cumsum(weights), (random.random() + np.arange(n)) / n)
    return random.permutation(np.minimum(places, len(weights) - 1))


def _chances(fit: Rebuilt) -> Array:
    """Probability of each minimum."""
    return np.asarray(softmax([-0.5 * one.cost / fit.widening**2 for one in fit.basins]))


def _minima(fit: Rebuilt, about: Sequence[Likelihood], draws: Sequence[tuple[int, int]]) -> list[Basin]:
    """Return the minimum of each draw. A draw is the index of the basin where its search starts, and a seed."""
    found = []
    for place, seed in draws:
        start = fit.basins[place].vector
        other = Perturbed.of(about[place], np.random.default_rng(seed), fit.widening)
        found.append(descend(other, start, steps=STEPS, settled=SETTLED))  # type: ignore[arg-type]
    return found
