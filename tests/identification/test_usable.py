"""The first sentence of a verdict: what a fingerprint can be used for, and when it is good for nothing."""

from __future__ import annotations

from dataclasses import replace

import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.si import in_si
from shipfp_rs.identification.automatic import LEAST_EXPLAINED_PCT, reworded
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint, Identifiability

STUCK = "The search did not end in a minimum, so take no figure for an estimate: stopped."


@pytest.fixture
def found() -> Fingerprint:
    """Return what a good fit leaves to word."""
    return Fingerprint(
        parameters={
            "tau_n": Estimate(1.5, 0.01, (1.48, 1.52), "s"),
            "vK_p": Estimate(15.8, 0.1, (15.6, 16.0), "-"),
            "M_max": Estimate(2.0, 0.01, (1.98, 2.02), "-"),
        },
        derived={},
        identifiability=Identifiability(3, 3, 10.0),
        fit={"dn": {"nrmse_pct": 97.0}, "dM": {"nrmse_pct": 90.0}, "overall": {}},
        structure={"name": "ship"},
        data=({"operating_point": {"n_e": 1300.0, "M_b": 222.93}, "signals": {"dM": "M_b"}},),
        adequate={"stands": True, "misses_pct": {"dn": 0.1, "dM": 0.2}, "dispersion": 1.0},
    )


def test_a_good_fit_is_usable_for_all(found) -> None:
    assert reworded(found).usable.endswith("comparison: the data tell every parameter.")


def test_a_model_that_explains_nothing_of_the_torque_is_not_usable(found) -> None:
    fit = {**found.fit, "dM": {"nrmse_pct": 0.5 * LEAST_EXPLAINED_PCT}}
    assert (
        reworded(replace(found, fit=fit)).usable
        == "Not usable, because the model explains nothing of the torque."
    )
    fit["dM"] = {"nrmse_pct": 2.0 * LEAST_EXPLAINED_PCT}  # much noise is no contradiction
    assert reworded(replace(found, fit=fit)).usable.startswith("Usable")


def test_a_search_that_ended_in_no_minimum_is_not_usable(found) -> None:
    usable = reworded(replace(found, verdict=(STUCK,))).usable
    assert usable == "Not usable, because the search did not end in a minimum; no figure is an estimate."


def test_what_is_told_roughly_or_not_at_all_is_named(found) -> None:
    rough = {**found.parameters, "tau_n": Estimate(1.5, 0.2, (1.1, 1.9), "s")}
    assert reworded(replace(found, parameters=rough)).usable.endswith("but tau_n only roughly.")
    lost = {**found.parameters, "tau_n": Estimate(None, unit="s", status="unidentifiable")}
    usable = reworded(replace(found, parameters=lost)).usable
    assert usable == "Usable for simulation and comparison, but tau_n is not known alone."


def test_a_torque_limit_in_si_is_the_engine_s(found) -> None:
    limit = in_si(found, fp.Vessel.load("stan-launch-804"))["torque_limit"]
    assert limit["value"] == pytest.approx(2.0 * 222.93)
