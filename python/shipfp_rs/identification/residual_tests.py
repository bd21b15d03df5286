"""Tests of residuals: for independence from the set point, and for whiteness where the noise is assumed white.

Ljung's test (1999, section 16.6) asks whether lagged set points still explain residuals. A fit has already removed what its
derivatives explain, so the derivatives' share is removed from the lagged set points first. Residuals and lagged set points
are spectra in units of the noise that the residuals show, so the test statistic is chi-squared for noise of any colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from shipfp_rs.errors import InputError
from shipfp_rs.identification.identifiability import without_nuisance
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.noise import LEAST_REACH, noise_root, real_rows, turned
from shipfp_rs.identification.structure_fit import StructureFit
from shipfp_rs.identification.structure_models import InBand, Samples, banded, structure_likelihood
from shipfp_rs.support.arrays import DEVIATIONS_95, Array, Mask, Numbers

WHITENESS_LAGS = 25
"""Number of lags of the autocorrelation, as in MATLAB's `resid`."""


@dataclass(frozen=True)
class ResidualTest:
    """Correlation coefficients by lag [-], and a chi-squared test of all of them together."""

    lags: npt.NDArray[np.int64]  # in samples, shape (L,)
    correlation: Array
    band: Array  # half width of the 95 % band of correlations by chance, shape (L,)
    statistic: float
    freedom: int

    @property
    def p(self) -> float | None:
        """Probability of such correlations by chance."""
        return float(chi2.sf(self.statistic, self.freedom)) if self.freedom > 0 else None

    def by_lag(self) -> dict[str, list[float]]:
        """Return lags, correlations and bands as lists, without lags that have no pair of samples."""
        known = np.isfinite(self.band)
        return {
            "lags": self.lags[known].tolist(),
            "correlation": self.correlation[known].tolist(),
            "band": self.band[known].tolist(),
        }


def whiteness(
    records: Sequence[tuple[Array, Mask]], fitted: int = 0, lags: int = WHITENESS_LAGS
) -> ResidualTest:
    """Test residuals for autocorrelation by Ljung and Box (doi:10.1093/biomet/65.2.297); masked samples are left out.

    Parameters
    ----------
    records
        Residuals of one output in each experiment, shape (N,), and their mask of valid samples.
    fitted
        Number of fitted coefficients of the noise model that whitened the residuals.
    lags
        Number of lags, starting at one sample.

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


INPUT_LAGS = 12
"""Number of lags of the set point besides zero, in geometric steps, since missing dynamics may be fast or slow."""
INPUT_REACH = 10
"""Length of the shortest record over the longest lag."""
LEAST_LEFT = 0.1
"""Least share of a residual that is assumed to remain after the projection (1 minus its leverage)."""
OPEN = 1e-8
"""Relative size below which a combination of lagged set points counts as explained by the fit."""


@dataclass(frozen=True)
class OutputTests:
    """Tests of one output's residuals, and their number of samples; whiteness only where noise is assumed white."""

    by_input: ResidualTest
    whiteness: ResidualTest | None
    samples: int

    def figures(self) -> dict[str, float | None]:
        """Return the p-values, and the share of the residual that the set point explains [%], for `Fingerprint.fit`."""
        white = {} if self.whiteness is None else {"whiteness_p": self.whiteness.p}
        # The rest of the residual is noise, with a variance of 1 per sample.
        rest = max(self.samples - self.by_input.freedom, 0)
        return {
            **white,
            "input_correlation_p": self.by_input.p,
            "input_explained_pct": 100.0
            * self.by_input.statistic
            / max(self.by_input.statistic + rest, 1e-300),
        }

    def correlograms(self) -> dict[str, dict[str, list[float]]]:
        """Return the JSON form of the correlations by lag."""
        white = {} if self.whiteness is None else {"autocorrelation": self.whiteness.by_lag()}
        return {**white, "set_point": self.by_input.by_lag()}


def residual_tests(fit: StructureFit) -> dict[str, OutputTests]:
    """Test each output's residuals at the minimum; empty where no experiment is long enough for a spectrum."""
    found = _in_band(fit)
    if found is None:
        return {}
    records, spectra, vector = found
    exact = replace(spectra, accuracy=np.zeros_like(spectra.accuracy)).with_noise(vector)
    lags = _lags(records)
    shapes = [_lagged(record, lags) for record in records]
    exact = _without_inputs(exact, vector, shapes)
    rows = exact.whitened(vector)
    residual, jacobian = rows[:, 0], _moving(rows[:, 1:])
    tests = {}
    for place, output in enumerate(fit.structure.outputs):
        inputs = _inputs(exact, [one[place] for one in shapes], len(residual))
        cleared = without_nuisance(np.hstack([inputs, jacobian]), len(lags))
        tests[output] = OutputTests(
            _test(inputs, cleared, residual, lags),
            _whiteness(fit, place),
            (len(residual) - len(exact.prior_rows(vector))) // len(exact.accuracy),
        )
    return tests


def _in_band(fit: StructureFit) -> tuple[list[InBand], Likelihood, Array] | None:
    """Return experiments as spectra, their likelihood and its search vector; None if every experiment is too short."""
    c, vector = fit.likelihood.coordinates, fit.best.vector
    if all(isinstance(record, InBand) for record in fit.records):
        return [record for record in fit.records if isinstance(record, InBand)], fit.likelihood, vector
    places, records = [*range(len(c.free))], []
    for index, record in enumerate(fit.records):
        if not isinstance(record, Samples):
            continue
        try:
            records.append(record if isinstance(record, InBand) else banded(record))
        except InputError:
            continue
        places += range(c.states(index).start, c.states(index).stop)
    if not records:
        return None
    found = structure_likelihood(records, fit.structure, accurate=not fit.likelihood.accuracy.any())
    own = vector[places]
    return records, found.with_noise(own), own


def _without_inputs(likelihood: Likelihood, vector: Array, shapes: Sequence[Numbers]) -> Likelihood:
    """Return the likelihood with the noise that remains after lagged set points (O, L, O, F) explain the residuals."""
    rows = likelihood.whitened(vector)
    every = [one.reshape(-1, *one.shape[2:]) for one in shapes]
    inputs = _inputs(likelihood, every, len(rows))
    columns = np.hstack([inputs, _moving(rows[:, 1:])])
    size = np.linalg.norm(columns, axis=0)
    turn, sizes, _ = np.linalg.svd(columns / np.where(size > 0.0, size, 1.0), full_matrices=False)
    basis = turn[:, sizes > OPEN * sizes[0]]
    # The projection also absorbs noise; the share is the diagonal of the hat matrix.
    taken = np.einsum("rk,rk->r", basis, basis)
    left = (rows[:, 0] - basis @ (basis.T @ rows[:, 0])) / np.maximum(1.0 - taken, LEAST_LEFT)
    # If the noise included what the structure lacks, the test would be less sensitive.
    roots, first = [], 0
    for index, record in enumerate(likelihood.models):
        size = record.spectrum.size
        real, imaginary = left[first : first + 2 * size].reshape(2, *record.spectrum.shape)
        own = turned(np.linalg.inv(likelihood.root(index)), (real + 1j * imaginary)[None])[0]
        # The inverse of an average over a few spectra is biased upwards (Wishart 1928).
        looks = 2 * LEAST_REACH + 1
        roots.append(noise_root(own) * np.sqrt(1.0 - len(own) / looks))
        first += 2 * size
    return replace(likelihood, roots=tuple(roots))


def _moving(columns: Array) -> Array:
    return columns[:, np.linalg.norm(columns, axis=0) > 0.0]


def _lags(records: Sequence[InBand]) -> npt.NDArray[np.int64]:
    """Tested lags of the set point [samples]."""
    shortest = min(len(record.data) for record in records)
    lags = np.unique(np.round(np.geomspace(1, max(shortest // INPUT_REACH, 1), INPUT_LAGS)).astype(np.int64))
    return np.append(0, lags)


def _lagged(record: InBand, lags: npt.NDArray[np.int64]) -> Numbers:
    """Return the set point at each lag as a signal of each output, (O, L, O, F)."""
    asked = record.data.dn_set
    wide = np.concatenate([np.full(lags[-1], asked[0]), asked])
    delayed = np.array([wide[lags[-1] - lag :][: len(asked)] for lag in lags])[:, None]
    if not record.valid.all():  # the outputs have different gaps
        delayed = np.repeat(delayed, len(record.measured), axis=1)
    return np.asarray(np.eye(len(record.measured))[:, None, :, None] * record.seen(delayed))


def _inputs(likelihood: Likelihood, shapes: Sequence[Numbers], rows: int) -> Array:
    """Stack spectra (L, O, F) of the records as columns (R, L) in units of the noise, zero in rows of priors."""
    found = np.concatenate(
        [real_rows(turned(likelihood.root(index), one)) for index, one in enumerate(shapes)], axis=1
    ).T
    return np.pad(found, ((0, rows - len(found)), (0, 0)))


def _test(inputs: Array, cleared: Array, residual: Array, lags: npt.NDArray[np.int64]) -> ResidualTest:
    size = np.linalg.norm(inputs, axis=0)
    unit = cleared / np.where(size > 0.0, size, 1.0)
    strength, direction = np.linalg.eigh(unit.T @ unit)
    told = strength > OPEN
    products = unit.T @ residual
    along = direction[:, told].T @ products
    length = float(np.linalg.norm(residual)) or 1.0
    return ResidualTest(
        lags,
        products / length,
        DEVIATIONS_95 * np.linalg.norm(unit, axis=0) / length,
        float(np.sum(along**2 / strength[told])),
        int(told.sum()),
    )


def _whiteness(fit: StructureFit, output: int) -> ResidualTest | None:
    """Test one output of the records whose noise is assumed white."""
    rows = []
    for index, record in enumerate(fit.records):
        if isinstance(record, Samples) and (not isinstance(record, InBand) or record.white):
            if isinstance(record, InBand):
                left = record.left(fit.known(index))[:, record.valid]
            else:
                left = record.evaluate(fit.known(index), ())[0]
            row = np.zeros(len(record.valid))
            row[record.valid] = (fit.likelihood.root(index) @ left)[output]
            rows.append((row, record.valid))
    return whiteness(rows) if rows else None
