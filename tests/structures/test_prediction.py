"""A simulation about what was measured: the initial state is that of the data, whatever the model is linear in."""

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.structures.prediction import simulated_about

RATE_HZ, COUNT = 50.0, 1500


@pytest.mark.parametrize("structure", [fp.Structure.linear(), fp.Structure.ship()], ids=["linear", "ship"])
def test_data_of_the_model_itself_are_met_from_where_they_begin(structure):
    values = {one.name: one.start for one in structure.parameters}
    u = 1.0 + 0.02 * np.sin(0.8 * np.arange(COUNT) / RATE_HZ)
    point = {"n_set": 1200.0, "n_e": 1200.0, "M_b": 100.0}

    def experiment(speed, torque):
        rows = {"n_set": u, "n_e": 1.0 + speed, "M_b": 1.0 + torque}
        signals = {name: point[name] * row for name, row in rows.items()}
        return fp.Experiment("begun", RATE_HZ, signals, operating_point=point, hold="first")

    begun = dict.fromkeys(structure.equations.states, 0.0) | {"initial dn": 0.03}
    still = experiment(np.zeros(COUNT), np.zeros(COUNT))
    true = structure.equations.simulate({**values, **begun}, still)
    found = simulated_about(structure, values, experiment(*true))
    np.testing.assert_allclose(list(found.values()), true, atol=1e-7)
