"""The search of all ships against certified answers of the NIST Statistical Reference Datasets, from both starts."""

from types import SimpleNamespace

import numpy as np
import pytest

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.basins import descend
from shipfp_rs.identification.likelihood import Products
from tests.nist_strd import MODELS, Problem, agreeing

ASTRAY = {("BoxBOD", 1), ("MGH10", 1), ("MGH17", 1)}
"""The far start of these leads to where a term has no effect, a minimum at infinity: one descent finds no way back."""


class Squares:
    """A dataset in place of a likelihood, in units of its certified residual."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        size = len(problem.certified)
        self.coordinates = SimpleNamespace(bounds=(np.full(size, -np.inf), np.full(size, np.inf)))

    def near(self, vector):
        return self

    def products(self, vector: np.ndarray) -> Products:
        residual, jacobian = self.problem.function(vector)
        residual, rows = (part / self.problem.residual_deviation for part in (residual, -jacobian.T))
        with np.errstate(all="ignore"):
            found = Products(float(residual @ residual), rows @ residual, rows @ rows.T)
        if not np.isfinite(found.cost) or not np.isfinite(found.matrix).all():
            raise SimulationError("a residual is not finite")
        return found


CASES = [(name, start) for name in MODELS for start in (1, 2) if (name, start) not in ASTRAY]


@pytest.mark.parametrize(("name", "start"), CASES)
def test_certified_answer_is_found(name, start):
    problem = Problem.read(name)
    found = descend(Squares(problem), problem.starts[start - 1], steps=5000, settled=1e-9)
    # A step that lowers the sum of squares by a part of 1e-9 of the noise counts no more.
    assert agreeing(found.vector, problem.certified) > 4.5
