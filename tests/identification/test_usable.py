"""The first sentence of a verdict: what a fingerprint can be used for, and when it is good for nothing."""

from __future__ import annotations

from dataclasses import asdict, replace
from types import SimpleNamespace

import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.si import doubts, in_si
from shipfp_rs.identification.adequacy import LARGE_MISS_PCT, LEAST_EXPLAINED_PCT, misses_of, stands
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint, Identifiability
from shipfp_rs.identification.stretches import Score
from shipfp_rs.identification.verdict import Told, element_rows
from shipfp_rs.identification.verdict import with_verdict as judged
from shipfp_rs.identification.wording import missed
from shipfp_rs.structures.ties import true_values

NOT_FOR_TUNING = "Usable for simulation and comparison, but not for control tuning: "
LOST = Estimate(None, unit="s", status="unidentifiable")


def with_verdict(fingerprint, **case):
    return judged(Told(fingerprint, (), **case))


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
        adequate={"stands": True, "misses_pct": {"dn": 0.1, "dM": 0.2}},
    )


def test_a_good_fit_is_usable_for_all(found) -> None:
    told = with_verdict(found)
    assert told.usable.endswith("comparison: the data determine every parameter.")
    assert (told.usability, told.why_not) == ("usable", "")


def test_a_model_that_explains_nothing_of_the_torque_is_not_usable(found) -> None:
    fit = {**found.fit, "dM": {"nrmse_pct": 0.5 * LEAST_EXPLAINED_PCT}}
    told = with_verdict(replace(found, fit=fit))
    assert told.usable == "Not usable, because the model explains nothing of the torque."
    assert (told.usability, told.why_not) == ("not usable", "nothing explained")
    fit["dM"] = {"nrmse_pct": 2.0 * LEAST_EXPLAINED_PCT}  # much noise is no contradiction
    assert with_verdict(replace(found, fit=fit)).usable.startswith("Usable")


def test_a_search_that_ended_in_no_minimum_is_not_usable(found) -> None:
    told = with_verdict(replace(found, settings={"converged": False}))
    assert told.usable == "Not usable, because the search did not end in a minimum; no figure is an estimate."
    assert (told.usability, told.why_not) == ("not usable", "no minimum")


def test_a_load_told_alone_has_the_share_that_the_statistics_have(found) -> None:
    fields = {
        "adequate": {**found.adequate, "stands": False, "misses_pct": {"dn": 15.2, "dM": 3.0}},
        "load_side": {"p": LOST},
    }
    told = with_verdict(replace(found, **fields), kind="misfit")
    assert "(the model misses 15 % of the drive train's response)" in told.usable
    assert "15 % of the speed" in missed(told.adequate)


def test_what_is_called_not_determined_is_not_listed_as_known(found) -> None:
    open_too = {
        **found.parameters,
        "g": Estimate(-0.5, 1.5, (-3.5, 2.5)),
        "T_s": Estimate(0.28, 0.02, (0.24, 0.32)),
    }
    told = with_verdict(replace(found, parameters=open_too))
    assert "do not determine g" in told.usable
    lines = {line.partition(":")[0]: line for line in told.verdict}
    assert "g = " not in lines["Known"]
    assert "T_s = 0.280 (0.240 to 0.320)" in lines["Known"]
    assert lines["Estimated, but hardly known"].startswith("Estimated, but hardly known: g = -0.5")


@pytest.mark.parametrize(("fall", "state"), [(4550.0, "open"), (3.0, "off")])
def test_a_limit_that_the_data_show_is_not_called_absent(fall: float, state: str) -> None:
    question = SimpleNamespace(tried=("rack_rate",), loaded=False, experiments=())
    fit = SimpleNamespace(
        question=question,
        along=frozenset(),
        elements=(),
        gains={"rack_rate": 9e3},
        scores={"rack_rate": Score(fall, 0.0, 0.0, 0.0)},
    )
    row = element_rows(fit, {})["rack_rate"]
    assert (row["state"], row["evidence"]) == (state, fall)


def test_a_model_that_misses_much_and_data_that_tell_nothing_are_not_usable(found) -> None:
    misses = {"stands": False, "misses_pct": {"dn": 1.1 * LARGE_MISS_PCT}}
    told = with_verdict(replace(found, adequate=misses))
    assert told.usable.startswith("Not usable, because the model misses 11 %")
    assert (told.usability, told.why_not) == ("not usable", "misfit")
    told = with_verdict(replace(found, parameters=dict.fromkeys(found.parameters, LOST)))
    assert told.usable == "Not usable, because the data determine no parameter."
    assert (told.usability, told.why_not) == ("not usable", "nothing told")


def test_the_state_is_written_and_read_and_no_other_word_is_taken_for_one(found, tmp_path) -> None:
    lost = {**found.parameters, "tau_n": LOST}
    path = with_verdict(replace(found, parameters=lost)).save(tmp_path / "fingerprint.json")
    assert Fingerprint.load(path).usability == "usable except"
    path.write_text(path.read_text().replace('"usable except"', '"perhaps"'))
    with pytest.raises(fp.InputError, match="usability: found 'perhaps', expected '', 'usable'"):
        Fingerprint.load(path)


def test_a_deviation_without_a_value_is_refused(found, tmp_path) -> None:
    path = found.save(tmp_path / "fingerprint.json")
    path.write_text(path.read_text().replace('"value": 1.5', '"value": null'))
    with pytest.raises(fp.InputError, match=r"parameters\.tau_n\.value: found None, expected a number"):
        Fingerprint.load(path)


def test_what_is_told_roughly_or_not_at_all_is_named(found) -> None:
    rough = {**found.parameters, "tau_n": Estimate(1.5, 0.2, (1.1, 1.9), "s")}
    assert with_verdict(replace(found, parameters=rough)).usable.endswith(
        "every parameter, but tau_n only roughly."
    )
    told = with_verdict(replace(found, parameters={**found.parameters, "tau_n": LOST}))
    assert told.usable == (
        NOT_FOR_TUNING + "the data do not determine tau_n, for which other values fit as well."
    )
    assert (told.usability, told.why_not) == ("usable except", "")
    wide = {**found.parameters, "tau_n": Estimate(0.24, 4.0, (0.01, 8.2), "s")}
    assert with_verdict(replace(found, parameters=wide)).usable == told.usable
    rough = {**found.parameters, "tau_n": LOST, "vK_p": Estimate(15.8, 4.0, (8.0, 24.0), "-")}
    assert (
        "determine tau_n, for which other values fit as well, and give vK_p only"
        in with_verdict(replace(found, parameters=rough)).usable
    )


@pytest.mark.parametrize(
    ("low", "high", "tunes"),
    [(12.0, 23.0, True), (11.5, 16.0, False), (15.0, 24.0, False), (-1.0, 40.0, False)],
)
def test_gains_that_may_be_off_by_a_third_tune_nothing(found, low: float, high: float, tunes: bool) -> None:
    gain = Estimate(15.8, 0.25 * (high - low), (low, high), "-")
    told = with_verdict(replace(found, parameters={**found.parameters, "vK_p": gain}))
    assert ("simulation, control tuning" in told.usable) is tunes
    assert (told.usability == "usable") is tunes
    assert tunes or told.usable.endswith("not for control tuning: vK_p may be off by more than a third.")


def test_a_torque_limit_in_si_is_the_engine_s(found) -> None:
    limit = in_si(found, fp.Vessel.load("stan-launch-804"))["torque_limit"]
    assert limit["value"] == pytest.approx(2.0 * 222.93)


@pytest.mark.parametrize("point", ["", "[operating_point]\nn_e_rpm = 1243.0\nM_s_Nm = 800.0\n"])
def test_a_vessel_file_with_the_gear_ratio_alone_gives_figures_in_si_and_says_so(
    found, tmp_path, point
) -> None:
    file = tmp_path / "vessel.toml"
    file.write_text(f'name = "Boat"\n[gearbox]\nratio = 3.82\n{point}', encoding="utf-8")
    boat, known = fp.Vessel.load(file), fp.Vessel.load("stan-launch-804")
    assert in_si(found, boat).keys() == in_si(found, known).keys()
    assert in_si(found, boat)["torque_limit"]["value"] == pytest.approx(2.0 * 222.93)
    assert [line for line in doubts(found, boat) if "lacks gearbox.efficiency" in line]
    assert not [line for line in doubts(found, known) if "lacks" in line]


def test_a_trial_without_torque_is_usable_but_for_what_only_a_torque_tells() -> None:
    tug = fp.Vessel.load("stan-tug-1205")
    chirp = fp.signals.chirp(0.02, 2.0, 120.0, 30.0, rate_hz=25.0, name="chirp")
    trial = fp.simulate(tug, chirp, noise={"n_e": 0.1}, seed=1)
    signals = {name: trial.signals[name] for name in ("n_set", "n_e")}
    found = fp.identify(replace(trial, signals=signals), vessel=tug.name)
    assert found.settings["converged"]
    assert found.usability == "usable except"
    truth = true_values(asdict(fp.linearise(tug)))
    for name in ("(p-g)/tau_n", "vK_p/tau_n", "vK_i/tau_n"):
        low, high = found.derived[name].ci95
        assert low < truth[name] < high


def test_a_given_structure_is_judged_too(found) -> None:
    tested = {"input_correlation_p": 1e-9, "input_explained_pct": 20.0, "nrmse_pct": 90.0}
    fit = {"dn": tested, "dM": tested, "overall": {"structure_p": 1e-9}}

    def told(fit) -> Fingerprint:
        misses = misses_of(fit, 5000)
        adequate = {"stands": stands(misses, fit["overall"]["structure_p"]), "misses_pct": misses}
        return with_verdict(replace(found, fit=fit, adequate=adequate))

    bent = told(fit)
    assert bent.usable == NOT_FOR_TUNING + (
        "its intervals hold for the model, not for the drive train, of whose response the model misses 4.4 %."
    )
    assert (bent.usability, bent.adequate["stands"]) == ("usable except", False)
    assert bent.verdict[0] == bent.usable
    assert told({**fit, "overall": {"structure_p": 0.3}}).usability == "usable"
    assert told({**fit, "dn": {**tested, "nrmse_pct": 60.0}}).why_not == "misfit"
