"""The search's own steps against SciPy's least squares on the same problem."""

import numpy as np
import pytest
from benches import rival_ship
from benches.bench_identify import SHIP, experiment
from scipy.optimize import least_squares

from shipfp_rs import Structure
from shipfp_rs.errors import IdentificationError
from shipfp_rs.identification.descent import descend
from shipfp_rs.identification.minima import search_minima
from shipfp_rs.identification.options import Options
from shipfp_rs.identification.variable_projection import Elimination


@pytest.fixture(scope="module")
def found():
    structure = Structure.ship(["dead_time_loop", "dead_time_set_point"], torque="gauge")
    structure = structure.with_start(**dict(zip(SHIP, rival_ship.START[:8].tolist(), strict=True)))
    data = experiment(*rival_ship.trial(5, 200.0))
    return search_minima(data, structure, Options(noise="white", starts=1))


def lowest(search, noise, start):
    """SciPy's end with the weights held, from near the minimum."""
    problem = Elimination(search, start)
    lower, upper = search.bounds()
    return least_squares(
        lambda x: problem(x, noise)[0],
        start,
        jac=lambda x: problem(x, noise)[1],
        bounds=(lower, upper),
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
    )


def test_it_ends_where_scipy_ends(found):
    search, best = found.search, found.best
    scipys = lowest(search, best.noise, best.vector)
    cost = float(search.gram(best.vector, best.noise, best.sums)[-1, -1])
    assert 2.0 * scipys.cost <= cost * (1.0 + 1e-9)
    assert cost - 2.0 * scipys.cost < 1e-3  # in units of the deviance


def test_it_takes_few_passes_and_stops_at_a_limit(found):
    search, start = found.search, np.array([*rival_ship.START[:8], 0.0, 0.0, 0.0, 0.0])
    arguments = {"near": False, "enough": 0.1}
    reached = descend(
        search,
        Elimination(search, start),
        start,
        search.initial_noise(),
        max_evaluations=100,
        **arguments,
    )
    assert reached.settled
    assert reached.passes < 40
    stopped = descend(
        search, Elimination(search, start), start, search.initial_noise(), max_evaluations=3, **arguments
    )
    assert not stopped.settled
    assert stopped.limit == "3 evaluations"


def test_a_start_that_can_not_be_simulated_is_told(found):
    search, start = found.search, np.array([*rival_ship.START[:8], 0.0, 0.0, 0.0, 0.0])
    start[search.names.index("vK_i")] = 1e3
    with pytest.raises(IdentificationError, match="start vector can't be evaluated"):
        descend(
            search,
            Elimination(search, start),
            start,
            search.initial_noise(),
            near=False,
            enough=0.1,
            max_evaluations=10,
        )
