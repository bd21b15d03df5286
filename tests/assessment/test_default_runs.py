"""Trials of one tug, identified with nothing given: what changed between them, and what the search chose itself."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from shipfp_rs import cli, signals
from shipfp_rs.assessment import comparable
from shipfp_rs.assessment.comparison import compare
from shipfp_rs.assessment.validation import validate
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.parquet import write_experiments
from shipfp_rs.identification.estimate import ALONG, Estimate
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.simulation.simulate import Inflow, disturbed, simulate
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.vessel import Vessel

TUG = Vessel.load("stan-tug-1205").replace(
    {
        "governor.set_point_dead_time_s": 0.15,
        "actuator.dead_time_s": 0.06,
        "actuator.lag_s": 0.03,
    }
)
ADDED = 0.28 * TUG.shaft.propeller_side_inertia_kg_m2
MENDED = TUG.replace(
    {
        "shaft.propeller_side_inertia_kg_m2": TUG.shaft.propeller_side_inertia_kg_m2 + ADDED,
        "shaft.inertia_kg_m2": TUG.shaft.inertia_kg_m2 + ADDED,
    }
)
LIMITED = TUG.replace({"engine.envelope": {"speed_rpm": [600.0, 1800.0], "torque_Nm": [520.0, 520.0]}})
SHIPS = {"tug": TUG, "mended": MENDED, "limited": LIMITED}


@cache
def trial(
    seed: int, ship: str = "tug", *, moving: bool = False, rack: bool = False, rate_hz: float = 50.0
) -> Fingerprint:
    """Of one simulated trial with a gauge on the shaft, in still or moving water."""
    chirp = signals.chirp(0.02, 1.5, 120.0, 40.0, rate_hz=rate_hz)
    record = simulate(SHIPS[ship], chirp, noise={"n_e": 0.02, "M_g": 0.04}, seed=seed)
    if moving:
        record = disturbed(record, linearise(SHIPS[ship]), Inflow(), seed)
    names = ("n_set", "n_e", "M_g", *(("X_f",) if rack else ()))
    others = {"rack_rate": False, "twist": False} if ship == "limited" else None
    return identify(replace(record, signals={name: record.signals[name] for name in names}), elements=others)


@pytest.fixture(scope="module")
def first() -> Fingerprint:
    return trial(1)


@pytest.fixture(scope="module")
def mended() -> Fingerprint:
    return trial(3, "mended")


@pytest.fixture(scope="module", params=["written", pytest.param("fitted", marks=pytest.mark.slow)])
def limited(request) -> Fingerprint:
    """Of a trial that shows a limit: one written into another fingerprint, at night one that a fit has found."""
    if request.param == "fitted":
        return trial(520, "limited", rate_hz=20.0)
    found = trial(2)
    limits = {"M_max": Estimate(1.12, 0.01, (1.1, 1.14), "-", "free"), "M_soft": Estimate(5e-3, unit="-")}
    row = {"state": "on", "evidence": 300.0, "limit": None, "words": ELEMENTS["torque_limit"].words}
    return replace(
        found,
        parameters={**found.parameters, **limits},
        elements={**found.elements, "torque_limit": row},
        settings={**found.settings, "optimum": {**found.optimum, "M_max": 1.12, "M_soft": 5e-3}},
    )


@pytest.mark.parametrize(
    "moving", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["still water", "another sea"]
)
def test_the_same_ship_again_shows_no_change(first, moving):
    again = trial(5, moving=moving)
    assert first["T_s"].value != again["T_s"].value
    same = compare(first, again)
    assert not any(change.significant for change in same.changes)
    assert "No change beyond" in same.verdict[0]


@pytest.mark.slow
def test_what_differs_along_a_valley_of_delays_is_no_change():
    # Lag, dead times and a governor's hold trade for each other: each trial ends elsewhere in one bent valley.
    found = [trial(seed) for seed in range(102, 107)]
    alarms = [compare(one, other).joint.p < 0.05 for one, other in combinations(found, 2)]
    assert sum(alarms) <= 2  # of 10


def test_a_heavier_propeller_after_a_repair_is_found(first, mended):
    changed = compare(first, mended)
    assert [change.name for change in changed.changes if change.significant] == ["tau_prop"]
    assert changed["tau_prop"].change_pct == pytest.approx(28.0, abs=2.0)
    assert changed.joint.p < 1e-6


def test_a_default_run_explains_another_trial_of_the_ship_better_than_one_after_a_repair(first, mended):
    own, other = (validate(first, one.experiments[0]) for one in (trial(2), mended))
    for output in ("dn", "dM"):
        assert own[output] > 95.0
        assert own[output] > other[output] + 1.0


def test_a_limit_that_one_trial_shows_is_told_and_the_rest_compared(first, limited, tmp_path, capsys):
    assert limited.elements["torque_limit"]["state"] == "on"
    files = [str(one.save(tmp_path / f"{name}.json")) for name, one in (("A", first), ("B", limited))]
    assert cli.main(["compare", *files, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert not any(change["significant"] for change in told["changes"])
    assert "known in the second fingerprint alone, so not compared: M_max" in told["remarks"]
    assert any("1 of 2 fingerprints have no upper torque limit" in line for line in told["remarks"])


def test_a_limit_that_the_search_left_undecided_is_no_obstacle(first, limited):
    along = {name: replace(limited[name], status="fixed", reason=ALONG) for name in ("M_max", "M_soft")}
    undecided = replace(
        limited,
        parameters={**limited.parameters, **along},
        elements={**limited.elements, "torque_limit": {**limited.elements["torque_limit"], "state": "open"}},
    )
    for pair in ((first, undecided), (undecided, first)):
        assert not any(change.significant for change in compare(*pair).changes)


def test_a_fingerprint_without_the_limit_is_fitted_again_with_the_experiments_it_holds(
    first, limited, monkeypatch
):
    asked = []

    def again(experiments, **options):
        asked.append((experiments, options["fixed"]))
        return limited

    monkeypatch.setattr(comparable, "identify", again)
    compare(first, limited)
    assert asked == [(first.experiments, {})]


def test_a_rack_that_one_trial_recorded_leaves_the_rest_to_compare(first):
    found = compare(first, trial(4, rack=True))
    assert not any(change.significant for change in found.changes)
    assert any(
        line.startswith("known in the second fingerprint alone") and " v" in line for line in found.remarks
    )
    assert {"tau_prop", "vK_p", "vK_i"} <= {change.name for change in found.changes}


def test_gains_of_a_governor_whose_rack_was_recorded_are_compared():
    found = compare(trial(4, rack=True), trial(6, rack=True))
    assert not any(change.significant for change in found.changes)
    assert {"v", "K_p", "K_i", "K_p/K_i"} <= {change.name for change in found.changes}
    assert found.joint.freedom > 5


def test_gains_of_a_governor_whose_rack_was_recorded_have_covariances():
    recorded = trial(1, rack=True)
    names, matrix = recorded.covariance["names"], np.array(recorded.covariance["matrix"])
    assert {"K_p", "K_i", "v"} <= set(names)
    for name, variance in zip(names, matrix.diagonal(), strict=True):
        assert variance == pytest.approx(recorded[name].std ** 2)
    # With every parameter known, the condition is that of the scaled covariance.
    assert 1.0 < recorded.identifiability.condition < np.inf


def test_trials_without_a_torque_are_compared_with_each_other_alone(first):
    record = first.experiments[0]
    bare = [identify(one, outputs=["dn"]) for one in (record, trial(2).experiments[0])]
    assert not any(change.significant for change in compare(*bare).changes)
    with pytest.raises(InputError, match="identify both logs with the same outputs"):
        compare(first, bare[0])


def test_what_somebody_gave_is_still_the_same_in_both_or_refused(first):
    record = first.experiments[0]
    held = identify(record, fixed={"T_d": 0.05})
    with pytest.raises(InputError, match=r"T_d was estimated in the first fingerprint and given as 0\.05"):
        compare(first, held)
    late = identify(record, elements={"late_speed": True}, fixed={"T_n": 0.01})
    with pytest.raises(InputError, match=r"T_n was left out in the first fingerprint and given as 0\.01"):
        compare(first, late)


@pytest.mark.parametrize(
    "damage", [{"tau_n": None}, {"T_d": float("nan")}, None], ids=["lacks", "nan", "null"]
)
def test_a_damaged_list_of_possible_ships_is_named(first, damage):
    ship = damage and ({**first.optimum, **damage} if "T_d" in damage else damage)
    with pytest.raises(InputError, match=r"settings\.possible"):
        compare(first, replace(first, settings={**first.settings, "possible": [ship]}))


def test_the_experiments_beside_the_files_fit_the_limit_again(first, limited, tmp_path, monkeypatch, capsys):
    files = []
    for name, one in (("A", first), ("B", limited)):
        (tmp_path / name).mkdir()
        files.append(str(one.save(tmp_path / name / "fingerprint.json")))
        write_experiments(tmp_path / name / "experiments.parquet", one.experiments)
    monkeypatch.setattr(comparable, "identify", lambda experiments, **options: limited)
    assert cli.main(["compare", *files, "--json"]) == 0
    assert any("fitted again" in line for line in json.loads(capsys.readouterr().out)["remarks"])
