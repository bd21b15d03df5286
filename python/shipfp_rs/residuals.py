"""Residual tests: what a fit leaves over should be white and free of the set point (Ljung 1999, section 16.6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2

from shipfp_rs._core import all_pole_backwards
from shipfp_rs.experiment import Experiment
from shipfp_rs.problem import CHUNK, Block, Evaluation, prewhiten
from shipfp_rs.products import orthonormal
from shipfp_rs.solver import AR_ORDER, Minimum, Search, scatter_of

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

WHITENESS_LAGS = 25
"""Lags of the autocorrelation, as many as MATLAB's `resid` shows."""
INPUT_LAGS = 12
"""Lags of the set point besides zero, in geometric steps, for dynamics that are missing may be fast or slow."""
INPUT_REACH = 10
"""The longest of them is this part of the record."""
BAND = 1.96
"""Standard deviations of a normal variable that hold 95 %."""
OPEN = 1e-8
"""A direction of the lagged set points with less than this part of its size left is one that the fit took away."""

STILL = 1e-4
"""Probability below which what a fit explains is no chance."""


@dataclass(frozen=True)
class ResidualTest:
    """Correlations by lag, and the test that all of them are chance.

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
    band = np.divide(BAND, np.sqrt(pairs), out=np.full(lags, np.inf), where=known)
    statistic = float(np.sum(pairs * correlation**2)) * (samples + 2) / max(samples, 1)
    return ResidualTest(steps, correlation, band, statistic, int(known.sum()) - fitted)


def input_correlations(
    search: Search, minimum: Minimum, evaluations: Sequence[Evaluation]
) -> dict[str, ResidualTest]:
    """Test the whitened residuals of each output for what the set point still explains.

    Ljung's test compares the correlations of residual and lagged set point with their scatter for white residuals.
    A fit has taken away what its own sensitivities J explain, so here the lagged set points U are cleared of
    J first: with A = (I - J J+) U and S the covariance of the residuals e, (A'e)' (A' S A)^-1 (A'e) is chi-squared.
    `evaluations` are the search's filtered ones at the minimum.
    """
    # Residuals far out count as in the fit: up to the threshold of its cost (eq. 4.7).
    plain = replace(search, huber=None)
    parts = list(plain.parts(evaluations, minimum.noise))
    if search.huber is not None:
        for part in parts:
            np.clip(part[-1], -search.huber, search.huber, out=part[-1])
    priors = plain.priors(minimum.vector)
    gram = priors.T @ priors
    for part in parts:
        rows = part.reshape(len(part), -1)
        gram += rows @ rows.T
    shortest = min((len(b.data) for b in search.blocks if isinstance(b.data, Experiment)), default=0)
    lags = np.unique(np.round(np.geomspace(1, max(shortest // INPUT_REACH, 1), INPUT_LAGS)).astype(np.int64))
    lags = np.append(0, lags)
    count = sum(int(np.count_nonzero(part[-1])) for part in parts) + int(np.count_nonzero(priors[:, -1]))
    basis = orthonormal(gram[:-1, :-1])
    along = basis.T @ gram[:-1, -1]
    models = minimum.noise.models
    tests: dict[str, ResidualTest] = {}
    records: list[_Record] = []
    for index, output in enumerate(search.structure.outputs):
        # Without noise models the lagged set points are the same for every output.
        if index == 0 or models is not None:
            model = np.ones(1) if models is None else models[index]
            records = [
                _Record.of(
                    _lagged_inputs(block, evaluation, model, lags), part, basis, evaluation, models is None
                )
                for block, evaluation, part in zip(search.blocks, evaluations, parts, strict=True)
            ]
        factors = minimum.noise.root[:, index]
        explained = sum(np.einsum("o,olb->bl", factors, record.onto_basis) for record in records)
        products = sum(factors @ record.onto_residual for record in records) - explained.T @ along
        length = np.sqrt(factors @ factors * sum(record.squares for record in records))
        turned = priors[:, :-1] @ basis @ explained
        covariance = turned.T @ turned
        for record in records:
            covariance += record.covariance(factors, explained)
        tests[output] = _test(length, covariance, products, float(gram[-1, -1]), count, lags)
    return tests


def _lagged_inputs(
    block: Block, evaluation: Evaluation, model: Array, lags: npt.NDArray[np.int64]
) -> Callable[[slice], Array]:
    """Return what gives a stretch of the lagged set points (L, R), as a noise model filters them; zero where masked."""
    samples = evaluation.residual.shape[1]
    if not isinstance(block.data, Experiment):
        return lambda stretch: np.zeros((len(lags), len(range(samples)[stretch])))
    # Before the record the set point is taken to have been what it is at its first sample.
    first = np.full(len(model) - 1, block.data.dn_set[0])
    filtered = lfilter(model, [1.0], np.append(first, block.data.dn_set))[len(first) :]
    reach = int(lags[-1])
    whole = np.append(np.full(reach, block.data.dn_set[0] * model.sum()), filtered)

    def lagged(stretch: slice) -> Array:
        rows = [whole[reach - lag : reach - lag + samples][stretch] for lag in lags]
        return np.asarray(rows * evaluation.valid[stretch])

    return lagged


@dataclass(frozen=True)
class _Record:
    """Sums of one block's lagged set points (L), its sensitivities in an orthonormal basis (B) and its residuals.

    `onto_basis` (O, L, B) and `onto_residual` (O, L) are products with the lagged set points, `squares` (L,) theirs with
    themselves; `scattered` (L + B, L + B) in all pairs of outputs are the products of both as the residuals' own
    scatter weighs them.
    """

    onto_basis: Array
    onto_residual: Array
    squares: Array
    scattered: Array

    @classmethod
    def of(
        cls,
        lagged: Callable[[slice], Array],
        part: Array,
        basis: Array,
        evaluation: Evaluation,
        coloured: bool,
    ) -> _Record:
        """Add up a block's whitened rows (Q + 1, O, R), stretch by stretch, while these fit into a cache."""
        own = part[-1]
        outputs, samples = own.shape
        models = None
        if coloured and samples > 2 * AR_ORDER:
            # e = H w with w white gives A'e = (H'A)'w, and H' is the noise filter run backwards.
            models = [_stable_model(row) for row in own]
            own = np.stack([lfilter(model, [1.0], row) for model, row in zip(models, own, strict=True)])
        count, size = len(lagged(slice(0, 0))), basis.shape[1]
        after = [np.zeros((count + size, AR_ORDER))] * outputs
        onto = np.zeros((outputs, count, size + 1))
        squares = np.zeros(count)
        products = np.zeros((outputs * (count + size),) * 2)
        for start in reversed(range(0, samples, CHUNK)):
            stretch = slice(start, start + CHUNK)
            inputs = lagged(stretch)
            squares += np.einsum("ls,ls->l", inputs, inputs)
            tall = []
            for output in range(outputs):
                rows = np.concatenate([inputs, basis.T @ part[:-1, output, stretch]])
                onto[output, :, :-1] += inputs @ rows[count:].T
                onto[output, :, -1] += inputs @ part[-1, output, stretch]
                if models is not None:
                    rows = all_pole_backwards(rows, models[output][1:], after[output])
                    after[output] = np.hstack([rows[:, :AR_ORDER], after[output]])[:, :AR_ORDER].copy()
                tall.append(rows)
            joined = np.concatenate(tall)
            products += joined @ joined.T
        by_output = products.reshape(outputs, count + size, outputs, count + size)
        scatter = own @ own.T / max(int(evaluation.valid.sum()), 1)
        return cls(onto[..., :-1], onto[..., -1], squares, scatter[:, None, :, None] * by_output)

    def covariance(self, factors: Array, explained: Array) -> Array:
        """Covariance A' S A (L, L) of the correlations, A the lagged set points, times a factor in each output, cleared."""
        cleared = np.array(
            [np.vstack([factor * np.eye(explained.shape[1]), -explained]) for factor in factors]
        )
        return np.asarray(np.einsum("oai,oapb,pbj->ij", cleared, self.scattered, cleared, optimize=True))


def _stable_model(residual: Array) -> Array:
    """Autoregressive model [1, a1, ..., ap] by Yule and Walker, which never runs away."""
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
        BAND * np.sqrt(np.maximum(np.diag(unit), 0.0)) / length,
        float(np.sum(along**2 / strength[told])),
        int(told.sum()),
    )


def responds(search: Search, minimum: Minimum) -> bool:
    """Whether the fit explains experiments better than constants do, by a likelihood ratio, or there are responses.

    Where nothing moves, initial states can still be fitted to the noise, and parameters to what they start.
    """
    if not all(isinstance(block.data, Experiment) for block in search.blocks):
        return True
    still = []
    models = minimum.noise.models
    for block in search.blocks:
        mean = np.mean(block.measured[:, block.valid], axis=1, keepdims=True)
        offsets = any(name.startswith("offset") for name in block.nuisance)
        level = np.where(block.valid, block.measured - offsets * mean, 0.0)
        constant = Evaluation(level, np.zeros((0, *level.shape)), block.valid)
        still.append(constant if models is None else prewhiten(constant, models))
    count, moved = search.scatter(minimum.vector, minimum.noise)
    before, after = (np.linalg.slogdet(s + 1e-300 * np.eye(len(s))) for s in (scatter_of(still), moved))
    ratio = count * (before[1] - after[1])
    return bool(chi2.sf(ratio, search.size) < STILL)


def residual_tests(search: Search, minimum: Minimum) -> dict[str, OutputTests]:
    """Test each output's residuals; nothing for frequency responses, which have no order in time."""
    experiments = [isinstance(block.data, Experiment) for block in search.blocks]
    if not any(experiments):
        return {}
    evaluations = search.filtered(minimum.vector, minimum.noise)
    records = [e for e, timed in zip(evaluations, experiments, strict=True) if timed]
    samples = sum(int(record.valid.sum()) for record in records)
    models = minimum.noise.models
    tests: dict[str, OutputTests] = {}
    for index, (output, by_input) in enumerate(input_correlations(search, minimum, evaluations).items()):
        fitted = 0 if models is None else int(np.count_nonzero(models[index][1:]))
        white = whiteness([(record.residual[index], record.valid) for record in records], fitted)
        tests[output] = OutputTests(white, by_input, samples)
    return tests
