"""From simple to rich: the ladder stops where the data carry no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shipfp_rs.assessment.ladder import climb, ladder
from shipfp_rs.errors import InputError
from shipfp_rs.identification.identify import identify
from shipfp_rs.structures.structure import Structure
from tests.identification.test_identifiability import (
    BAND,
    VALUES,
    experiment,
    response,
    started_near_truth,
    truth,
)

PLAIN = Structure.linear(products=True, name="plain")
LOOP = Structure.linear(products=True, dead_time_loop=True, name="with T_d")
SET_POINT = Structure.linear(products=True, dead_time_set_point=True, name="with T_set")
BOTH = Structure.linear(products=True, dead_time_loop=True, dead_time_set_point=True, name="with both")


@pytest.mark.parametrize("domain", ["time", "frequency"])
@pytest.mark.parametrize("true", [PLAIN, SET_POINT, BOTH], ids=lambda structure: structure.name)
def test_the_ladder_ends_on_the_structure_that_made_the_data(true, domain):
    rungs = [started_near_truth(structure) for structure in (PLAIN, SET_POINT, BOTH)]
    made, settings = (
        (experiment(true, noise=0.02), {}) if domain == "time" else (response(true), {"noise": "std"})
    )
    found = ladder(made, rungs, starts=1, **settings)
    assert found.rungs[found.best].structure == true.name
    assert found.fingerprint["tau_n"].value == pytest.approx(VALUES["tau_n"], rel=0.01)
    # The first rungs are too simple: each step up to the true one is worth more than chance.
    for rung in found.rungs[1 : found.best + 1]:
        assert rung.supported
        assert rung.p < 1e-6
    assert not any(rung.supported for rung in found.rungs[found.best + 1 :])


def test_a_rival_as_rich_as_the_last_rung_is_judged_by_how_well_it_fits():
    made = response(SET_POINT)
    rungs = [started_near_truth(structure) for structure in (PLAIN, LOOP, SET_POINT)]
    found = ladder(made, rungs, starts=1, noise="std")
    assert [rung.supported for rung in found.rungs] == [True, True, True]
    assert found.rungs[2].p is None
    assert found.rungs[found.best].structure == "with T_set"


def test_void_parameters_are_seldom_taken():
    random = np.random.default_rng(8)
    clean, _ = PLAIN.equations.response(truth(PLAIN), BAND, ())
    taken = 0
    for _ in range(20):
        turned = clean * np.exp(
            1e-3 * (random.normal(size=clean.shape) + 1j * random.normal(size=clean.shape))
        )
        made = replace(response(PLAIN), response=dict(zip(("n_e", "M_b"), turned, strict=True)))
        steps = [identify(made, started_near_truth(s), noise="std", starts=1) for s in (PLAIN, SET_POINT)]
        taken += climb(steps).best
    assert taken <= 2


def test_it_prints_a_table_and_gives_json():
    found = ladder(response(PLAIN), [PLAIN, SET_POINT], starts=1, noise="std")
    assert "*the first" in str(found)
    assert found.to_dict()["best"] == "plain"
    assert [row["structure"] for row in found.to_dict()["rungs"]] == ["plain", "with T_set"]


def test_one_structure_is_no_ladder_and_outputs_must_be_the_same():
    with pytest.raises(InputError, match="two or more"):
        ladder(response(PLAIN), [PLAIN])
    with pytest.raises(InputError, match="same outputs"):
        ladder(response(PLAIN), [PLAIN, Structure.linear(outputs=("dn",))])
