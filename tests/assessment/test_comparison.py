"""Two fingerprints of one ship: what changed, what did not, and what can't be compared.

`pytest -m study -k pairs -s` prints how often no change raises an alarm and a change of inertia is found.
"""

from __future__ import annotations

import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from scipy.stats import binom

from shipfp_rs import cli, signals
from shipfp_rs.assessment import comparable
from shipfp_rs.assessment.comparison import compare, covariance_of, trend
from shipfp_rs.assessment.si import response_with_deviation, step_with_deviation
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import foresee, identify
from shipfp_rs.plot.estimates import draw
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.vessel import Vessel
from tests.launch import noise

TUG = linearise(Vessel.load("stan-tug-1205"))
STRUCTURE = Structure.linear(torque="gauge", products=True, free_exponent=True)
CHIRP = signals.chirp(0.01, 1.5, 240.0, 40.0, rate_hz=50.0)
POINT = {"n_set": 1183.8, "n_e": 1183.8, "M_g": 1725.0}
NOISE, COLOUR = np.array([[2.4e-4], [1.2e-2]]), 0.58
"""What `shipfp demo` leaves over of speed and torque, relative to the operating point, and its speed's correlation."""
SHORT = signals.chirp(0.02, 1.5, 60.0, 40.0, rate_hz=25.0)


def fingerprint(
    seed, *, inertia: float = 1.0, excitation=CHIRP, structure=STRUCTURE, **settings
) -> Fingerprint:
    """Of one simulated trial of the tug with the demo's noise, all its inertias times a factor."""
    truth = {
        "tau_n": TUG.tau_n * inertia,
        "g": TUG.g,
        "vK_p": TUG.v * TUG.K_p,
        "vK_i": TUG.v * TUG.K_i,
        "p": TUG.p,
        "tau_prop": TUG.tau_prop * inertia,
    }
    set_point = {"n_set": POINT["n_set"] + excitation.samples}
    bare = Experiment("trial", excitation.rate_hz, set_point, POINT, hold=excitation.hold)
    clean = STRUCTURE.equations.simulate(truth, bare)
    dn, dM = clean + NOISE * noise(clean.shape, COLOUR, seed)
    measured = {"n_e": POINT["n_e"] * (1.0 + dn), "M_g": POINT["M_g"] * (1.0 + dM)}
    options = {"intervals": "symmetric", **settings}
    return identify(replace(bare, signals=set_point | measured), structure, vessel="stan-tug-1205", **options)


def _pair(job: tuple[int, float]) -> tuple[bool, bool]:
    draw, inertia = job
    found = compare(fingerprint([draw, 1]), fingerprint([draw, 2], inertia=inertia))
    return found.joint.p < found.level, any(change.significant for change in found.changes)


@pytest.mark.study
def test_pairs_without_a_change_alarm_as_seldom_as_the_level_says(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    pairs = 400
    jobs = [(draw, inertia) for inertia in (1.0, 1.1) for draw in range(pairs)]
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        results = []
        for result in pool.map(_pair, jobs, chunksize=5):
            results.append(result)
            if sys.stderr.isatty():
                print(f"\r{len(results)} of {len(jobs)} pairs", end="", file=sys.stderr)
    alarms = np.array(results).reshape(2, pairs, 2).mean(axis=1)
    print(f"\nShare of {pairs} pairs with an alarm at a level of 5 % [%]")
    print("pairs                   joint test   any quantity (Holm)")
    for label, row in zip(("no change", "inertia up by 10 %"), alarms, strict=True):
        print(f"{label:22}{100 * row[0]:11.2f}{100 * row[1]:21.2f}")
    assert 0.03 <= alarms[0, 0] <= 0.07
    assert alarms[0, 1] <= 0.07
    assert alarms[1].min() >= 0.90


@pytest.fixture(scope="module")
def pair() -> tuple[Fingerprint, Fingerprint]:
    return fingerprint(1), fingerprint(2)


@pytest.fixture(scope="module")
def heavier() -> Fingerprint:
    return fingerprint(2, inertia=1.1)


def test_a_few_pairs_without_a_change_raise_few_alarms():
    alarms = sum(_short_pair(draw, 1.0) < 0.05 for draw in range(8))
    assert alarms <= binom.ppf(0.999, 8, 0.07)


def _short_pair(draw: int, inertia: float) -> float:
    return compare(
        fingerprint([draw, 3], excitation=SHORT), fingerprint([draw, 4], inertia=inertia, excitation=SHORT)
    ).joint.p


def test_ten_per_cent_more_inertia_is_found_and_named(pair, heavier):
    changed = compare(pair[0], heavier)
    assert changed.joint.p < 1e-6
    assert changed["tau_prop"].significant
    low, high = changed["tau_prop"].ci95
    assert low < 0.1 * TUG.tau_prop < high
    # Each trial tells it to 1.4 per cent, the change to two.
    assert changed["tau_prop"].change_pct == pytest.approx(10.0, abs=4.0)
    assert not changed["p"].significant
    assert any("tau_prop changed by" in line for line in changed.verdict)


def test_nothing_changed_is_said_with_what_could_have_been_seen(pair):
    same = compare(*pair)
    assert not any(change.significant for change in same.changes)
    assert "No change beyond" in same.verdict[0]
    assert "could not have been distinguished from chance" in same.verdict[1]
    # Combinations that repeat each other count once: five directions, not six quantities.
    assert same.joint.freedom == 5 < len(same.changes)


def test_a_fingerprint_does_not_differ_from_itself(pair):
    same = compare(pair[0], pair[0])
    assert same.joint.statistic == 0.0
    assert all(change.change == 0.0 and change.p == 1.0 for change in same.changes)


def test_deviations_of_combinations_are_those_of_their_intervals(pair):
    names = ["p", "tau_prop", "vK_p/tau_n"]
    deviations = np.sqrt(np.diag(covariance_of(pair[0], names)))
    assert deviations == pytest.approx([pair[0][name].std for name in names], rel=1e-9)
    with pytest.raises(InputError, match="no standard deviation"):
        covariance_of(pair[0], ["tau_n"])


def test_what_is_not_comparable_is_refused_and_says_why(pair):
    one, other = pair
    refusals = {
        "same ship": replace(other, vessel="stan-launch-804"),
        "differ in torque": replace(other, structure={**other.structure, "torque": "brake"}),
        "fingerprint found no minimum": replace(other, settings={**other.settings, "converged": False}),
        "operating points differ": replace(
            other, data=({**other.data[0], "operating_point": {**POINT, "n_set": 1300.0}},)
        ),
        "given as 1.172 in the second": fingerprint(2, structure=STRUCTURE.with_fixed(tau_n=1.172)),
    }
    for reason, second in refusals.items():
        with pytest.raises(InputError, match=reason):
            compare(one, second)
    with pytest.raises(InputError, match="between 0 and 1"):
        compare(one, other, level=5.0)
    heavier = replace(other, data=({**other.data[0], "operating_point": {**POINT, "M_g": 1900.0}},))
    assert "operating torques differ" in compare(one, heavier).remarks[0]


def test_a_trend_over_years_is_found_and_none_where_there_is_none():
    years = {
        2020.0 + year: fingerprint(year, inertia=1.0 + 0.05 * year, excitation=SHORT) for year in range(5)
    }
    slope, std, p = trend(years, "tau_prop")
    assert abs(slope - 0.05 * TUG.tau_prop) < 4 * std
    assert p < 0.01
    still = {year: fingerprint(7 + year, excitation=SHORT) for year in range(5)}
    assert trend(still, "tau_prop")[2] > 0.001
    with pytest.raises(InputError, match="three or more"):
        trend({2020.0: years[2020.0]}, "tau_prop")
    with pytest.raises(InputError, match="'tau_n' is not known"):
        trend(years, "tau_n")


def test_bands_of_the_responses_hold_the_true_ones(pair):
    found = pair[0]
    truth = dict(found.settings["optimum"]) | {
        "tau_n": TUG.tau_n, "g": TUG.g, "vK_p": TUG.v * TUG.K_p, "vK_i": TUG.v * TUG.K_i,
        "p": TUG.p, "tau_prop": TUG.tau_prop,
    }  # fmt: skip
    frequency = np.geomspace(0.02, 1.5, 20)
    true, _ = STRUCTURE.equations.response(truth, frequency, ())
    bands = response_with_deviation(found, frequency)
    for output, row in zip(STRUCTURE.outputs, true, strict=True):
        ratio = bands.response[output] / row
        assert (np.abs(np.log(np.abs(ratio))) < 4 * bands.amplitude_std[output]).all()
        assert (np.abs(np.angle(ratio)) < 4 * bands.phase_std[output]).all()
    step = step_with_deviation(found)
    # After the transient a step of the set point is a step of the speed, known without any parameter.
    assert step.mean["dn"][-1] == pytest.approx(1.0, abs=1e-3)
    assert step.std["dn"][-1] < 1e-4
    assert step.std["dn"][step.time < 0.0].max() == 0.0


def test_the_command_prints_and_draws_what_changed(pair, heavier, tmp_path, capsys):
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    pair[0].save(before)
    heavier.save(after)
    picture = tmp_path / "change.png"
    assert cli.main(["compare", str(before), str(after), "--out", str(picture)]) == 0
    shown = capsys.readouterr().out
    assert "tau_prop changed by" in shown
    assert "1/s²" in shown
    assert "1/s2" not in shown
    assert picture.stat().st_size > 10_000
    assert cli.main(["compare", str(before), str(after), "--json"]) == 0
    assert {change["name"] for change in json.loads(capsys.readouterr().out)["changes"]} >= {"p", "tau_prop"}
    assert cli.main(["compare", str(before), str(tmp_path / "none.json")]) == 2
    assert "none.json" in capsys.readouterr().err
    with pytest.raises(InputError, match="expected 1 to"):
        draw({})


def of_the_full_ship(seed: int, elements: dict[str, bool]) -> Fingerprint:
    """What a trial of the tug is expected to tell, with an engine that reaches its limit if that is said to act."""
    truth = {
        "tau_n": TUG.tau_n, "g": TUG.g, "vK_p": TUG.v * TUG.K_p, "vK_i": TUG.v * TUG.K_i, "p": TUG.p, "M_max": 1.15
    }  # fmt: skip
    bare = Experiment("trial", 25.0, {"n_set": POINT["n_set"] + 2.0 * SHORT.samples}, POINT, hold=SHORT.hold)
    plant = Structure.ship(["torque_limit"])
    clean = plant.equations.simulate({**truth, "M_soft": 3e-3}, bare)
    dn, dM = clean + NOISE * noise(clean.shape, COLOUR, seed)
    measured = {"n_e": POINT["n_e"] * (1.0 + dn), "M_b": 1725.0 * (1.0 + dM)}
    point = {**POINT, "M_b": 1725.0}
    record = replace(bare, signals={**bare.signals, **measured}, operating_point=point)
    return foresee([record], values=truth, elements=elements)


def test_ships_of_which_one_shows_a_limit_are_compared_with_it(monkeypatch):
    bent, straight = (
        of_the_full_ship(seed, {"torque_limit": acts}) for seed, acts in ((1, True), (2, False))
    )
    assert bent.elements["torque_limit"]["state"] == "on"
    apart = compare(*(replace(one, experiments=()) for one in (bent, straight)))
    assert any("1 of 2 fingerprints have no upper torque limit" in line for line in apart.remarks)
    assert "M_max" not in {change.name for change in apart.changes}
    asked = []

    def again(experiments, **options):
        asked.append(options["elements"])
        return of_the_full_ship(2, {"torque_limit": True})

    monkeypatch.setattr(comparable, "identify", again)
    found = compare(bent, straight)
    assert asked == [{"torque_limit": True, "rack_rate": False, "set_rate": False, "droop": False}]
    assert not found["M_max"].significant
    assert any("fitted again with upper torque limit" in line for line in found.remarks)


def test_a_change_of_no_quantity_alone_names_where_it_shows(pair):
    def with_two(change_p: float, change_tau: float) -> Fingerprint:
        one = pair[0]
        kept = {
            "p": replace(one["p"], value=2.0 + change_p, std=0.1, ci95=(1.8 + change_p, 2.2 + change_p)),
            "tau_prop": replace(one["tau_prop"], value=0.4 + change_tau, std=0.02, ci95=None),
        }
        matrix = [[0.01, 0.99 * 0.002], [0.99 * 0.002, 4e-4]]  # a correlation of 0.99
        return replace(one, parameters=kept, derived={}, covariance={"names": [*kept], "matrix": matrix})

    # Each by one deviation of the difference, but against their correlation.
    found = compare(with_two(0.0, 0.0), with_two(0.14, -0.028))
    assert not any(change.significant for change in found.changes)
    assert found.joint.p < 1e-6
    assert set(found.joint.most) == {"p", "tau_prop"}
    assert "p by +7.0 % and tau_prop by -7.0 %" in found.verdict[0]
