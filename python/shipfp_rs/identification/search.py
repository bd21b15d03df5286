"""The search: bounded least squares by SciPy, with output weights and noise models iterated to consistency."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.descent import descend
from shipfp_rs.identification.variable_projection import Elimination
from shipfp_rs.identification.weighted_problem import Minimum, Noise, WeightedProblem, mean_scatter
from shipfp_rs.identification.whitening import Whitening, autoregressive_model
from shipfp_rs.optimise.least_squares import STOPPED, Solution, approach, minimise
from shipfp_rs.optimise.normal_equations import Products
from shipfp_rs.structures.parameter import Parameter
from shipfp_rs.support.arrays import Array

STABLE_DRAWS = 50
"""Most vectors drawn for a random start; after so many with an unstable loop it is given up."""
AR_ORDER = 8
WEIGHT_ITERATIONS = 100
CRITERION_TOLERANCE = 1e-8
"""Change of N ln det(E'E/N) that ends the iteration of the weights: parameters then move by 1e-4 of their deviation."""
ROUGH = 1e-2
"""The same change, where noise models are still to be fitted."""
LITTLE = 0.1
"""Fall of the deviance that ends a descent whose noise models are still to be fitted."""
NOTHING = 1e-6
"""Fall of the deviance that ends the last descent: a thousandth of a standard deviation."""
UNMOVED = 1e-10
"""Relative change of the vector that ends a descent where there is no noise."""


@dataclass(frozen=True, kw_only=True)
class Search(WeightedProblem):
    """The way from a start vector to a minimum of a weighted problem."""

    time_limit_s: float | None = None

    def minimise(self, start: Array) -> Minimum:
        """Search from `start`; the weights are refitted until they agree with the residuals."""
        noise = replace(self.initial_noise(), sharp=not self._refines)
        return self._weighted(start, noise, ROUGH if self._refines else CRITERION_TOLERANCE)

    def refine(self, minimum: Minimum) -> Minimum:
        """Go on from a minimum with AR noise models fitted to its residuals, until these agree too."""
        for tolerance in (ROUGH, CRITERION_TOLERANCE) if self._refines else ():
            noise = replace(self._with_models(minimum), sharp=tolerance < ROUGH)
            minimum = self._weighted(minimum.vector, noise, tolerance)
        return minimum

    @property
    def _refines(self) -> bool:
        return self.noise == "ar" and any(isinstance(block.data, Experiment) for block in self.blocks)

    def _with_models(self, minimum: Minimum) -> Noise:
        raw = self.evaluate(minimum.vector, ())
        time_blocks = [
            evaluation
            for block, evaluation in zip(self.blocks, raw, strict=True)
            if isinstance(block.data, Experiment)
        ]
        models = tuple(
            autoregressive_model([(e.residual[output], e.valid) for e in time_blocks], AR_ORDER)
            for output in range(len(self.structure.outputs))
        )
        return replace(minimum.noise, whitening=Whitening(models))

    def _named(self, message: str, linear: npt.NDArray[np.bool_]) -> str:
        """Put names into a message in place of entries of the searched vector, which lacks the `linear` unknowns."""
        searched = [name for name, left_out in zip(self.unknowns, linear, strict=True) if not left_out]
        return re.sub(r"entry (\d+) of the vector", lambda found: searched[int(found[1])], message)

    @property
    def _reweighs(self) -> bool:
        """Whether residuals are in units of their own deviation."""
        return self.weighting in ("variance", "determinant")

    def _weighted(self, start: Array, noise: Noise, tolerance: float) -> Minimum:
        problem, linear = Elimination(self, start), self.linear
        kept, used, criterion, limit = start[~linear], 0, np.inf, ""
        if self._descends:
            reached = descend(
                self,
                problem,
                kept,
                noise,
                near=noise.whitening is not None,
                enough=LITTLE if tolerance >= ROUGH else NOTHING,
                time_limit_s=self.time_limit_s,
            )
            kept, noise, used, limit = reached.kept, reached.noise, reached.passes, reached.limit
        # Where a descent crept, steps towards the floor's lowest point would do no better.
        done = self._descends and (reached.crept or tolerance >= ROUGH)
        if limit or done:
            vector, sums = problem.complete(kept, noise)
            message = f"{STOPPED} {limit}, before a minimum was reached" if limit else ""
            criterion = self._criterion(vector, noise, sums)
            return Minimum(vector, criterion, reached.settled, message, used, noise, sums)
        # While the weights still change much, a few steps towards the minimum for the present ones are enough.
        rough = self._reweighs and noise.whitening is None and not self._descends
        for _ in range(WEIGHT_ITERATIONS if self._reweighs else 1):
            solution = self._solve(problem, kept, noise, rough=rough)
            used += solution.evaluations
            before, criterion = criterion, solution.cost
            moved = np.max(np.abs(solution.vector - kept) / (np.abs(kept) + 1e-9))
            kept = solution.vector
            vector, sums = problem.complete(kept, noise)
            count, scatter = mean_scatter(sums)
            if not self._reweighs:
                break
            following, criterion = self.noise_at(noise, count, scatter)
            settled = moved < UNMOVED or abs(before - criterion) < (ROUGH if rough else tolerance)
            if solution.message.startswith(STOPPED) or (settled and not rough):
                break
            noise, rough = following, rough and not settled
        return Minimum(
            vector=vector,
            criterion=criterion,
            converged=solution.converged,
            message=self._named(solution.message, linear),
            evaluations=used,
            noise=noise,
            sums=sums,
        )

    @property
    def _descends(self) -> bool:
        """Whether `descend` searches: for whitened residuals, along a known valley."""
        return self._reweighs and self.structure.equations.has_valley

    def _criterion(self, vector: Array, noise: Noise, sums: Sequence[Products]) -> float:
        """Return the figure by which minima are ranked."""
        if self._reweighs:
            return self.noise_at(noise, *mean_scatter(sums))[1]
        return float(self.gram(vector, noise, sums)[-1, -1])

    def _solve(self, problem: Elimination, kept: Array, noise: Noise, *, rough: bool) -> Solution:
        lower, upper = self.bounds()
        samples = len(self.structure.outputs) * sum(block.count for block in self.blocks)

        def both(kept: Array) -> tuple[Array, Array]:
            self.require_stable(kept)
            return problem(kept, noise)

        search = (
            approach
            if rough
            else partial(
                minimise,
                near=samples * self._reweighs,
                deviations=NOTHING**0.5 if self._descends else None,
            )
        )
        return search(
            both,
            kept,
            lower[~self.linear],
            upper[~self.linear],
            time_limit_s=self.time_limit_s,
        )


def start_vectors(search: Search, count: int, seed: int | None) -> list[Array]:
    """Return the declared start and `count` - 1 random ones, logarithmic over bounds that span decades."""
    rest = np.zeros(search.size - len(search.free))
    vectors = [np.concatenate([[parameter.start for parameter in search.free], rest])]
    random = np.random.default_rng(seed)
    for _ in range(count - 1):
        for _ in range(STABLE_DRAWS):
            vector = np.concatenate([[_drawn(parameter, random) for parameter in search.free], rest])
            try:
                search.require_stable(vector)
            except SimulationError:
                continue
            vectors.append(vector)
            break
    return vectors


def _drawn(parameter: Parameter, random: np.random.Generator) -> float:
    if parameter.lower > 0 and parameter.upper / parameter.lower > 100:
        return float(np.exp(random.uniform(np.log(parameter.lower), np.log(parameter.upper))))
    if np.isfinite(parameter.lower) and np.isfinite(parameter.upper):
        return float(random.uniform(parameter.lower, parameter.upper))
    return float(parameter.start * (1.0 + random.normal()))
