"""Residual tests: what a fit leaves over should be white and free of the set point (Ljung 1999, section 16.6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2

from shipfp_rs._core import leftover_sums
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.blocks import Block
from shipfp_rs.identification.search import AR_ORDER, Search
from shipfp_rs.identification.weighted_problem import Minimum, Noise, mean_scatter
from shipfp_rs.identification.whiteness import ResidualTest, whiteness
from shipfp_rs.identification.whitening import Evaluation, Whitening
from shipfp_rs.optimise.normal_equations import Products, orthonormal
from shipfp_rs.support.quantiles import DEVIATIONS_95

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

INPUT_LAGS = 12
"""Number of lags of the set point besides zero, in geometric steps, since missing dynamics may be fast or slow."""
INPUT_REACH = 10
"""The longest lag, as a part of the record."""
OPEN = 1e-8
"""A direction of the lagged set points counts as explained by the fit where less than this part of its size is left."""

STILL = 1e-4
"""The fit explains more than chance where the probability is below this."""


@dataclass(frozen=True)
class OutputTests:
    """Both tests of one output's residuals, and how many samples they had."""

    whiteness: ResidualTest
    by_input: ResidualTest
    samples: int

    def figures(self) -> dict[str, float | None]:
        """Return the two p-values and what the set point still explains [%], for the fingerprint's fit."""
        return {
            "whiteness_p": self.whiteness.p,
            "input_correlation_p": self.by_input.p,
            "input_explained_pct": 100.0 * min(self.by_input.statistic / self.samples, 1.0),
        }

    def correlograms(self) -> dict[str, dict[str, list[float]]]:
        """Return the JSON form of the correlations by lag."""
        return {"autocorrelation": self.whiteness.by_lag(), "set_point": self.by_input.by_lag()}


def input_correlations(
    search: Search, minimum: Minimum, evaluations: Sequence[Evaluation]
) -> dict[str, ResidualTest]:
    """Test the whitened residuals of each output for what the set point still explains.

    Ljung's test compares the correlations of residual and lagged set point with their scatter for white residuals.
    A fit has taken away what its own sensitivities J explain, so here the lagged set points U are cleared of
    J first: with A = (I - J J+) U and S the covariance of the residuals e, (A'e)' (A' S A)^-1 (A'e) is chi-squared.
    `evaluations` are those of the search at the minimum, filtered by the noise models, without columns of offsets.
    """
    noise, outputs = minimum.noise, search.structure.outputs
    residuals = [noise.root @ evaluation.residual for evaluation in evaluations]
    priors = search.priors(minimum.vector)
    gram = search.gram(minimum.vector, noise, minimum.sums)
    lags = _lags(search)
    count = sum(map(np.count_nonzero, residuals)) + int(np.count_nonzero(priors[:, -1]))
    basis = orthonormal(gram[:-1, :-1])
    along = basis.T @ gram[:-1, -1]
    free = range(len(search.free))
    records = [
        _Record.of(block, evaluation, residual, basis[[*free, *range(own.start, own.stop)]], noise, lags)
        for block, evaluation, residual, own in zip(
            search.blocks, evaluations, residuals, search.places(), strict=True
        )
    ]
    tests: dict[str, ResidualTest] = {}
    for index, output in enumerate(outputs):
        factors = noise.root[:, index]
        across = np.sum([np.tensordot(factors, record.across[index], 1) for record in records], axis=0)
        explained, products = across[:, :-1].T, across[:, -1]
        length = np.sqrt(factors @ factors * sum(record.squares[index] for record in records))
        turned = priors[:, :-1] @ basis @ explained
        covariance = turned.T @ turned
        for record in records:
            covariance += record.covariance(index, factors, explained)
        tests[output] = _test(
            length, covariance, products - explained.T @ along, max(float(gram[-1, -1]), 0.0), count, lags
        )
    return tests


@dataclass(frozen=True)
class _Record:
    """Sums of one block's lagged set points (L), its sensitivities in an orthonormal basis (B) and its residuals.

    Each output (first axis) has the lagged set points that its noise model filters. `across` (O, L, O, B + 1) are their
    products with the basis and the residual in each output, `squares` (O, L) those with themselves. The rows of
    `coloured` (O (L + B), O (L + B)) are filtered once more, backwards, as the residuals' own colour asks for; `scatter`
    (O, O) is what it leaves of them.
    """

    across: Array
    squares: Array
    coloured: Array
    scatter: Array
    own_inputs: bool
    """Whether the outputs' lagged set points differ, so that all of a test's are those of the output it is about."""

    @classmethod
    def of(
        cls,
        block: Block,
        evaluation: Evaluation,
        residual: Array,
        basis: Array,
        noise: Noise,
        lags: npt.NDArray[np.int64],
    ) -> _Record:
        """Add up a block's lagged set points, whitened residuals (O, R) and sensitivities combined by a basis (Q, B)."""
        outputs, samples = residual.shape
        columns = len(evaluation.jacobian)
        mix = np.zeros((outputs, basis.shape[1], columns * outputs + 1))
        mix[..., :-1] = -np.einsum("op,qb->obqp", noise.root, basis[:columns]).reshape(*mix.shape[:2], -1)
        whitening = noise.whitening
        filters = [np.ones(1)] if whitening is None else list(whitening.models)
        for output, row in enumerate(basis[columns:]):
            gain = filters[min(output, len(filters) - 1)].sum()
            mix[..., -1] -= gain * np.outer(noise.root[:, output], row)
        # e = H w with w white gives A'e = (H'A)'w, and H' is the noise filter run backwards.
        models = np.eye(1, AR_ORDER + 1).repeat(outputs, axis=0)
        if whitening is None and samples > 2 * AR_ORDER:
            models = np.array([_stable_model(row) for row in residual])
        white = np.array([lfilter(model, [1.0], row) for model, row in zip(models, residual, strict=True)])
        across, squares, coloured = leftover_sums(
            np.array([_with_past(block, samples, model, int(lags[-1])) for model in filters]),
            lags.tolist(),
            evaluation.jacobian.reshape(-1, samples),
            mix,
            residual,
            evaluation.valid,
            np.ascontiguousarray(models[:, 1:]),
        )
        return cls(
            np.broadcast_to(across.swapaxes(1, 2), (outputs, outputs, len(lags), across.shape[-1])),
            np.broadcast_to(squares, (outputs, len(lags))),
            coloured.reshape(coloured.shape[0] * coloured.shape[1], -1),
            white @ white.T / max(int(evaluation.valid.sum()), 1),
            whitening is not None,
        )

    def covariance(self, output: int, factors: Array, explained: Array) -> Array:
        """Covariance A' S A (L, L) of the correlations; A are lagged set points times each output's factor, cleared."""
        outputs, (count, lags) = len(factors), explained.shape
        cleared = np.zeros((outputs, outputs, lags + count, lags))
        for place, factor in enumerate(factors):
            cleared[place, output if self.own_inputs else place, :lags] = factor * np.eye(lags)
            cleared[place, place, lags:] = -explained
        rows = cleared.reshape(outputs, -1, lags)
        weighed = np.einsum("op,paj->oaj", self.scatter, self.coloured @ rows)
        return np.asarray(np.einsum("oai,oaj->ij", rows, weighed))


def _lags(search: Search) -> npt.NDArray[np.int64]:
    """Lags of the set point that are looked at [samples]."""
    shortest = min((len(b.data) for b in search.blocks if isinstance(b.data, Experiment)), default=0)
    lags = np.unique(np.round(np.geomspace(1, max(shortest // INPUT_REACH, 1), INPUT_LAGS)).astype(np.int64))
    return np.append(0, lags)


def _with_past(block: Block, samples: int, model: Array, reach: int) -> Array:
    """Return the set point as a noise model filters it, behind as much of its past; none of a response.

    Before the record the set point is taken to have been what it is at its first sample.
    """
    if not isinstance(block.data, Experiment):
        return np.zeros(reach + samples)
    dn_set = block.data.dn_set
    before = np.full(len(model) - 1, dn_set[0])
    filtered = lfilter(model, [1.0], np.append(before, dn_set))[len(before) :]
    return np.append(np.full(reach, dn_set[0] * model.sum()), filtered)


def _stable_model(residual: Array) -> Array:
    """Autoregressive model [1, a1, ..., ap] by Yule and Walker, which is always stable."""
    products = np.array([residual[lag:] @ residual[: len(residual) - lag] for lag in range(AR_ORDER + 1)])
    if not products[0] > 0.0:
        return np.append(1.0, np.zeros(AR_ORDER))
    products[0] *= 1.0 + 1e-9
    return np.asarray(np.append(1.0, -solve_toeplitz(products[:-1], products[1:])))


def _test(
    size: Array,
    covariance: Array,
    products: Array,
    sum_of_squares: float,
    count: int,
    lags: npt.NDArray[np.int64],
) -> ResidualTest:
    size = np.where(size > 0.0, size, 1.0)
    unit = covariance / np.outer(size, size)
    products = products / size
    strength, direction = np.linalg.eigh(unit)
    told = strength > OPEN * sum_of_squares / max(count, 1)
    along = direction[:, told].T @ products
    length = np.sqrt(sum_of_squares) or 1.0
    return ResidualTest(
        lags,
        products / length,
        DEVIATIONS_95 * np.sqrt(np.maximum(np.diag(unit), 0.0)) / length,
        float(np.sum(along**2 / strength[told])),
        int(told.sum()),
    )


def responds(search: Search, minimum: Minimum) -> bool:
    """Whether the fit explains experiments better than constants do, by a likelihood ratio, or there are responses.

    Even without excitation initial states can be fitted to the noise, and parameters to their decay.
    """
    if not all(isinstance(block.data, Experiment) for block in search.blocks):
        return True
    still = [_of_constants(block, minimum.noise.whitening) for block in search.blocks]
    (_, before), (count, after) = mean_scatter(still), mean_scatter(minimum.sums)
    fall = [np.linalg.slogdet(scatter + 1e-300 * np.eye(len(scatter)))[1] for scatter in (before, after)]
    return bool(chi2.sf(count * (fall[0] - fall[1]), search.size) < STILL)


def _of_constants(block: Block, whitening: Whitening | None) -> Products:
    """Sums of the residuals of a fit of constants (zero without offsets), whitened."""
    mean = (
        block.mean if any(name.startswith("offset") for name in block.nuisance) else np.zeros(len(block.mean))
    )
    if whitening is None:
        scatter = block.scatter + np.outer(block.mean - mean, block.mean - mean)
        return Products(block.count * scatter[:, None, :, None], block.count)
    level = np.where(block.valid, block.measured - mean[:, None], 0.0)
    left = whitening(Evaluation(level, np.zeros((0, *level.shape)), block.valid))
    return Products.of(left.residual, left.jacobian, int(left.valid.sum()))


def input_dispersion(figures: Mapping[str, Any], samples: int) -> float:
    """Return the ratio of an output's residual power that the set point explains to that of noise, at least one.

    `figures` are those of `OutputTests.figures`: the share that the set point explains, of so many samples, over the
    degrees of freedom of the test.
    """
    share = float(figures.get("input_explained_pct") or 0.0) / 100.0
    return max(share * samples / (INPUT_LAGS + 1.0), 1.0)


def residual_tests(search: Search, minimum: Minimum) -> dict[str, OutputTests]:
    """Test each output's residuals; nothing for frequency responses, which have no order in time."""
    experiments = [isinstance(block.data, Experiment) for block in search.blocks]
    if not any(experiments):
        return {}
    evaluations = search.filtered(minimum)
    records = [e for e, timed in zip(evaluations, experiments, strict=True) if timed]
    samples = sum(int(record.valid.sum()) for record in records)
    whitening = minimum.noise.whitening
    tests: dict[str, OutputTests] = {}
    for index, (output, by_input) in enumerate(input_correlations(search, minimum, evaluations).items()):
        fitted = 0 if whitening is None else int(np.count_nonzero(whitening.models[index][1:]))
        white = whiteness([(record.residual[index], record.valid) for record in records], fitted)
        tests[output] = OutputTests(white, by_input, samples)
    return tests
