"""Chapters 6 and 7: the thesis's full-scale tables reproduced, and what a structure that suits the tug finds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.reproduce import Row, fullscale, trial
from shipfp_rs.reproduce.fullscale import measured_response
from shipfp_rs.reproduce.pictures import draw

PAGE = (Path(__file__).parents[2] / "docs" / "tutorials" / "full-scale.md").read_text(encoding="utf-8")


@pytest.fixture
def reproduction(fullscale):
    return fullscale


def rows(reproduction, case: str, way: str):
    return [row for row in reproduction.rows if (row.table, row.case, row.way) == ("7.1", case, way)]


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
        if name.startswith("ii, weighted:")
    }
    chi = [fingerprint.fit["overall"]["chi_squared"] for fingerprint in weighted.values()]
    *_, none, loop, set_point, both = chi
    assert none > loop > set_point > both
    best = list(weighted.values())[-1]
    assert best["p"].value == pytest.approx(2.17, abs=0.02)
    assert best["p"].ci95[0] > 2.0
    assert best["tau_prop"].value == pytest.approx(0.43, abs=0.03)
    assert best["(p-g)/(vK_i)+T_set-T_f"].value == pytest.approx(0.47, abs=0.03)
    assert best["tau_n"].status == "unidentifiable"


def test_low_frequency_torque_over_speed_is_the_propeller_exponent():
    response = measured_response(1.637)
    ratio = np.abs(response.response["M_g"] / response.response["n_e"])
    assert ((ratio[response.frequency_hz < 0.07] > 2.10) & (ratio[response.frequency_hz < 0.07] < 2.25)).all()


def test_the_verdict_names_what_can_not_be_identified(reproduction):
    text = "\n".join(reproduction.verdict)
    assert "Not identifiable from these data: tau_n (only known together with" in text
    assert "one side only: K_p (on its lower bound 0.01; the data allow up to" in text
    assert "K_i (on its upper bound 10; the data allow down to" in text


def test_every_row_is_plain_json(reproduction):
    content = json.loads(json.dumps(reproduction.to_dict(), allow_nan=False))
    assert {row["way"] for row in content["rows"]} == {"printed", "thesis", "ours"}
    tables = {row["table"] for row in content["rows"]}
    assert tables == {"6.8", "6.9", "6.11", "6.12", "7.1", "E.1", "7.2", "7.3", "eq. 7.9"}


def table(reproduction, name: str, case: str, way: str) -> Row:
    (row,) = [row for row in reproduction.rows if (row.table, row.case, row.way) == (name, case, way)]
    return row


def test_calculated_torques_are_those_of_eq_6_3_and_one_printed_error_is_wrong(reproduction):
    printed = table(reproduction, "6.8", "calculated [Nm]", "printed").parameters
    ours = table(reproduction, "6.8", "calculated [Nm]", "ours").parameters
    for speed, torque in printed.items():
        assert ours[speed] == pytest.approx(torque, abs=0.25)
    errors = {way: table(reproduction, "6.8", "error [%]", way).parameters for way in ("printed", "ours")}
    off = {speed: errors["ours"][speed] - errors["printed"][speed] for speed in printed}
    assert off.pop("1184 rpm") == pytest.approx(0.57, abs=0.02)
    assert max(map(abs, off.values())) < 0.02


def test_peaks_of_the_torque_are_what_turns_at_one_speed(reproduction):
    printed = table(reproduction, "6.9", "peak [Hz]", "printed").parameters
    rates = table(reproduction, "6.9", "rate [Hz]", "ours").parameters
    for name, rate in rates.items():
        assert printed[name] == pytest.approx(rate, rel=0.004)


def test_the_set_point_line_is_the_least_squares_one_within_its_interval(reproduction):
    line = table(reproduction, "6.11", "least squares", "ours")
    assert line.parameters["rpm/V"] == pytest.approx(-251.57, abs=0.01)
    assert line.parameters["rpm at 0 V"] == pytest.approx(-85.69, abs=0.01)


def test_the_torsional_calculation_gives_the_printed_time_constant(reproduction):
    ours = table(reproduction, "eq. 7.9", "torsional calculation", "ours").parameters
    assert ours["tau_n [s]"] == pytest.approx(1.17, abs=0.005)


def test_the_torsional_calculation_as_a_prior_makes_the_total_known_and_leaves_the_rest_as_it_was(
    reproduction,
):
    free, held = (
        reproduction.fingerprints[f"ii, weighted{case}: extended, T_d and T_set"]
        for case in ("", ", torsional prior")
    )
    assert free["tau_n"].status == "unidentifiable"
    assert held["tau_n"].value == pytest.approx(1.17, abs=0.03)
    low, high = held["tau_n"].ci95
    assert low < 1.17 < high
    for name in ("p", "tau_prop", "T_d", "T_set"):
        assert held[name].value == pytest.approx(free[name].value, abs=2.0 * free[name].std)


def test_three_different_sets_do_not_fit_the_same_steps_to_the_same_hundredth(reproduction):
    printed = {
        table(reproduction, "7.2", case, "printed").parameters["steps"] for case in ("ii", "iii", "iv")
    }
    ours = [table(reproduction, "7.2", case, "ours").parameters["steps"] for case in ("ii", "iii", "iv")]
    assert len(printed) == 1
    assert np.ptp(ours) > 1.0


@pytest.mark.parametrize("name", ["7.2", "7.3"])
@pytest.mark.parametrize("signal", ["sines", "short chirp", "long chirp"])
def test_the_extended_structure_predicts_the_simulated_trial_best(reproduction, name, signal):
    best = table(reproduction, name, "ii, weighted", "ours").parameters[signal]
    others = [table(reproduction, name, case, "ours").parameters[signal] for case in ("i", "ii", "iii", "iv")]
    assert best > max(others) + 10.0


@pytest.mark.parametrize(("name", "duration_s"), [("S2", 3 / 0.0044), ("C11", 500.0), ("St1", 450.0)])
def test_the_trial_has_the_printed_plan(name, duration_s):
    excitation = trial.excitation(name)
    assert excitation.duration == pytest.approx(duration_s, abs=0.1)
    assert np.abs(excitation.samples).max() == pytest.approx(502.8 if name == "St1" else 76.0, rel=1e-3)


def test_an_experiment_that_was_not_made_is_refused():
    with pytest.raises(InputError, match=r"experiment 'S18', expected one of S1, S2"):
        trial.excitation("S18")


def test_the_ladder_from_the_thesis_structure_ends_with_both_dead_times(reproduction):
    (line,) = [line for line in reproduction.verdict if line.endswith(" *")]
    assert "extended, T_d and T_set" in line
    assert chi_squared(reproduction, "thesis") > 20 * chi_squared(reproduction, "extended, T_d and T_set")


def chi_squared(reproduction, structure: str) -> float:
    return reproduction.fingerprints[f"ii, weighted: {structure}"].fit["overall"]["chi_squared"]


def test_each_table_and_the_measured_sines_have_a_picture(reproduction, tmp_path):
    draw(tmp_path, reproduction, responses=fullscale.responses)
    assert {file.name for file in tmp_path.iterdir()} == set(fullscale.FILES)


def test_our_curve_goes_through_the_published_sines_and_the_printed_ones_do_not(reproduction):
    measured, models = fullscale.responses(reproduction)
    off = {}
    for label, curve in models.items():
        at = np.interp(measured.frequency_hz, curve.frequency_hz, np.abs(curve.response["n_e"]))
        off[label] = np.abs(at / np.abs(measured.response["n_e"]) - 1.0).max()
    assert off.pop("ours") < 0.05
    assert min(off.values()) > 0.1


def test_the_table_of_full_scale_results_is_what_the_command_prints(reproduction):
    found = {(row.case, row.way): row for row in reproduction.rows if row.table == "7.1"}
    printed = [
        f"{found[key].fit['dn']:.1f} / {found[key].fit['dM']:.1f}"
        for key in (("ii", "printed"), ("ii", "thesis"), ("ii", "ours"), ("ii, ten points", "ours"))
    ]
    for figures in printed:
        assert figures in PAGE
    assert (
        f"{found['ii', 'ours'].parameters['p']:.2f} | {found['ii', 'ours'].parameters['tau_prop']:.2f}"
        in PAGE
    )
