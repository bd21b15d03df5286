"""Residual tests: what a fit leaves over should be free of the set point, and white where it was taken for white.

Ljung's test (1999, section 16.6) asks whether lagged set points still explain residuals. A fit has taken away what its own
derivatives explain, so the lagged set points are cleared of these first. Both stand as spectra in units of the noise that
the residuals themselves show, so that what is left follows a chi-squared law whatever colours the noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.identification.identifiability import without_nuisance
from shipfp_rs.identification.likelihood import LEAST_REACH, noise_root, real_rows, turned
from shipfp_rs.identification.structure_fit import Fitted, StructureFit
from shipfp_rs.identification.structure_likelihood import StructureLikelihood
from shipfp_rs.identification.structure_records import InBand, Samples, banded
from shipfp_rs.identification.whiteness import ResidualTest, whiteness
from shipfp_rs.support.arrays import Array, Numbers
from shipfp_rs.support.quantiles import DEVIATIONS_95

INPUT_LAGS = 12
"""Number of lags of the set point besides zero, in geometric steps, since missing dynamics may be fast or slow."""
INPUT_REACH = 10
"""The longest lag, as a part of the record."""
LEAST_LEFT = 0.1
"""Least part of the noise that counts as left over."""
OPEN = 1e-8
"""A direction of the lagged set points counts as explained by the fit where less than this part of its size is left."""


@dataclass(frozen=True)
class OutputTests:
    """Both tests of one output's residuals, and how many numbers they had; whiteness of noise taken for white only."""

    by_input: ResidualTest
    whiteness: ResidualTest | None
    samples: int

    def figures(self) -> dict[str, float | None]:
        """Return the p-values and what the set point still explains [%], for the fingerprint's fit."""
        white = {} if self.whiteness is None else {"whiteness_p": self.whiteness.p}
        return {
            **white,
            "input_correlation_p": self.by_input.p,
            "input_explained_pct": 100.0 * min(self.by_input.statistic / self.samples, 1.0),
        }

    def correlograms(self) -> dict[str, dict[str, list[float]]]:
        """Return the JSON form of the correlations by lag."""
        white = {} if self.whiteness is None else {"autocorrelation": self.whiteness.by_lag()}
        return {**white, "set_point": self.by_input.by_lag()}


def residual_tests(fit: StructureFit) -> dict[str, OutputTests]:
    """Test each output's residuals at the end of a search; none where no experiment is long enough for a spectrum."""
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


def _in_band(fit: StructureFit) -> tuple[list[InBand], Fitted, Array] | None:
    """Return the experiments as spectra, their likelihood with the noise at the end, and the end's entries in it.

    None where there is no experiment, or none that is long enough for a spectrum.
    """
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
    found = StructureLikelihood.of(records, fit.structure, accurate=not fit.likelihood.accuracy.any())
    own = vector[places]
    return records, found.with_noise(own), own


def _without_inputs(likelihood: Fitted, vector: Array, shapes: Sequence[Numbers]) -> Fitted:
    """Return the likelihood whose noise is what is left where lagged set points (O, L, O, F) explain what they can.

    With what a structure misses counted as noise, the test would see a part of it only.
    """
    rows = likelihood.whitened(vector)
    every = [one.reshape(-1, *one.shape[2:]) for one in shapes]
    inputs = _inputs(likelihood, every, len(rows))
    columns = np.hstack([inputs, _moving(rows[:, 1:])])
    size = np.linalg.norm(columns, axis=0)
    turn, sizes, _ = np.linalg.svd(columns / np.where(size > 0.0, size, 1.0), full_matrices=False)
    basis = turn[:, sizes > OPEN * sizes[0]]
    # What is explained takes noise along, where it has much to say nearly all (the hat matrix's diagonal).
    taken = np.einsum("rk,rk->r", basis, basis)
    left = (rows[:, 0] - basis @ (basis.T @ rows[:, 0])) / np.maximum(1.0 - taken, LEAST_LEFT)
    roots, first = [], 0
    for index, record in enumerate(likelihood.records):
        size = record.spectrum.size
        real, imaginary = left[first : first + 2 * size].reshape(2, *record.spectrum.shape)
        own = turned(np.linalg.inv(likelihood.root(index)), (real + 1j * imaginary)[None])[0]
        # The inverse of a matrix that is a mean of so many is too large by chance (Wishart 1928).
        looks = 2 * LEAST_REACH + 1
        roots.append(noise_root(own) * np.sqrt(1.0 - len(own) / looks))
        first += 2 * size
    return replace(likelihood, roots=tuple(roots))


def _moving(columns: Array) -> Array:
    return columns[:, np.linalg.norm(columns, axis=0) > 0.0]


def _lags(records: Sequence[InBand]) -> npt.NDArray[np.int64]:
    """Lags of the set point that are looked at [samples]."""
    shortest = min(len(record.data) for record in records)
    lags = np.unique(np.round(np.geomspace(1, max(shortest // INPUT_REACH, 1), INPUT_LAGS)).astype(np.int64))
    return np.append(0, lags)


def _lagged(record: InBand, lags: npt.NDArray[np.int64]) -> Numbers:
    """Return what the set point at each lag would be as each output, (O, L, O, F)."""
    asked = record.data.dn_set
    wide = np.concatenate([np.full(lags[-1], asked[0]), asked])
    delayed = np.array([wide[lags[-1] - lag :][: len(asked)] for lag in lags])[:, None]
    if not record.valid.all():  # each output has gaps of its own
        delayed = np.repeat(delayed, len(record.measured), axis=1)
    return np.asarray(np.eye(len(record.measured))[:, None, :, None] * record.seen(delayed))


def _inputs(likelihood: Fitted, shapes: Sequence[Numbers], rows: int) -> Array:
    """Shapes (L, O, F) of each record in units of the noise, zero where priors stand, (R, L)."""
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
    """Test one output of the records whose noise was taken for white."""
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


def input_dispersion(figures: Mapping[str, Any], samples: int) -> float:
    """Return the ratio of an output's residual power that the set point explains to that of noise, at least one.

    `figures` are those of `OutputTests.figures`. The ratio is the share of the power that the set point explains, times
    the number of samples, over the degrees of freedom of the test.
    """
    share = float(figures.get("input_explained_pct") or 0.0) / 100.0
    return max(share * samples / (INPUT_LAGS + 1.0), 1.0)
