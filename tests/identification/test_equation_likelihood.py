"""The smooth ship's likelihood, by the kernel and by bands of hats, against what all models have in common: whole rows."""

from functools import cache

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.identification.first_guesses import first_guesses
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.question import question_of
from tests.families.draw import draw


@cache
def made():
    """A likelihood of two records with noise of its own residuals, and a vector beside that it is looked at."""
    question = question_of(
        [fp.Experiment(**draw("tug", seed, longest_s=240.0).experiment()) for seed in (7, 11)]
    )
    likelihood = question.likelihood("straight")
    guess = first_guesses(likelihood.records, question.outputs, question.gauge)[0]
    vector = likelihood.coordinates.vector({"c_2": 0.0, "T_s": 0.04, "T_M": 2e-3, **guess})
    states = np.random.default_rng(0).normal(size=likelihood.coordinates.size) * 1e-3
    states[: len(likelihood.coordinates.names)] = 0.0
    return likelihood.with_noise(vector).with_noise(vector + states), vector + 2.0 * states


class TestAgainstWholeRows:
    def test_products(self):
        likelihood, vector = made()
        found, expected = likelihood.products(vector), Likelihood.products(likelihood, vector)
        scale = np.sqrt(expected.matrix.diagonal())
        assert found.cost == pytest.approx(expected.cost, rel=1e-9)
        assert likelihood.cost(vector) == pytest.approx(expected.cost, rel=1e-9)
        np.testing.assert_allclose(found.downhill / scale, expected.downhill / scale, atol=1e-7)
        both = found.matrix / np.outer(scale, scale), expected.matrix / np.outer(scale, scale)
        np.testing.assert_allclose(*both, atol=1e-9)

    def test_smooth_errors_and_what_they_leave(self):
        likelihood, vector = made()
        residuals = likelihood.residuals(vector)
        for found, expected in zip(
            likelihood.smooth_errors(residuals), Likelihood.smooth_errors(likelihood, residuals), strict=True
        ):
            np.testing.assert_allclose(found, expected, atol=1e-9)
        for found, expected in zip(
            likelihood._left(residuals), Likelihood._left(likelihood, residuals), strict=True
        ):
            for one, other in zip(found, expected, strict=True):
                np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(other).max())

    def test_derivatives_of_the_coordinates(self):
        likelihood, vector = made()
        c = likelihood.coordinates
        jacobian = c.jacobian(c.values(vector))
        for place in range(len(c.names)):
            step = np.zeros(c.size)
            step[place] = 1e-6
            up, down = (c.values(vector + sign * step) for sign in (1, -1))
            slopes = [(up[name] - down[name]) / 2e-6 for name in c.names]
            np.testing.assert_allclose(jacobian[:, place], slopes, rtol=1e-6, atol=1e-7)
