"""Table 7.1: the thesis's full-scale fit reproduced from its sine fits, and what a structure that suits the tug finds."""

from __future__ import annotations

import json

import numpy as np
import pytest

from shipfp_rs.reproduce.fullscale import measured_response


@pytest.fixture
def reproduction(fullscale):
    return fullscale


def rows(reproduction, case: str, way: str):
    return [row for row in reproduction.rows if row.case == case and row.way == way]


def test_the_thesis_structure_gives_the_printed_fit_with_both_gains_on_their_bounds(reproduction):
    (row,) = rows(reproduction, "ii", "thesis")
    (printed,) = rows(reproduction, "ii", "printed")
    assert 0.26 <= row.parameters["tau_n"] <= 0.28
    assert row.parameters["K_p"] == 0.01
    assert row.parameters["K_i"] == 10.0
    assert row.parameters["vK_p"] == pytest.approx(printed.parameters["vK_p"], abs=5e-4)
    assert row.fit["dn"] == pytest.approx(61.8, abs=0.5)
    assert row.fit["dM"] == pytest.approx(19.9, abs=0.5)
    estimates = reproduction.fingerprints["ii: thesis"].parameters
    assert estimates["K_p"].status == estimates["K_i"].status == "at_bound"


@pytest.mark.parametrize("case", ["ii", "ii, ten points"])
def test_the_extended_structure_fits_both_outputs_better(reproduction, case):
    (ours,) = rows(reproduction, case, "ours")
    (thesis,) = rows(reproduction, case, "thesis")
    for output in ("dn", "dM"):
        assert ours.fit[output] > thesis.fit[output] + 5.0
    assert ours.parameters["tau_n"] is None
    low, high = ours.intervals["tau_prop"]
    assert low < 0.43 < high


def test_ten_consistent_points_are_fitted_to_86_and_62_per_cent(reproduction):
    (row,) = rows(reproduction, "ii, ten points", "ours")
    assert row.fit["dn"] > 86.0
    assert row.fit["dM"] > 62.0


def test_weighing_each_point_supports_two_dead_times_and_an_exponent_of_2_17(reproduction):
    weighted = {
        name: fingerprint
        for name, fingerprint in reproduction.fingerprints.items()
        if name.startswith("ii, weighted")
    }
    chi = [fingerprint.fit["overall"]["chi_squared"] for fingerprint in weighted.values()]
    *_, none, loop, set_point, both = chi
    assert none > loop > set_point > both
    best = list(weighted.values())[-1]
    assert best["p"].value == pytest.approx(2.17, abs=0.02)
    assert best["p"].ci95[0] > 2.0
    assert best["tau_prop"].value == pytest.approx(0.43, abs=0.03)
    assert best["(p-g)/(vK_i)+T_set"].value == pytest.approx(0.47, abs=0.03)
    assert best["tau_n"].status == "unidentifiable"


def test_low_frequency_torque_over_speed_is_the_propeller_exponent():
    response = measured_response(1.637)
    ratio = np.abs(response.response["M_g"] / response.response["n_e"])
    assert ((ratio[response.frequency_hz < 0.07] > 2.10) & (ratio[response.frequency_hz < 0.07] < 2.25)).all()


def test_the_verdict_names_what_can_not_be_identified(reproduction):
    text = "\n".join(reproduction.verdict)
    assert "Not identifiable from these data: tau_n (only known together with" in text
    assert "known from one side: K_p (on its lower bound 0.01; the data allow up to" in text
    assert "K_i (on its upper bound 10; the data allow down to" in text


def test_every_row_is_plain_json(reproduction):
    content = json.loads(json.dumps(reproduction.to_dict(), allow_nan=False))
    assert {row["way"] for row in content["rows"]} == {"printed", "thesis", "ours"}
    assert all(row["table"] == "7.1" for row in content["rows"])


def test_the_ladder_from_the_thesis_structure_ends_with_both_dead_times(reproduction):
    (line,) = [line for line in reproduction.verdict if "*" in line and "deviance" in line]
    assert "extended, T_d and T_set" in line
    assert chi_squared(reproduction, "thesis") > 20 * chi_squared(reproduction, "extended, T_d and T_set")


def chi_squared(reproduction, structure: str) -> float:
    return reproduction.fingerprints[f"ii, weighted: {structure}"].fit["overall"]["chi_squared"]
