"""The unknowns in which a model is linear, always at their best values: a search need not look for them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.weighted_problem import Minimum, Noise, WeightedProblem
from shipfp_rs.optimise.normal_equations import Products, cleared, condense, regression
from shipfp_rs.support.arrays import Array

REPEATED = 1e-4
"""Another pass is made where better values of the eliminated unknowns would lower the cost by more than this part."""
PASSES = 3
"""Passes over the data for one point at most."""
REMEMBERED = 8
"""Number of points whose sums are kept, since new weights then need no new pass over the data."""


class _Pass(NamedTuple):
    """Sums of one pass over the data, at a full vector (Q,)."""

    vector: Array
    noise: Noise
    sums: Sequence[Products]


class Elimination:
    """A weighted problem in the unknowns `kept` (K,), all in which the model is not linear.

    Variable projection (10.1137/0710036, with the Jacobian of 10.1007/BF01932995): the unknowns in which the model is
    linear are eliminated. Without it a small vK_i and a large initial dE make a long curved valley. A pass over the data
    needs some values of the eliminated unknowns; it takes those that the point before leads to, or of the start (Q,).
    Their best values and the cost there follow exactly from the sums of that pass.
    """

    def __init__(self, problem: WeightedProblem, start: Array, known: Minimum | None = None) -> None:
        self._problem = problem
        self._linear = problem.linear
        # No derivative depends on an offset, so the pass may be made at any offset near the best one.
        self._exact = all(set(block.linear) <= set(block.offsets) for block in problem.blocks)
        kept, best = start[~self._linear], start[self._linear]
        # The last point, the best values of the eliminated unknowns there, and their slopes by the kept ones.
        self._lead = kept, best, np.zeros((len(best), len(kept)))
        self._known = [] if known is None else [_Pass(known.vector, known.noise, known.sums)]

    def __call__(self, kept: Array, noise: Noise) -> tuple[Array, Array]:
        """Return a residual (K + 1,) and Jacobian (K + 1, K) with the cost, gradient and J'J of the whole problem.

        The search then works on a few rows however long the record is. Squaring the Jacobian costs digits of a step,
        none of where the gradient vanishes.
        """
        _, gram, coefficients = self._at(kept, noise)
        return condense(cleared(gram, np.append(self._linear, False), coefficients))

    def complete(self, kept: Array, noise: Noise) -> tuple[Array, list[Products]]:
        """Return the full vector (Q,) and every block's sums there."""
        problem = self._problem
        done, _, coefficients = self._at(kept, noise)
        step = np.zeros(problem.size)
        step[self._linear] = -coefficients[:, -1]
        sums = [
            part.moved(np.append(step[: len(problem.free)], step[own]))
            for part, own in zip(done.sums, problem.places(), strict=True)
        ]
        return done.vector + step, sums

    def _at(self, kept: Array, noise: Noise) -> tuple[_Pass, Array, Array]:
        """Return the sums for `kept`, their gram matrix, and what the eliminated columns explain of the others."""
        problem, linear = self._problem, self._linear
        own = np.append(linear, False)
        done = next((one for one in reversed(self._known) if self._is(one, kept, noise)), None)
        vector = self._led_to(kept) if done is None else done.vector
        for again in reversed(range(PASSES)):
            if done is None:
                done = _Pass(vector, noise, problem.sums(vector, noise))
                self._known = [*self._known[1 - REMEMBERED :], done]
            gram = problem.gram(done.vector, noise, done.sums)
            if not np.isfinite(gram).all():
                raise SimulationError("the simulation or its sensitivities left the range of finite numbers")
            coefficients = regression(gram, own)
            saved = float(gram[own, -1] @ coefficients[:, -1])
            vector = done.vector.copy()
            vector[linear] -= coefficients[:, -1]
            slopes = -coefficients[:, :-1] * (not self._exact)
            self._lead = kept, vector[linear], slopes
            if not again or self._exact or saved <= REPEATED * max(float(gram[-1, -1]) - saved, 0.0):
                break
            done = None
        assert done is not None
        return done, gram, coefficients

    def _is(self, one: _Pass, kept: Array, noise: Noise) -> bool:
        same = one.noise.whitening is noise.whitening and one.noise.sharp == noise.sharp
        return same and np.array_equal(one.vector[~self._linear], kept)

    def _led_to(self, kept: Array) -> Array:
        vector = np.empty(self._problem.size)
        vector[~self._linear] = kept
        before, best, slope = self._lead
        vector[self._linear] = best + slope @ (kept - before)
        return vector
