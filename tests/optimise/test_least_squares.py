"""The search finds known minima, says honestly when it did not, and turns back where a model fails."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from shipfp_rs.errors import IdentificationError, InputError, SimulationError
from shipfp_rs.optimise.gauss_newton import Bounds, Point, gauss_newton_step
from shipfp_rs.optimise.least_squares import minimise

INF = np.inf


def rosenbrock(x):
    """More, Garbow and Hillstrom, ACM TOMS 7 (1981) 17-41, problem 1: minimum 0 at (1, 1)."""
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


def powell_singular(x):
    """The same, problem 13: minimum 0 at the origin, where the Jacobian is singular."""
    a, b, c, d = x
    residual = [a + 10 * b, 5**0.5 * (c - d), (b - 2 * c) ** 2, 10**0.5 * (a - d) ** 2]
    slope, steep = 2 * (b - 2 * c), 2 * 10**0.5 * (a - d)
    jacobian = [[1, 10, 0, 0], [0, 0, 5**0.5, -(5**0.5)], [0, slope, -2 * slope, 0], [steep, 0, 0, -steep]]
    return np.array(residual), np.array(jacobian, dtype=float)


def freudenstein_roth(x):
    """The same, problem 2: minimum 0 at (5, 4), a local one of 48.98425 at (11.41278, -0.89681)."""
    a, b = x
    residual = [-13 + a + ((5 - b) * b - 2) * b, -29 + a + ((b + 1) * b - 14) * b]
    return np.array(residual), np.array([[1, 10 * b - 3 * b**2 - 2], [1, 3 * b**2 + 2 * b - 14]])


@pytest.mark.parametrize("condition", [1e1, 1e4, 1e6])
def test_a_step_between_bounds_is_scipy_s(condition):
    """Bounded linear least squares from a corner: SciPy's `lsq_linear` knows the least sum of squares."""
    random = np.random.default_rng(12)
    for _ in range(20):
        left, _ = np.linalg.qr(random.normal(size=(20, 6)))
        right, _ = np.linalg.qr(random.normal(size=(6, 6)))
        jacobian = left * np.geomspace(1.0, 1.0 / condition, 6) @ right
        residual, bounds = random.normal(size=20), Bounds(np.zeros(6), np.ones(6))
        start = random.choice([0.0, 1e-9, 0.5, 1.0], size=6)
        step = gauss_newton_step(Point(start, residual, jacobian, float(residual @ residual)), bounds)
        least = 2.0 * lsq_linear(jacobian, jacobian @ start - residual, (0.0, 1.0), tol=1e-14).cost
        after = residual + jacobian @ step.step
        assert (start + step.step >= -1e-12).all()
        assert (start + step.step <= 1.0 + 1e-12).all()
        assert step.promise == pytest.approx(residual @ residual - after @ after, rel=1e-6, abs=1e-12)
        assert step.promise == pytest.approx(residual @ residual - least, rel=1e-6, abs=1e-9)


class TestMinimum:
    def test_is_found_to_full_precision(self):
        found = minimise(rosenbrock, [-1.2, 1.0], -INF, INF)
        assert found.converged
        np.testing.assert_allclose(found.vector, 1.0, rtol=1e-14)

    @pytest.mark.parametrize("upper", [0.5, 0.9])
    def test_on_a_bound_is_exactly_on_it(self, upper):
        """With x0 <= u below 1 the minimum is (u, u^2)."""
        found = minimise(rosenbrock, [-1.2, 1.0], -INF, [upper, INF])
        assert found.converged
        assert found.active.tolist() == [True, False]
        assert found.vector[0] == upper
        np.testing.assert_allclose(found.vector[1], upper**2, rtol=1e-12)
        np.testing.assert_allclose(found.cost, (1 - upper) ** 2, rtol=1e-12)

    def test_with_every_entry_on_a_bound(self):
        found = minimise(lambda q: (q - [3.0, -3.0], np.eye(2)), [0.5, 0.5], 0.0, 1.0)
        assert found.converged
        assert found.vector.tolist() == [1.0, 0.0]
        assert found.active.all()

    def test_local_one_is_a_minimum_too(self):
        found = minimise(freudenstein_roth, [0.5, -2.0], -INF, INF)
        assert found.converged
        np.testing.assert_allclose(found.cost, 48.98425, rtol=1e-6)
        np.testing.assert_allclose(found.vector, [11.41278, -0.89681], rtol=1e-5)

    def test_with_singular_jacobian_is_reached_if_not_vouched_for(self):
        """Steps halve the distance for ever: right to nine digits, but no step is ever small beside the vector."""
        found = minimise(powell_singular, [3.0, -1.0, 0.0, 1.0], -INF, INF)
        np.testing.assert_allclose(found.vector, 0.0, atol=1e-4)

    def test_of_a_start_that_is_one(self):
        found = minimise(rosenbrock, [1.0, 1.0], -INF, INF)
        assert found.converged
        assert found.vector.tolist() == [1.0, 1.0]

    def test_start_outside_its_bounds_is_moved_between_them(self):
        found = minimise(rosenbrock, [5.0, 5.0], [0.0, 0.0], [2.0, 2.0])
        assert found.converged
        np.testing.assert_allclose(found.vector, 1.0, rtol=1e-12)


class TestUnidentifiable:
    """A Jacobian of deficient rank is a matter for the report, not for the search."""

    def test_parameters_known_only_as_a_product(self):
        x = np.linspace(0, 2, 30)
        y = 6 * x + 0.1 * np.sin(40 * x)

        def function(q):
            return y - q[0] * q[1] * x, -np.stack([q[1] * x, q[0] * x], axis=1)

        found = minimise(function, [1.0, 1.0], 0.0, 100.0)
        assert found.converged
        np.testing.assert_allclose(found.vector[0] * found.vector[1], x @ y / (x @ x), rtol=1e-12)

    def test_parameter_without_effect_stays_near_its_start(self):
        def function(q):
            residual, jacobian = rosenbrock(q[:2])
            return residual, np.column_stack([jacobian, np.zeros(2)])

        found = minimise(function, [-1.2, 1.0, 7.0], -INF, INF)
        assert found.converged
        np.testing.assert_allclose(found.vector, [1.0, 1.0, 7.0], rtol=1e-12)

    def test_fewer_residuals_than_parameters(self):
        found = minimise(lambda q: (np.array([q @ q - 4]), 2 * q[None]), [3.0, 1.0, 1.0], -INF, INF)
        assert found.converged
        np.testing.assert_allclose(found.vector @ found.vector, 4.0, rtol=1e-14)


class TestNotConverged:
    """What is no minimum is not called one."""

    def test_limit_of_evaluations(self):
        found = minimise(rosenbrock, [-1.2, 1.0], -INF, INF, max_evaluations=8)
        assert not found.converged
        assert found.evaluations == 8
        assert "limit of 8 evaluations" in found.message
        assert found.cost < 24.2

    def test_limit_of_time(self):
        found = minimise(rosenbrock, [-1.2, 1.0], -INF, INF, time_limit_s=0.0)
        assert not found.converged
        assert "limit of 0 s" in found.message
        assert found.vector.tolist() == [-1.2, 1.0]

    @pytest.mark.parametrize("power", [1, 2, 4])
    @pytest.mark.parametrize("floor", [0.0, 1.0])
    def test_valley_to_infinity(self, floor, power):
        """The sum of squares falls for ever as x grows."""

        def function(q):
            return np.array([q[0] ** -power, floor]), np.array([[-power * q[0] ** (-power - 1)], [0.0]])

        assert not minimise(function, [1.0], 0.5, INF).converged

    @pytest.mark.parametrize(("rate", "found"), [(30.0, True), (200.0, False), (800.0, True)])
    def test_plateau(self, rate, found):
        """A decay so fast that it explains no sample; the minimum is at a rate of 1.

        From 30 the search still feels it. At 200 only rounding is left of the slope; at 800 not even that,
        so that the rate is tried elsewhere.
        """
        x = np.arange(1.0, 7.0)
        y = 1 - np.exp(-x)

        def function(q):
            decay = np.exp(-q[1] * x)
            return y - q[0] * (1 - decay), -np.stack([1 - decay, q[0] * x * decay], axis=1)

        solution = minimise(function, [1.0, rate], -INF, INF)
        assert solution.converged == found
        assert (solution.cost < 1e-20) == found

    def test_saddle_is_left(self):
        """At the start both rates are equal and so are their slopes: a stationary point of rank 1, no minimum."""
        x = np.linspace(0, 4, 40)
        y = np.exp(-0.5 * x) + np.exp(-2 * x)

        def function(q):
            a, b = np.exp(-q[0] * x), np.exp(-q[1] * x)
            return y - a - b, np.stack([x * a, x * b], axis=1)

        merged = minimise(
            lambda q: (lambda r, j: (r, j.sum(1, keepdims=True)))(*function(q.repeat(2))), [1.0], 0, INF
        )
        found = minimise(function, merged.vector.repeat(2), 0.0, INF)
        assert found.converged
        np.testing.assert_allclose(np.sort(found.vector), [0.5, 2.0], rtol=1e-9)


class TestFailingModel:
    @pytest.mark.parametrize(
        "way", ["raises", "not finite", "only the Jacobian", "divides by zero", "overflows"]
    )
    def test_search_turns_back(self, way):
        """The step from the start goes beyond 2, where the model has no answer; the minimum is at 1.9."""

        def function(q):
            beyond = q[0] > 2
            if beyond and way == "raises":
                raise SimulationError("diverged at sample 3")
            if beyond and way == "divides by zero":
                1 / 0  # noqa: B018
            residual, slope = np.log(q) - np.log(1.9), 1 / q[:, None]
            if beyond and way == "not finite":
                residual = residual * np.nan
            if beyond and way == "only the Jacobian":
                slope = slope * np.nan
            if beyond and way == "overflows":
                residual = np.full(1, 1e200)
            return residual, slope

        found = minimise(function, [0.1], 1e-3, INF)
        assert found.converged
        np.testing.assert_allclose(found.vector, 1.9, rtol=1e-12)

    def test_at_the_start_is_an_error(self):
        def function(q):
            raise SimulationError("diverged at sample 3")

        with pytest.raises(
            IdentificationError, match="start vector can't be evaluated: diverged at sample 3"
        ):
            minimise(function, [1.0], 0, 2)

    def test_other_exceptions_pass(self):
        def function(q):
            raise KeyError("tau")

        with pytest.raises(KeyError, match="tau"):
            minimise(function, [1.0], 0, 2)


@pytest.mark.parametrize(
    ("start", "lower", "upper", "message"),
    [
        ([np.nan, 1.0], -INF, INF, "start: found .*nan"),
        ([], -INF, INF, "start"),
        ([1.0, 1.0], [0.0, 3.0], [2.0, 3.0], "bounds of entry 1: 3 to 3 hold no value"),
        ([1.0, 1.0], [0.0, np.nan], [2.0, 3.0], "bounds of entry 1"),
    ],
)
def test_input_is_checked(start, lower, upper, message):
    with pytest.raises(InputError, match=message):
        minimise(rosenbrock, start, lower, upper)


def test_shape_of_the_jacobian_is_checked():
    with pytest.raises(InputError, match=r"Jacobian of shape \(1, 2\), expected \(2, 2\)"):
        minimise(lambda q: (q, np.ones((1, 2))), [1.0, 1.0], -INF, INF)
