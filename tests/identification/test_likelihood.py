"""The smooth ship's likelihood, by the kernel and by bands of hats, against whole rows."""

from functools import cache

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.identification.first_guesses import first_guesses
from shipfp_rs.identification.likelihood import Products
from shipfp_rs.identification.noise import real_rows, turned
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
        gram = likelihood.gram(vector, fused=False)
        expected = Products(gram[0, 0], gram[1:, 0], gram[1:, 1:])
        found = likelihood.products(vector)
        scale = np.sqrt(expected.matrix.diagonal())
        assert found.cost == pytest.approx(expected.cost, rel=1e-9)
        assert likelihood.cost(vector) == pytest.approx(expected.cost, rel=1e-9)
        np.testing.assert_allclose(found.downhill / scale, expected.downhill / scale, atol=1e-7)
        both = found.matrix / np.outer(scale, scale), expected.matrix / np.outer(scale, scale)
        np.testing.assert_allclose(*both, atol=1e-9)

    def test_smooth_errors_and_what_they_leave(self):
        """Ridge regression on the whole shapes, each of a standard deviation of one."""
        likelihood, vector = made()
        residuals = likelihood.residuals(vector)
        rows, shapes = (
            np.concatenate([real_rows(turned(likelihood.root(at), one)) for at, one in enumerate(of)], axis=1)
            for of in ([one[None] for one in residuals], likelihood.shapes)
        )
        covariance = np.linalg.inv(shapes @ shapes.T + np.eye(len(shapes)))
        sizes, unsure = likelihood.smooth_errors(residuals)
        np.testing.assert_allclose(unsure, covariance, atol=1e-9)
        np.testing.assert_allclose(sizes, covariance @ shapes @ rows[0], atol=1e-9)
        left, _ = likelihood._left(residuals)
        for found, residual, shape in zip(left, residuals, likelihood.shapes, strict=True):
            expected = residual - np.tensordot(sizes, shape, 1)
            np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())

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
