"""The search against the certified answers of the NIST Statistical Reference Datasets, from both published starts."""

import numpy as np
import pytest

from shipfp_rs.optimise.least_squares import minimise
from tests.nist_strd import MODELS, Problem, solve

EXTENDED = np.finfo(np.longdouble).eps < 1e-18
"""Lanczos1's residuals are 1e-13 of its data: double precision holds only two or three digits of them."""


def test_all_problems_are_here():
    assert len(MODELS) == 27


@pytest.mark.parametrize("start", [1, 2])
@pytest.mark.parametrize("name", MODELS)
def test_certified_answer_is_found(name, start):
    problem = Problem.read(name)
    solution = solve(problem, start)
    assert solution.converged, solution.message
    assert solution.cost <= problem.sum_of_squares * (1 + 1e-6)
    parameters, deviations, residual = problem.digits(solution)
    assert parameters > 9
    fewer = name == "Lanczos1" and not EXTENDED
    assert deviations > (2 if fewer else 6)
    assert residual > (2 if fewer else 6)


def test_minimum_at_infinity_is_not_called_one():
    """NIST names one of MGH09 at (inf, -14.07..., -inf, -inf) with a sum of squares of 0.00102734."""
    function = Problem.read("MGH09").function
    solution = minimise(function, [1e3, -14.0, -4e3, -1e4], -np.inf, np.inf, max_evaluations=2000)
    assert solution.cost == pytest.approx(0.00102734, rel=1e-5)
    assert not solution.converged
    assert "where it has no effect of its own any more" in solution.message


@pytest.mark.parametrize(
    "start",
    [
        pytest.param([1.0, 1.0, 1.0, 0.5, 0.6], id="both terms become one"),
        pytest.param([1.0, 1.0, 1.0, 5.0, 6.0], id="both terms vanish"),
        pytest.param([1.0, 1.0, 1.0, 50.0, 60.0], id="both terms start without effect"),
    ],
)
def test_merged_and_vanished_terms_are_not_taken_for_a_minimum(start):
    problem = Problem.read("MGH17")
    solution = minimise(problem.function, start, -np.inf, np.inf, max_evaluations=2000)
    assert not solution.converged or solution.cost <= problem.sum_of_squares * (1 + 1e-6)
