"""Residual tests: as many false alarms as they say, and an alarm where the structure lacks something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from shipfp_rs import signals
from shipfp_rs.identification.fingerprint import Fingerprint, Identifiability
from shipfp_rs.identification.identify import identify
from shipfp_rs.identification.residual_tests import OutputTests, ResidualTest, whiteness
from shipfp_rs.identification.verdict import Told, with_verdict
from shipfp_rs.structures.structure import Structure
from tests.launch import LAUNCH, noise, noisy_record

EXCITATION = signals.chirp(0.05, 5.0, 30.0, 13.0, rate_hz=50.0)
STRUCTURE = Structure.linear(products=True)


def alarms(fingerprint):
    return [line for line in fingerprint.verdict if "contradict" in line or "correlated" in line]


def test_a_fit_of_the_right_structure_alarms_no_more_often_than_it_says():
    draws, probabilities, alarmed = 30, [], 0
    for draw in range(draws):
        correlation = (0.0, 0.9, 0.99)[draw % 3]
        record = noisy_record(EXCITATION, 0.05, correlation, [1, draw])
        fingerprint = identify(record, STRUCTURE, intervals="symmetric")
        alarmed += bool(alarms(fingerprint))
        probabilities.append([fingerprint.fit[output]["input_correlation_p"] for output in ("dn", "dM")])
    assert alarmed <= 0.05 * draws
    # Chance spreads p evenly from 0 to 1.
    assert kstest(np.ravel(probabilities), "uniform").pvalue > 0.01


@pytest.mark.parametrize("missing", [{"T_d": 0.03}, {"T_set": 0.03}])
def test_a_missing_dead_time_is_noticed_and_once_declared_no_more(missing):
    experiment = noisy_record(EXCITATION, 0.05, 0.9, 5, replace(LAUNCH, **missing))
    without = identify(experiment, STRUCTURE)
    assert without.fit["dM"]["input_correlation_p"] < 1e-6
    assert any("Dynamics are missing" in line for line in alarms(without))
    dead_time = {"dead_time_loop": "T_d" in missing, "dead_time_set_point": "T_set" in missing}
    whole = identify(experiment, Structure.linear(products=True, **dead_time))
    assert not alarms(whole)


def test_coloured_noise_taken_for_white_is_noticed_and_not_blamed_on_the_structure():
    fingerprint = identify(noisy_record(EXCITATION, 0.05, 0.9, 5), STRUCTURE, noise="white")
    (line,) = alarms(fingerprint)
    assert line.startswith("The noise is not what was assumed: whitened residuals are still correlated in dn")


def outside(test):
    return np.mean(np.abs(test["correlation"]) > test["band"])


def test_the_correlogram_shows_what_the_tests_say():
    """One lag in twenty outside the band by chance (24 draws, 25 lags), most of them where noise was taken for white."""
    white = [
        identify(noisy_record(EXCITATION, 0.05, 0.0, [2, k]), STRUCTURE, noise="white", intervals="symmetric")
        for k in range(24)
    ]
    # The noise beside a set point's lag is told from residuals nearby, so that its band is a little too narrow.
    for kind, apart in (("autocorrelation", 0.02), ("set_point", 0.05)):
        shares = [outside(found.residuals[output][kind]) for found in white for output in ("dn", "dM")]
        assert np.mean(shares) == pytest.approx(0.05, abs=apart)
    coloured = identify(noisy_record(EXCITATION, 0.05, 0.9, 5), STRUCTURE, noise="white").residuals["dn"]
    assert outside(coloured["autocorrelation"]) > 0.5
    # The first-order noise's own correlation, 0.9 to the power of the lag.
    assert coloured["autocorrelation"]["correlation"][:3] == pytest.approx([0.9, 0.81, 0.729], abs=0.05)
    late = identify(
        noisy_record(EXCITATION, 0.05, 0.0, 5, replace(LAUNCH, T_set=0.06)), STRUCTURE, noise="white"
    )
    followed = late.residuals["dM"]["set_point"]
    assert outside(followed) > 0.3
    assert followed["lags"][0] == 0


def test_whiteness_is_the_statistic_of_ljung_and_box():
    values = noise((1, 400), 0.3, 2)[0]
    centred = values - values.mean()
    correlation = [np.sum(centred[k:] * centred[:-k]) / np.sum(centred**2) for k in range(1, 11)]
    expected = 400 * 402 * sum(r**2 / (400 - k) for k, r in enumerate(correlation, 1))
    test = whiteness([(values, np.ones(400, dtype=bool))], fitted=2, lags=10)
    # Over gaps each lag counts the pairs it has, so its weight is N/(N - k) of the formula's.
    assert test.statistic == pytest.approx(expected, rel=0.05)
    assert test.freedom == 8
    assert test.p == pytest.approx(chi2.sf(test.statistic, 8))


def test_whiteness_leaves_gaps_out():
    values = noise((1, 5000), 0.0, 3)[0]
    valid = np.ones(5000, dtype=bool)
    valid[1000:2000] = valid[::7] = False
    holed = np.where(valid, values, np.nan)
    assert whiteness([(np.where(valid, holed, 0.0), valid)]).p > 0.01
    assert whiteness([(values, valid)]).p == whiteness([(np.where(valid, holed, 0.0), valid)]).p


def test_without_excitation_there_is_nothing_to_correlate_with():
    still = replace(EXCITATION, samples=np.zeros_like(EXCITATION.samples))
    experiment = noisy_record(EXCITATION, 0.05, 0.0, 1)
    experiment = replace(experiment, signals={**experiment.signals, "n_set": 1300.0 + still.samples})
    fingerprint = identify(experiment, STRUCTURE.with_fixed(tau_n=1.5, g=-0.5, vK_i=1.5))
    assert fingerprint.fit["dn"]["input_correlation_p"] is None


def test_a_record_too_short_for_the_test_is_said_and_tunes_no_governor():
    """Without a test nothing shows whether the structure is right, so no gain is called known."""
    short = noisy_record(signals.chirp(0.3, 5.0, 0.6, 0.1, rate_hz=50.0), 0.01, 0.0, 3)
    found = identify(short, STRUCTURE, noise="white", intervals="symmetric")
    assert "structure_p" not in found.fit["overall"]
    assert found.usability in ("usable except", "not usable")
    assert not any(line.startswith("Known: ") for line in found.verdict)
    if found.usability == "usable except":
        assert "too short for a test of its residuals" in found.verdict[0]


def test_what_the_set_point_explains_of_residuals_is_a_share_of_all_of_them():
    lags = np.arange(13)
    some = OutputTests(ResidualTest(lags, np.zeros(13), np.ones(13), 987.0, 13), None, 1000)
    assert some.figures()["input_explained_pct"] == pytest.approx(50.0)
    most = OutputTests(ResidualTest(lags, np.zeros(13), np.ones(13), 1e5, 13), None, 1000)
    assert 98.0 < most.figures()["input_explained_pct"] < 100.0


def test_residuals_that_follow_by_a_trifle_are_said_to():
    row = {"nrmse_pct": 99.98, "input_correlation_p": 3e-110, "input_explained_pct": 99.0}
    fit = {"dn": row, "dM": {"nrmse_pct": 99.9, "input_correlation_p": 0.5}}
    found = Fingerprint({}, {}, Identifiability(0, 0, 1.0), fit, STRUCTURE.to_dict())
    line = with_verdict(Told(found, (), contradicted=True)).verdict[-1]
    assert line == "The residuals follow the set point in dn, by less than 0.1 % of it: too little to matter."
