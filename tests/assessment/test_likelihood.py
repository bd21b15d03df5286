"""Profiles to look at: parabolas where the data tell much, valleys and walls where they do not."""

from __future__ import annotations

import json

import numpy as np
import pytest

from shipfp_rs import plot, signals
from shipfp_rs.assessment.profile_likelihood import LEVEL, profile_likelihood
from shipfp_rs.errors import InputError
from shipfp_rs.identification.identify import identify
from shipfp_rs.reproduce.fullscale import extended_structure, measured_response
from shipfp_rs.structures.structure import Structure
from tests.launch import noisy_record

CHIRP = signals.chirp(0.01, 5.0, 120.0, 13.0, rate_hz=50.0)


@pytest.fixture(scope="module")
def tug():
    found = profile_likelihood(measured_response(1.637), extended_structure(), noise="std", starts=8)
    return {one.name: one for one in found}


def test_the_published_sine_fits_bound_four_parameters_one_side_of_three_and_say_nothing_of_two(tug):
    kinds = {name: one.kind for name, one in tug.items()}
    assert {name for name, kind in kinds.items() if kind == "bounded"} == {"p", "tau_prop", "T_d", "T_set"}
    assert kinds["v"] == kinds["g"] == "flat"
    # From a point on the valley any larger inertia goes with larger gains; below 0.6 s even g = 1 does not help.
    assert kinds["tau_n"] == kinds["K_p"] == kinds["K_i"] == "one-sided"
    assert tug["K_p"].interval[1] == tug["K_i"].interval[1] == 1000.0
    assert tug["tau_n"].interval[0] == pytest.approx(0.63, abs=0.05)
    assert tug["v"].interval == (0.01, 300.0)


def test_along_a_valley_the_others_keep_what_the_data_tell(tug):
    v = tug["v"]
    combination = v.values * v.others["K_p"] / v.others["tau_n"]
    assert np.ptp(v.values) > 9.0
    assert combination == pytest.approx(np.full(len(combination), 3.79), abs=0.25)


def test_well_told_parameters_have_parabolas_of_their_own_deviations():
    data, structure = noisy_record(CHIRP, 0.01, 0.0, 3), Structure.linear(products=True)
    fingerprint = identify(data, structure)
    for one in profile_likelihood(data, structure, ["tau_n", "g"]):
        estimate = fingerprint[one.name]
        low, high = estimate.ci95
        assert one.kind == "bounded"
        assert one.interval == pytest.approx((low, high), abs=0.02 * (high - low))
        turns = (one.values - estimate.value) / estimate.std
        assert one.deviance == pytest.approx(turns**2, rel=0.03, abs=0.03)
        at_ends = np.interp(one.interval, one.values, one.deviance)
        assert at_ends == pytest.approx((LEVEL, LEVEL), rel=0.05)


def test_a_rise_has_one_minimum_and_steep_walls_are_told(tug):
    for one in tug.values():
        assert (np.diff(one.values) > 0.0).all()
        assert one.deviance.min() < 0.01
    skewed = tug["T_d"]
    assert skewed.value - skewed.interval[0] > 1.4 * (skewed.interval[1] - skewed.value)


def test_it_is_json_and_words(tug):
    for one in tug.values():
        content = json.loads(json.dumps(one.to_dict(), allow_nan=False))
        assert len(content["values"]) == len(content["deviance"])
        assert one.kind in str(one)
    assert str(tug["p"]).startswith("p is bounded: 2.167 (2.1")


def test_the_picture_shows_the_level_and_the_unit(tug):
    ax = plot.likelihood(tug["tau_prop"])
    assert ax.get_xlabel() == "tau_prop [s]"
    assert ax.get_ylabel() == "deviance [-]"
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["bounded", "95 %"]


def test_what_is_not_searched_for_and_unknown_options_are_refused():
    data, structure = measured_response(1.637), extended_structure()
    with pytest.raises(InputError, match="no free parameter 'taun', did you mean 'tau_n'"):
        profile_likelihood(data, structure, ["taun"])
    with pytest.raises(InputError, match="identify has no option 'nois' here, did you mean 'noise'"):
        profile_likelihood(data, structure, nois="std")
