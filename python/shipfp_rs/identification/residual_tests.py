"""Residual tests: what a fit leaves over should be white and free of the set point (Ljung 1999, section 16.6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2

from shipfp_rs._core import leftover_sums
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.blocks import Block, Evaluation, prewhiten
from shipfp_rs.identification.search import AR_ORDER, Search
from shipfp_rs.identification.weighted_problem import Minimum, Noise, mean_scatter
from shipfp_rs.optimise.normal_equations import Products, orthonormal
from shipfp_rs.support.quantiles import DEVIATIONS_95

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

WHITENESS_LAGS = 25
"""Lags of the autocorrelation, as many as MATLAB's `resid` shows."""
INPUT_LAGS = 12
"""Number of lags of the set point besides zero, in geometric steps, since missing dynamics may be fast or slow."""
INPUT_REACH = 10
"""The longest lag, as a part of the record."""
OPEN = 1e-8
"""A direction of the lagged set points counts as explained by the fit where less than this part of its size is left."""

STILL = 1e-4
"""The fit explains more than chance where the probability is below this."""


@dataclass(frozen=True)
class ResidualTest:
    """Correlations by lag.

    They come with the test that all of them are chance.

    Parameters
    ----------
    lags
        In samples, shape (L,).
    correlation, band
        Correlation coefficients [-] and the half width of the band that holds 95 % of each if it is chance, shape (L,).
    statistic, freedom
        What follows a chi-squared distribution with that many degrees of freedom if all of them are.
    p
        Probability of a statistic as large; None without a degree of freedom.
    """

    lags: npt.NDArray[np.int64]
    correlation: Array
    band: Array
    statistic: float
    freedom: int

    @property
    def p(self) -> float | None:
        """Probability of such correlations by chance."""
        return float(chi2.sf(self.statistic, self.freedom)) if self.freedom > 0 else None

    def by_lag(self) -> dict[str, list[float]]:
        """Return lags, correlations and bands as lists; lags without a pair of samples are left out."""
        known = np.isfinite(self.band)
        return {
            "lags": self.lags[known].tolist(),
            "correlation": self.correlation[known].tolist(),
            "band": self.band[known].tolist(),
        }


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


def whiteness(
    records: Sequence[tuple[Array, Mask]], fitted: int = 0, lags: int = WHITENESS_LAGS
) -> ResidualTest:
    """Test residuals for autocorrelation, Ljung and Box (10.1093/biomet/65.2.297), gaps left out.

    Parameters
    ----------
    records
        Residuals of one output in each experiment, shape (N,), and where they are valid.
    fitted
        Coefficients of the noise model that made them white.
    lags
        Number of lags, from one sample on.

    Examples
    --------
    >>> import numpy as np
    >>> noise = np.random.default_rng(1).normal(size=5000)
    >>> whiteness([(noise, np.isfinite(noise))]).p > 0.01
    True
    >>> whiteness([(np.cumsum(noise), np.isfinite(noise))]).p < 1e-6
    True
    """
    steps = np.arange(1, lags + 1)
    products, pairs, samples = np.zeros(lags), np.zeros(lags), 0
    for values, valid in records:
        count = int(valid.sum())
        if count < 2:
            continue
        centred = np.where(valid, values - values[valid].mean(), 0.0)
        spread = float(np.sqrt(centred @ centred / count)) or 1.0
        samples += count
        for index, lag in enumerate(steps[steps < len(values)]):
            products[index] += centred[lag:] @ centred[:-lag] / spread**2
            pairs[index] += np.count_nonzero(valid[lag:] & valid[:-lag])
    known = pairs > 0
    correlation = np.divide(products, pairs, out=np.zeros(lags), where=known)
    band = np.divide(DEVIATIONS_95, np.sqrt(pairs), out=np.full(lags, np.inf), where=known)
    statistic = float(np.sum(pairs * correlation**2)) * (samples + 2) / max(samples, 1)
    return ResidualTest(steps, correlation, band, statistic, int(known.sum()) - fitted)


def input_correlations(
    search: Search, minimum: Minimum, evaluations: Sequence[Evaluation]
) -> dict[str, ResidualTest]:
    """Test the whitened residuals of each output for what the set point still explains.

    Ljung's test compares the correlations of residual and lagged set point with their scatter for white residuals.
    A fit has taken away what its own sensitivities J explain, so here the lagged set points U are cleared of
    J first: with A = (I - J J+) U and S the covariance of the residuals e, (A'e)' (A' S A)^-1 (A'e) is chi-squared.
    `evaluations` are those of the search at the minimum, filtered by the noise models. A column that belongs to a
    constant offset may be left out.
    """
    noise, outputs = minimum.noise, search.structure.outputs
    residuals = [noise.root @ evaluation.residual for evaluation in evaluations]
    priors = search.priors(minimum.vector)
    if search.huber is None:
        gram = search.gram(minimum.vector, noise, minimum.sums)
    else:
        # Outlying residuals are cut off at the threshold of the fit's cost (eq. 4.7).
        residuals = [np.clip(residual, -search.huber, search.huber) for residual in residuals]
        gram = np.asarray(priors.T @ priors)
        for part, residual in zip(
            replace(search, huber=None).parts(evaluations, noise), residuals, strict=True
        ):
            part[-1] = residual
            rows = part.reshape(len(part), -1)
            gram += rows @ rows.T
    shortest = min((len(b.data) for b in search.blocks if isinstance(b.data, Experiment)), default=0)
    lags = np.unique(np.round(np.geomspace(1, max(shortest // INPUT_REACH, 1), INPUT_LAGS)).astype(np.int64))
    lags = np.append(0, lags)
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
        filters = [np.ones(1)] if noise.models is None else list(noise.models)
        for output, row in enumerate(basis[columns:]):
            gain = filters[min(output, len(filters) - 1)].sum()
            mix[..., -1] -= gain * np.outer(noise.root[:, output], row)
        # e = H w with w white gives A'e = (H'A)'w, and H' is the noise filter run backwards.
        models = np.eye(1, AR_ORDER + 1).repeat(outputs, axis=0)
        if noise.models is None and samples > 2 * AR_ORDER:
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
            noise.models is not None,
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
    still = [_of_constants(block, minimum.noise.models) for block in search.blocks]
    (_, before), (count, after) = mean_scatter(still), mean_scatter(minimum.sums)
    fall = [np.linalg.slogdet(scatter + 1e-300 * np.eye(len(scatter)))[1] for scatter in (before, after)]
    return bool(chi2.sf(count * (fall[0] - fall[1]), search.size) < STILL)


def _of_constants(block: Block, models: Sequence[Array] | None) -> Products:
    """Sums of the residuals of a fit of constants (zero without offsets), filtered by the noise's models."""
    mean = (
        block.mean if any(name.startswith("offset") for name in block.nuisance) else np.zeros(len(block.mean))
    )
    if models is None:
        scatter = block.scatter + np.outer(block.mean - mean, block.mean - mean)
        return Products(block.count * scatter[:, None, :, None], block.count)
    level = np.where(block.valid, block.measured - mean[:, None], 0.0)
    left = prewhiten(Evaluation(level, np.zeros((0, *level.shape)), block.valid), models)
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
    listed = search.huber is not None or any(block.relative for block in search.blocks)
    evaluations = search.filtered(minimum.vector, minimum.noise, constants=listed)
    records = [e for e, timed in zip(evaluations, experiments, strict=True) if timed]
    samples = sum(int(record.valid.sum()) for record in records)
    models = minimum.noise.models
    tests: dict[str, OutputTests] = {}
    for index, (output, by_input) in enumerate(input_correlations(search, minimum, evaluations).items()):
        fitted = 0 if models is None else int(np.count_nonzero(models[index][1:]))
        white = whiteness([(record.residual[index], record.valid) for record in records], fitted)
        tests[output] = OutputTests(white, by_input, samples)
    return tests
