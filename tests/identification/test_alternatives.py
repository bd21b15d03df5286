"""Alternatives: every one has what the chosen structure's figures are computed from."""

from types import SimpleNamespace

import numpy as np

from shipfp_rs import Structure
from shipfp_rs.identification.alternatives import alternatives
from shipfp_rs.structures.linearised import loop_of, state_space


def fitted(elements):
    structure = Structure.ship(elements, torque="brake")
    found = {"tau_n": 0.8, "g": -0.3, "vK_p": 3.0, "vK_i": 9.0, "p": 2.0, "tau_prop": 0.2, "tau_twist": 2e-3}
    values = {parameter.name: parameter.start for parameter in structure.parameters} | {
        name: value for name, value in found.items() if name in structure.names
    }
    search = SimpleNamespace(structure=structure, values=lambda vector: values)
    return SimpleNamespace(elements=elements, search=search, minimum=SimpleNamespace(vector=np.zeros(0)))


def test_a_rival_with_a_stiff_shaft_has_the_loop_of_the_structure_without_a_twist():
    chosen, rival = fitted(("twist",)), fitted(())
    (other,) = alternatives(SimpleNamespace(best=chosen, rivals=(rival,), neglected={}))
    assert other["elements"] == []
    _, known = loop_of(chosen.search.structure, other["optimum"])
    assert known["tau_prop"] == known["tau_n"] == 0.8
    own, stiff = (
        np.linalg.eigvals(state_space(one.search.structure, other["optimum"], 2).A) for one in (rival, chosen)
    )
    np.testing.assert_allclose(np.sort_complex(stiff), np.sort_complex(own), rtol=1e-9)
