"""One record, four ways to ask: alone, tied, beside another record, and profiled. They must answer alike."""

from __future__ import annotations

from dataclasses import replace

import pytest

from shipfp_rs import Experiment, Fingerprint, Structure, identify, signals
from shipfp_rs.assessment.profile_likelihood import profile_likelihood
from tests.launch import noisy_record

SHIP = Structure.ship([], products=True)
FREE = tuple(parameter.name for parameter in SHIP.free)
CHIRP = signals.chirp(0.01, 5.0, 120.0, 13.0, rate_hz=50.0)


@pytest.fixture(scope="module")
def record() -> Experiment:
    return replace(noisy_record(CHIRP, 0.01, 0.0, 3), name="one")


@pytest.fixture(scope="module")
def alone(record) -> Fingerprint:
    return identify(record, SHIP)


def moved(other: Fingerprint, alone: Fingerprint, name: str, suffix: str = "") -> float:
    """Return by how many standard deviations an estimate differs from that of the record alone."""
    return abs(other[name + suffix].value - alone[name].value) / alone[name].std


def widths(other: Fingerprint, alone: Fingerprint, name: str, suffix: str = "") -> float:
    return other[name + suffix].std / alone[name].std


def test_a_tie_at_the_ratio_that_was_found_moves_nothing(record, alone):
    ratio = alone["vK_i"].value / alone["vK_p"].value
    tied = identify(record, SHIP.with_tied(vK_i=("vK_p", ratio)))
    for name in FREE:
        assert moved(tied, alone, name) < 0.1, name
        assert widths(tied, alone, name) < 1.05, name
    assert tied.settings["criterion"] == pytest.approx(alone.settings["criterion"], abs=1.0)
    assert (tied.usability, tied.verdict[0]) == (alone.usability, alone.verdict[0])


def test_a_record_of_its_own_parameters_beside_it_moves_nothing(record, alone):
    beside = replace(noisy_record(CHIRP, 0.01, 0.0, 4), name="two")
    both = identify([record, beside], Structure.joint({"one": SHIP, "two": SHIP}, shared=[]))
    for name in FREE:
        # A gauge's error is the same in both records, so the other one tells a little of it.
        assert moved(both, alone, name, " (one)") < 0.6, name
        assert widths(both, alone, name, " (one)") == pytest.approx(1.0, abs=0.1), name
    assert both.usability == alone.usability


def test_a_profile_ends_where_the_interval_does(record, alone):
    for profile in profile_likelihood(record, SHIP, list(FREE)):
        low, high = alone[profile.name].ci95
        assert profile.interval == pytest.approx((low, high), abs=0.05 * (high - low)), profile.name


def test_a_ship_whose_structure_is_found_answers_as_where_it_is_given(record, alone):
    delays = {"T_d": 0.0, "T_set": 0.0, "T_s": 0.0, "tau_act": 0.0, "T_f": 0.0, "c_2": 0.0, "T_M": 0.0}
    absent = dict.fromkeys(("torque_limit", "rack_rate", "twist"), False)
    found = identify(record, fixed=delays, elements=absent)
    for name in FREE:
        assert moved(found, alone, name) < 0.1, name
        assert widths(found, alone, name) == pytest.approx(1.0, abs=0.05), name
    assert found.settings["criterion"] == pytest.approx(alone.settings["criterion"], abs=1.0)
    assert found.verdict[0] == alone.verdict[0]
