"""Advised gains on the ships that they are for, and fingerprints of which nothing is advised."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.closed_loop import closed_loop
from shipfp_rs.assessment.si import parameters_of, with_parameters
from shipfp_rs.assessment.tuning import FIGURES, Steps, phase_margins, tune
from shipfp_rs.identification.usability import (
    BENT,
    LIMITED,
    LOAD_ONLY,
    MISSED,
    NO_GAUGE,
    TO_THE_METER,
    UNTESTED,
)
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.sentences import Sentence

KNOWN = {"T_M": 0.0, "T_f": 0.0, "tau_eng": 0.0, "c_2": 0.0, "tau_twist": 0.0}
"""What a yard may know of a simple ship; fewer unknowns make draws quick."""


def launch(**changes: float) -> fp.Vessel:
    vessel = fp.Vessel.load("stan-launch-804")
    return vessel.replace({"actuator.dead_time_s": 0.05, "actuator.lag_s": 0.08} | changes)


def fitted(vessel: fp.Vessel, seed: int = 1) -> fp.Fingerprint:
    chirp = fp.signals.chirp(0.01, 3.0, 200.0, 30.0, rate_hz=50.0)
    noise = {"n_e": 0.05, "M_b": 0.1}
    trial = fp.simulate(vessel, chirp, noise=noise, seed=seed)
    return fp.identify(trial, torque="brake", outputs=["dn", "dM"], fixed=KNOWN)


@cache
def told() -> fp.Fingerprint:
    return fitted(launch())


@cache
def advised():
    return tune(told(), recovery_s=4.0, dip_pct=2.0, draws=100)


def of_the_truth(vessel: fp.Vessel, advice) -> tuple[Structure, dict[str, float]]:
    """A ship's structure and true parameters."""
    structure = Structure.ship(
        ["dead_time_loop", "dead_time_set_point", "actuator_lag", "droop"],
        products=False,
        mean_sampling=True,
    )
    values = {"droop": 0.0, **parameters_of(vessel)}
    return structure, {name: float(values.get(name, 0.0)) for name in structure.names}


def test_margins_of_many_gains_are_those_of_the_loop_one_by_one():
    found = closed_loop(told())
    structure = Structure.from_dict(told().structure)
    margins, crossovers = phase_margins(structure, told().optimum, np.array([[1.0, 1.0]]))
    assert margins[0] == pytest.approx(found["phase margin"].value, abs=0.1)
    assert crossovers[0] == pytest.approx(found["crossover"].value, rel=0.03)


def test_the_steps_are_those_of_a_simulation_by_hand():
    vessel, size = launch(), 0.01
    structure, values = of_the_truth(vessel, None)
    test = Steps(size, 0.1, 0.01, 10.0, 5.0, {})
    (row,) = test.figures(structure, values, [(2.0, 3.0)])
    quicker = with_parameters(vessel, {"K_p": 2.0 * values["K_p"], "K_i": 3.0 * values["K_i"]})
    at = quicker.operating_point.n_e_rpm
    step = fp.Excitation("step", "step", 100.0, np.r_[np.zeros(1), np.full(999, size * at)], "zero")
    speed = fp.simulate(quicker, step).signals["n_e"]
    overshoot = 100.0 * (speed.max() / at - 1.0 - size) / size
    assert row[FIGURES.index("overshoot")] == pytest.approx(overshoot, rel=0.01, abs=0.1)


def test_a_drooping_governor_settles_where_its_droop_says():
    structure, values = of_the_truth(launch(**{"governor.droop": 0.05, "governor.K_i": 5.0}), None)
    test = Steps(0.01, 0.1, 1e-4, 40.0, 5.0, {})
    level, lower = test.settled(values)
    # Set point less droop times fuel, and fuel is what load and propeller take.
    regulates = values["p"] - values["g"]
    assert level == pytest.approx(0.01 - 0.05 * regulates * level)
    assert lower == pytest.approx(0.05 * (0.1 - regulates * lower))
    (row,) = test.figures(structure, values, [(1.0, 1.0)])
    assert row[FIGURES.index("recovery")] < 30.0  # back within 1e-4 of that level
    assert row[FIGURES.index("dip")] > 100.0 * lower


def test_a_droop_is_set_and_the_gains_are_for_it():
    advice = tune(told(), recovery_s=4.0, droop_pct=4.0, draws=60)
    assert advice.gains["droop"] == (0.0, 0.04)
    assert (
        advice.figures["dip"][0] > 0.04 * 10.0 / 2.0
    )  # it droops by 4 % of a tenth, propeller and engine take some


def test_advised_gains_meet_the_limits_on_the_true_ship():
    structure, values = of_the_truth(launch(), None)
    advice = advised()
    test = Steps(0.01, 0.1, 0.01, 20.0, 5.0, {**advice.limits, "crossover": np.inf})
    rows = test.figures(structure, values, [(advice.proportional, advice.integral), (1.0, 1.0)])
    assert test.met(rows)[0]
    assert advice.share >= 0.95
    assert rows[0, -1] < rows[1, -1]


def test_advice_is_in_the_units_of_the_dial():
    trial = replace(told(), settings={**told().settings, "governor": {"gain": 20.0, "reset": 0.5}})
    advice = tune(trial, recovery_s=4.0, draws=60)
    dial = advice.dials
    assert dial["gain"] == (20.0, pytest.approx(20.0 * advice.proportional))
    assert dial["reset"][1] == pytest.approx(0.5 * advice.integral / advice.proportional)
    assert tune(trial, recovery_s=4.0, draws=60, dials={"gain": 5.0}).dials.keys() == {"gain"}
    with pytest.raises(fp.InputError, match="dials: found Gain, expected some of gain, reset, droop_pct"):
        tune(trial, recovery_s=4.0, draws=60, dials={"Gain": 5.0})


def test_advice_is_the_same_for_the_same_seed_and_has_a_file_form():
    again = tune(told(), recovery_s=4.0, dip_pct=2.0, draws=100)
    assert again.gains == advised().gains
    assert json.loads(json.dumps(again.to_dict()))["share"] == again.share


REFUSED = {
    "of which only the load is told": {"usable": LOAD_ONLY},
    "whose model misses much": {"usable": Sentence(MISSED, share="4")},
    "with a limit": {"usable": LIMITED},
    "of too short a record": {"usable": UNTESTED},
    "that fits with large errors of the gauges alone": {"usable": BENT},
    "that ends at a meter": {"usable": TO_THE_METER},
    "whose torque is hardly a gauge's": {"usable": Sentence(NO_GAUGE, behind="97", over="3")},
    "that is not usable": {"usable": "Not usable: the model misses 30 % of the speed"},
    "that was not judged": {"usable": ""},
}


@pytest.mark.parametrize("kind", REFUSED)
def test_nothing_is_advised_for_a_fingerprint(kind):
    with pytest.raises(fp.InputError, match="expected one whose model of the loop is not in doubt"):
        tune(replace(told(), **REFUSED[kind]))


def test_nothing_is_advised_where_no_gains_meet_the_limits():
    with pytest.raises(
        fp.InputError,
        match=r"limits: found gains that meet them for at most .* do not keep to the limit of the dip",
    ):
        tune(told(), dip_pct=0.01, draws=60)


@pytest.mark.study
def test_advice_holds_on_the_true_ships():
    """Ships with other gains, dead times and lags; TUNING_SHIPS sets their number, TUNING_FOLDER keeps their results."""
    ships, met, answered = int(os.environ.get("TUNING_SHIPS", "40")), 0, 0
    folder = Path(os.environ.get("TUNING_FOLDER", "target/tuning"))
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(ships):
        file = folder / f"{seed}.json"
        if not file.is_file():
            file.write_text(json.dumps(_one_ship(seed)), encoding="utf-8")
        row = json.loads(file.read_text(encoding="utf-8"))
        answered += row["why"] == ""
        met += row["met"]
        print(f"ship {seed}: {row}; limits met on {met} of {answered}", flush=True)
    assert met >= 0.9 * answered


def _one_ship(seed: int) -> dict[str, object]:
    random = np.random.default_rng(seed)
    changes = {"actuator.dead_time_s": random.uniform(0.02, 0.1), "actuator.lag_s": random.uniform(0.0, 0.15)}
    changes["governor.droop"] = random.choice((0.0, random.uniform(0.02, 0.06)))
    vessel = launch(**changes)
    own = parameters_of(vessel)
    gains = {name: own[name] * np.exp(random.uniform(-0.7, 0.7)) for name in ("K_p", "K_i")}
    vessel = with_parameters(vessel, gains)
    try:
        advice = tune(fitted(vessel, seed), seed=seed)
    except fp.ShipfpError as error:
        return {"met": False, "why": str(error)[:100]}
    structure, values = of_the_truth(vessel, advice)
    test = Steps(0.01, 0.1, 0.01, 20.0, 5.0, {**advice.limits, "crossover": np.inf})
    rows = test.figures(structure, values, [(advice.proportional, advice.integral)])
    return {"met": bool(test.met(rows)[0]), "why": "", "share": advice.share}
